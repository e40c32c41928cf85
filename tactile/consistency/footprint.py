"""Compare where the mesh predicts that the pads touch with where they felt the fruit.

Along a pad's normal the mesh lies h ahead of each marker in the first frame. Rigid bodies would touch after
the travel min h, at the point of least h. The gel measures the same of the real fruit: the travel at first
touch, and the centre of the imprint (Hertz 1882: indentation is quadratic about the point of first touch).
Compliant fruit changes an imprint's size, not its centre. A plane pad presses hardest where the skin is
parallel to it, so the check uses the mesh's tilt against the pad under the imprint's centre. An error of the
mesh shifts that centre far on a flat place and little on a round one, but changes the tilt equally
everywhere.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactile.consistency.finding import E_OF_ANOTHER_FRUIT, FindingKind
from tactile.consistency.misfit import Misfit, Situation
from tactile.consistency.pressing import Pressing, clearer
from tactile.registration import depth_along

AHEAD_SD_MM = 0.15
"""Spread (mm) of a pad's travel at first touch relative to the mesh, on valid recordings over meshes with 0.1
mm of error: 0.12, at most 0.32 (benchmarks/field_spreads.py)."""
TILT_SD, TILT_PER_MM = 0.012, 0.15
"""Spread (radians) of the norm of a recording's tilts under its imprints' centres on such meshes; spread per
mm of error of a mesh whose error is known."""
MOVED_SD_MM = 0.4
"""The first jaw may push a fruit along the jaws by this shift. Assumed; where the fruit does not slide, 0.18
and less (benchmarks/field_spreads.py)."""
E_OF_A_TURN, REFUSED_AT = 0.1, 12.0
"""Relative standard deviation of E if the pads may have touched elsewhere (pit and curvature: up to 10 %);
standard deviations of a width from which the recording is certainly of another fruit."""
DEEP, PRINT_SD = 0.15, 4.0
"""An imprint's markers exceed this share of the deepest indentation and this many standard deviations of
noise."""
FEWEST = 12
"""Fewest markers of an imprint: twice the six numbers of a quadratic."""
END_OF_CLOSING = 0.98
"""Share of the pad's travel at which the first closing ends: creep in a hold adds less than 2 %."""
TOUCH_SD, TOUCH_SHARE, RISING = 5.0, 0.01, 5
"""The total indentation rises above this multiple of its noise's RMS and this share of its peak; this many
frames from there are extrapolated back to the first touch."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """One pad's distance to the mesh (mm) and its extra travel before it touched. Then the offset of the
    imprint's centre from the mesh's nearest point (in the pad's plane, mm), and the mesh's tilt there
    (radians).

    The last two are NaN if the imprint is too small.
    """

    name: str
    gap_mm: float
    ahead_mm: float
    ahead_sd_mm: float
    middle_mm: Float[np.ndarray, " 2"]
    tilt: Float[np.ndarray, " 2"]


def footprint(
    press: Pressing, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Footprint | None:
    """The pad's imprint against the mesh; None if the pad never touches or faces past the mesh."""
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
        gap_mm=float(first.min()),
        ahead_mm=touch - float(first.min()),
        ahead_sd_mm=float(np.hypot(AHEAD_SD_MM, sd)),
        middle_mm=middle_mm,
        tilt=tilt,
    )


def mesh_misfits(situation: Situation) -> list[Misfit]:
    """Misfits of both pads' imprints with the mesh: another fruit, a mesh of another size or rotated, poses
    of another day. Empty without a mesh, or if a pad faces past it.
    """
    vertices, faces, pressings = situation.vertices, situation.faces, situation.pressings
    if vertices is None or faces is None:
        return []
    prints = [made for press in pressings if (made := footprint(press, vertices, faces)) is not None]
    return list(_of_prints(situation, prints)) if len(prints) == len(pressings) else []


