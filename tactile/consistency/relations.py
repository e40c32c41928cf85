"""The relations that every sound recording obeys, and how far a recording is from each.

A recording's likelihood is a product over relations. Each is a quantity whose spread over sound recordings is
known: with r its distance in standard deviations, its log likelihood is that of Student's t with 9 degrees of
freedom, -5 ln(1 + r^2 / 9), whose tails leave room for fruit and sensors that nobody has recorded yet (Lange,
Little and Taylor 1989). Standard deviations are those of benchmarks/field_spreads.py unless they are said to
be assumed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from tactile.consistency.finding import MEANINGLESS, Field, times_said
from tactile.consistency.finding import FindingKind as Kind
from tactile.consistency.pressing import (
    FEWEST_PRESSED,
    FRAMES_SIMILAR,
    Pressing,
    at_peak,
    clearer,
    gives_way,
    pressing_of,
)
from tactile.readers.recording import GelPad, Recording, marker_area_mm2
from tactile.readers.sensor_model import PublishedGel

LIMIT = 5.0
"""Log Bayes factor from which a transformation is named, and loss from which a relation fails: odds of 150,
as many as there are relations and transformations; a distance of 3.9 standard deviations."""
FAILS_AT = 3.0 * float(np.sqrt(np.expm1(LIMIT / 5.0)))
"""The same in standard deviations."""
GAIN, OVER_TIME, OVER_MARKERS = 0.02, 0.018, 0.1
"""Of a gel's law: ln of the forces over what the law gives; 1 less the correlations over frames and
markers."""
LEAST_NOISE, LEAST_SHARE_SEEN = 1e-3, 0.2
"""Noise of a recording that has none, of the largest value; share of a variance that must not be noise."""
PRESSES_DEG = 17.0
"""Mean force, and stiffness times displacement, against the pad's normal; friction of 1 makes 45 degrees."""
NEIGHBOURS, FEWEST_ORDERED = 0.13, 20
"""1 less the correlation of a marker with its neighbours, and pressed markers that say something of it."""
FACE_MM, FACE = 21.0, 0.5
"""Longest side of a gel's markers and the spread of its ln: sensors have 10 to 60 mm."""
PUBLISHED = 0.76
"""Of a published standard deviation, whose tails need no room: three of them fail."""
IN_GEL, IN_GEL_SD, STEP_MM = 0.08, 0.71, 0.13
"""A gel's indentation over its jaw's way past the first touch, whose frame's step is STEP_MM: 0.05 to
0.55."""
NU, RADIUS_MM, HERTZ_OFF = 0.45, 25.0, 2.0
"""For the modulus of a half-space under a ball, which is right to a factor of two for any fruit here."""
BALANCE = 0.1
"""ln of one pad's normal force over the other's at the peak (assumed: weight, tilt of the pads)."""
TURNS, STEP_SHARE = 0.115, 0.02
"""Share of the jaws' steps, of at least STEP_SHARE of their way, that go back on the one before."""
ROUGH, STRONG, CALM, FEWEST_FRAMES = 0.076, 0.1, 0.35, 8
"""Mean square of a signal's steps over twice its variance, where the signal has STRONG of its peak and the
jaws step by less than CALM of their way: 1 for chance order."""
LATE_MM, LATE_SD_MM, LATE_AT, CLOSING_MM = -0.3, 0.23, 0.15, 3.5
"""The jaws' opening at release less that at touch, where the gel passes LATE_AT of its peak, of jaws that
close by CLOSING_MM: creep and yield make it negative, adhesion positive."""
OPENING_SD_MM, OPENING_SHARE = 0.076, 0.025
"""Aperture against the poses' distance, in mm and of the jaws' way (assumed: a clock, a bent finger)."""
FACING_DEG, AROUND, AWAY = 6.6, 0.18, 0.26
"""Angle between a pad's normal and the line to the other pad; ln of the fruit's size over the pads' distance,
where that is smaller; 1 less the cosine between normal and the fruit's middle (all assumed)."""
OVER_NOISE = 10.0
"""Means and sums below so many standard deviations of their noise say nothing."""
E_PER_GAIN, E_OF_APERTURE, E_PER_LATE = 0.7, 0.2, 0.28
"""Relative errors of E: per ln of a gain, whose cause may be force (1.1), displacement (0.3) or stiffness;
assumed, which of aperture and poses is wrong is not known; per share of the closing that a lag is, of which
3 of 3.5 mm make 0.01 to 0.25."""
E_PER_PITCH = 2.2
"""Error of ln E per ln of the pictures' scale where it enters all lengths and the forces of springs with its
third power: 0.21 at 1.1 (benchmarks/field_mistakes.py --grade --only "picture scale"). Where it enters the
markers' places alone and the forces with its square, 0.8."""


