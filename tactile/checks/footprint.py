"""Where the mesh says that the pads should have touched, against where they felt it.

Along a pad's normal the mesh stands h ahead of each marker in the first frame. Rigid bodies would touch first
after the travel min h, at the point where h is least. What the gel felt says the same of the real fruit: the
travel at first touch, and the middle of the print (Hertz 1882: indentation is quadratic about the point of
first touch). Fruit that yields changes the size of a print, not its middle. A plane pad presses hardest where
the skin lies parallel to it, so that what counts is the mesh's tilt against the pad under the middle of the
print: an error of the mesh moves that middle far on a flat place and little on a round one, and its tilt by
the same everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactile.checks.finding import Finding, FindingKind, FindingRank
from tactile.checks.pressing import Pressing, clearer
from tactile.registration import depth_along

AHEAD_SD_MM = 0.13
"""Spread (mm) of a pad's travel at first touch against the mesh on sound recordings over meshes with 0.1 mm
of error: 0.12, greatest 0.32 (benchmarks/field_spreads.py)."""
TILT_SD, TILT_PER_MM = 0.0085, 0.11
"""Spread (radians, each way) of the mesh's tilt under the middle of the print on such meshes: 0.0074 on the
even half, 0.0104 on fruit drawn without a solver (benchmarks/field_spreads.py); and per mm of error of a
mesh whose error is known, 3 mm of the middle at a radius of 27 mm."""
SAID, REFUSED = 4.5, 14.0
"""In such spreads, widths from two pads: 0.8 mm and 2.6 mm. Sound recordings' reach 0.48 mm on the even half
and 0.77 mm on fruit drawn without a solver (benchmarks/field_spreads.py)."""
TILT_SAID = 5.5
"""Root of the sum of squares of a recording's tilts, two a pad, in their spreads. Sound recordings have up to
3.4 on the even half, 4.7 on fruit drawn without a solver, 5.0 on 100 by a solver (field_spreads.py)."""
TILT_FITS = 4.8
"""The same of prints that fit."""
OTHERWISE = 16.0
"""Difference of the squares of that root, this arrangement less another (twice a log likelihood ratio). Sound
recordings of 100 fruit by a solver have up to 13.3 (99 %: 5.7) with the pads exchanged and 12.2 (99 %: 8.5)
with the mesh turned, of fruit drawn without one 9.2 (field_spreads.py). Mirrored meshes are not tried: there
sound ones have up to 16.5, mirrored ones more than 16.5 in a fifth."""
MOVED_MM = 1.5
"""A fruit may be pushed by the first jaw: its shift along the jaws is said beyond this. Sound recordings
here, whose fruit does not slide, have 0.18 and less (benchmarks/field_spreads.py), and a mirrored mesh makes
up to 0.8."""
E_OF_ANOTHER_FRUIT, E_OF_A_TURN = 0.35, 0.1
"""Relative standard deviation of E where the recording may be another fruit's (moduli of one lot spread by a
factor of 1.4), and where the pads may have touched elsewhere (pit and curvature: up to 10 %)."""
DEEP, PRINT_SD = 0.15, 4.0
"""Markers indented by this share of the deepest, and so many standard deviations of noise, make the print."""
FEWEST = 12
"""Markers of a print: twice the six numbers of a quadratic."""
END_OF_CLOSING = 0.98
"""Share of the pad's way at which the first closing ends: a hold creeps by less than 2 %."""
TOUCH_SD, TOUCH_SHARE, RISING = 5.0, 0.01, 5
"""The total indentation rises where it exceeds so many of its noise's root mean squares, and this share of
its peak; so many frames from there are led back to the first touch."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """Of one pad: how much farther it went before it touched than the mesh says, and how far from the mesh's
    nearest point the print's middle lies (in the pad's plane, mm), with the mesh's tilt there (radians).

    The last two are NaN where the print is too small.
    """

    name: str
    ahead_mm: float
    ahead_sd_mm: float
    middle_mm: Float[np.ndarray, " 2"]
    tilt: Float[np.ndarray, " 2"]


def footprint(
    press: Pressing, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Footprint | None:
    """The pad's print against the mesh; None where the pad never touches or looks past the mesh."""
    pose, rest = press.pad.pose[0], press.pad.rest_mm
    total = clearer(press)[0][:, press.touched, 2].sum(axis=1)
    if not press.touched.any() or total.max() <= 0:
        return None
    ahead = depth_along(rest @ pose[:3, :3].T + pose[:3, 3], pose[:3, 2], vertices[faces])
    met = np.isfinite(ahead)
    if met.sum() < FEWEST:
        return None
    travel = press.closing_mm
    touch, sd = _first_touch(press, total, travel)
    first = ahead[met & _inner(press)] if (met & _inner(press)).any() else ahead[met]
    middle_mm, tilt = _middle(press, ahead, travel)
    return Footprint(
        name=press.pad.name,
        ahead_mm=touch - float(first.min()),
        ahead_sd_mm=float(np.hypot(AHEAD_SD_MM, sd)),
        middle_mm=middle_mm,
        tilt=tilt,
    )


