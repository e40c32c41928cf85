"""`sensor_gain`: one pad records its force times a gain.

The true force is the recorded one over the gain, on that pad alone; the pads' recorded forces no longer
balance. A gain common to both pads is Young's modulus, and cannot be told from it. Which of two pads has the
gain is E too, but for the gel: a pad's force over its gel's displacement, against what the gel's maker or a
calibration says of it, grows by the gain.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import PAD, Correction, EffectSpec, EffectWords, Scope, number
from fem.mismatch.evidence.equation_cache import balance_equations
from fem.mismatch.evidence.friction_cone import NO_SPRING, normal_stiffness
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.force_products import OfSomeForces
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor, wrench
from fem.mismatch.model.pads import own_markers, pads_of, response_to
from fem.mismatch.signature_variant import OfPad, Variant, pad_of

GEL_SD, COMMON_GEL_SD = 0.04, 0.07
"""Relative standard deviation of what is said of a gel's stiffness: of one pad's, and of all alike."""
MOST_AUXILIARY = 20.0
"""What a gel's maker says never outweighs more ln evidence of the markers than this."""

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
        number(
            "gain",
            "1",
            "recorded force over true force",
            limits=(0.01, 100.0),
            low=0.5,
            high=2.0,
            model_share=0.003,
        ),
    ),
    correction=Correction.FORCE_GAIN,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class SensorGain:
    """One pad's gain; which pad is the signature's variant."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Minus the response to that pad's forces, and the imbalance that they leave: the slope of `respond`.

        The noise's scale belongs to it: equal gains of both pads leave the sums of forces as they are.
        """
        signatures = []
        for pad in pads_of(forward):
            fields = [
                ObservationDelta(
                    markers=-forward.compliance * alone,
                    balance=balance - _imbalance_share(forward, recording, pad),
                )
                for recording, (alone, balance) in zip(
                    forward.base.grasps, _of_pad(forward, pad), strict=True
                )
            ]
            columns = (
                Regressor(name=f"{pad} gain", sd=0.15, fields=fields, of_forces=OfSomeForces(_of(pad))),
            )
            signatures.append(Signature(variant=OfPad(pad=pad), columns=columns))
        return signatures

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the gain less one, as 1 - 1/gain."""
        return {"gain": float(1 / np.clip(1 - amounts[0], 0.55, 1.9))}

    def auxiliary_log_likelihood(
        self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant
    ) -> float:
        """ln of the pads' stiffness being as said with this gain, over that without."""
        stiffer = [(pad, _stiffer(forward, pad)) for pad in pads_of(forward)]
        known = [(pad, z) for pad, z in stiffer if z is not None]
        if not known:
            return 0.0
        z = np.array([z for _, z in known])
        gained = np.array([np.log(parameters["gain"]) if pad == pad_of(variant) else 0.0 for pad, _ in known])
        weight = np.linalg.inv(GEL_SD**2 * np.eye(len(z)) + COMMON_GEL_SD**2)
        log_ratio = (z @ weight @ z - (z - gained) @ weight @ (z - gained)) / 2
        return float(np.clip(log_ratio, -MOST_AUXILIARY, MOST_AUXILIARY))

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The forces of that pad divided by the gain, and the sums with them on the scale of their noise."""
        share = 1 - 1 / parameters["gain"]
        pad = pad_of(variant)
        parts = _of_pad(forward, pad)
        return Response(
            unit=[
                recording.tracks.unit_displacement - share * alone
                for recording, (alone, _) in zip(forward.base.grasps, parts, strict=True)
            ],
            balance=[
                _balance(
                    forward, recording, share * balance, _noise_scale(recording, pad, parameters["gain"])
                )
                for recording, (_, balance) in zip(forward.base.grasps, parts, strict=True)
            ],
        )


def _balance(
    forward: ForwardModel, recording: GraspResponse, taken_N: Float[np.ndarray, "f 6"], scale: float
) -> Float[np.ndarray, "f 6"]:
    """What brings the recorded sums to those without the part that is taken away, times a scale."""
    equations = balance_equations(forward, recording)
    if equations is None:
        return taken_N
    return np.asarray(equations.measured - scale * (equations.measured - taken_N))


def _imbalance_share(forward: ForwardModel, recording: GraspResponse, pad: str) -> Float[np.ndarray, "f 6"]:
    """The recorded sums times d ln(_noise_scale) / d gain: a pad's share of the markers."""
    equations = balance_equations(forward, recording)
    if equations is None or pad not in recording.pad_names:
        return np.zeros((len(recording.force_N), 6))
    return np.asarray(own_markers(recording, recording.pad_names.index(pad)).mean() * equations.measured)


def _noise_scale(recording: GraspResponse, pad: str, gain: float) -> float:
    """Noise of the recorded sums over that of the sums with one pad's forces divided by the gain.

    Forces of one pad over the gain balance those of the other as well as forces of the other times the gain,
    but all of them are smaller and so is what noise leaves of their sums: without this scale a pad that reads
    too high would always explain recordings better than the other reading too low.
    """
    if pad not in recording.pad_names:
        return 1.0
    pad_share = float(own_markers(recording, recording.pad_names.index(pad)).mean())
    return float((pad_share / gain**2 + 1 - pad_share) ** -0.5)


def _of(pad: str) -> Callable[[GraspResponse, Float[np.ndarray, "q n 3"]], Float[np.ndarray, "q n 3"]]:
    """Minus the forces of one pad."""

    def part(recording: GraspResponse, force_N: Float[np.ndarray, "q n 3"]) -> Float[np.ndarray, "q n 3"]:
        if pad not in recording.pad_names:
            return np.zeros_like(force_N)
        return np.where(own_markers(recording, recording.pad_names.index(pad)), -force_N, 0.0)

    return part


def _stiffer(forward: ForwardModel, pad: str) -> float | None:
    """ln of a pad's normal force per displacement over what is said of its gel; None where nothing is."""
    said = [
        motion.gel_N_per_mm
        for recording in forward.base.grasps
        for motion in recording.case.pads
        if motion.name == pad and motion.gel_N_per_mm is not None
    ]
    felt = normal_stiffness(forward, pad)
    return float(np.log(felt / np.mean(said))) if said and felt > NO_SPRING else None


def _of_pad(
    forward: ForwardModel, pad: str
) -> list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"]]]:
    """Response to one pad's forces alone, mm MPa, and their own sums; zero where it takes no part."""
    parts = []
    for recording in forward.base.grasps:
        if pad not in recording.pad_names:
            parts.append((np.zeros_like(recording.force_N), np.zeros((len(recording.force_N), 6))))
            continue
        markers = own_markers(recording, recording.pad_names.index(pad))
        alone = forward.memoised(
            ("alone", recording.case.name, pad),
            partial(_alone, forward, recording, markers),
        )
        position = recording.tracks.position_mm
        balance = wrench(
            np.where(markers, recording.force_N, 0.0), position, centre_mm=position.mean(axis=(0, 1))
        )
        parts.append((alone, balance))
    return parts


def _alone(
    forward: ForwardModel, recording: GraspResponse, markers: Bool[np.ndarray, "1 n 1"]
) -> Float[np.ndarray, "f n 3"]:
    return recording.over_time(response_to(forward, recording, np.where(markers, recording.patterns, 0.0)))


EFFECT: Effect = SensorGain()
