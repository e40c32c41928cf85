"""Whether frames are in the order in which they were taken, and gel, jaws and clock in step."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from tactile.checks.finding import Finding, FindingKind, FindingRank
from tactile.checks.pressing import FEWEST_PRESSED, PRESSED_SD, QUIET_OVER, QUIET_SHARE, Pressing, clearer
from tactile.contact import STARTS_IN_CONTACT
from tactile.io.recording import Recording

FEWEST_MOVES, STEP_SHARE = 8, 0.02
"""Steps of the jaws that are counted, of at least this share of their way: fewer say nothing of order, and
smaller ones are the log's resolution."""
TURNS = 0.45
"""Share of the jaws' steps that go back on the one before; frames in chance order have two thirds, protocols
of several cycles up to a quarter (0.13 in benchmarks/field_spreads.py)."""
ROUGH = 0.3
"""Mean square of a signal's steps over twice its variance: 1 for chance order; sound recordings, some of
whose signals cross their whole range in five frames, have up to 0.18 (benchmarks/field_spreads.py)."""
OVER_NOISE = 15.0
"""A total below so many standard deviations of its noise jumps for no other reason: its steps then are 1/10
of its square, a third of ROUGH."""
LATE_AT, LATE_MM, EARLY_MM = 0.15, 0.6, 1.2
"""The jaws' opening at release less that at touch (mm, both pads together), where the gel passes this share
of its peak: late signals make it positive. Sound flesh has 0.1 and less, an adhesive gel (reach 0.12 mm)
0.25; creep and yield make it negative, to -0.59 (benchmarks/field_spreads.py)."""
LATE_REFUSED_MM, CLOSING_MM, E_PER_MM_LATE = 4.0, 3.5, 0.15
"""A clock late by 0.19 s at 4 mm/s, which `drupe explain` can put right, makes 3.1 mm (open-08). Limits are
for jaws that close by CLOSING_MM, and grow with it. Relative error of E per mm: taken, not measured; half of
the share of a closing that a mm is."""
SPEED_MM_PER_S = (0.008, 300.0)
"""Fastest closing of a gripper's jaws: grippers have 0.1 to 100, testing machines that hold a fruit between
two pads 0.017 (1 mm/min) and more, the recordings here 1 to 9 (benchmarks/field_spreads.py). Milliseconds
are seen below 8 mm/s."""
SAME_STEP, MOST_LOST = 0.05, 4
"""Relative difference (of time steps) that counts as none; frames lost at once: 5 steps at once are a
pause."""
FEWEST_DROPPED, DROPPED_SAID = 3, 0.1
"""Such time steps, and their share of all: every third frame dropped makes 0.19 to 0.36, a lost frame in a
long recording harms nothing. Sound recordings, whose pace changes up to ten times, have none
(benchmarks/field_spreads.py)."""
E_OF_DROPPED = 0.02
"""Relative standard deviation of E: every third frame dropped changed two fruit's E by 0.1 and 1.7 %
(benchmarks/field_mistakes.py --grade --only dropped)."""
IN_CONTACT = 0.15
"""Share of the peak, of displacement and of force, that may be left in the first and the last frame; sound
ones have 0.09 and less (benchmarks/field_spreads.py)."""
E_WITHOUT_TOUCH = 0.2
"""Relative standard deviation of E. Markers are compared with themselves at their first touch; without it the
surface counts, as far as its error is known (absolute surfaces: 15 to 18 %)."""
TARE_SHARE, TARE_MOVED, E_OF_A_TARE = 0.1, 0.3, 0.05
"""Force at rest over the peak where the displacement has less than 0.3 of that share; E's relative standard
deviation: an offset that is seen as one is taken out with the frames in the air."""
NEAR_THE_LIMIT = 0.9
"""Of tactile.contact's own limit for a recording that starts in contact, above which it sees no frame in the
air: the two take their medians over unlike frames."""
FEWEST_QUIET, DRIFT_SHARE, DRIFT_SD = 3, 0.04, 6.0
"""Quiet frames before and after; change of the force over the peak, and over its noise. Sound recordings
change by up to 0.026 of the peak on the even half; fruit drawn without a solver, whose forces are as small
as 0.3 N, by 0.098 of it where that is 4.6 times the noise (benchmarks/field_spreads.py)."""
E_PER_DRIFT = 0.5
"""Relative error of E per share of the peak: a drift that grows evenly is half of it at the peak."""
FEWEST_FRAMES, STRONG, CALM, FEWEST_CALM, LEAST_SPREAD = 8, 0.1, 0.35, 5, 0.05
"""Of `roughness`: frames in all; share of the peak from which a frame counts; share of the jaws' way that a
step may be (a larger one is a jump of its own); steps that make a mean; and the variance over the square of
the peak that a signal is taken to have at least, for a hold has none."""