def footprint_findings(
    prints: Sequence[Footprint],
    *,
    width_mm: float | None,
    surface_sd_mm: float = 0.0,
) -> list[Finding]:
    """Another fruit, a mesh of another size or turned, poses of another day.

    `width_mm`: the mesh's width between the pads. `surface_sd_mm`: the mesh's own error.
    """
    findings: list[Finding] = []
    if len(prints) == 2 and width_mm is not None:
        first, second = prints
        wider, aside = first.ahead_mm + second.ahead_mm, (first.ahead_mm - second.ahead_mm) / 2
        sd = float(np.linalg.norm([first.ahead_sd_mm, second.ahead_sd_mm, np.sqrt(2.0) * surface_sd_mm]))
        if abs(wider) > SAID * sd:
            findings.append(_width(width_mm, wider, refused=abs(wider) > REFUSED * sd))
        if abs(aside) > MOVED_MM + SAID * sd:
            side = first.name if aside < 0 else second.name
            where = f"the pads touched {abs(aside):.1f} mm farther to the {side} than poses and mesh predict"
            findings.append(_aside(where))
    elif prints and abs(prints[0].ahead_mm) > MOVED_MM + SAID * surface_sd_mm:
        off = abs(prints[0].ahead_mm)
        findings.append(_aside(f"the pad touched {off:.1f} mm from the place that pose and mesh predict"))
    if not findings and tilted(prints, surface_sd_mm) > TILT_SAID:
        findings.append(_aside(_where(prints), kind=FindingKind.PRINT_ASIDE))
    return findings


def better_otherwise(
    prints: Sequence[Footprint],
    others: Sequence[tuple[FindingKind, Sequence[Footprint]]],
    *,
    surface_sd_mm: float,
) -> Finding | None:
    """The other arrangement that the prints fit far better than this one, and well; None where none is.

    `others`: the prints with the pads exchanged, and on the mesh turned about each axis.
    """
    fits = [
        (tilted(there, surface_sd_mm), kind)
        for kind, there in others
        if len(there) == len(prints) and all(np.isfinite(pad_print.tilt).all() for pad_print in there)
    ]
    best, kind = min(fits, key=lambda fit: fit[0], default=(np.inf, FindingKind.MESH_TURNED))
    if best > TILT_FITS or tilted(prints, surface_sd_mm) ** 2 - best**2 < OTHERWISE:
        return None
    what = "on the mesh rotated by 90 degrees: the mesh is rotated or of another fruit, or a pose is wrong"
    if kind is FindingKind.PADS_EXCHANGED:
        what = (
            "with the pads exchanged: left and right are swapped (signals or poses), or the mesh is rotated "
            "or of another fruit"
        )
    says = f"{_where(prints)}, and the contact imprints fit far better {what}"
    return Finding(kind, FindingRank.FRUIT, says, relative_sd=E_OF_A_TURN)


def _where(prints: Sequence[Footprint]) -> str:
    worst = max(prints, key=lambda imprint: float(np.nan_to_num(np.linalg.norm(imprint.tilt))))
    off = float(np.linalg.norm(worst.middle_mm))
    return (
        f"the middle of the {worst.name} pad's contact imprint is {off:.1f} mm from the place that "
        "pose and mesh predict"
    )


def tilted(prints: Sequence[Footprint], surface_sd_mm: float) -> float:
    """Length of the prints' tilts, all together, in the spread that sound ones have."""
    sd = float(np.hypot(TILT_SD, TILT_PER_MM * surface_sd_mm))
    return float(np.linalg.norm(np.nan_to_num([imprint.tilt for imprint in prints]))) / sd


