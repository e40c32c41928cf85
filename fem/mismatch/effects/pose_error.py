"""`pose_error`: one pad's recorded pose is shifted in the gel's plane and tilted about the pad's x axis.

recorded pose = true pose . shift . tilt. The true positions and forces of its markers are

    p_true = pose tilt^-1 shift^-1 (rest + d),        f_true = R tilt^-1 f

If the fruit rotates by w in the grasp, the skin's motion at the true places differs by w x (X_true - X) from
that at the recorded places. For a shear that rotates the fruit by 2 degrees and a pad that is 3 mm off, the
difference is a tenth of a millimetre.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Parameters, Response, Signature
from fem.mismatch.effect_spec import PAD, Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.inner_changes import slid_response
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import ARM_MM, GraspResponse
from fem.mismatch.model.warm_start import quadratic_surrogate
from fem.mismatch.signature_variant import Variant, of_pad
from fem.solid.pad_link import pad_link

NAMES = ("shift_mm.0", "shift_mm.1", "tilt_deg")
PRIOR_SD = 2.5
"""Prior of each parameter, mm and degrees."""
FAR = 0.1
"""See fem.mismatch.model.warm_start. With the default, a shift together with a tilt of twice its size would
never be computed exactly."""

SPEC = EffectSpec(
    name="pose_error",
    rank=180,
    family="interaction",
    scope=Scope.GRIPPER,
    words=EffectWords(
        short="one pad is not where the gripper's calibration says",
        meaning="A pad sits shifted or tilted against its recorded place.",
        advice="Repeat the calibration (drupe robot). Apply the effect to the recordings made so far.",
    ),
    parameters=(
        PAD,
        EffectParameter(
            "shift_mm",
            "mm",
            "shift of the pad in its plane",
            components=2,
            limits=(-100.0, 100.0),
            low=-7.0,
            high=7.0,
        ),
        EffectParameter(
            "tilt_deg",
            "deg",
            "tilt of the pad",
            limits=(-90.0, 90.0),
            low=-10.0,
            high=10.0,
        ),
    ),
    correction=Correction.PAD_POSE,
)
"""Limits and bounds are set by hand, wide."""


class PoseError(Effect):
    """Error of one pad, which the signature's variant names."""

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One per pad: shifts along its x and y, and a tilt by a degree."""
        signatures = []
        for pad in model.pads:
            first_orders = [_first_order(model, recording, pad) for recording in model.grasps]
            columns = tuple(
                Regressor(
                    name=f"{pad} {name}",
                    sd=PRIOR_SD,
                    fields=[
                        ObservationDelta(markers=shift[k] + model.compliance * unit[k], balance=balance[k])
                        for unit, shift, balance in first_orders
                    ],
                )
                for k, name in enumerate(NAMES)
            )
            signatures.append(Signature(variant=of_pad(pad), columns=columns))
        return signatures

    def other_start(self, model: CaseModel, variant: Variant) -> dict[str, float] | None:
        """Parameters that best balance forces and moments of all recordings, to first order.

        Effects of tilt and shift compensate each other: a shift of 2 mm may almost vanish from the amounts.
        """
        pad = variant.pad
        normal, right = np.diag(np.full(len(NAMES), PRIOR_SD**-2.0)), np.zeros(len(NAMES))
        free = False
        for recording in model.grasps:
            equations = model.balance_equations(recording)
            if equations is None or pad not in recording.pad_names:
                continue
            columns, free = _first_order(model, recording, pad)[2], True
            weighed = np.stack([equations.weighed(column) for column in columns])
            normal += np.tensordot(weighed, columns, axes=([1, 2], [1, 2]))
            right += np.tensordot(weighed, equations.measured, axes=2)
        return self.spec.within_bounds(*np.linalg.solve(normal, right)) if free else None

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The response with the pad linked to the skin at its true place."""
        theta = np.array([parameters[name] for name in NAMES])
        grasps, pad = model.grasps, variant.pad

        def first_order(at: Float[np.ndarray, "3"]) -> list[list[np.ndarray]]:
            changes = [
                [np.tensordot(at, change, axes=1) for change in _first_order(model, recording, pad)]
                for recording in grasps
            ]
            return [
                [recording.tracks.unit_displacement + unit, shift, balance]
                for recording, (unit, shift, balance) in zip(grasps, changes, strict=True)
            ]

        responses = quadratic_surrogate(
            model.warm_starts,
            (self.spec.name, pad, model.compliance),
            theta,
            first_order=first_order,
            exact=lambda at: model.each(lambda recording: _exact(model, recording, pad, at)),
            far=FAR,
        )
        unit, shift_mm, balance = (list(channel) for channel in zip(*responses, strict=True))
        return Response(unit=unit, shift_mm=shift_mm, balance=balance)


