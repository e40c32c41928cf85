"""`slip`: the skin slides over a pad where the shear would exceed Coulomb's cone, |f_t| <= mu f_n.

The recorded forces are those that friction transmits, so s c is correct for the skin. But a marker, which is
part of the gel, stays behind the skin by the path w that the skin has slid over it:

    y(t) = X + s c(t) + R q(t) - w(t; mu) + noise

Signature: -w for a few mu, amount 1. It omits mu that are smaller than the markers' own ratios of shear to
pressure allow (fem.mismatch.evidence.friction_cone): no such cone explains any misfit of the plain model.
Coulomb's law: Johnson 1985, Contact Mechanics, chapter 7.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.friction_cone import ShearRatios, least_mu, shear_ratios, spring_ratio
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import MarkerEquations
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.signature_variant import Variant, at_value

MU = "mu"
STEPS = (1.05, 1.3, 1.6, 2.0, 2.5, 3.1)
"""Values of mu tried, over the smallest that the markers' ratios allow."""
LOWEST, HIGHEST = 0.03, 0.8
"""Bounds of mu. Wet gel on wax is above the lower; dry skin at the upper sticks in every grasp. Set by
hand."""
LEAST_OF_PATH = 0.5
"""Amount of a mu's path below which the data show another cause. Set by hand: the path shortens by a third
from one of the tried mu to the next."""
SEEN_MM = 0.002
"""A path that is nowhere longer than this is not observable."""

SPEC = EffectSpec(
    name="slip",
    rank=110,
    family="interaction",
    scope=Scope.LOT,
    words=EffectWords(
        short="the fruit slips between the pads",
        meaning="The pads slide over the skin: wax, juice or dust makes it slippery.",
        advice="Wipe fruit and pads dry, close the gripper a little further and slower, and record again.",
    ),
    parameters=(
        EffectParameter(
            MU,
            "1",
            "friction between pad and skin",
            limits=(0.0, 100.0),
            low=LOWEST,
            high=HIGHEST,
            log=True,
        ),
    ),
)
"""Limits and bounds are set by hand, wide."""


class Slip(Effect):
    """The effect; see the module."""

    says_more = True

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each mu at which a marker slips."""
        least = least_mu(_ratios(model))
        signatures = []
        for mu in (step * least for step in STEPS if step * least < HIGHEST):
            variant = at_value("mu", round(mu, 4))
            try:
                paths = _paths(model, mu)
            except FemFailure as failure:
                signatures.append(Signature(variant=variant, columns=(), untried=failure.detail))
                continue
            if max(float(np.abs(path).max()) for path in paths) > SEEN_MM:
                behind = [-path for path in paths]
                signatures.append(
                    Signature.of_markers(
                        "path", behind, sd=1.0, variant=variant, positive=True, least=LEAST_OF_PATH
                    )
                )
        return signatures

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's own mu, at which its amount is one."""
        return self.spec.within_bounds(signature.variant.values[0])

    def auxiliary_log_likelihood(self, model: CaseModel, parameters: Parameters, variant: Variant) -> float:
        """From the number of markers on this cone."""
        return max(_ratios(model).log_ratio(parameters[MU]), 0.0)

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The coefficient has that of its bounds."""
        return {}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The markers, behind the skin by the slid path."""
        return Response.plain(model, shift_mm=[-path for path in _paths(model, parameters[MU])])


EFFECT: Effect = Slip(spec=SPEC)


def _ratios(model: CaseModel) -> ShearRatios:
    return model.memoised("shear ratios", lambda: shear_ratios(model))


def _paths(model: CaseModel, mu: float) -> Fields:
    """Displacement of every recording's markers with Coulomb friction `mu` on the pads."""
    stiffness = {name: spring_ratio(model, name) for name in model.pads}
    return [
        slip_path(
            recording,
            model.marker_equations(recording),
            compliance=model.compliance,
            mu=mu,
            spring_ratio=np.array([stiffness[name] for name in recording.pad_names])[recording.pad_of_marker],
        )
        for recording in model.grasps
    ]


LEVEL_MM = 0.016
"""Twice the spread, without slip (7-9 um), of the shear displacement D at first touch."""
WHOLE_STEPS, HALF_STEPS, STILL_MM = 8, 100, 5e-4
"""Rounds end when no path changes by more than STILL_MM, which no marker shows. Half steps follow the whole
steps: a marker may alternate between contact and no contact (as in open-04 of the mismatch cases)."""
FIRM = 4.0
"""A marker touches if its depth exceeds this many standard deviations of its noise."""
FAR_OFF = 2.0
"""The noise-free depth of the model is used, but not less than the measured depth minus this many standard
deviations."""
SHORTEST_STEP_MM = 0.004
"""A smaller rise of depth between two frames is noise (that of one frame of the samples' sensor), and is not
extrapolated back."""
FARTHEST_BACK = 1.2
"""Most frames by which the first touch is extrapolated back, in a line through the first two frames."""