def _of_prints(situation: Situation, prints: Sequence[Footprint]) -> Iterator[Misfit]:
    surface_sd_mm, pressings = situation.surface_sd_mm, situation.pressings
    if len(prints) == 2:
        yield _width(pressings, prints, surface_sd_mm)
    first, last = prints[0], prints[-1]
    aside = first.ahead_mm if first is last else (first.ahead_mm - last.ahead_mm) / 2
    sd = MOVED_SD_MM + float(np.hypot(first.ahead_sd_mm, surface_sd_mm))
    says = (
        f"the pads touched {abs(aside):.1f} mm farther to the {(first if aside < 0 else last).name} than "
        "poses and mesh predict"
    )
    yield Misfit(FindingKind.ASIDE, abs(aside) / sd, says, relative_sd=E_OF_A_TURN)
    tilts = np.nan_to_num([imprint.tilt for imprint in prints])
    worst = prints[int(np.argmax(np.linalg.norm(tilts, axis=1)))]
    says = (
        f"the middle of the {worst.name} pad's contact imprint is {np.linalg.norm(worst.middle_mm):.1f} mm "
        "from the place that pose and mesh predict"
    )
    sd = float(np.hypot(TILT_SD, TILT_PER_MM * surface_sd_mm))
    tilt = float(np.linalg.norm(tilts))
    yield Misfit(FindingKind.PRINT_ASIDE, tilt / sd, says, relative_sd=E_OF_A_TURN)


def _width(pressings: Sequence[Pressing], prints: Sequence[Footprint], surface_sd_mm: float) -> Misfit:
    """Misfit of the mesh's width between the pads with the fruit's at first contact."""
    poses = [press.pad.pose[0] for press in pressings]
    apart = float((poses[1][:3, 3] - poses[0][:3, 3]) @ poses[0][:3, 2])
    mesh = apart - prints[0].gap_mm - prints[1].gap_mm
    wider = prints[0].ahead_mm + prints[1].ahead_mm
    fruit = mesh - wider
    sd = float(np.linalg.norm([*(made.ahead_sd_mm for made in prints), np.sqrt(2.0) * surface_sd_mm]))
    says = (
        f"the fruit between the pads is {fruit:.1f} mm wide at first contact, but its mesh is {mesh:.1f} mm "
        f"wide ({mesh / fruit:.3f} times)"
    )
    sds = abs(wider) / sd
    relative_sd = E_OF_ANOTHER_FRUIT * min(1.0, sds / REFUSED_AT)
    detail = f"{mesh / fruit:.4f}"
    return Misfit(FindingKind.WIDTH, sds, says, relative_sd=relative_sd, detail=detail)


def _inner(press: Pressing) -> np.ndarray:
    """Markers within reach of the imprint; what lies ahead elsewhere (a stalk) does not count."""
    rest = press.pad.rest_mm
    middle = rest[press.touched].mean(axis=0)
    reach = float(np.linalg.norm(rest[press.touched] - middle, axis=1).max()) + 3.0 * press.spacing_mm
    return np.asarray(np.linalg.norm(rest - middle, axis=1) <= reach)


def _first_touch(
    press: Pressing, total: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"]
) -> tuple[float, float]:
    """Travel at which the first contact begins, and its uncertainty.

    Total indentation grows with travel past the touch to the power 1.5 (a half-space, Hertz) to 2 (a bed of
    springs). Both extrapolate the first frames back, to at most one step before the last frame within noise.
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
    """Centre of the imprint minus the mesh's nearest point, and the mesh's tilt there, from quadratics.

    Both are fitted to the same markers at the end of the first closing: shear in a later hold moves markers.
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
    """Place of the maximum of a quadratic through z, and its second derivatives; None if none is nearby."""
    x, y = xy_mm.T
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
    c = np.linalg.lstsq(terms, z_mm, rcond=None)[0]
    bend = np.array([[c[3], c[4]], [c[4], c[5]]])
    if np.linalg.eigvalsh(bend).max() >= 0:
        return None
    top = -np.linalg.solve(bend, c[1:3])
    near = np.abs(top - xy_mm.mean(axis=0)).max() < 2 * float(np.ptp(xy_mm))
    return (top, bend) if near else None