WRONG_MESH = (
    "the mesh is rotated, mirrored or of another fruit, or a pose is wrong (a moved pad, another day, the "
    "other pad)"
)
CAUSES = {
    Kind.SCALE: "a gain of the force, a scale of the displacement, a creeping gel, or the stiffness (kn, kt) "
    "of another gel",
    Kind.OUT_OF_STEP: "frames of one of them are shuffled, missing or wrong; record the grasp again",
    Kind.OTHER_MARKERS: "one of them has another marker order (permuted), or other axes; write both in one "
    "order",
    Kind.AXES: "its axes are exchanged or rotated; z points out of the gel into the fruit",
    Kind.MARKERS_UNIT: "another unit; write the positions of the markers on the gel in millimetres",
    Kind.MARKERS_ORDER: "markers are in another order (permuted) in rest_mm than in displacement and force; "
    "write all three in one order",
    Kind.STIFFNESS_NOT_OF_SENSOR: "a wrong value, or another gel. E has the same relative error if the "
    "forces use this value. Correct the stiffness, or state the gel's own under [sensor] in batch.toml",
    Kind.PITCH_NOT_OF_SENSOR: "the scale of the gel's pictures is wrong (in displacement and forces), or the "
    "sensor has another gel. Calibrate the sensor's camera",
    Kind.TOO_DEEP: "displacement or poses are scaled, or from another recording",
    Kind.FRAMES_SHUFFLED: "the frames are out of order (shuffled); sort the frames by their times",
    Kind.GEL_FRAMES_SHUFFLED: "its frames are out of order (shuffled) relative to the jaws' log",
    Kind.CLOCKS_APART: "the two clocks disagree (lag); give gel and jaws one clock",
    Kind.POSES_TURNED: "rotations are transposed, or the poses are from another day; record the poses again",
    Kind.POSE_AWAY: "a wrong pose; z must point out of the gel into the fruit",
    Kind.APERTURE: "aperture and poses disagree (from another recording, or with another clock)",
    Kind.POSES_UNIT: "poses or mesh have another unit; write millimetres",
    Kind.WIDTH: "the recording is of another fruit, the mesh is scaled, rotated or of another fruit, or the "
    "poses are wrong",
    Kind.ASIDE: WRONG_MESH,
    Kind.PRINT_ASIDE: WRONG_MESH,
}
"""What is likely, and what to do, where a relation fails and no transformation explains it."""
COMPARED = frozenset({Kind.UNBALANCED, Kind.MODULUS})
"""Relations that fruit and pads may break too: they only tell which of two transformations is likelier."""


@dataclass(frozen=True)
class Misfit:
    """How far a recording is from one relation.

    `sds`: in standard deviations of sound recordings. `says` continues the pads' names: what was found, and
    what was expected. `relative_sd`: of E, where no transformation explains it.
    """

    kind: Kind
    sds: float
    says: str = ""
    _: KW_ONLY
    pads: tuple[str, ...] = ()
    field: Field | None = None
    detail: str = ""
    relative_sd: float = MEANINGLESS

    @property
    def loss(self) -> float:
        """Minus its log likelihood, 0 at the best."""
        return float(5.0 * np.log1p(self.sds**2 / 9.0))

    @property
    def fails(self) -> bool:
        """Whether the recording is not sound for this relation alone."""
        return self.loss > LIMIT and self.kind not in COMPARED