def slip_path(
    recording: GraspResponse,
    equations: MarkerEquations,
    *,
    compliance: float,
    mu: float,
    spring_ratio: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "f n 3"]:
    """w, mm, in the fruit frame: path of the skin ahead of each marker, zero out of contact.

    `spring_ratio`: k_t / k_n of each marker's gel. Raises FemFailure (NOT_CONVERGED) if the paths still
    change after all rounds.
    """
    tracks = recording.tracks
    pressed = -_in_pad_axes(recording, tracks.gel_displacement_mm)[..., 2]
    firm = (tracks.episode >= 0) & (pressed > FIRM * tracks.sd_mm)
    at_least = pressed - FAR_OFF * tracks.sd_mm
    path = np.zeros_like(tracks.position_mm)
    excess = tracks.position_mm - tracks.place_mm - compliance * tracks.unit_displacement
    for taken in (*[1.0] * WHOLE_STEPS, *[0.5] * HALF_STEPS):
        stuck = tracks.gel_displacement_mm - equations.residual(excess + path) + path
        local = _in_pad_axes(recording, stuck)
        depth = np.maximum(-local[..., 2], at_least)
        slid = _returned(local[..., :2], depth, firm, tracks.episode, mu / spring_ratio)
        change = _in_fruit_axes(recording, slid) - path
        path = path + taken * change
        changed_mm = float(np.abs(change).max())
        if changed_mm < STILL_MM:
            return np.asarray(path)
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"the slid path at a friction of {mu:.3g} still changes by {1e3 * changed_mm:.2g} µm after "
        f"{WHOLE_STEPS + HALF_STEPS} rounds, expected {1e3 * STILL_MM:.2g} µm at most",
    )


def _in_pad_axes(recording: GraspResponse, vectors: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    """Transforms markers' vectors from the fruit frame to the axes of each marker's pad."""
    in_pad_axes = np.empty_like(vectors)
    for pad, pose in enumerate(recording.pose):
        markers = recording.pad_of_marker == pad
        in_pad_axes[:, markers] = vectors[:, markers] @ pose[:, :3, :3]
    return in_pad_axes


def _in_fruit_axes(
    recording: GraspResponse, along_pad: Float[np.ndarray, "f n 2"]
) -> Float[np.ndarray, "f n 3"]:
    """Transforms markers' vectors along their pad's x and y to the fruit frame."""
    in_fruit_axes = np.empty((*along_pad.shape[:2], 3))
    for pad, pose in enumerate(recording.pose):
        markers = recording.pad_of_marker == pad
        in_fruit_axes[:, markers] = along_pad[:, markers] @ np.swapaxes(pose[:, :3, :2], 1, 2)
    return in_fruit_axes


def _returned(
    shear: Float[np.ndarray, "f n 2"],
    depth: Float[np.ndarray, "f n"],
    firm: np.ndarray,
    episode: np.ndarray,
    slope: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "f n 2"]:
    """The return mapping, frame by frame; each contact begins without slip."""
    count = shear.shape[1]
    level, slid, contact = np.zeros((count, 2)), np.zeros((count, 2)), np.full(count, -1)
    path = np.zeros_like(shear)
    for frame in range(len(shear)):
        fresh = firm[frame] & (episode[frame] != contact)
        if fresh.any():
            level[fresh] = _excess_of_level(_at_touch(shear[:, fresh], depth[:, fresh], frame))
            slid[fresh], contact[fresh] = 0.0, episode[frame][fresh]
        asked = shear[frame] - level - slid
        size = np.linalg.norm(asked, axis=1)
        over = np.where(firm[frame], np.maximum(size - slope * depth[frame], 0.0), 0.0)
        slid = slid + asked * (over / np.maximum(size, 1e-12))[:, None]
        path[frame] = np.where(
            (episode[frame] >= 0)[:, None] & (episode[frame] == contact)[:, None], slid, 0.0
        )
    return path


def _at_touch(
    shear: Float[np.ndarray, "f n 2"], depth: Float[np.ndarray, "f n"], frame: int
) -> Float[np.ndarray, "n 2"]:
    """D at zero depth, extrapolated linearly from this frame and the next."""
    after = min(frame + 1, len(shear) - 1)
    rise = depth[after] - depth[frame]
    back = np.clip(depth[frame] / np.maximum(rise, SHORTEST_STEP_MM), 0.0, FARTHEST_BACK)
    back = np.where(rise > SHORTEST_STEP_MM, back, 0.0)
    return np.asarray(shear[frame] - back[:, None] * (shear[after] - shear[frame]))


def _excess_of_level(level_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Part of the level that exceeds its own error."""
    size = np.linalg.norm(level_mm, axis=1, keepdims=True)
    return np.asarray(level_mm * np.maximum(1 - LEVEL_MM / np.maximum(size, 1e-12), 0.0))
