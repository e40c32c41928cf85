"""Relations of a pad's signals: the gel's law, directions, the marker grid, the sensor's published values."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactile.consistency.finding import Field, times_said
from tactile.consistency.finding import FindingKind as Kind
from tactile.consistency.misfit import FAILS_AT, OVER_NOISE, Misfit, Situation, abs_ln, degrees
from tactile.consistency.pressing import (
    DEEPEST,
    FEWEST_PRESSED,
    FRAMES_SIMILAR,
    Pressing,
    at_peak,
    clearer,
    gives_way,
)
from tactile.readers.recording import GelPad, Recording, marker_area_mm2
from tactile.readers.sensor_model import PublishedGel

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


GAIN, OVER_TIME, OVER_MARKERS = 0.02, 0.018, 0.1
"""Spreads of a gel's law: ln of the forces over its prediction; 1 less the correlations over frames and
markers."""
LEAST_NOISE, LEAST_SHARE_SEEN = 1e-3, 0.2
"""Least noise, over the largest value; least share of a variance that counts as signal."""
PRESSES_DEG = 17.0
"""Spread of the angle to the pad's normal of mean force, and of stiffness times displacement; friction of 1
makes 45 degrees."""
NEIGHBOURS, FEWEST_ORDERED = 0.13, 20
"""Spread of 1 less the correlation of a marker with its neighbours; fewest pressed markers to judge it by."""
FACE_MM, FACE = 21.0, 0.5
"""Typical longest side of a gel's markers and the spread of its ln: sensors have 10 to 60 mm."""
PUBLISHED = 0.76
"""Factor on a published standard deviation, which needs no heavy tails: three of them fail."""
IN_GEL, IN_GEL_SD, STEP_MM = 0.08, 0.71, 0.13
"""A gel's indentation over its jaw's travel past first touch (0.05 to 0.55), the spread of its ln, and one
frame's travel (mm)."""
NU, RADIUS_MM, HERTZ_OFF = 0.45, 25.0, 2.0
"""For the modulus of a half-space under a ball, which is correct to a factor of two for any fruit here."""
E_PER_PITCH = 2.2
"""Error of ln E per ln of the pictures' scale if it enters all lengths and, to the third power, the forces of
springs: 0.21 at 1.1 (benchmarks/field_mistakes.py --grade CACHE --only "picture scale"). If it enters only
the markers' places and, squared, the forces, the error is 0.8."""
E_PER_GAIN = 0.7
"""Relative error of E per ln of a gain, which force (1.1), displacement (0.3) or stiffness may cause."""


def signal_misfits(situation: Situation) -> list[Misfit]:
    """Misfits between signals, sensor, jaws, poses and clock; of the mesh only its centre and size count."""
    known = situation.touch_is_seen and situation.vertices is not None
    of_pads: list[Misfit] = []
    for press in situation.pressings:
        misfits = [*_law(press), *_direction(press), *_grid(press)]
        misfits += [misfit for gel in situation.gels for misfit in _sensor(press.pad, gel)]
        misfits += _closing(press, situation.E_range_MPa) if known else ()
        of_pads += [replace(misfit, pads=press.pads) for misfit in misfits]
    return [*of_pads, *machine_misfits(situation)]


def correlation(a: Float[np.ndarray, "t ..."], b: Float[np.ndarray, "t ..."]) -> float:
    """Correlation of two series over all components; 0 if one is constant."""
    a, b = (x - x.mean(axis=0) for x in (a, b))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _whitened(
    values: Sequence[Float[np.ndarray, "k 3"]], noise: Sequence[Float[np.ndarray, "q 3"]]
) -> tuple[list[Float[np.ndarray, "k 3"]], list[float]]:
    """Measured displacement and the one predicted from the forces, each component over their joint noise, and
    the share of each one's variance that is not noise. `noise`: both without contact.
    """
    of_each = np.array([of_one.var(axis=0) for of_one in noise])
    largest = max(float(np.abs(field).max()) for field in values)
    weight = 1 / np.sqrt(of_each.sum(axis=0) + (LEAST_NOISE * largest) ** 2 + 1e-30)
    seen = [field * weight for field in values]
    shares = [
        1 - float((variance * weight**2).sum() / max(float(field.var(axis=0).sum()), 1e-30))
        for field, variance in zip(seen, of_each, strict=True)
    ]
    return seen, [max(share, LEAST_SHARE_SEEN) for share in shares]