@dataclass(frozen=True, kw_only=True)
class Situation:
    """A recording with its pads made ready, and what it is held against: the fruit's mesh and that mesh's
    error, moduli of its category, gels of its sensor. `touch_is_seen`: nothing hides where the pads meet the
    fruit.
    """

    recording: Recording
    pressings: tuple[Pressing, ...]
    vertices: Float[np.ndarray, "v 3"] | None = None
    faces: Int[np.ndarray, "f 3"] | None = None
    E_range_MPa: tuple[float, float] | None = None
    surface_sd_mm: float = 0.0
    gels: tuple[PublishedGel, ...] = ()
    touch_is_seen: bool = True

    def with_pads(self, pads: Sequence[GelPad]) -> "Situation":
        """The same with these pads; signals that did not change are not made ready again."""
        ready = tuple(
            replace(press, pad=pad) if _same_signals(press.pad, pad) else pressing_of(pad)
            for press, pad in zip(self.pressings, pads, strict=True)
        )
        return replace(self, recording=replace(self.recording, pads=tuple(pads)), pressings=ready)


def _same_signals(pad: GelPad, other: GelPad) -> bool:
    return all(
        getattr(pad, name) is getattr(other, name)
        for name in ("rest_mm", "displacement_mm", "force_N", "gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm")
    )


def signal_misfits(situation: Situation) -> list[Misfit]:
    """Signals against each other, the sensor, jaws, poses and clock; of the mesh only its middle and size."""
    known = situation.touch_is_seen and situation.vertices is not None
    of_pads = [
        replace(misfit, pads=(press.pad.name,))
        for press in situation.pressings
        for relation in (_law, _direction, _grid)
        for misfit in relation(press)
    ]
    for press in situation.pressings:
        against = [misfit for gel in situation.gels for misfit in _sensor(press.pad, gel)]
        against += _closing(press, situation.E_range_MPa) if known else ()
        of_pads += [replace(misfit, pads=(press.pad.name,)) for misfit in against]
    return [*of_pads, *_machine(situation)]


def correlation(a: Float[np.ndarray, "t ..."], b: Float[np.ndarray, "t ..."]) -> float:
    """Of two series, over all their components; 0 where one is constant."""
    a, b = (x - x.mean(axis=0) for x in (a, b))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _ln(ratio: float) -> float:
    """|ln| of a ratio, large where it is 0."""
    return abs(float(np.log(max(ratio, 1e-12))))


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _whitened(
    values: Sequence[Float[np.ndarray, "k 3"]], noise: Sequence[Float[np.ndarray, "q 3"]]
) -> tuple[list[Float[np.ndarray, "k 3"]], list[float]]:
    """Displacement and the one by the forces, each component over the noise of both together, and the share
    of each one's variance that is not noise. `noise`: what both are where nothing is pressed.
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


def _totals(press: Pressing) -> tuple[list[Float[np.ndarray, "t 3"]], list[float]] | None:
    """Displacement felt, and by the forces, summed over the pressed markers and whitened; None without a
    law."""
    if press.gel_mm is None or not press.touched.any() or not gives_way(press):
        return None
    totals = [field[:, press.touched].sum(axis=1) for field in (press.felt_mm, press.gel_mm)]
    return _whitened(totals, [total[press.quiet] for total in totals])


def gain_of(press: Pressing) -> float | None:
    """Size of the normal displacement that the forces make by the gel's law over that of the one felt, both
    summed over the pressed markers, without their noise; None where no law says anything of the pad.
    """
    if press.gel_mm is None or not press.touched.any() or not gives_way(press):
        return None
    totals = [field[:, press.touched, 2].sum(axis=1) for field in (press.felt_mm, press.gel_mm)]
    felt, gel = (float((total**2).mean() - total[press.quiet].var()) for total in totals)
    return float(np.sqrt(gel / felt)) if min(felt, gel) > 0 else None


def _law(press: Pressing) -> Iterator[Misfit]:
    """Displacement against the one that the forces make: size, course over time, pattern over markers."""
    gain, totals = gain_of(press), _totals(press)
    if gain is None or totals is None or press.gel_mm is None:
        return
    most = float(np.exp(FAILS_AT * GAIN))
    says = (
        f"force is {times_said(gain)} the value from this gel's stiffness and displacement (expected "
        f"{1 / most:.2f} to {most:.2f} times)"
    )
    yield Misfit(Kind.SCALE, _ln(gain) / GAIN, says, relative_sd=E_PER_GAIN * _ln(gain))
    in_time = correlation(*totals[0]) / float(np.sqrt(np.prod(totals[1])))
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
    """Friction carries no more than about the normal force: force, and stiffness times displacement, point
    out of the gel.
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
            angle = _degrees(mean[2] / size)
            says = f"{name} points {angle:.0f}° away from the pad's normal (expected below 68°)"
            yield Misfit(Kind.AXES, angle / PRESSES_DEG, says, field=name)


