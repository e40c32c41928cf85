"""`sensor_gain`: one pad records its force times a gain.

The true force is the recorded one over the gain, on that pad alone; the pads' recorded forces no longer
balance. A gain common to both pads cannot be separated from Young's modulus. Without the gel, neither can the
choice of the pad with the gain. The gel decides: the ratio of a pad's measured gel stiffness to the value
of the gel's maker or a calibration grows by the gain.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import PAD, Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.friction_cone import NO_SPRING, normal_stiffness
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import OfSomeForces
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.signature_variant import Variant, of_pad

GEL_SD, COMMON_GEL_SD = 0.04, 0.07
"""Relative standard deviations of a stated gel stiffness: of one pad's own, and common to all pads."""
MOST_AUXILIARY = 20.0
"""Largest ln likelihood ratio that a stated gel stiffness may contribute."""

SPEC = EffectSpec(
    name="sensor_gain",
    rank=140,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="one pad reads its force too high or too low",
        meaning="The pads disagree about the same squeeze by a constant factor: one is out of calibration.",
        advice="Calibrate this pad with a weight. Until then apply the effect: forces of the whole batch are "
        "corrected by the factor found.",
    ),
    parameters=(
        PAD,
        EffectParameter(
            "gain",
            "1",
            "recorded force over true force",
            limits=(0.01, 100.0),
            low=0.5,
            high=2.0,
        ),
    ),
    correction=Correction.FORCE_GAIN,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


class SensorGain(Effect):
    """One pad's gain; the signature's variant names the pad."""

    says_more = True

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """Minus the response to that pad's forces, and their imbalance: the derivative of `respond`.

        This includes the noise's scale: equal gains of both pads do not change the sums of forces.
        """
        return [self._signature(model, pad) for pad in model.pads]

    def _signature(self, model: CaseModel, pad: str) -> Signature:
        fields = []
        for recording, (alone, balance) in zip(model.grasps, _of_pad(model, pad), strict=True):
            scaled = recording.own_markers(pad).mean() * _sums(model, recording)
            fields.append(ObservationDelta(markers=-model.compliance * alone, balance=balance - scaled))
        minus_its_forces = OfSomeForces(
            lambda recording, force_N: np.where(recording.own_markers(pad), -force_N, 0.0)
        )
        column = Regressor(name=f"{pad} gain", sd=0.15, fields=fields, of_forces=minus_its_forces)
        return Signature(variant=of_pad(pad), columns=(column,))

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The gain, from the amount 1 - 1/gain."""
        return self.spec.within_bounds(1 / max(1 - float(amounts[0]), 1e-3))

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """About a true sensor."""
        return {"gain": Prior(1.0, signature.columns[0].sd)}

    def auxiliary_log_likelihood(self, model: CaseModel, parameters: Parameters, variant: Variant) -> float:
        """ln likelihood ratio of the stated gel stiffnesses, with this gain to without."""
        stiffer = [(pad, _stiffer(model, pad)) for pad in model.pads]
        known = [(pad, z) for pad, z in stiffer if z is not None]
        if not known:
            return 0.0
        z = np.array([z for _, z in known])
        gained = np.array([np.log(parameters["gain"]) if pad == variant.pad else 0.0 for pad, _ in known])
        weight = np.linalg.inv(GEL_SD**2 * np.eye(len(z)) + COMMON_GEL_SD**2)
        log_ratio = (z @ weight @ z - (z - gained) @ weight @ (z - gained)) / 2
        return float(np.clip(log_ratio, -MOST_AUXILIARY, MOST_AUXILIARY))

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """That pad's forces divided by the gain, and their sums on the scale of their noise.

        Dividing one pad's forces by the gain balances the other's as well as multiplying the other's by it.
        But it makes all forces smaller, and with them the noise of their sums. Without this scale, a pad that
        reads too high would always explain recordings better than the other pad reading too low.
        """
        gain, pad = parameters["gain"], variant.pad
        share, parts, balances = 1 - 1 / gain, _of_pad(model, pad), []
        for recording, (_, balance) in zip(model.grasps, parts, strict=True):
            pad_share, sums = float(recording.own_markers(pad).mean()), _sums(model, recording)
            scale = (pad_share / gain**2 + 1 - pad_share) ** -0.5
            balances.append(scale * share * balance + (1 - scale) * sums)
        return Response.plain(model, [-share * alone for alone, _ in parts], balance=balances)


def _sums(model: CaseModel, recording: GraspResponse) -> Float[np.ndarray, "f 6"]:
    """Sums of the recorded forces and moments, N; zero if they need not balance."""
    equations = model.balance_equations(recording)
    return np.zeros((len(recording.force_N), 6)) if equations is None else equations.measured


def _stiffer(model: CaseModel, pad: str) -> float | None:
    """ln of a pad's measured normal stiffness over the stated one; None if either is unknown."""
    said = [
        motion.gel_N_per_mm
        for recording in model.grasps
        for motion in recording.case.pads
        if motion.name == pad and motion.gel_N_per_mm is not None
    ]
    felt = normal_stiffness(model, pad)
    return float(np.log(felt / np.mean(said))) if said and felt > NO_SPRING else None


def _of_pad(
    model: CaseModel, pad: str
) -> list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"]]]:
    """Response to one pad's forces alone, mm MPa, and their sums; zero in recordings without the pad."""
    parts = []
    for recording in model.grasps:
        mine = recording.own_markers(pad)
        patterns = np.where(mine, recording.patterns, 0.0)
        alone = model.memoised(("alone", recording.case.name, pad), partial(recording.response_to, patterns))
        force_N = np.where(mine, recording.force_N, 0.0)
        parts.append((recording.over_time(alone), recording.wrench(force_N)))
    return parts


EFFECT: Effect = SensorGain(spec=SPEC)
