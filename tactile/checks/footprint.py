"""Where the mesh says that the pads should have touched, against where they felt it.

Along a pad's normal the mesh stands h ahead of each marker in the first frame. Rigid bodies would touch first
after the travel min h, at the point where h is least. What the gel felt says the same of the real fruit: the
travel at first touch, and the middle of the print (Hertz 1882: indentation is quadratic about the point of
first touch). Fruit that yields changes the size of a print, not its middle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactile.checks.finding import Finding, Kind, Rank
from tactile.checks.pressing import Pressing, clearer
from tactile.registration import depth_along

AHEAD_SD_MM, MIDDLE_SD_MM = 0.13, 0.3
"""Spread of the two on sound recordings over meshes with 0.1 mm of error: travel at first touch against the
mesh (0.12, greatest 0.32), the middle of the print (0.27 each way, greatest 0.9)."""
SAID, REFUSED = 4.5, 14.0
"""In such spreads, widths from two pads: 0.8 mm and 2.6 mm."""
MOVED_MM = 1.5
"""A fruit may be pushed by the first jaw: its shift along the jaws is said beyond this."""
E_OF_ANOTHER_FRUIT, E_OF_A_TURN = 0.35, 0.1
"""Relative standard deviation of E where the recording may be another fruit's (moduli of one lot spread by a
factor of 1.4), and where the pads may have touched elsewhere (pit and curvature: up to 10 %)."""
DEEP = 0.15
"""Markers indented by this share of the deepest make the print."""
FEWEST = 12


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """Of one pad: how much farther it went before it touched than the mesh says, and how far from the mesh's
    nearest point the print's middle lies (in the pad's plane, mm; NaN where the print is too small).
    """

    name: str
    ahead_mm: float
    ahead_sd_mm: float
    middle_mm: Float[np.ndarray, " 2"]


def footprint(
    one: Pressing, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Footprint | None:
    """The pad's print against the mesh; None where the pad never touches or looks past the mesh."""
    pose, rest = one.pad.pose[0], one.pad.rest_mm
    total = clearer(one)[0][:, one.touched, 2].sum(axis=1)
    if not one.touched.any() or total.max() <= 0:
        return None
    ahead = depth_along(rest @ pose[:3, :3].T + pose[:3, 3], pose[:3, 2], vertices[faces])
    met = np.isfinite(ahead)
    if met.sum() < FEWEST:
        return None
    travel = one.closing_mm
    touch, sd = _first_touch(one, total, travel)
    first = ahead[met & _inner(one)] if (met & _inner(one)).any() else ahead[met]
    return Footprint(
        name=one.pad.name,
        ahead_mm=touch - float(first.min()),
        ahead_sd_mm=float(np.hypot(AHEAD_SD_MM, sd)),
        middle_mm=_middle(one, ahead, travel),
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
    found: list[Finding] = []
    if len(prints) == 2 and width_mm is not None:
        wider = prints[0].ahead_mm + prints[1].ahead_mm
        aside = (prints[0].ahead_mm - prints[1].ahead_mm) / 2
        sd = float(np.linalg.norm([*(one.ahead_sd_mm for one in prints), np.sqrt(2.0) * surface_sd_mm]))
        if abs(wider) > SAID * sd:
            found.append(_width(width_mm, wider, refused=abs(wider) > REFUSED * sd))
        if abs(aside) > MOVED_MM + SAID * sd:
            found.append(
                _aside(
                    f"the pads touched {abs(aside):.1f} mm farther to the "
                    f"{prints[0].name if aside < 0 else prints[1].name} than poses and mesh say"
                )
            )
    elif prints and abs(prints[0].ahead_mm) > MOVED_MM + SAID * surface_sd_mm:
        found.append(_aside(f"the pad touched {abs(prints[0].ahead_mm):.1f} mm from where pose and mesh say"))
    limit = SAID * float(np.hypot(MIDDLE_SD_MM, 3 * surface_sd_mm))
    far = [one for one in prints if float(np.nanmax(np.abs([*one.middle_mm, 0.0]))) > limit]
    if far and not found:
        worst = max(far, key=lambda one: float(np.linalg.norm(one.middle_mm)))
        found.append(
            _aside(
                f"the middle of the {worst.name} pad's print lies "
                f"{float(np.linalg.norm(worst.middle_mm)):.1f} mm from where pose and mesh put it"
            )
        )
    return found


def _width(width_mm: float, wider_mm: float, *, refused: bool) -> Finding:
    real = width_mm - wider_mm
    return Finding(
        kind=Kind.WIDTH,
        rank=Rank.FRUIT,
        says=(
            f"the fruit between the pads is {real:.1f} mm wide where they first touch, "
            f"its mesh {width_mm:.1f} mm ({width_mm / real:.3f} times): the recording is of another fruit, "
            "the mesh is scaled, turned or of another fruit, or the poses are wrong"
        ),
        refused=refused,
        relative_sd=E_OF_ANOTHER_FRUIT,
    )


def _aside(what: str) -> Finding:
    return Finding(
        kind=Kind.ASIDE,
        rank=Rank.FRUIT,
        says=(
            f"{what}: the mesh is turned, mirrored or of another fruit, "
            "or a pose is wrong (a pad moved in its mount, another day, the other pad)"
        ),
        relative_sd=E_OF_A_TURN,
    )


def _inner(one: Pressing) -> np.ndarray:
    """Markers within reach of the print: what stands ahead elsewhere (a stalk) does not count."""
    rest = one.pad.rest_mm
    middle = rest[one.touched].mean(axis=0)
    reach = float(np.linalg.norm(rest[one.touched] - middle, axis=1).max()) + 3.0 * one.spacing_mm
    return np.asarray(np.linalg.norm(rest - middle, axis=1) <= reach)


def _first_touch(
    one: Pressing, total: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"]
) -> tuple[float, float]:
    """Travel at which the first contact begins, and how far the way there leaves it open.

    Total indentation grows with travel past the touch to the power 1.5 (a half-space, Hertz) to 2 (a bed of
    springs): the first frames are led back by both, at most one step before the first frame above noise.
    """
    noise = float(np.sqrt((total[one.quiet] ** 2).mean()))
    level = max(5.0 * noise, 0.01 * float(total.max()))
    first = int(np.argmax(total > level))
    before = max(first - 1, 0)
    step = max(float(travel[first] - travel[before]), 0.0)
    rising = [first]
    for k in range(first + 1, min(first + 5, len(total))):
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
    one: Pressing, ahead: Float[np.ndarray, " n"], travel: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " 2"]:
    """Middle of the print less the mesh's nearest point, both from quadratics over the same markers.

    At the end of the first closing: a shear during a later hold moves markers.
    """
    end = int(np.argmax(travel >= travel.min() + 0.98 * np.ptp(travel)))
    values, sd = clearer(one)
    depth = values[end, :, 2]
    peak = float(np.sort(depth)[-5:].mean())
    use = (depth > max(DEEP * peak, 4 * sd)) & np.isfinite(ahead)
    nothing = np.full(2, np.nan)
    if use.sum() < FEWEST:
        return nothing
    felt, mesh = (_extremum(one.pad.rest_mm[use, :2], z[use]) for z in (depth, -ahead))
    if felt is None or mesh is None:
        return nothing
    return np.asarray(felt - mesh)


def _extremum(
    xy_mm: Float[np.ndarray, "n 2"], z_mm: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 2"] | None:
    """Where a quadratic through z has its maximum; None where it has none nearby."""
    x, y = xy_mm.T
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
    c = np.linalg.lstsq(terms, z_mm, rcond=None)[0]
    bend = np.array([[c[3], c[4]], [c[4], c[5]]])
    if np.linalg.eigvalsh(bend).max() >= 0:
        return None
    top = -np.linalg.solve(bend, c[1:3])
    return top if np.abs(top - xy_mm.mean(axis=0)).max() < 2 * float(np.ptp(xy_mm)) else None