def _grid(press: Pressing) -> Iterator[Misfit]:
    """Markers' places, and signals that are alike at neighbours."""
    side = float(np.ptp(press.pad.rest_mm[:, :2], axis=0).max())
    says = f"rest_mm spans {side:.3g} mm (expected 3 to 150 mm)"
    yield Misfit(Kind.MARKERS_UNIT, _ln(side / FACE_MM) / FACE, says)
    similarity = []
    for values in (press.felt_mm, press.force_N):
        mean, sd = at_peak(press, values)
        if mean[:, 2].std() > 4 * sd:
            similarity.append(correlation(mean[:, 2], mean[press.near, 2].mean(axis=1)))
    if press.touched.sum() >= FEWEST_ORDERED and len(similarity) == 2:
        stated = f"{max(*similarity, 0.0):.2f}, expected above 0.5"
        says = f"neighbours on the gel have different signals (correlation {stated})"
        yield Misfit(Kind.MARKERS_ORDER, (1 - max(similarity)) / NEIGHBOURS, says)


def measured_pitch_mm(pad: GelPad) -> float | None:
    """Root of the face that belongs to one marker; None where too few markers show it."""
    area_mm2 = marker_area_mm2(pad.rest_mm)
    return None if area_mm2 is None else float(np.sqrt(area_mm2))


def _sensor(pad: GelPad, known: PublishedGel) -> Iterator[Misfit]:
    """Stated stiffness and pitch against what is known of the sensor's gel; forces that were computed with a
    wrong stiffness fit it exactly, so that no other relation shows it.
    """
    for name, (expected, sd) in known.stiffness.items():
        stated: float = getattr(pad, name)
        off = _ln(stated / expected)
        says = f"{name} is {stated:g}, but {known.source} has {expected:.3g} ± {100 * sd:.2g} %"
        yield Misfit(Kind.STIFFNESS_NOT_OF_SENSOR, off / (PUBLISHED * sd), says, relative_sd=off)
    pitch = measured_pitch_mm(pad)
    if pitch is not None and known.pitch_mm is not None:
        off, sd = _ln(pitch / known.pitch_mm), known.pitch_sd
        says = (
            f"markers are {pitch:.3g} mm apart, but {known.source} has {known.pitch_mm:.3g} mm ± "
            f"{100 * sd:.2g} %"
        )
        yield Misfit(Kind.PITCH_NOT_OF_SENSOR, off / (PUBLISHED * sd), says, relative_sd=E_PER_PITCH * off)


def closing_mm(press: Pressing) -> float:
    """How far the pad goes past its first touch (the last frame before any marker is pressed)."""
    pressed = press.pressed.sum(axis=1) >= FEWEST_PRESSED
    way = press.closing_mm
    return float(way.max() - way[max(int(np.argmax(pressed)) - 1, 0)]) if pressed.any() else 0.0


