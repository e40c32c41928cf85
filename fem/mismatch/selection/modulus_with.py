"""E of all recordings together: by the plain model, and with an explanation in its place.

With an effect in place E is known no better than the effect: what its parameters are off by is in its spread.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import fit_compliance
from fem.mismatch.effect import Response
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


def modulus_of(forward: ForwardModel, response: Response | None = None) -> Modulus:
    """E by least squares over all markers of each recording, their mean; with an effect's response in place.

    The standard deviation: scatter between recordings, and LEAST_RELATIVE_SD for what they have in common.
    """
    found = []
    for k, recording in enumerate(forward.base.grasps):
        tracks = recording.tracks
        if response is not None:
            shift = 0.0 if response.shift_mm is None else response.shift_mm[k]
            tracks = replace(
                tracks, unit_displacement=response.unit[k], position_mm=tracks.position_mm - shift
            )
        fit = fit_compliance(
            tracks,
            scale_sd=forward.base.case.budget.gel_scale_sd,
            fruit_moves=recording.case.support == "free",
        )
        found.append(max(fit.compliance, 1e-9))
    logs = -np.log(found)
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
    plain = modulus_of(again.forward, again.response)
    own = _own_error(again)
    laws = SYSTEMATIC**2 * again.fit.covariance[-len(own) :, -len(own) :] + np.diag(own**2)
    change = np.array(
        [np.log(modulus_of(again.forward, ahead).value / plain.value) / step for step, ahead in again.ahead]
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