def _totals(press: Pressing) -> list[Float[np.ndarray, "t 3"]] | None:
    """Measured displacement, and the one that the gel's law predicts from the forces, summed over the pressed
    markers; None if no law applies to the pad.
    """
    if press.gel_mm is None or not press.touched.any() or not gives_way(press):
        return None
    return [field[:, press.touched].sum(axis=1) for field in (press.felt_mm, press.gel_mm)]


def gain_of(press: Pressing) -> float | None:
    """Size of the normal displacement that the gel's law predicts from the forces over that of the measured
    one. Both are summed over the pressed markers, without noise; None if no law applies to the pad.
    """
    totals = _totals(press)
    return None if totals is None else _gain(press, totals)


def _gain(press: Pressing, totals: Sequence[Float[np.ndarray, "t 3"]]) -> float | None:
    felt, gel = (float((z**2).mean() - z[press.quiet].var()) for z in (total[:, 2] for total in totals))
    return float(np.sqrt(gel / felt)) if min(felt, gel) > 0 else None


def _law(press: Pressing) -> Iterator[Misfit]:
    """Misfits of displacement with the law's prediction: size, course over time, pattern over markers."""
    totals = _totals(press)
    gain = None if totals is None else _gain(press, totals)
    if gain is None or totals is None or press.gel_mm is None:
        return
    course, shares = _whitened(totals, [total[press.quiet] for total in totals])
    most = float(np.exp(FAILS_AT * GAIN))
    says = (
        f"force is {times_said(gain)} the value from this gel's stiffness and displacement (expected "
        f"{1 / most:.2f} to {most:.2f} times)"
    )
    yield Misfit(Kind.SCALE, abs_ln(gain) / GAIN, says, relative_sd=E_PER_GAIN * abs_ln(gain))
    in_time = correlation(*course) / float(np.sqrt(np.prod(shares)))
    says = f"force and displacement do not agree over time (correlation {in_time:.2f}, expected above 0.93)"
    yield Misfit(Kind.OUT_OF_STEP, max(1 - in_time, 0.0) / OVER_TIME, says)
    use, top = press.touched, press.heaviest
    both = [field[:, use] for field in (press.felt_mm, press.gel_mm)]
    quiet = [field[press.quiet].reshape(-1, 3) * float(np.sqrt(FRAMES_SIMILAR / len(top))) for field in both]
    seen, shares = _whitened([field[top].mean(axis=0) for field in both], quiet)
    if use.sum() >= FEWEST_ORDERED and min(shares) > LEAST_SHARE_SEEN:
        over = max(correlation(*seen) / float(np.sqrt(np.prod(shares))), -1.0)
        says = (
            f"force and displacement do not belong to the same markers (correlation over markers {over:.2f}, "
            "expected above 0.6)"
        )
        yield Misfit(Kind.OTHER_MARKERS, max(1 - over, 0.0) / OVER_MARKERS, says)


def _direction(press: Pressing) -> Iterator[Misfit]:
    """Misfits of directions. Friction is at most about the normal force: force, and stiffness times
    displacement, point out of the gel.
    """
    pad, use = press.pad, press.touched
    stiffness = np.array([pad.gel_kt_MPa_per_mm, pad.gel_kt_MPa_per_mm, pad.gel_kn_MPa_per_mm])
    fields: dict[Field, np.ndarray] = {"force": press.force_N}
    if gives_way(press):
        fields["displacement"] = press.felt_mm * stiffness
    for name, values in fields.items() if use.any() else ():
        mean = values[press.heaviest][:, use].mean(axis=(0, 1))
        size = float(np.linalg.norm(mean))
        noise = float(np.sqrt((values[press.quiet] ** 2).mean() / use.sum()))
        if size > OVER_NOISE * noise:
            angle = degrees(mean[2] / size)
            says = f"{name} points {angle:.0f}° away from the pad's normal (expected below 68°)"
            yield Misfit(Kind.AXES, angle / PRESSES_DEG, says, field=name)


