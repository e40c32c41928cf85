"""Relations of jaws, poses and clocks: with each other, with the signals and with the fruit's size."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from tactile.consistency.finding import Field
from tactile.consistency.finding import FindingKind as Kind
from tactile.consistency.misfit import FAILS_AT, OVER_NOISE, Misfit, Situation, abs_ln, degrees
from tactile.consistency.pressing import clearer
from tactile.readers.recording import Recording

BALANCE = 0.1
"""Spread of ln of one pad's normal force over the other's at the peak (assumed: weight, tilt of the pads)."""
TURNS, STEP_SHARE = 0.115, 0.02
"""Share of the jaws' steps, of at least STEP_SHARE of their travel, that reverse the step before."""
ROUGH, STRONG, CALM, FEWEST_FRAMES = 0.076, 0.1, 0.35, 8
"""Mean square of a signal's steps over twice its variance: 1 for random order. It counts where the signal
exceeds STRONG of its peak and the jaws step by less than CALM of their travel."""
LATE_MM, LATE_SD_MM, LATE_AT, CLOSING_MM = -0.3, 0.23, 0.15, 3.5
"""The jaws' opening at release minus that at touch, where the gel's signal passes LATE_AT of its peak, for
jaws that close by CLOSING_MM: creep and yield make it negative, adhesion positive."""
OPENING_SD_MM, OPENING_SHARE = 0.076, 0.025
"""Spread of aperture minus the poses' distance, in mm and as a share of the jaws' travel (assumed: a clock, a
bent finger)."""
FACING_DEG, AROUND, AWAY = 6.6, 0.18, 0.26
"""Angle between a pad's normal and the other's reversed normal; ln of the fruit's size over the pads'
distance, if that is smaller; 1 minus the cosine between normal and direction to the fruit's centre (all
assumed)."""
E_OF_APERTURE, E_PER_LATE = 0.2, 0.28
"""Relative errors of E. The first is assumed: aperture or poses may be wrong. The second is per lag over
closing; a lag of 3 mm in a closing of 3.5 mm changes E by 0.01 to 0.25."""


def machine_misfits(situation: Situation) -> Iterator[Misfit]:
    """Relations of pads, jaws and clock; with a mesh those of poses too, which a recording alone may lack."""
    recording, pressings, vertices = situation.recording, situation.pressings, situation.vertices
    pair = len(pressings) == 2 and recording.loading == "grasp"
    yield _turns(recording.aperture_mm)
    yield from _rough(situation)
    if situation.touch_is_seen and (apart := release_less_touch_mm(situation)) is not None:
        yield _late(recording, apart)
    if pair:
        totals = [press.force_N[pressings[0].heaviest, :, 2].sum(axis=1).mean() for press in pressings]
        yield Misfit(Kind.UNBALANCED, abs_ln(abs(totals[0] / (totals[1] or 1e-30))) / BALANCE)
    if vertices is None:
        return
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if pair:
        yield from _jaws(situation, float((high - low).mean()))
    for press in pressings:
        pose = press.pad.pose[0]
        to_middle = (low + high) / 2 - pose[:3, 3]
        cosine = float(pose[:3, 2] @ to_middle) / max(float(np.linalg.norm(to_middle)), 1e-9)
        says = "pose has its z axis pointing away from the fruit"
        yield Misfit(Kind.POSE_AWAY, (1 - cosine) / AWAY if cosine < 0 else 0.0, says, pads=press.pads)


def _turns(jaws_mm: Float[np.ndarray, " t"]) -> Misfit:
    moves = np.diff(jaws_mm)
    moves = moves[np.abs(moves) > STEP_SHARE * max(float(np.ptp(jaws_mm)), 1e-9)]
    back = float((moves[1:] * moves[:-1] < 0).mean()) if len(moves) >= FEWEST_FRAMES else 0.0
    says = f"the jaws reverse in {100 * back:.0f} % of their steps (expected below 45 %)"
    return Misfit(Kind.FRAMES_SHUFFLED, back / TURNS, says)


