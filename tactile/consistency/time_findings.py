"""Where a recording begins and ends, what its force is at rest, and its clock."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from tactile.consistency.finding import Finding, FindingKind, doubted
from tactile.consistency.pressing import FEWEST_PRESSED, PRESSED_SD, QUIET_OVER, QUIET_SHARE, Pressing
from tactile.contact import STARTS_IN_CONTACT
from tactile.readers.recording import Recording

IN_CONTACT, E_WITHOUT_TOUCH = 0.15, 0.2
"""Share of the peak, of displacement and of force, above which the first or the last frame is in contact:
valid recordings have 0.09 and less (benchmarks/field_spreads.py). Relative standard deviation of E without
the first touch: the mesh's surface replaces it, as far as its error is known."""
TARE_SHARE, E_OF_A_TARE = 0.1, 0.05
"""Force at rest over the peak if the tare is missing; E's relative standard deviation after the
correction."""
FEWEST_QUIET, DRIFT_SHARE, DRIFT_SD, E_PER_DRIFT = 3, 0.04, 6.0, 0.5
"""Fewest quiet frames before and after; change of the force over the peak, and over its noise. Valid
recordings change by up to 0.026 of the peak, with small forces by 4.6 times the noise. Relative error of E
per share of the peak: a drift that grows evenly has reached half of it at the peak."""
SPEED_MM_PER_S = (0.008, 300.0)
"""Fastest closing of jaws: grippers have 0.1 to 100, testing machines 0.017 (1 mm/min) and more."""


def time_findings(recording: Recording, pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings of a recording that begins or ends in contact, of forces without a tare or with drift, and of
    a clock in another unit."""
    return [
        *(finding for press in pressings for finding in _start(press)),
        *(finding for press in pressings for finding in _drift(press)),
        *_remarks(recording, pressings),
    ]


def _raw_totals(press: Pressing) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Indentation and normal force as recorded, summed over the pressed markers."""
    use = press.touched
    return -press.pad.displacement_mm[:, use, 2].sum(axis=1), press.pad.force_N[:, use, 2].sum(axis=1)


def pressed_share(press: Pressing, frame: int) -> float:
    """The smaller of indentation and force in a frame, each over its peak; 0 if nothing is pressed."""
    if not press.touched.any():
        return 0.0
    return min(float(total[frame] / max(np.abs(total).max(), 1e-30)) for total in _raw_totals(press))


def _start(press: Pressing) -> Iterator[Finding]:
    """A recording that begins in contact, and forces without a tare."""
    if not press.touched.any():
        return
    totals = _raw_totals(press)
    u, F = (max(float(np.abs(total).max()), 1e-30) for total in totals)
    rest_u, rest_F = (float(np.median(total[press.quiet])) for total in totals)
    if pressed_share(press, 0) > IN_CONTACT:
        says = (
            f"recording starts in contact ({100 * totals[0][0] / u:.0f} % of its peak in the first frame): "
            "the frames before first contact are missing; start recording before the jaws touch"
        )
        yield doubted(
            FindingKind.STARTS_IN_CONTACT,
            says,
            relative_sd=E_WITHOUT_TOUCH,
            pads=press.pads,
            hides_touch=True,
        )
    elif abs(rest_F) / F > TARE_SHARE and abs(rest_u) / u < 0.3 * TARE_SHARE:
        # tactile.contact finds no no-contact frames if the whole pad's offset exceeds its own limit
        total = press.pad.force_N[:, :, 2].sum(axis=1)
        hidden = bool(np.median(total[press.quiet]) > 0.9 * STARTS_IN_CONTACT * total.max())
        says = (
            f"force has an offset of {rest_F:.2g} N in the contact's markers without contact (no tare); set "
            "the force to zero before the grasp"
        )
        yield Finding(FindingKind.NO_TARE, says, pads=press.pads, refused=hidden, relative_sd=E_OF_A_TARE)


def drift_of(press: Pressing) -> tuple[float, float, float] | None:
    """Change of the total force from before the grasp to after it, its noise, and the peak (N).

    None if either side has no quiet frames.
    """
    pressed = np.flatnonzero(
        (press.felt_mm[:, press.touched, 2] > PRESSED_SD * press.felt_sd_mm).sum(axis=1) >= FEWEST_PRESSED
    )
    if not len(pressed):
        return None
    still = np.sqrt((press.felt_mm**2).mean(axis=(1, 2)))
    quiet = np.flatnonzero(still <= QUIET_OVER * np.percentile(still, QUIET_SHARE))
    before, after = quiet[quiet < pressed[0]], quiet[quiet >= pressed[-1]]
    fewest = min(len(before), len(after))
    if fewest < FEWEST_QUIET:
        return None
    total = press.force_N[:, :, 2].sum(axis=1)
    change = float(np.median(total[after]) - np.median(total[before]))
    return change, float(total[before].std()) / float(np.sqrt(fewest / 2)), float(total.max())


def _drift(press: Pressing) -> Iterator[Finding]:
    """Findings of force that does not return to its value before the first touch, though the gel does."""
    change, noise, peak = drift_of(press) or (0.0, 0.0, 1.0)
    if abs(change) > max(DRIFT_SHARE * peak, DRIFT_SD * noise):
        says = (
            f"force drifts: without contact it differs by {change:+.2f} N between before and after the "
            f"grasp ({100 * change / peak:+.0f} % of the peak); let the sensor warm up"
        )
        sd = E_PER_DRIFT * abs(change) / peak
        yield Finding(FindingKind.FORCE_DRIFT, says, pads=press.pads, relative_sd=sd)


def _remarks(recording: Recording, pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """Findings that cast no doubt: no unloading, a clock in another unit."""
    if pads := tuple(press.pad.name for press in pressings if pressed_share(press, -1) > IN_CONTACT):
        says = (
            "recording ends under load (there is no unloading). E needs none, but without it drupe cannot "
            "detect clock lag, force drift, creep or yield"
        )
        yield Finding(FindingKind.ENDS_PRESSED, says, pads=pads, remark=True)
    speed = np.abs(np.diff(recording.aperture_mm)) / np.diff(recording.time_s)
    fastest = float(speed.max(initial=0.0))
    low, high = SPEED_MM_PER_S
    if recording.loading == "grasp" and fastest != 0 and not low <= fastest <= high:
        unit = "milliseconds" if fastest < low else "minutes or hours"
        says = (
            f"time_s looks like {unit}: the jaws would close at {fastest:.2g} mm/s, expected {low:g} to "
            f"{high:g}; E does not depend on it"
        )
        yield Finding(FindingKind.TIME_UNIT, says, remark=True)