def _first_order(
    model: CaseModel, recording: GraspResponse, pad: str
) -> tuple[Float[np.ndarray, "3 f n 3"], Float[np.ndarray, "3 f n 3"], Float[np.ndarray, "3 f 6"]]:
    """Derivatives of unit displacement, shift of positions and imbalance, per mm, mm and degree."""

    def compute() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        force, position = recording.force_N, recording.tracks.position_mm
        unit, shift = np.zeros((3, *force.shape)), np.zeros((3, *force.shape))
        balance = np.zeros((3, len(force), 6))
        if pad not in recording.pad_names:
            return unit, shift, balance
        number = recording.pad_names.index(pad)
        axes, markers = recording.turn_of(number), recording.own_markers(number)
        mine = np.where(markers, force, 0.0)
        origin = recording.pose[number][:, None, :3, 3]
        unit[:2] = -slid_response(model, recording, number)
        for k in range(2):
            shift[k] = np.where(markers, axes[:, k], 0.0)
            balance[k, :, 3:] = np.cross(axes[:, k], mine.sum(axis=1)) / ARM_MM
        degree = np.pi / 180
        turned = np.where(markers, np.cross(axes[:, 0], recording.patterns), 0.0)
        unit[2] = -degree * recording.over_time(recording.response_to(turned))
        arm = np.where(markers, np.cross(axes[:, 0], position - origin), 0.0)
        shift[2] = degree * arm
        aside = np.cross(axes[:, 0], recording.tracks.place_mm - origin[-1])
        turns = _turns(
            model, recording, recording.tracks.place_mm, position, recording.tracks.unit_displacement
        )
        for k, way in enumerate((axes[:, 0], axes[:, 1], degree * aside)):
            shift[k] += _ridden(turns, np.where(markers[0], -way, 0.0))
        balance[2] = degree * recording.wrench(np.cross(axes[:, 0], mine))
        balance[2, :, 3:] += degree * np.cross(arm, mine).sum(axis=1) / ARM_MM
        return unit, shift, balance

    return model.memoised(("pose", recording.case.name, pad, model.compliance), compute)


def _exact(
    model: CaseModel, recording: GraspResponse, pad: str, theta: Float[np.ndarray, "3"]
) -> list[np.ndarray]:
    """Unit displacement, shift of positions and imbalance with the pad at its true place."""
    position, force = recording.tracks.position_mm, recording.force_N
    zero = [recording.tracks.unit_displacement, np.zeros_like(position), np.zeros((len(position), 6))]
    if pad not in recording.pad_names:
        return zero
    number = recording.pad_names.index(pad)
    markers = recording.pad_of_marker == number
    cos, sin = np.cos(np.radians(theta[2])), np.sin(np.radians(theta[2]))
    back = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
    axes = recording.turn_of(number)
    turn = axes @ back @ axes.T
    shift = turn @ axes[:, :2] @ theta[:2]
    origin = recording.pose[number][:, None, :3, 3]
    truly = position.copy()
    truly[:, markers] = (position[:, markers] - origin) @ turn.T + origin - shift
    pushed = force.copy()
    pushed[:, markers] = force[:, markers] @ turn.T
    history = recording.case.history.pads[number]
    where = (history.surface_mm - origin[-1]) @ turn.T + origin[-1] - shift
    link = pad_link(replace(history, surface_mm=where), recording.solid)
    links = tuple(link if k == number else other for k, other in enumerate(recording.links))
    patterns = recording.patterns.copy()
    patterns[:, markers] = recording.patterns[:, markers] @ turn.T
    there = replace(recording, links=links, patterns=patterns)
    unit = recording.whole(there.response_to(patterns))
    balance = recording.wrench(force) - recording.wrench(pushed, truly)
    elsewhere = np.zeros_like(recording.tracks.place_mm)
    elsewhere[markers] = where - history.surface_mm
    place = recording.tracks.place_mm + elsewhere
    turns = _turns(model, recording, place, truly, unit)
    # the equations rotate the markers about their recorded places: repeat with that difference removed
    turns = _turns(model, recording, place, truly - _ridden(turns, elsewhere), unit)
    return [unit, position - truly + _ridden(turns, elsewhere), balance]


def _turns(
    model: CaseModel,
    recording: GraspResponse,
    place_mm: Float[np.ndarray, "n 3"],
    position_mm: Float[np.ndarray, "f n 3"],
    unit: Float[np.ndarray, "f n 3"],
) -> Float[np.ndarray, "f 3"]:
    """w from the markers at these places, up to a constant in each contact."""
    return model.marker_equations(recording).turns(position_mm - place_mm - model.compliance * unit)


def _ridden(turns: Float[np.ndarray, "f 3"], elsewhere_mm: Float[np.ndarray, "n 3"]) -> np.ndarray:
    """w x (X_true - X), frames by markers."""
    return np.cross(turns[:, None], elsewhere_mm)


EFFECT: Effect = PoseError(spec=SPEC)
