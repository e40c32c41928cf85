"""Whether frames are in the order in which they were taken, and gel, jaws and clock in step."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactile.checks.finding import Finding, Kind, Rank
from tactile.checks.pressing import QUIET_OVER, QUIET_SHARE, Pressing, clearer
from tactile.contact import STARTS_IN_CONTACT
from tactile.recording import Recording

FEWEST_MOVES = 8
TURNS = 0.45
"""Share of the jaws' steps that go back on the one before; frames in chance order have two thirds, protocols
of several cycles up to a quarter."""
ROUGH = 0.3
"""Mean square of a signal's steps over twice its variance: 1 for chance order; sound recordings, some of
whose signals cross their whole range in five frames, have up to 0.16."""
OVER_NOISE = 15.0
"""A total below so many standard deviations of its noise jumps for no other reason."""
LATE_MM, EARLY_MM = 0.6, 1.2
"""The jaws' opening at release less that at touch, both pads together: late signals make it positive. Sound
flesh has 0.1 and less, an adhesive gel (reach 0.12 mm) 0.25; creep and yield make it negative."""
LATE_REFUSED_MM = 4.0
"""A clock late by 0.19 s at 4 mm/s, which `drupe explain` can put right, makes 3.1."""
SPEED_MM_PER_S = (0.02, 300.0)
"""Fastest closing of the jaws; grippers have 0.1 to 100."""
IN_CONTACT = 0.15
"""Share of the peak that the gel may show in the first frame."""
E_WITHOUT_TOUCH = 0.2
"""Markers are compared with themselves at their first touch; without it the surface counts, as far as its
error is known (absolute surfaces: 15 to 18 %)."""
TARE_SHARE = 0.1
"""Force at rest over the peak where the displacement is none."""


def time_findings(recording: Recording, pressings: Sequence[Pressing]) -> list[Finding]:
    """Chance order of the jaws' log and of the gel's frames, a gel that is late, a clock in another unit."""
    jaws = recording.aperture_mm
    found: list[Finding] = []
    moves = np.diff(jaws)
    moves = moves[np.abs(moves) > 0.02 * max(float(np.ptp(jaws)), 1e-9)]
    disordered = len(moves) >= FEWEST_MOVES and float((moves[1:] * moves[:-1] < 0).mean()) > TURNS
    if disordered:
        return [
            _refused(
                Kind.FRAMES_SHUFFLED,
                "the frames are out of order (shuffled): the jaws turn back at "
                f"{100 * float((moves[1:] * moves[:-1] < 0).mean()):.0f} % of their steps; "
                "sort the frames by the time at which they were taken",
            )
        ]
    for one in pressings:
        for name, values, sd in (
            ("displacement", one.felt_mm, one.felt_sd_mm),
            ("force", one.force_N, one.force_sd_N),
        ):
            signal = values[:, one.touched, 2].sum(axis=1)
            faint = np.abs(signal).max(initial=0.0) < OVER_NOISE * sd * np.sqrt(one.touched.sum())
            if not faint and roughness(signal, jaws) > ROUGH:
                found.append(
                    _refused(
                        Kind.GEL_FRAMES_SHUFFLED,
                        f"{name} jumps from frame to frame while the jaws move evenly: "
                        "its frames are out of order (shuffled) against the jaws' log",
                        pads=(one.pad.name,),
                    )
                )
    if not found:
        found += _late(recording, pressings)
    found += _clock(recording)
    return [*found, *_start(pressings), *_drift(pressings)]


def _drift(pressings: Sequence[Pressing]) -> list[Finding]:
    """Force that does not come back to where it was before the first touch, though the gel does."""
    found = []
    for one in pressings:
        pressed = np.flatnonzero((one.felt_mm[:, one.touched, 2] > 6 * one.felt_sd_mm).sum(axis=1) >= 3)
        if not len(pressed):
            continue
        still = np.sqrt((one.felt_mm**2).mean(axis=(1, 2)))
        quiet = np.asarray(still <= QUIET_OVER * np.percentile(still, QUIET_SHARE))
        before, after = quiet.copy(), quiet.copy()
        before[pressed[0] :] = False
        after[: pressed[-1]] = False
        if min(before.sum(), after.sum()) < FEWEST_QUIET:
            continue
        total = one.force_N[:, :, 2].sum(axis=1)
        peak = float(total.max())
        change = float(np.median(total[after]) - np.median(total[before]))
        noise = float(total[before].std()) / np.sqrt(min(before.sum(), after.sum()) / 2)
        if abs(change) > max(DRIFT_SHARE * peak, 6 * noise):
            found.append(
                Finding(
                    kind=Kind.FORCE_DRIFT,
                    rank=Rank.RELATION,
                    pads=(one.pad.name,),
                    says=(
                        f"force drifts: with nothing touching it differs by {change:+.2f} N after the grasp "
                        f"from before ({100 * change / peak:+.0f} % of the peak)"
                    ),
                    relative_sd=0.5 * abs(change) / peak,
                )
            )
    return found


FEWEST_QUIET, DRIFT_SHARE = 3, 0.04
"""Quiet frames before and after; share of the peak. Sound recordings change by up to 0.033 of
it and 3.0 standard deviations of the noise; 4 % and 6 are asked for."""


def _start(pressings: Sequence[Pressing]) -> list[Finding]:
    """A recording that begins in contact, and forces without a tare."""
    found = []
    for one in pressings:
        use = one.touched
        if not use.any():
            continue
        raw_u, raw_F = -one.pad.displacement_mm[:, use, 2].sum(axis=1), one.pad.force_N[:, use, 2].sum(axis=1)
        u, F = (float(np.abs(x).max()) for x in (raw_u, raw_F))
        if raw_u[0] > IN_CONTACT * u and raw_F[0] > IN_CONTACT * F:
            found.append(
                Finding(
                    kind=Kind.STARTS_IN_CONTACT,
                    rank=Rank.MACHINE,
                    pads=(one.pad.name,),
                    says=(
                        f"recording starts in contact ({100 * raw_u[0] / u:.0f} % of its peak in the first "
                        "frame): the frames before the first touch are missing"
                    ),
                    relative_sd=E_WITHOUT_TOUCH,
                    hides_touch=True,
                )
            )
            continue
        rest_u, rest_F = (float(np.median(x[one.quiet])) for x in (raw_u, raw_F))
        if abs(rest_F) > TARE_SHARE * F and abs(rest_u) < 0.3 * TARE_SHARE * u:
            found.append(
                Finding(
                    kind=Kind.NO_TARE,
                    rank=Rank.MACHINE,
                    pads=(one.pad.name,),
                    says=(
                        f"force has an offset of {rest_F:.2g} N in the contact's markers "
                        "while nothing touches (no tare)"
                    ),
                    refused=_taken_for_contact(one),
                    relative_sd=E_OF_A_TARE,
                )
            )
    return found


E_OF_A_TARE = 0.05
"""An offset that is seen as one is taken out with the frames in the air."""


def _taken_for_contact(one: Pressing) -> bool:
    """Whether the offset of the whole pad is so large that tactile.contact sees no frame in the air."""
    total = one.pad.force_N[:, :, 2].sum(axis=1)
    return bool(np.median(total[one.quiet]) > 0.9 * STARTS_IN_CONTACT * total.max())


def roughness(signal: Float[np.ndarray, " t"], jaws_mm: Float[np.ndarray, " t"]) -> float:
    """Mean square of steps where the jaws step less than usual, over twice the variance in contact."""
    if np.ptp(signal) <= 0 or len(signal) < 8:
        return 0.0
    strong = np.abs(signal) > 0.1 * np.abs(signal).max()
    calm = np.abs(np.diff(jaws_mm)) <= 0.35 * max(float(np.ptp(jaws_mm)), 1e-12)
    use = (strong[1:] | strong[:-1]) & calm
    spread = float(signal[strong].var()) if strong.sum() > 3 else 0.0
    if use.sum() < 5 or spread <= 0:
        return 0.0
    spread = max(spread, 0.05 * float(np.abs(signal).max()) ** 2)
    return float((np.diff(signal)[use] ** 2).mean() / (2 * spread))


def _late(recording: Recording, pressings: Sequence[Pressing]) -> list[Finding]:
    """Touch and release at unlike openings of the jaws."""
    jaws = recording.aperture_mm if recording.loading == "grasp" else -recording.aperture_mm
    total = np.sum(
        [
            total / max(float(total.max()), 1e-30)
            for total in (clearer(one)[0][:, one.touched, 2].sum(axis=1) for one in pressings)
        ],
        axis=0,
    )
    at = 0.15 * float(total.max())
    up = np.flatnonzero((total[1:] >= at) & (total[:-1] < at))
    down = np.flatnonzero((total[1:] < at) & (total[:-1] >= at))
    if not len(up) or not len(down) or down[-1] <= up[-1]:
        return []
    touch, release = (_crossing(total, jaws, k, at) for k in (int(up[-1]), int(down[-1])))
    apart = release - touch
    if -EARLY_MM * _scale(jaws) <= apart <= LATE_MM * _scale(jaws):
        return []
    late = "late" if apart > 0 else "early"
    return [
        Finding(
            kind=Kind.CLOCKS_APART,
            rank=Rank.MACHINE,
            says=(
                f"the gel's signals (displacement and force) are {late} against the jaws: "
                f"at release the jaws stand {abs(apart):.2f} mm {'wider' if apart > 0 else 'closer'} than "
                "at touch; the two clocks disagree (lag)"
            ),
            refused=bool(abs(apart) > LATE_REFUSED_MM * _scale(jaws)),
            relative_sd=0.15 * abs(apart),
        )
    ]


def _scale(jaws_mm: Float[np.ndarray, " t"]) -> float:
    """Limits are for a closing of 3 mm."""
    return max(1.0, float(np.ptp(jaws_mm)) / 3.5)


def _crossing(
    signal: Float[np.ndarray, " t"], jaws_mm: Float[np.ndarray, " t"], k: int, level: float
) -> float:
    share = (level - signal[k]) / (signal[k + 1] - signal[k])
    return float(jaws_mm[k] + share * (jaws_mm[k + 1] - jaws_mm[k]))


def _clock(recording: Recording) -> list[Finding]:
    speed = np.abs(np.diff(recording.aperture_mm)) / np.diff(recording.time_s)
    if not len(speed):
        return []
    fastest = float(speed.max())
    low, high = SPEED_MM_PER_S
    if fastest == 0 or low <= fastest <= high:
        return []
    unit = "milliseconds" if fastest < low else "minutes or hours"
    return [
        Finding(
            kind=Kind.TIME_UNIT,
            rank=Rank.MACHINE,
            says=(
                f"time_s looks like {unit}: the jaws would close at {fastest:.2g} mm/s, "
                f"expected {low:g} to {high:g}"
            ),
        )
    ]


def _refused(kind: Kind, says: str, *, pads: tuple[str, ...] = ()) -> Finding:
    return Finding(kind=kind, rank=Rank.FIELD, says=says, pads=pads, refused=True)
