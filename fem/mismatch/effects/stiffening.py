"""`stiffening`: flesh that grows stiffer the more it is strained.

    P(F) = exp(b W / mu) P_nh,     P_nh = mu (F - F^-T) + lambda ln(J) F^-T = dW/dF,
    W = mu/2 (F : F - 3 - 2 ln J) + lambda/2 (ln J)^2,      F = I + grad u,  J = det F

the exponential of Fung (1967, "Elasticity of soft tissues in simple elongation", American Journal of
Physiology 213) on the Neo-Hookean law in the form of Bonet and Wood (2008, "Nonlinear Continuum Mechanics for
Finite Element Analysis", eq. 6.28). Where it stiffens much, strains of a tenth are in play, and small strains
would ask for a b an eighth too large.

Two signatures. b W/mu times the linear stress, W of small strain, in the plain model's field: it exaggerates,
as the field itself gives way less for it; the start takes the b at which the plain field, shrunk as a whole,
does the same work. And the Neo-Hookean law with hardly any b, in full: flesh that does not stiffen departs
from small strain by its large deformation alone, in another pattern.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants
from fem.fem_failure import FemFailure
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, NextGrasp, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.stress_history import PathState, first_guess, fixed_point, keep_run, path_state
from fem.mismatch.result import Parameter
from fem.mismatch.signature_variant import ONE_WAY, InMode, Variant
from fem.solid.flesh_pieces import FleshPieces, Tensors
from fem.solid.small_strain import Points, linear_stress, on_diagonal, strain_energy, trace

B = "b"
PRIOR_SD = 30.0
"""Of b in the linear round. Set by hand, as large as strong stiffening in the samples
(samples.mismatch.strengths)."""
NEO_HOOKEAN = "neo-hookean"
HARDLY = 1.0
"""b from which flesh that is Neo-Hookean at most is searched."""
DOUBTFUL = 0.5
"""Relative standard deviation from which b cannot be told from nothing: then half of it does as well, and the
less there is of it the less it changes."""
FRAMES = 24
"""Frames of all recordings together."""
LEAST_VOLUME = 0.01
"""Flesh is never pressed to less than this share of its volume, not even while rounds go on."""
STEEPEST = 4.0
"""b W/mu above which the exponential goes on as a straight line: no round of the search may run away."""

SPEC = EffectSpec(
    name="stiffening",
    rank=20,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh stiffens the further it is pressed",
        meaning="The resistance grows faster than the squeeze: a deep grasp makes the fruit look firmer "
        "than a light one. Some of it is large deformation alone, which no soft fruit is without.",
        advice="Grasp all fruit equally deep and gently, or apply the effect so that the modulus is that of "
        "the first touch.",
    ),
    parameters=(
        number(
            B,
            "1",
            "how fast the flesh stiffens",
            limits=(-10.0, 1e3),
            low=0.1,
            high=400.0,
            log=True,
            model_share=0.05,
            strain_power=-2.0,
            low_is_a_law=True,
        ),
    ),
    separated_by=(
        ("damage", NextGrasp.CYCLES),
        ("plastic_set", NextGrasp.CYCLES),
        ("gripper_compliance", NextGrasp.DEPTHS),
        ("skin", NextGrasp.DEPTHS),
        ("poisson_ratio", NextGrasp.DEPTHS),
        ("graded_modulus", NextGrasp.DEPTHS),
    ),
    modes=(NEO_HOOKEAN,),
    holds_large_deformation=True,
)
"""Limits and bounds are wide, errors measured: see fem.mismatch.effect_spec."""


@dataclass(frozen=True)
class Stiffening:
    """The effect; see the module."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The exponential's, its amount b, and the Neo-Hookean law's, its amount 1."""
        state = path_state(forward, frames=FRAMES, remembers=False)
        nu, s = forward.poisson_ratio, forward.compliance
        mu = unit_lame_constants(nu)[0]

        def law(gradient: Tensors) -> Tensors:
            grown = strain_energy(gradient, poisson_ratio=nu) / mu
            return np.asarray(grown[:, :, None, None] * linear_stress(gradient, poisson_ratio=nu))

        more = -state.response(
            FleshPieces.whole(forward.points, workers=forward.workers).forces(s * state.linear, law)
        )
        fields = [ObservationDelta(markers=own) for own in state.at_markers(more)]
        found = [
            Signature(
                variant=ONE_WAY, columns=(Regressor(name=B, sd=PRIOR_SD, positive=True, fields=fields),)
            )
        ]
        try:
            moved = _beyond_linear(forward, self.spec.searched[0].low, guess=None)
        except FemFailure as failure:  # flesh so soft that the search from the linear answer does not settle
            return [*found, Signature(variant=InMode(mode=NEO_HOOKEAN), columns=(), untried=failure.detail)]
        large = state.at_markers(moved)
        beyond = [ObservationDelta(markers=s * own) for own in large]
        column = Regressor(name=NEO_HOOKEAN, sd=1.0, positive=True, fields=beyond)
        return [*found, Signature(variant=InMode(mode=NEO_HOOKEAN), columns=(column,))]

    def start(
        self,
        forward: ForwardModel,
        signature: Signature,
        amounts: Float[np.ndarray, " k"],
    ) -> dict[str, float]:
        """The amount within the bounds: about the modulus that fits best, both halves of the error cancel."""
        if signature.variant == InMode(mode=NEO_HOOKEAN):
            return {B: HARDLY}
        return {B: float(np.clip(amounts[0], 1.0, 200.0))}

    def remark(self, parameters: Mapping[str, Parameter]) -> str:
        """Where b may as well be nothing."""
        b = parameters[B]
        if not (isinstance(b.value, float) and isinstance(b.sd, float)) or b.sd < DOUBTFUL * b.value:
            return ""
        return (
            f"b = {b.value:.1f} ± {b.sd:.1f} may as well be nothing: what shows is then the flesh's large "
            "deformation by itself, which no soft fruit is without."
        )

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Neo-Hookean flesh with Fung's factor; finite strain, dead loads on the unloaded skin."""
        b, s = parameters[B], forward.compliance
        state = path_state(forward, frames=FRAMES, remembers=False)
        place = np.log([b * s**2, s])
        more = _beyond_linear(forward, b, guess=first_guess(forward, self.spec.name, place))
        keep_run(forward, self.spec.name, place, more)
        return Response(
            unit=[
                recording.tracks.unit_displacement + own
                for recording, own in zip(forward.base.grasps, state.at_markers(more), strict=True)
            ]
        )