def _closing(press: Pressing, E_range_MPa: tuple[float, float] | None) -> Iterator[Misfit]:
    """The gel's indentation, and a half-space's modulus, against how far the jaw closes."""
    if not press.touched.any():
        return
    closing = closing_mm(press)
    felt = float(np.quantile(np.abs(press.felt_mm[:, :, 2]).max(axis=0), 0.98))
    share = felt / (closing + STEP_MM)
    if share > IN_GEL or gives_way(press):
        most = IN_GEL * float(np.exp(FAILS_AT * IN_GEL_SD)) * (closing + STEP_MM)
        says = (
            f"gel is indented by {felt:.2g} mm while its jaw moves {closing:.2g} mm past first contact "
            f"(expected at most {most:.2g} mm)"
        )
        yield Misfit(Kind.TOO_DEEP, _ln(share / IN_GEL) / IN_GEL_SD, says)
    if E_range_MPa is not None:
        total_N = float(np.abs(press.force_N[:, :, 2].sum(axis=1)).max())
        into_flesh = max(closing - felt, 0.1 * (closing + STEP_MM))
        E = 0.75 * (1 - NU**2) * total_N / (np.sqrt(RADIUS_MM) * into_flesh**1.5)
        low, high = E_range_MPa[0] / HERTZ_OFF, E_range_MPa[1] * HERTZ_OFF
        yield Misfit(Kind.MODULUS, 4 * _ln(E / np.sqrt(low * high)) / _ln(high / low))


def _machine(situation: Situation) -> Iterator[Misfit]:
    """Pads, jaws and clock against each other; with a mesh poses too, which a recording alone may lack."""
    recording, pressings, vertices = situation.recording, situation.pressings, situation.vertices
    pair = len(pressings) == 2 and recording.loading == "grasp"
    yield _turns(recording.aperture_mm)
    yield from _rough(situation)
    if situation.touch_is_seen and (apart := release_less_touch_mm(situation)) is not None:
        yield _late(recording, apart)
    if pair:
        totals = [press.force_N[pressings[0].heaviest, :, 2].sum(axis=1).mean() for press in pressings]
        yield Misfit(Kind.UNBALANCED, _ln(abs(totals[0] / (totals[1] or 1e-30))) / BALANCE)
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
        yield Misfit(Kind.POSE_AWAY, (1 - cosine) / AWAY if cosine < 0 else 0.0, says, pads=(press.pad.name,))


def _turns(jaws_mm: Float[np.ndarray, " t"]) -> Misfit:
    moves = np.diff(jaws_mm)
    moves = moves[np.abs(moves) > STEP_SHARE * max(float(np.ptp(jaws_mm)), 1e-9)]
    back = float((moves[1:] * moves[:-1] < 0).mean()) if len(moves) >= FEWEST_FRAMES else 0.0
    says = f"the jaws reverse in {100 * back:.0f} % of their steps (expected below 45 %)"
    return Misfit(Kind.FRAMES_SHUFFLED, back / TURNS, says)


def _rough(situation: Situation) -> Iterator[Misfit]:
    """Fields that jump from frame to frame while the jaws do not."""
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
                spread = max(float(signal[strong].var()), 0.05 * peak**2)  # a hold has none
                says = f"{name} jumps from frame to frame while the jaws move evenly"
                rough = float((steps**2).mean()) / (2 * spread)
                pads = (press.pad.name,)
                yield Misfit(Kind.GEL_FRAMES_SHUFFLED, rough / ROUGH, says, field=name, pads=pads)


def release_less_touch_mm(situation: Situation) -> float | None:
    """The jaws' opening where the gel is released less that where it is touched; None without either."""
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
    """Poses against each other, against the aperture and against the fruit's size."""
    first, second = (press.pad.pose for press in situation.pressings)
    line = second[0, :3, 3] - first[0, :3, 3]
    angle = _degrees(-float(first[0, :3, 2] @ second[0, :3, 2]))
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
    yield Misfit(Kind.POSES_UNIT, _ln(min(apart / size_mm, 1.0)) / AROUND, says)