def time_findings(recording: Recording, pressings: Sequence[Pressing]) -> list[Finding]:
    """Chance order of the jaws' log and of the gel's frames, a gel that is late, a clock in another unit."""
    back = turns_share(recording.aperture_mm)
    if back > TURNS:
        says = (
            f"the frames are out of order (shuffled): the jaws reverse in {100 * back:.0f} % of their steps; "
            "sort the frames by their times"
        )
        return [Finding(FindingKind.FRAMES_SHUFFLED, FindingRank.FIELD, says, refused=True)]
    shuffled = list(_shuffled(recording.aperture_mm, pressings))
    return [
        *shuffled,
        *([] if shuffled else _late(recording, pressings)),
        *_clock(recording),
        *_logger(recording),
        *_dropped(recording),
        *_start(pressings),
        *_drift(pressings),
        *_end(pressings),
    ]


def _shuffled(jaws_mm: Float[np.ndarray, " t"], pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """Fields that jump from frame to frame while the jaws do not."""
    for press in pressings:
        fields = {
            "displacement": (press.felt_mm, press.felt_sd_mm),
            "force": (press.force_N, press.force_sd_N),
        }
        for name, (values, sd) in fields.items():
            signal = values[:, press.touched, 2].sum(axis=1)
            faint = np.abs(signal).max(initial=0.0) < OVER_NOISE * sd * np.sqrt(press.touched.sum())
            if not faint and roughness(signal, jaws_mm) > ROUGH:
                kind, pads = FindingKind.GEL_FRAMES_SHUFFLED, (press.pad.name,)
                says = (
                    f"{name} jumps from frame to frame while the jaws move evenly: its frames are out of "
                    "order (shuffled) relative to the jaws' log"
                )
                yield Finding(kind, FindingRank.FIELD, says, pads=pads, refused=True)


def dropped_steps(time_s: Float[np.ndarray, " t"]) -> int:
    """Time steps that are a whole multiple, at least twice, of the steps beside them, which are alike.

    A protocol that changes its pace has unlike steps on the two sides of such a change; a clock that jitters
    has no whole multiples.
    """
    step = np.diff(time_s)
    before, here, after = step[:-2], step[1:-1], step[2:]
    similar = np.abs(after - before) <= SAME_STEP * before
    times = here / ((before + after) / 2)
    whole = np.abs(times - np.rint(times)) <= SAME_STEP * times
    return int((similar & whole & (np.rint(times) >= 2) & (np.rint(times) <= MOST_LOST + 1)).sum())


def _logger(recording: Recording) -> Iterator[Finding]:
    """What the logger did and reading put right."""
    for correction in recording.corrections:
        said, detail = correction.says.rstrip("."), f"{correction.fault} {correction.quantity}"
        yield Finding(FindingKind.LOGGER, FindingRank.MACHINE, said, detail=detail, remark=True)


def _dropped(recording: Recording) -> Iterator[Finding]:
    """Frames that are missing between those that are there."""
    steps, missing = len(recording.time_s) - 1, dropped_steps(recording.time_s)
    if missing >= FEWEST_DROPPED and missing >= DROPPED_SAID * steps:
        says = (
            f"frames were dropped: {missing} of {steps} time steps are at least twice their neighbours; "
            "record at a lower rate, or check the computer's load"
        )
        yield Finding(FindingKind.FRAMES_DROPPED, FindingRank.FIELD, says, relative_sd=E_OF_DROPPED)


def _end(pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """A recording that ends while it is pressed."""
    pads = tuple(press.pad.name for press in pressings if _pressed_in(press, -1))
    if pads:
        says = (
            "recording ends under load (there is no unloading). E needs none, but without it drupe cannot "
            "detect clock lag, force drift, creep or yield"
        )
        yield Finding(FindingKind.ENDS_PRESSED, FindingRank.MACHINE, says, pads=pads, remark=True)


def _raw_totals(press: Pressing) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Indentation and normal force as they were written, summed over the markers that are pressed."""
    use = press.touched
    return -press.pad.displacement_mm[:, use, 2].sum(axis=1), press.pad.force_N[:, use, 2].sum(axis=1)


def _pressed_in(press: Pressing, frame: int) -> bool:
    """Whether displacement and force are well above zero in a frame."""
    totals = _raw_totals(press)
    return bool(press.touched.any()) and all(
        bool(total[frame] > IN_CONTACT * np.abs(total).max()) for total in totals
    )


def turns_share(jaws_mm: Float[np.ndarray, " t"]) -> float:
    """Share of the jaws' steps that go back on the one before; 0 of few steps."""
    moves = np.diff(jaws_mm)
    moves = moves[np.abs(moves) > STEP_SHARE * max(float(np.ptp(jaws_mm)), 1e-9)]
    return float((moves[1:] * moves[:-1] < 0).mean()) if len(moves) >= FEWEST_MOVES else 0.0


def drift_of(press: Pressing) -> tuple[float, float, float] | None:
    """Change of the total force from before the grasp to after it, its noise, and the peak (N).

    None where either side has no quiet frames.
    """
    pressed = np.flatnonzero(
        (press.felt_mm[:, press.touched, 2] > PRESSED_SD * press.felt_sd_mm).sum(axis=1) >= FEWEST_PRESSED
    )
    if not len(pressed):
        return None
    still = np.sqrt((press.felt_mm**2).mean(axis=(1, 2)))
    quiet = np.asarray(still <= QUIET_OVER * np.percentile(still, QUIET_SHARE))
    before, after = quiet.copy(), quiet.copy()
    before[pressed[0] :] = False
    after[: pressed[-1]] = False
    if min(before.sum(), after.sum()) < FEWEST_QUIET:
        return None
    total = press.force_N[:, :, 2].sum(axis=1)
    change = float(np.median(total[after]) - np.median(total[before]))
    noise = float(total[before].std()) / float(np.sqrt(min(before.sum(), after.sum()) / 2))
    return change, noise, float(total.max())


def _drift(pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """Force that does not come back to where it was before the first touch, though the gel does."""
    for press in pressings:
        change, noise, peak = drift_of(press) or (0.0, 0.0, 1.0)
        if abs(change) > max(DRIFT_SHARE * peak, DRIFT_SD * noise):
            says = (
                f"force drifts: without contact it differs by {change:+.2f} N between before and after the "
                f"grasp ({100 * change / peak:+.0f} % of the peak)"
            )
            pads, sd = (press.pad.name,), E_PER_DRIFT * abs(change) / peak
            yield Finding(FindingKind.FORCE_DRIFT, FindingRank.RELATION, says, pads=pads, relative_sd=sd)


def _start(pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """A recording that begins in contact, and forces without a tare."""
    for press in pressings:
        if not press.touched.any():
            continue
        totals, pads = _raw_totals(press), (press.pad.name,)
        u, F = (float(np.abs(total).max()) for total in totals)
        rest_u, rest_F = (float(np.median(total[press.quiet])) for total in totals)
        starts = _pressed_in(press, 0)
        if starts:
            kind, sd, refused = FindingKind.STARTS_IN_CONTACT, E_WITHOUT_TOUCH, False
            says = (
                f"recording starts in contact ({100 * totals[0][0] / u:.0f} % of its peak in the first "
                "frame): the frames before first contact are missing"
            )
        elif abs(rest_F) > TARE_SHARE * F and abs(rest_u) < TARE_MOVED * TARE_SHARE * u:
            kind, sd, refused = FindingKind.NO_TARE, E_OF_A_TARE, _taken_for_contact(press)
            says = f"force has an offset of {rest_F:.2g} N in the contact's markers without contact (no tare)"
        else:
            continue
        rank = FindingRank.MACHINE
        yield Finding(kind, rank, says, pads=pads, refused=refused, relative_sd=sd, hides_touch=starts)


def _taken_for_contact(press: Pressing) -> bool:
    """Whether the offset of the whole pad is so large that tactile.contact sees no frame in the air."""
    total = press.pad.force_N[:, :, 2].sum(axis=1)
    return bool(np.median(total[press.quiet]) > NEAR_THE_LIMIT * STARTS_IN_CONTACT * total.max())


def roughness(signal: Float[np.ndarray, " t"], jaws_mm: Float[np.ndarray, " t"]) -> float:
    """Mean square of steps where the jaws step less than usual, over twice the variance in contact."""
    if np.ptp(signal) <= 0 or len(signal) < FEWEST_FRAMES:
        return 0.0
    strong = np.abs(signal) > STRONG * np.abs(signal).max()
    calm = np.abs(np.diff(jaws_mm)) <= CALM * max(float(np.ptp(jaws_mm)), 1e-12)
    use = (strong[1:] | strong[:-1]) & calm
    spread = float(signal[strong].var()) if strong.sum() > 3 else 0.0
    if use.sum() < FEWEST_CALM or spread <= 0:
        return 0.0
    spread = max(spread, LEAST_SPREAD * float(np.abs(signal).max()) ** 2)
    return float((np.diff(signal)[use] ** 2).mean() / (2 * spread))


def release_less_touch_mm(recording: Recording, pressings: Sequence[Pressing]) -> float | None:
    """The jaws' opening where the gel is released less that where it is touched; None without either."""
    jaws = recording.aperture_mm if recording.loading == "grasp" else -recording.aperture_mm
    total = np.sum(
        [
            total / max(float(total.max()), 1e-30)
            for total in (clearer(pressing)[0][:, pressing.touched, 2].sum(axis=1) for pressing in pressings)
        ],
        axis=0,
    )
    at = LATE_AT * float(total.max())
    up = np.flatnonzero((total[1:] >= at) & (total[:-1] < at))
    down = np.flatnonzero((total[1:] < at) & (total[:-1] >= at))
    if not len(up) or not len(down) or down[-1] <= up[-1]:
        return None
    touch, release = (_crossing(total, jaws, k, at) for k in (int(up[-1]), int(down[-1])))
    return release - touch


def _late(recording: Recording, pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """Touch and release at unlike openings of the jaws."""
    apart = release_less_touch_mm(recording, pressings)
    scale = max(
        1.0, float(np.ptp(recording.aperture_mm)) / CLOSING_MM
    )  # the limits are for jaws that close so far
    if apart is None or -EARLY_MM * scale <= apart <= LATE_MM * scale:
        return
    late, wider = ("late", "wider") if apart > 0 else ("early", "closer")
    says = (
        f"the gel's signals (displacement and force) are {late} relative to the jaws: at release the jaws "
        f"are {abs(apart):.2f} mm {wider} than at first contact; the two clocks disagree (lag)"
    )
    refused, sd = bool(abs(apart) > LATE_REFUSED_MM * scale), E_PER_MM_LATE * abs(apart)
    yield Finding(FindingKind.CLOCKS_APART, FindingRank.MACHINE, says, refused=refused, relative_sd=sd)


def _crossing(
    signal: Float[np.ndarray, " t"], jaws_mm: Float[np.ndarray, " t"], k: int, level: float
) -> float:
    share = (level - signal[k]) / (signal[k + 1] - signal[k])
    return float(jaws_mm[k] + share * (jaws_mm[k + 1] - jaws_mm[k]))


def _clock(recording: Recording) -> Iterator[Finding]:
    """A clock in another unit, by a gripper's jaws. E knows no time, so that it is a remark."""
    speed = np.abs(np.diff(recording.aperture_mm)) / np.diff(recording.time_s)
    fastest = float(speed.max(initial=0.0))
    low, high = SPEED_MM_PER_S
    if recording.loading == "grasp" and fastest != 0 and not low <= fastest <= high:
        unit = "milliseconds" if fastest < low else "minutes or hours"
        says = (
            f"time_s looks like {unit}: the jaws would close at {fastest:.2g} mm/s, expected {low:g} to "
            f"{high:g}; E does not depend on it"
        )
        yield Finding(FindingKind.TIME_UNIT, FindingRank.MACHINE, says, remark=True)