def _grid(press: Pressing) -> Iterator[Misfit]:
    """Size of the marker grid, and correlation of neighbouring markers' signals."""
    side = float(np.ptp(press.pad.rest_mm[:, :2], axis=0).max())
    says = f"rest_mm spans {side:.3g} mm (expected 3 to 150 mm)"
    yield Misfit(Kind.MARKERS_UNIT, abs_ln(side / FACE_MM) / FACE, says)
    similarity = []
    for values in (press.felt_mm, press.force_N):
        mean, sd = at_peak(press, values)
        if mean[:, 2].std() > 4 * sd:
            similarity.append(correlation(mean[:, 2], mean[press.near, 2].mean(axis=1)))
    if press.touched.sum() >= FEWEST_ORDERED and len(similarity) == 2:
        stated = f"{max(*similarity, 0.0):.2f}, expected above 0.5"
        says = f"neighbours on the gel have different signals (correlation {stated})"
        yield Misfit(Kind.MARKERS_ORDER, (1 - max(similarity)) / NEIGHBOURS, says)


def _sensor(pad: GelPad, known: PublishedGel) -> Iterator[Misfit]:
    """Misfits of stated stiffness and pitch with those published for the sensor's gel. Forces that were
    computed with a wrong stiffness fit it exactly, so that no other relation shows it.
    """
    for name, (expected, sd) in known.stiffness.items():
        stated: float = getattr(pad, name)
        off = abs_ln(stated / expected)
        says = f"{name} is {stated:g}, but {known.source} has {expected:.3g} ± {100 * sd:.2g} %"
        yield Misfit(Kind.STIFFNESS_NOT_OF_SENSOR, off / (PUBLISHED * sd), says, relative_sd=off)
    area_mm2 = marker_area_mm2(pad.rest_mm)
    if area_mm2 is not None and known.pitch_mm is not None:
        pitch = float(np.sqrt(area_mm2))
        off, sd = abs_ln(pitch / known.pitch_mm), known.pitch_sd
        says = (
            f"markers are {pitch:.3g} mm apart, but {known.source} has {known.pitch_mm:.3g} mm ± "
            f"{100 * sd:.2g} %"
        )
        yield Misfit(Kind.PITCH_NOT_OF_SENSOR, off / (PUBLISHED * sd), says, relative_sd=E_PER_PITCH * off)


def closing_mm(press: Pressing) -> float:
    """Travel of the pad past its first touch (the last frame before any marker is pressed)."""
    pressed = press.pressed.sum(axis=1) >= FEWEST_PRESSED
    way = press.closing_mm
    return float(way.max() - way[max(int(np.argmax(pressed)) - 1, 0)]) if pressed.any() else 0.0


def _closing(press: Pressing, E_range_MPa: tuple[float, float] | None) -> Iterator[Misfit]:
    """Misfits of the gel's indentation, and of a half-space's modulus, with the jaw's travel."""
    if not press.touched.any():
        return
    closing = closing_mm(press)
    felt = float(np.quantile(np.abs(press.felt_mm[:, :, 2]).max(axis=0), DEEPEST))
    share = felt / (closing + STEP_MM)
    if share > IN_GEL or gives_way(press):
        most = IN_GEL * float(np.exp(FAILS_AT * IN_GEL_SD)) * (closing + STEP_MM)
        says = (
            f"gel is indented by {felt:.2g} mm while its jaw moves {closing:.2g} mm past first contact "
            f"(expected at most {most:.2g} mm)"
        )
        yield Misfit(Kind.TOO_DEEP, abs_ln(share / IN_GEL) / IN_GEL_SD, says)
    if E_range_MPa is not None:
        total_N = float(np.abs(press.force_N[:, :, 2].sum(axis=1)).max())
        into_flesh = max(closing - felt, 0.1 * (closing + STEP_MM))
        E = 0.75 * (1 - NU**2) * total_N / (np.sqrt(RADIUS_MM) * into_flesh**1.5)
        low, high = E_range_MPa[0] / HERTZ_OFF, E_range_MPa[1] * HERTZ_OFF
        yield Misfit(Kind.MODULUS, 4 * abs_ln(E / np.sqrt(low * high)) / abs_ln(high / low))