def _beyond_linear(
    forward: ForwardModel, b: float, *, guess: Float[np.ndarray, "f n 3"] | None
) -> Float[np.ndarray, "f n 3"]:
    """v - v0 (fem.mismatch.model.stress_history), from a guess of it."""
    nu, s = forward.poisson_ratio, forward.compliance
    state = path_state(forward, frames=FRAMES, remembers=False)
    pieces = FleshPieces.whole(forward.points, workers=forward.workers)
    shrunk, steepest = _shrunk(pieces, state, b, s, nu)

    def law(gradient: Tensors) -> Tensors:
        return np.asarray(
            fung_neo_hookean(gradient, b, poisson_ratio=nu) - linear_stress(gradient, poisson_ratio=nu)
        )

    return fixed_point(
        state,
        lambda moved: pieces.forces(moved, law),
        compliance=s,
        stiffer=steepest,
        start=(shrunk - 1)[:, None, None] * state.linear if guess is None else guess,
        together=False,
    )


@np.errstate(over="ignore", invalid="ignore")
def fung_neo_hookean(gradient: Tensors, b: float, *, poisson_ratio: float) -> Tensors:
    """First Piola stress for E = 1 MPa."""
    mu, lame = unit_lame_constants(poisson_ratio)
    F = on_diagonal(gradient.copy(), np.ones_like(gradient[:, :, 0, 0]))
    cofactor = np.empty_like(F)
    for j in range(3):
        for i in range(3):
            p, q, r, s = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            cofactor[:, :, j, i] = F[:, :, p, r] * F[:, :, q, s] - F[:, :, p, s] * F[:, :, q, r]
    J, log_J = _volume_ratio(gradient)
    # F : F - 3 = 2 tr H + H : H, whose parts would cancel in single precision otherwise
    energy = trace(gradient) + (gradient**2).sum(axis=(2, 3)) / 2 - log_J + lame / mu / 2 * log_J**2
    factor = _exponential(b * energy)
    F *= (mu * factor)[:, :, None, None]
    F += (factor * (lame * log_J - mu) / J)[:, :, None, None] * cofactor
    return F


def _volume_ratio(H: Tensors) -> tuple[Points, Points]:
    """J = det(I + H), never below LEAST_VOLUME, and its logarithm, of which little is lost near 1."""
    grown = trace(H)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        grown = grown + H[:, :, i, i] * H[:, :, j, j] - H[:, :, i, j] * H[:, :, j, i]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        grown = grown + H[:, :, 0, i] * (H[:, :, 1, j] * H[:, :, 2, k] - H[:, :, 1, k] * H[:, :, 2, j])
    grown = np.maximum(grown, LEAST_VOLUME - 1)
    return 1 + grown, np.log1p(grown)


def _exponential(x: Float[np.ndarray, "*x"]) -> Float[np.ndarray, "*x"]:
    """exp(x), beyond STEEPEST as its tangent there."""
    near = np.minimum(x, STEEPEST)
    return np.asarray(np.exp(near) * (1 + x - near))


def _shrunk(
    pieces: FleshPieces, state: PathState, b: float, compliance: float, nu: float
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """By how much the linear field shrinks as a whole, and the stiffness then at all but 1 % of the points.

    a + sum over points of a W expm1(b a^2 W/mu) over that of W = 1, small strain.
    """
    mu = unit_lame_constants(nu)[0]
    energy = pieces.measured(
        compliance * state.linear, lambda gradient: strain_energy(gradient, poisson_ratio=nu)
    )
    x, v = b / mu * energy.reshape(-1, len(state.linear)).T, pieces.volume_mm3.ravel()
    whole = np.maximum(x @ v, 1e-300)
    low, high = np.zeros(len(x)), np.ones(len(x))
    for _ in range(12):
        a = (low + high) / 2
        over = a * ((x * _exponential(a[:, None] ** 2 * x)) @ v) / whole > 1
        low, high = np.where(over, low, a), np.where(over, a, high)
    top = np.quantile(x, 0.99, axis=1) * a**2
    return a, _exponential(top) * (1 + 2 * top)


EFFECT: Effect = Stiffening()