def _rough(situation: Situation) -> Iterator[Misfit]:
    """Misfits of fields that jump from frame to frame while the jaws do not."""
    jaws_mm = situation.recording.aperture_mm
    calm = np.abs(np.diff(jaws_mm)) <= CALM * max(float(np.ptp(jaws_mm)), 1e-12)
    for press in situation.pressings if len(jaws_mm) >= FEWEST_FRAMES else ():
        use = press.touched
        fields: dict[Field, np.ndarray] = {"displacement": press.felt_mm, "force": press.force_N}
        for name, values in fields.items():
            signal = values[:, use, 2].sum(axis=1)
            peak = float(np.abs(signal).max(initial=0.0))
            strong = np.abs(signal) > STRONG * peak
            steps = np.diff(signal)[(strong[1:] | strong[:-1]) & calm]
            clear = peak > OVER_NOISE * float(signal[press.quiet].std())
            if clear and len(steps) >= 5 and strong.sum() >= 4:
                spread = max(float(signal[strong].var()), 0.05 * peak**2)  # a hold has no variance
                says = f"{name} jumps from frame to frame while the jaws move evenly"
                rough = float((steps**2).mean()) / (2 * spread)
                yield Misfit(Kind.GEL_FRAMES_SHUFFLED, rough / ROUGH, says, field=name, pads=press.pads)


def release_less_touch_mm(situation: Situation) -> float | None:
    """The jaws' opening at the gel's release minus that at its touch; None without either."""
    recording = situation.recording
    jaws = recording.aperture_mm if recording.loading == "grasp" else -recording.aperture_mm
    totals = [clearer(press)[0][:, press.touched, 2].sum(axis=1) for press in situation.pressings]
    total = np.sum([of_pad / max(float(of_pad.max()), 1e-30) for of_pad in totals], axis=0)
    at = LATE_AT * float(total.max())
    up = np.flatnonzero((total[1:] >= at) & (total[:-1] < at))
    down = np.flatnonzero((total[1:] < at) & (total[:-1] >= at))
    if not len(up) or not len(down) or down[-1] <= up[-1]:
        return None
    touch, release = (
        float(jaws[k] + (at - total[k]) / (total[k + 1] - total[k]) * (jaws[k + 1] - jaws[k]))
        for k in (int(up[-1]), int(down[-1]))
    )
    return release - touch


def _late(recording: Recording, apart_mm: float) -> Misfit:
    scale = max(1.0, float(np.ptp(recording.aperture_mm)) / CLOSING_MM)
    late, wider = ("late", "wider") if apart_mm > 0 else ("early", "closer")
    says = (
        f"the gel's signals (displacement and force) are {late} relative to the jaws: at release the jaws "
        f"are {abs(apart_mm):.2f} mm {wider} than at first contact"
    )
    sds = abs(apart_mm - LATE_MM * scale) / (LATE_SD_MM * scale)
    return Misfit(Kind.CLOCKS_APART, sds, says, relative_sd=E_PER_LATE * abs(apart_mm) / (CLOSING_MM * scale))


def _jaws(situation: Situation, size_mm: float) -> Iterator[Misfit]:
    """Relations of poses with each other, with the aperture and with the fruit's size."""
    first, second = (press.pad.pose for press in situation.pressings)
    line = second[0, :3, 3] - first[0, :3, 3]
    angle = degrees(-float(first[0, :3, 2] @ second[0, :3, 2]))
    if min(first[0, :3, 2] @ line, -second[0, :3, 2] @ line) < 0:
        angle = max(angle, 90.0)
    says = f"the pads do not face each other in their poses (off by {angle:.0f}°, expected below 26°)"
    yield Misfit(Kind.POSES_TURNED, angle / FACING_DEG, says)
    between = (second[:, :3, 3] - first[:, :3, 3]) @ first[0, :3, 2]
    stated = situation.recording.aperture_mm
    moved, closed, differ = (float(np.ptp(values)) for values in (between, stated, stated - between))
    sd_mm = max(OPENING_SD_MM, OPENING_SHARE * closed)
    says = (
        f"the pads' poses close by {moved:.3g} mm, the aperture by {closed:.3g} mm, and they differ by up to "
        f"{differ:.3g} mm (expected at most {FAILS_AT * sd_mm:.2g} mm)"
    )
    yield Misfit(Kind.APERTURE, differ / sd_mm, says, relative_sd=E_OF_APERTURE)
    apart = float(np.abs(between).max())
    says = f"the poses place the pads {apart:.3g} mm apart, around a fruit of {size_mm:.0f} mm"
    yield Misfit(Kind.POSES_UNIT, abs_ln(min(apart / size_mm, 1.0)) / AROUND, says)
