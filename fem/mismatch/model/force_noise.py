"""Errors in variables: draws of the noise in a recording's forces, and its bias on fields linear in them.

A regression on a noisy regressor is biased, and not only attenuated. Noise that is independent between
markers has short wavelengths. A model that responds less to these, as with a stiff surface, fits better.
Uncorrected, marker noise of 4 um on soft fruit without mismatch looks like a skin of 0.3 to 0.5 mm. The log
Bayes factor of that is 3 to 27. The noise also looks like flesh that is firmer outside.

The model's response c = C f contains the noise of the forces. If forces are computed from the gel's springs
(fem.estimation.denoised_force), this is the noise of the markers' own displacement. Every field phi that is
linear in the forces contains it too. So noise alone gives its product with the data a nonzero mean:

    n = E[phi(df) . W e],        e = dy - s C df

dy, df: noise of the markers' positions, and of the forces after projection on their patterns. The normal
equations use b_i - n_i for b_i = phi_i . W y (corrected score: Nakamura 1990, Biometrika 77; Fuller 1987,
Measurement Error Models, section 2.2). The projection of W e on the forces' patterns,
g_r = sum_t a_r(t) (W e)(t), and its adjoint field K0^-1 L g_r serve every phi. If phi is a change of the
flesh's law, phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r),

    phi(df) . W e = s sum_r (K0^-1 L g_r) . b(dU_r)

A model with an effect, which resembles its signatures phi in amounts a, has a different noise. With
Q = E[phi(df) . W phi(df)], the square of its noise is less than that of the plain model by

    2 a.n - a.Q a,        and the products of columns phi_j with it are n_j - Q_j a

At r times the 1/E of the draws, e is dy - r s C df. With q = E[phi(df) . W s C df] a product n becomes
n + (1 - r) q (`of_response`).

Noise has short wavelengths, and an effect that stiffens the surface soon removes most of its response. The
square is least at the amounts t a, t = a.n / a.Q a; beyond these it is kept constant.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from fem.cached_value import cached_value
from fem.estimation.coloured_noise import drawn_coloured_noise
from fem.estimation.denoised_force import DenoisedForce
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.frame_thinning import spacing
from fem.estimation.sensitivity import inner_forces, inner_work
from fem.grasp_history import PadHistory
from fem.mismatch.model.plain_model import GraspResponse, PlainModel
from fem.parallel_map import parallel_map

DRAWS = 2
"""Draws of a recording's noise. Each has some thousand independent numbers, so n changes by a tenth between
draws; the correction is about as large as the amounts' standard deviations."""
WeighedMarkers: TypeAlias = Callable[[Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]
"""W of a recording: the map from a field phi of its markers to W phi."""


@dataclass(frozen=True, kw_only=True)
class ForceNoise:
    """p draws of one recording's noise, each by patterns r; s is the plain model's 1/E.

    `force_N`: df_r on the markers. `moved`: dU_r = K0^-1 L df_r at all nodes (E = 1 MPa). `response`: C df_r
    at the markers, of the finer mesh if the recording has it. `weighed`: W e. `adjoint`: K0^-1 L g_r at all
    nodes, `adjoint_response` at the markers.
    """

    compliance: float
    recording: GraspResponse
    force_N: Float[np.ndarray, "p r n 3"]
    moved: Float[np.ndarray, "p r m 3"]
    response: Float[np.ndarray, "p r n 3"]
    weighed: Float[np.ndarray, "p f n 3"]
    adjoint: Float[np.ndarray, "p r m 3"]
    adjoint_response: Float[np.ndarray, "p r n 3"]

    def of_draws(self, products: Float[np.ndarray, " p"]) -> float:
        """Mean over draws, times the share of frames kept: frames left out contribute to the patterns too."""
        return float(products.mean()) * self.recording.kept

    def with_weighed(self, fields: Float[np.ndarray, "p f n 3"]) -> float:
        """n of a field that each draw has at the markers."""
        return self.of_draws(np.einsum("pfnx,pfnx->p", fields, self.weighed))

    def solved(self, loads: Float[np.ndarray, "p r m 3"]) -> Float[np.ndarray, "p f n 3"]:
        """s sum_r a_r(t) L' K0^-1 b_r at the markers, with b_r the nodal loads of the first patterns."""
        moved = self.recording.solid.displacement(loads.reshape(-1, *loads.shape[2:]))
        seen = self.recording.at_markers(moved)
        return self.over_time(seen.reshape(*loads.shape[:2], *seen.shape[1:]))

    @property
    def leading(self) -> Float[np.ndarray, "p r m 3"]:
        """`moved` for the patterns with which laws of the flesh are solved (GraspResponse.leading)."""
        return self.moved[:, : self.recording.finer.first]

    def over_time(self, response: Float[np.ndarray, "p r n 3"]) -> Float[np.ndarray, "p f n 3"]:
        """s sum_r a_r(t) c_r, c_r the responses to the first patterns."""
        shares = self.recording.shares[:, : response.shape[1]]
        return np.asarray(self.compliance * np.einsum("fr,prnx->pfnx", shares, response))

    def of_response(self, weigh: WeighedMarkers) -> "ForceNoise":
        """The same draws with s C df for e; `weigh`: W. One solve."""
        weighed = np.stack([weigh(draw) for draw in self.over_time(self.response)])
        pulled = np.einsum("fr,pfnx->prnx", _shares(self.recording), weighed)
        moved, seen = _solved_on(self.recording, pulled)
        return replace(self, weighed=weighed, adjoint=moved, adjoint_response=seen)

    @cached_value
    def inner_products(self) -> dict[str, float]:
        """n / s of pit and Poisson's ratio for each cause (fem.estimation.sensitivity).

        Each recording's surface undulations are eliminated separately, without n.
        """
        moved, adjoint = self.leading, self.adjoint[:, : self.leading.shape[1]]
        flat = (-1, *moved.shape[2:])
        work = inner_work(self.recording.solid, moved.reshape(flat), adjoint.reshape(flat))
        return {
            cause: self.of_draws(cause_work.reshape(moved.shape[:2]).sum(axis=1))
            for cause, cause_work in work.items()
        }


class LinearInForces(Protocol):
    """A linear map from forces to a field."""

    def product(self, noise: ForceNoise) -> float:
        """n of the module's docstring for one recording."""
        ...

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """phi(df) of each draw at the markers, mm per unit of the column."""
        ...


@dataclass(frozen=True)
class OfFlesh:
    """phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r), r the leading patterns (GraspResponse.leading).

    `load`: b, from fields of a recording's flesh to nodal forces.
    """

    load: Callable[[GraspResponse, Float[np.ndarray, "q m 3"]], Float[np.ndarray, "q m 3"]]

    def product(self, noise: ForceNoise) -> float:
        """From the adjoint fields, no solve."""
        loads = self._loads(noise)
        work = np.einsum("prmx,prmx->p", noise.adjoint[:, : loads.shape[1]], loads, optimize=True)
        return noise.compliance * noise.of_draws(work)

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern."""
        return noise.solved(self._loads(noise))

    def _loads(self, noise: ForceNoise) -> Float[np.ndarray, "p r m 3"]:
        moved = noise.leading
        return self.load(noise.recording, moved.reshape(-1, *moved.shape[2:])).reshape(moved.shape)


@dataclass(frozen=True)
class OfResponse:
    """phi = s part(c), `part` linear in a recording's response c(t)."""

    part: Callable[[GraspResponse, Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """Directly."""
        return noise.with_weighed(self.fields(noise))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """Without a solve."""
        return np.stack([self.part(noise.recording, draw) for draw in noise.over_time(noise.response)])


@dataclass(frozen=True)
class OfFinerMesh:
    """phi = s (c - L' U): what the finer mesh adds (fem.mismatch.model.finer_mesh)."""

    def product(self, noise: ForceNoise) -> float:
        """Directly."""
        return noise.with_weighed(self.fields(noise))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """Without a solve."""
        moved = noise.moved.reshape(-1, *noise.moved.shape[2:])
        coarse = noise.recording.at_markers(moved).reshape(noise.response.shape)
        return noise.over_time(noise.response - coarse)


@dataclass(frozen=True)
class OfSomeForces:
    """phi = s C g(f). `part`: g, linear in the forces on a recording's markers, such as a subset of them."""

    part: Callable[[GraspResponse, Float[np.ndarray, "q n 3"]], Float[np.ndarray, "q n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """By the adjoint fields at the markers."""
        force_N = self._forces(noise)
        return noise.compliance * noise.of_draws(np.einsum("prnx,prnx->p", noise.adjoint_response, force_N))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern."""
        force_N = self._forces(noise)
        loads = noise.recording.loads(force_N.reshape(-1, *force_N.shape[2:]))
        return noise.solved(loads.reshape(*force_N.shape[:2], *loads.shape[1:]))

    def _forces(self, noise: ForceNoise) -> Float[np.ndarray, "p r n 3"]:
        flat = noise.force_N.reshape(-1, *noise.force_N.shape[2:])
        return self.part(noise.recording, flat).reshape(noise.force_N.shape)


ALL = OfResponse(lambda _, response: response)
"""phi = s c: the response itself."""


@dataclass(frozen=True)
class OfInnerChange:
    """phi = s dc/dp of a cause inside the fruit (fem.estimation.sensitivity); zero without that cause."""

    cause: str

    def product(self, noise: ForceNoise) -> float:
        """By the work of the adjoint fields."""
        return noise.compliance * noise.inner_products.get(self.cause, 0.0)

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern."""
        recording, moved = noise.recording, noise.leading
        causes, loads = inner_forces(
            recording.solid, moved.reshape(-1, *moved.shape[2:]), list(recording.links), with_surface=False
        )
        if self.cause not in causes:
            return np.zeros_like(noise.weighed)
        return noise.solved(loads[list(causes).index(self.cause)].reshape(moved.shape))


def drawn_force_noise(
    base: PlainModel,
    weighed_markers: Sequence[WeighedMarkers],
    *,
    compliance: float,
    draws: int = DRAWS,
    workers: int = 1,
) -> list[ForceNoise]:
    """Draws of each recording's noise, as measured in its no-contact frames, with their adjoint fields.

    One solve serves the fields of all recordings. `draws`: the first of DRAWS.
    """
    drawn = parallel_map(
        lambda recording: drawn_noise(recording, base.case.budget), base.grasps, workers=workers
    )
    drawn = [(places[:draws], force_N[:draws]) for places, force_N in drawn]
    forces = [force_N for _, force_N in drawn]
    solved = _solved(base, forces)
    responses = [
        coarse if recording.finer_noise is None else recording.finer_noise[:draws]
        for recording, (_, coarse) in zip(base.grasps, solved, strict=True)
    ]
    weighed, pulled = [], []
    for recording, weigh, (places, _), response in zip(
        base.grasps, weighed_markers, drawn, responses, strict=True
    ):
        share = _shares(recording)
        excess = places - compliance * np.einsum("fr,prnx->pfnx", share, response)
        weighed.append(np.stack([weigh(draw) for draw in excess]))
        pulled.append(np.einsum("fr,pfnx->prnx", share, weighed[-1]))
    adjoint = _solved(base, pulled)
    return [
        ForceNoise(
            compliance=compliance,
            recording=recording,
            force_N=forces[k],
            moved=solved[k][0],
            response=responses[k],
            weighed=weighed[k],
            adjoint=adjoint[k][0],
            adjoint_response=adjoint[k][1],
        )
        for k, recording in enumerate(base.grasps)
    ]


def _shares(recording: GraspResponse) -> Float[np.ndarray, "f r"]:
    """Shares of the patterns that contain the forces' noise."""
    return recording.shares[:, : recording.finer.first + recording.finer.count]


def drawn_noise(
    recording: GraspResponse, budget: ErrorBudget
) -> tuple[Float[np.ndarray, "p f n 3"], Float[np.ndarray, "p r n 3"]]:
    """DRAWS draws of the noise of the markers' positions, and of the forces for each pattern; every call has
    the same.
    """
    rng = np.random.default_rng(0)
    drawn = [
        _of_pad(pad, denoised, recording.used, budget, DRAWS, rng)
        for pad, denoised in zip(recording.case.history.pads, recording.denoised, strict=True)
    ]
    places, forces = (np.concatenate(parts, axis=2) for parts in zip(*drawn, strict=True))
    shares = _shares(recording)
    return places, recording.finer.of_noise(
        np.einsum("fr,pfnx->prnx", shares / (shares**2).sum(axis=0), forces)
    )


def _of_pad(
    pad: PadHistory,
    denoised: DenoisedForce,
    used: Bool[np.ndarray, " t"],
    budget: ErrorBudget,
    draws: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "p f n 3"], Float[np.ndarray, "p f n 3"]]:
    """Noise of the markers' positions and of the denoised forces, from frame noise and marker scales."""
    moved, force = pad.gel_displacement_mm[used], pad.force_N[used]
    shape, lag1 = (draws, *moved.shape), pad.lag1 ** spacing(used)
    one_each = (draws, 1, moved.shape[1], 1)
    places = pad.displacement_sd_mm * drawn_coloured_noise(shape, lag1, rng)
    places += budget.gel_scale_sd * rng.normal(size=one_each) * moved
    felt = pad.force_sd_N * drawn_coloured_noise(shape, lag1, rng)
    felt += budget.force_scale_sd * rng.normal(size=one_each) * force
    flat = (-1, *moved.shape[1:])
    return places, denoised.noise(places.reshape(flat), felt.reshape(flat)).reshape(shape)


def _solved(
    base: PlainModel, force_N: Sequence[Float[np.ndarray, "_p _r _n 3"]]
) -> list[tuple[Float[np.ndarray, "_p _r _m 3"], Float[np.ndarray, "_p _r _n 3"]]]:
    """K0^-1 L f of the whole flesh and at the markers (E = 1 MPa), recording by recording."""
    loads = [
        recording.loads(forces.reshape(-1, *forces.shape[2:]))
        for recording, forces in zip(base.grasps, force_N, strict=True)
    ]
    return [
        _by_draw(recording, forces, moved)
        for recording, forces, moved in zip(base.grasps, force_N, base.displacements(loads), strict=True)
    ]


def _solved_on(
    recording: GraspResponse, force_N: Float[np.ndarray, "p r n 3"]
) -> tuple[Float[np.ndarray, "p r m 3"], Float[np.ndarray, "p r n 3"]]:
    """The same on one recording."""
    loads = recording.loads(force_N.reshape(-1, *force_N.shape[2:]))
    return _by_draw(recording, force_N, recording.solid.displacement(loads))


def _by_draw(
    recording: GraspResponse, force_N: Float[np.ndarray, "p r n 3"], moved: Float[np.ndarray, "q m 3"]
) -> tuple[Float[np.ndarray, "p r m 3"], Float[np.ndarray, "p r n 3"]]:
    """Displacements of all draws and patterns, at all nodes and at the markers."""
    return (
        moved.reshape(*force_N.shape[:2], *moved.shape[1:]),
        recording.at_markers(moved).reshape(force_N.shape),
    )


@dataclass(frozen=True, kw_only=True)
class NoiseOfChange:
    """For each recording: `square`: decrease of the noise's square by the effect and the other 1/E; `plain`:
    n of the plain model's column with both; `signatures`: n of each of the effect's signatures.
    """

    square: Float[np.ndarray, " k"]
    plain: Float[np.ndarray, " k"]
    signatures: Float[np.ndarray, "k c"]


def noise_of_change(
    bias: Float[np.ndarray, "k c1"],
    products: Float[np.ndarray, "k c1 c1"],
    amounts: Float[np.ndarray, " c"],
    *,
    share: float,
) -> NoiseOfChange:
    """Noise terms with an effect, from n (`bias`), Q (`products`; first row: q) and its signatures'
    `amounts`, at `share` times the 1/E.
    """
    less, across = 1 - share, products[:, 0]
    square = -2 * less * bias[:, 0] - less**2 * across[:, 0]
    at_share = bias + less * across
    of_signatures, plain, without = products[:, 1:, 1:], share * at_share[:, 0], at_share[:, 1:]
    gained, lost = float((without @ amounts).sum()), float((of_signatures @ amounts @ amounts).sum())
    reached = amounts * (gained / lost if 0 < gained < lost else 1.0)
    signatures = without - of_signatures @ reached
    return NoiseOfChange(
        square=square + (without + signatures) @ reached,
        plain=plain + (signatures - share * across[:, 1:]) @ reached,
        signatures=signatures,
    )


def noise_products(
    columns: Sequence[LinearInForces | None], noise: ForceNoise, weighed_markers: WeighedMarkers
) -> Float[np.ndarray, "c c"]:
    """Q of one recording; zero for columns that are not linear in the forces."""
    products = np.zeros((len(columns),) * 2)
    fields = {j: column.fields(noise) for j, column in enumerate(columns) if column is not None}
    weighed = {j: np.stack([weighed_markers(draw) for draw in draws]) for j, draws in fields.items()}
    for i, field in fields.items():
        for j, other in weighed.items():
            products[i, j] = noise.of_draws(np.einsum("pfnx,pfnx->p", field, other))
    return products
