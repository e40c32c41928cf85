"""Flesh whose stress depends on the strain history, under the forces of all recordings.

fem.solid.initial_stress solves the law's equation. This module chooses the recordings' frames, maps solutions
to the markers, and selects the field from which the iteration starts.

A few frames of a recording are solved for. In the others a Gaussian process predicts the excess over the
linear law (Rasmussen and Williams 2006, "Gaussian Processes for Machine Learning", section 2.2). The next
frame chosen is that of greatest variance. The kernel of the process is

- for an elastic law, that of fem.estimation.frame_prediction;
- for a law with a history, Matern 5/2 (eq. 4.17) in the shares a of the recording's force patterns and in
  max |a| so far. With each frame, the frame in which its peak so far occurred is chosen too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from fem.estimation.frame_prediction import elastic_kernel, weights_of_known
from fem.fem_failure import FemFailure
from fem.materials.fung_neo_hookean import fung_neo_hookean, shrunk_as_a_whole
from fem.materials.strain_path import PathLaw, strain_energy
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse, PlainModel
from fem.solid.initial_stress import AddedStress
from fem.solid.linear_solid import Support

REACH = 2.0
"""Length scale of the Matern kernel, over a recording's greatest load."""
NUGGET = 1e-8
"""Added to the kernel's diagonal, over its greatest value: nearly equal frames would make it singular."""

LEAST_FRAMES = 3
"""Fewest frames of a recording under an elastic law. Set by hand: on one external case of four recordings,
three frames each give an error of 0.2 to 1.0 um in 30 um of large deformation, one or two frames 0.9 to
4 um."""


@dataclass(frozen=True, kw_only=True)
class PathFrames:
    """`chosen`: increasing indices among the frames used; `mix`: weights of these to predict every frame."""

    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]


def path_frames(grasps: Sequence[GraspResponse], count: int, *, remembers: bool) -> tuple[PathFrames, ...]:
    """About `count` frames in all, shared among recordings by predictive variance."""
    paths = (
        [_Path.with_history(recording.shares) for recording in grasps]
        if remembers
        else _elastic_paths([_work(recording) for recording in grasps])
    )
    count = min(count, sum(len(path.covariance) for path in paths))
    while sum(len(path.chosen) for path in paths) < count:
        path = max(paths, key=lambda path: path.unknown.max())
        path.learn(int(path.unknown.argmax()))
    return tuple(PathFrames(chosen=path.chosen, mix=path.mix) for path in paths)


@dataclass
class _Path:
    """One recording while its frames are chosen, that of greatest load first.

    `covariance`: of the frames. `brought`: the frame to choose with each. `mix`: weights of the chosen frames
    to predict every frame. `unknown`: remaining variance of each frame, -1 if chosen.
    """

    covariance: Float[np.ndarray, "f f"]
    brought: Int[np.ndarray, " f"]
    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]
    unknown: Float[np.ndarray, " f"]

    @classmethod
    def of(cls, covariance: Float[np.ndarray, "f f"], brought: Int[np.ndarray, " f"], first: int) -> "_Path":
        """With the frame `first` chosen."""
        path = cls(
            covariance=covariance,
            brought=brought,
            chosen=np.zeros(0, dtype=np.int64),
            mix=np.zeros((len(covariance), 0)),
            unknown=np.diag(covariance).copy(),
        )
        path.learn(first)
        return path

    @classmethod
    def with_history(cls, shares: Float[np.ndarray, "f r"]) -> "_Path":
        """For a law that depends on the largest load so far."""
        size = np.linalg.norm(shares, axis=1)
        peak = np.maximum.accumulate(size)
        states = np.column_stack([shares, peak]) / max(float(size.max()), 1e-300)
        return cls.of(_matern(states), np.searchsorted(peak, peak), int(size.argmax()))

    def learn(self, frame: int) -> None:
        """Chooses one more frame, and the frame `brought` with it."""
        self.chosen = np.union1d(self.chosen, [frame, self.brought[frame]])
        jitter = NUGGET * max(float(self.covariance.max()), 1e-300)
        self.mix = weights_of_known(self.covariance, self.chosen, jitter).T
        self.unknown = np.diag(self.covariance) - (self.mix * self.covariance[:, self.chosen]).sum(axis=1)
        self.unknown[self.chosen] = -1.0


def _elastic_paths(work: Sequence[Float[np.ndarray, "_ _"]]) -> list[_Path]:
    """For laws without a history, with LEAST_FRAMES chosen in each; the greatest work sets the scale."""
    greatest = max(max(float(np.diag(each).max()) for each in work), 1e-300)
    paths = []
    for each in work:
        path = _Path.of(elastic_kernel(each, greatest), np.arange(len(each)), int(np.diag(each).argmax()))
        while len(path.chosen) < min(LEAST_FRAMES, len(each)):
            path.learn(int(path.unknown.argmax()))
        paths.append(path)
    return paths