def _width(width_mm: float, wider_mm: float, *, refused: bool) -> Finding:
    """The finding that pads first touch at another distance than the mesh is wide there (mm)."""
    real = width_mm - wider_mm
    says = (
        f"the fruit between the pads is {real:.1f} mm wide at first contact, but its mesh is {width_mm:.1f} "
        f"mm wide ({width_mm / real:.3f} times). The recording is of another fruit, the mesh is scaled, "
        "rotated or of another fruit, or the poses are wrong"
    )
    sd = E_OF_ANOTHER_FRUIT
    return Finding(FindingKind.WIDTH, FindingRank.FRUIT, says, refused=refused, relative_sd=sd)


def _aside(what: str, *, kind: FindingKind = FindingKind.ASIDE) -> Finding:
    says = (
        f"{what}. Either the mesh is rotated, mirrored or of another fruit, or a pose is wrong (a moved pad, "
        "another day, the other pad)"
    )
    return Finding(kind, FindingRank.FRUIT, says, relative_sd=E_OF_A_TURN)


def _inner(press: Pressing) -> np.ndarray:
    """Markers within reach of the print: what stands ahead elsewhere (a stalk) does not count."""
    rest = press.pad.rest_mm
    middle = rest[press.touched].mean(axis=0)
    reach = float(np.linalg.norm(rest[press.touched] - middle, axis=1).max()) + 3.0 * press.spacing_mm
    return np.asarray(np.linalg.norm(rest - middle, axis=1) <= reach)


def _first_touch(
    press: Pressing, total: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"]
) -> tuple[float, float]:
    """Travel at which the first contact begins, and how far the way there leaves it open.

    Total indentation grows with travel past the touch to the power 1.5 (a half-space, Hertz) to 2 (a bed of
    springs): the first frames are led back by both, at most one step before the first frame above noise.
    """
    noise = float(np.sqrt((total[press.quiet] ** 2).mean()))
    level = max(TOUCH_SD * noise, TOUCH_SHARE * float(total.max()))
    first = int(np.argmax(total > level))
    before = max(first - 1, 0)
    step = max(float(travel[first] - travel[before]), 0.0)
    rising = [first]
    for k in range(first + 1, min(first + RISING, len(total))):
        if travel[k] <= travel[rising[-1]] + 1e-6 or total[k] <= total[rising[-1]]:
            break
        rising.append(k)
    if len(rising) < 2:
        return float(travel[first] - step / 2), step / 2
    touches = []
    for power in (1.5, 2.0):
        slope, at = np.polyfit(travel[rising], np.maximum(total[rising], 0.0) ** (1 / power), 1)
        touches.append(float(np.clip(-at / slope, travel[before] - step, travel[first])))
    return float(np.mean(touches)), float(np.ptp(touches)) / 2


def _middle(
    press: Pressing, ahead: Float[np.ndarray, " n"], travel: Float[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Middle of the print less the mesh's nearest point, and the mesh's tilt there, from quadratics.

    Both over the same markers. At the end of the first closing: a shear during a later hold moves markers.
    """
    end = int(np.argmax(travel >= travel.min() + END_OF_CLOSING * np.ptp(travel)))
    values, sd = clearer(press)
    depth = values[end, :, 2]
    peak = float(np.sort(depth)[-5:].mean())
    use = (depth > max(DEEP * peak, PRINT_SD * sd)) & np.isfinite(ahead)
    nothing = np.full(2, np.nan)
    if use.sum() < FEWEST:
        return nothing, nothing
    felt, mesh = (_extremum(press.pad.rest_mm[use, :2], z[use]) for z in (depth, -ahead))
    if felt is None or mesh is None:
        return nothing, nothing
    apart = np.asarray(felt[0] - mesh[0])
    return apart, np.asarray(mesh[1] @ apart)


def _extremum(
    xy_mm: Float[np.ndarray, "n 2"], z_mm: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]] | None:
    """Where a quadratic through z has its maximum, and its second derivatives; None where none is nearby."""
    x, y = xy_mm.T
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
    c = np.linalg.lstsq(terms, z_mm, rcond=None)[0]
    bend = np.array([[c[3], c[4]], [c[4], c[5]]])
    if np.linalg.eigvalsh(bend).max() >= 0:
        return None
    top = -np.linalg.solve(bend, c[1:3])
    near = np.abs(top - xy_mm.mean(axis=0)).max() < 2 * float(np.ptp(xy_mm))
    return (top, bend) if near else None
