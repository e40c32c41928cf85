"""E of all recordings together: by the plain model, and with an explanation in its place.

Both by grading's own inference (fem.estimation.joint_inference), linear about the prior's pit: what the pit,
the pads' places and the surface may be off by is marginalised with an effect as without. With an effect in
place E is known no better than the effect: what its parameters are off by is in its spread.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks, fit_compliance
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import first_touch_evidence
from fem.fem_failure import FemFailure
from fem.mismatch.effect import Response
from fem.mismatch.effect_spec import Entry
from fem.mismatch.evidence.discrepancy_prior import discrepancy_spread
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import Modulus
from fem.mismatch.selection.refinement import Refit

LEAST_RELATIVE_SD = 0.01
"""Of E: what all recordings have in common. A linear truth is met to 0.9 and 1.3 % (docs/validation.md,
Mechanics)."""
SCATTER = 0.02
"""Relative scatter of one recording's E, where there is no second one to show it."""
SYSTEMATIC = 1.5
"""Standard deviations are this many times those of the thinned noise
(fem.mismatch.model.marker_equations)."""


def modulus_of(forward: ForwardModel, response: Response | None = None, *, infer_pit: bool = True) -> Modulus:
    """E of all recordings, by grading's own inference with an effect's response in the plain one's place.

    `infer_pit`: the recordings may say where the pit is, as in grading; False: it is where the response has
    it. Without grading's models, or where that inference has no E: the mean of the recordings' own fits.
    """
    tracks = [_tracks_with(forward, k, response) for k in range(len(forward.base.grasps))]
    fits = [
        fit_compliance(
            own,
            scale_sd=forward.base.case.budget.gel_scale_sd,
            fruit_moves=recording.case.support == "free",
        )
        for own, recording in zip(tracks, forward.base.grasps, strict=True)
    ]
    if not forward.graded:
        return _mean_of(fits)
    try:
        return _inferred(forward, tracks, fits, infer_pit=infer_pit)
    except FemFailure:
        return _mean_of(fits)


def _tracks_with(forward: ForwardModel, k: int, response: Response | None) -> MarkerTracks:
    """Recording number k with the effect's response."""
    tracks = forward.base.grasps[k].tracks
    if response is None:
        return tracks
    shift = 0.0 if response.shift_mm is None else response.shift_mm[k]
    return replace(tracks, unit_displacement=response.unit[k], position_mm=tracks.position_mm - shift)


def _inferred(
    forward: ForwardModel, tracks: Sequence[MarkerTracks], fits: Sequence[CompliantFit], *, infer_pit: bool
) -> Modulus:
    """By fem.estimation.joint_inference; raises FemFailure."""
    budget = forward.base.case.budget
    evidence = [
        first_touch_evidence(
            own,
            recording.over_time(recording.patterns),
            fit,
            history=recording.prepared,
            model=model,
            budget=budget,
        )[0]
        for own, recording, fit, model in zip(tracks, forward.base.grasps, fits, forward.graded, strict=True)
    ]
    found = joint_modulus(evidence, budget=budget, infer_pit=infer_pit and len(evidence) > 1)
    return Modulus(value=found.E_MPa, sd=found.E_sd_MPa)


def _mean_of(fits: Sequence[CompliantFit]) -> Modulus:
    """The mean of the recordings' own E; its standard deviation by their scatter, and LEAST_RELATIVE_SD for
    what they have in common.
    """
    logs = -np.log([max(fit.compliance, 1e-9) for fit in fits])
    value = float(np.exp(logs.mean()))
    scatter = float(logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else SCATTER
    return Modulus(value=value, sd=value * float(np.hypot(scatter, LEAST_RELATIVE_SD)))


@dataclass(frozen=True, kw_only=True)
class ModulusWith:
    """E with a refitted explanation in place: at its parameters (`at`), and all in all (`known`).

    `sd`: of the parameters, `change`: d ln E / d parameter, both on the scale searched.
    """

    at: Modulus
    known: Modulus
    sd: Float[np.ndarray, " p"]
    change: Float[np.ndarray, " p"]


def modulus_with(again: Refit) -> ModulusWith:
    """What the parameters are off by (their covariance, the model's error) is in the modulus' spread."""
    # Where an effect says where the pit is, its prior must not pull it back.
    infer_pit = all(effect.spec.enters is not Entry.MESH for effect in again.effects)
    plain = modulus_of(again.forward, again.response, infer_pit=infer_pit)
    own = _own_error(again)
    laws = SYSTEMATIC**2 * again.fit.covariance[-len(own) :, -len(own) :] + np.diag(own**2)
    change = np.array(
        [
            np.log(modulus_of(again.forward, ahead, infer_pit=infer_pit).value / plain.value) / step
            for step, ahead in again.ahead
        ]
    )
    spread = float(np.sqrt(change @ laws @ change))
    return ModulusWith(
        at=plain,
        known=replace(plain, sd=float(np.hypot(plain.sd, plain.value * spread))),
        sd=np.hypot(SYSTEMATIC * np.sqrt(np.diag(again.covariance)), own),
        change=change,
    )


def _own_error(again: Refit) -> Float[np.ndarray, " p"]:
    """What the model's own error makes of each parameter, on the scale searched."""
    found = []
    for effect, values in zip(again.effects, again.parameters, strict=True):
        for spec in effect.spec.searched:
            value = values[spec.name]
            off = [spec.model_sd, spec.model_share * value, discrepancy_spread(effect)]
            found.append(np.linalg.norm(off) / (value if spec.log else 1.0))
    return np.array(found)