def _work(recording: GraspResponse) -> Float[np.ndarray, "f f"]:
    """f . C f of every pair of frames, N mm MPa."""
    work = np.einsum("rnx,snx->rs", recording.patterns, recording.response, optimize=True)
    return np.asarray(recording.shares @ work @ recording.shares.T)


def _matern(states: Float[np.ndarray, "f d"]) -> Float[np.ndarray, "f f"]:
    x = np.sqrt(5) / REACH * cdist(states, states)
    return np.asarray((1 + x + x**2 / 3) * np.exp(-x))


MOST_ROUNDS = 40
"""Most iterations: cases with these effects converge in 1 to 10."""
CLOSE_MM = 6e-4
"""Iterations stop when no node of the skin moves by more than this, a tenth of a marker's noise."""

SMALL_SHARE = 1e-4
"""Force fields below this share of the largest are left out of an iteration."""


@dataclass(frozen=True, kw_only=True)
class PathState:
    """The chosen frames of all recordings one after the other. `linear`: v0 (fem.solid.initial_stress)."""

    base: PlainModel
    frames: tuple[PathFrames, ...]
    linear: Float[np.ndarray, "f n 3"]

    @classmethod
    def of(cls, base: PlainModel, frames: tuple[PathFrames, ...]) -> "PathState":
        """Under the recordings' forces."""
        fields = [
            _combined(recording, chosen_frames)
            for recording, chosen_frames in zip(base.grasps, frames, strict=True)
        ]
        return cls(base=base, frames=frames, linear=np.concatenate(fields))

    @property
    def first(self) -> list[int]:
        """Index of each recording's first frame, and the number of frames."""
        return [0, *np.cumsum([len(chosen_frames.chosen) for chosen_frames in self.frames]).tolist()]

    def among(self, other: "PathState") -> Int[np.ndarray, " f"]:
        """Indices of these frames in a state of more frames of the same recordings. Raises ValueError if it
        lacks one of them.
        """
        places = []
        for first, few, more in zip(other.first[:-1], self.frames, other.frames, strict=True):
            if not np.isin(few.chosen, more.chosen).all():
                raise ValueError("the other state lacks frames of this one")
            places.append(first + np.searchsorted(more.chosen, few.chosen))
        return np.concatenate(places)

    def response(self, force: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """K0^-1 times nodal forces, each recording with its own support."""
        displacement = np.empty_like(force)
        for support, solid in self.base.solids.items():
            held = self._held(support)
            turn, parts = _few(force[held])
            displacement[held] = np.tensordot(turn, solid.displacement(parts), axes=1)
        return displacement

    def marker_responses(
        self, forces: Sequence[Float[np.ndarray, "f n 3"]]
    ) -> list[list[Float[np.ndarray, "_f _n 3"]]]:
        """`at_markers` of the `response` to the forces of several laws, which are solved for together."""
        by_law: list[dict[str, Float[np.ndarray, "_f _n 3"]]] = [{} for _ in forces]
        for support, solid in self.base.solids.items():
            held = self._held(support)
            turns, parts = zip(*(_few(force[held]) for force in forces), strict=True)
            on_skin = solid.contact_displacement(np.concatenate(parts))
            cuts = np.cumsum([len(part) for part in parts])[:-1]
            for responses, turn, part in zip(by_law, turns, np.split(on_skin, cuts), strict=True):
                moved, first = np.tensordot(turn, part, axes=1), 0
                for recording, frames in zip(self.base.grasps, self.frames, strict=True):
                    if recording.case.support == support:
                        after = first + len(frames.chosen)
                        seen_at = recording.seen(moved[first:after])
                        responses[recording.case.name] = np.tensordot(frames.mix, seen_at, axes=1)
                        first = after
        return [[responses[recording.case.name] for recording in self.base.grasps] for responses in by_law]

    def at_markers(self, field: Float[np.ndarray, "f m 3"]) -> Fields:
        """At every recording's markers, in all frames."""
        responses = []
        for recording, chosen_frames, a, b in zip(
            self.base.grasps, self.frames, self.first, self.first[1:], strict=False
        ):
            seen_at = recording.at_markers(field[a:b])
            responses.append(np.tensordot(chosen_frames.mix, seen_at, axes=1))
        return responses

    def _held(self, support: Support) -> Int[np.ndarray, " g"]:
        """Frames of the recordings with this support."""
        of_recording = [recording.case.support == support for recording in self.base.grasps]
        return np.flatnonzero(np.repeat(of_recording, np.diff(self.first)))


def _few(
    fields: Float[np.ndarray, "f n 3"],
) -> tuple[Float[np.ndarray, "f r"], Float[np.ndarray, "r n 3"]]:
    """The fields' coefficients in an orthogonal basis, and the basis: proportional frames share one basis
    field.
    """
    flat = fields.reshape(len(fields), -1)
    size, turn = np.linalg.eigh(flat @ flat.T)
    kept = size > SMALL_SHARE**2 * max(float(size[-1]), 1e-300)
    kept[-1] = True
    return turn[:, kept], (turn[:, kept].T @ flat).reshape(-1, *fields.shape[1:])


def _combined(recording: GraspResponse, chosen_frames: PathFrames) -> Float[np.ndarray, "k n 3"]:
    return np.asarray(np.tensordot(recording.shares[chosen_frames.chosen], recording.moved, axes=1))


def path_state(model: CaseModel, *, frames: int, remembers: bool) -> PathState:
    """The model's recordings in about so many frames (times its path_share), chosen once."""

    def compute() -> PathState:
        count = max(round(model.path_share * frames), len(model.grasps))
        return PathState.of(model.base, path_frames(model.grasps, count, remembers=remembers))

    return model.memoised(("path", frames, remembers), compute)


def fixed_point(
    model: CaseModel,
    state: PathState,
    law: PathLaw,
    *,
    name: str,
    place: Float[np.ndarray, " p"],
    together: bool,
    start: Float[np.ndarray, "f n 3"] | None = None,
    stiffer: Float[np.ndarray, " f"] | None = None,
) -> Float[np.ndarray, "f n 3"]:
    """v - v0 of flesh with this law, to CLOSE_MM at the skin; see AddedStress, also for `together`.

    The iteration starts from the search's solution nearest to `place` (the law's parameters) under this
    `name`, else from `start` (None: zero). `stiffer`: None for laws that soften. Raises FemFailure
    (NOT_CONVERGED).
    """
    problem = AddedStress(
        linear=state.linear,
        added_force=lambda moved: model.pieces.forces(moved, law),
        response=state.response,
        compliance=model.compliance,
        stiffer=np.ones(len(state.linear)) if stiffer is None else stiffer,
        skin=state.base.case.mesh.outer_nodes,
    )
    known = None if model.warm_starts is None else model.warm_starts.nearest(name, place)
    more = problem.beyond_linear(
        start=start if known is None else known[1],
        together=together,
        tolerance_mm=CLOSE_MM,
        rounds=MOST_ROUNDS,
    )
    if model.warm_starts is not None:
        model.warm_starts.keep(name, place, more.astype(np.float32))
    return more


def whole_response(state: PathState, more: Float[np.ndarray, "f m 3"]) -> Fields:
    """The markers' displacement in every recording: the linear one plus v - v0 = `more`."""
    return [
        recording.tracks.unit_displacement + displacement
        for recording, displacement in zip(state.base.grasps, state.at_markers(more), strict=True)
    ]


FRAMES = 24
"""Frames of all recordings together."""
HARDLY_ANY = 0.1
"""Stiffening b that is negligible: W/mu is a hundredth at strains of a tenth, so that the law is
Neo-Hookean."""


def stiffening_path(model: CaseModel) -> PathState:
    """The frames in which the law is solved."""
    return path_state(model, frames=FRAMES, remembers=False)


def beyond_linear(model: CaseModel, b: float) -> Float[np.ndarray, "f n 3"]:
    """v - v0 (fem.solid.initial_stress), starting from the linear field times a factor or a warm start.

    Finite strain, dead loads on the unloaded skin. Raises FemFailure (NOT_CONVERGED).
    """
    nu, s = model.poisson_ratio, model.compliance
    state, pieces = stiffening_path(model), model.pieces
    energy = pieces.measured(s * state.linear, lambda gradient: strain_energy(gradient, poisson_ratio=nu))
    shrunk, steepest = shrunk_as_a_whole(energy, pieces.volume_mm3, b, poisson_ratio=nu)
    return fixed_point(
        model,
        state,
        fung_neo_hookean(b, poisson_ratio=nu),
        name="stiffening",
        place=np.log([b * s**2, s]),
        together=False,
        start=(shrunk - 1)[:, None, None] * state.linear,
        stiffer=steepest,
    )


def neo_hookean_field(model: CaseModel) -> Float[np.ndarray, "f n 3"] | FemFailure:
    """`beyond_linear` of Neo-Hookean flesh; or the failure, if flesh is so soft that the iteration from the
    linear field does not converge. Solved for once; at another 1/E it is scaled in proportion.
    """

    def compute() -> tuple[float, Float[np.ndarray, "f n 3"] | FemFailure]:
        try:
            return model.compliance, beyond_linear(model, HARDLY_ANY)
        except FemFailure as failure:
            return model.compliance, failure

    compliance, field = model.memoised("neo-hookean", compute)
    return field if isinstance(field, FemFailure) else model.compliance / compliance * field
