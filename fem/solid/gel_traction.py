"""The load of a gel on a fruit's skin: traction between the markers, integrated over the deformed skin.

A marker at rest place a (in the plane of the pad) measures the traction t(a) times the area of its gel cell.
A skin point at y in the plane of the pad touches the gel point that shear has moved there,

    a = y - s(a),        f = int N t(a) da,

s: the gel's displacement in its plane, N: shape functions of the skin's nodes. a is solved for at the nodes
and interpolated like their positions.

The pressure ends with a kink at the rim of the contact. A smooth interpolant through the zeros beyond the rim
overshoots there: clipped at zero, bicubic splines carry 0.3 to 1 % more than the pad's force. So the field is
interpolated through the markers that touch (polyharmonic spline r^3 with a plane; Wendland, "Scattered Data
Approximation", 2005, section 8.3) and extrapolated to the place where its pressure vanishes. Markers without
contact bound it: their pressure is set to zero if the extrapolation has the sign of the nearest marker that
touches.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import NdBSpline, RBFInterpolator, make_interp_spline
from scipy.spatial import Delaunay, cKDTree

from fem.elements.shape_functions import t6_gradient, t6_shape
from fem.fem_failure import FemFailure, FemProblem
from fem.solid.traction import cell_areas

FEWEST = 6
"""Fewest touching markers for extrapolation: twice the three of a plane. With fewer, the field is
interpolated through all markers of the pad."""
BEYOND = 1.5
"""Pitches beyond the touching markers at which the field ends: the rim lies less than one diagonal of a cell
(1.42) from the last marker that touches."""
BOUNDS = 4
"""Most passes that add markers without contact as bounds; the second pass adds almost none."""
FIXED_POINT = 4
"""Steps of a = y - s(a); shear strain of the gel is a tenth, so each removes nine tenths of the error."""
LONE = 0.5
"""Above this share of markers without a gel cell, no traction is computed from a pad's forces. Set by
hand."""
GRID = 2.0
"""Values per pitch for bicubic interpolation: the field's data are the markers, so that it is smooth over a
pitch."""


@dataclass(frozen=True, kw_only=True)
class MarkerGrid:
    """The markers of a pad on the gel at rest, in the pad's frame (mm); it serves all frames.

    `areas`: of gel that each marker represents (mm2). `pitch`: between neighbours. `hull`: of all markers.
    """

    rest_mm: Float[np.ndarray, "n 2"]
    areas: Float[np.ndarray, " n"]
    pitch: float
    hull: Delaunay

    @classmethod
    def of(cls, rest_mm: Float[np.ndarray, "n 2"]) -> "MarkerGrid":
        """Raises TOO_FEW_MARKERS if the markers are no grid."""
        areas = cell_areas(rest_mm)
        if (areas == 0).mean() > LONE:
            raise FemFailure(
                FemProblem.TOO_FEW_MARKERS,
                f"{int((areas == 0).sum())} of {len(areas)} markers of a pad have no neighbours that "
                "span an area with them, expected a grid. Without a grid, the gel area of each "
                "marker is unknown",
            )
        pitch = float(np.sqrt(np.median(areas[areas > 0])))
        return cls(
            rest_mm=rest_mm,
            areas=np.where(areas > 0, areas, pitch**2),
            pitch=pitch,
            hull=Delaunay(rest_mm),
        )


@dataclass(frozen=True, kw_only=True)
class GelFrame:
    """Measurements of one pad in one frame, in the pad's frame (mm, N).

    `shear_mm`: displacement of the markers in the plane. `force_N`: on the fruit. `touching`: which of them
    touch.
    """

    grid: MarkerGrid
    shear_mm: Float[np.ndarray, "n 2"]
    force_N: Float[np.ndarray, "n 3"]
    touching: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class GelField:
    """Traction (MPa) and shear displacement (mm) over the gel of one frame, pad frame, beyond its rim too.

    Bicubic through `GRID` values a pitch of the spline through the markers. The traction is zero farther than
    `reach_mm` from the markers that touch (`near`), and outside of the `hull` of all. `signs`: of the
    touching markers' normal force, as gel that sticks may pull; `shear_mm`: their greatest shear; `normal_N`:
    sum of their absolute normal forces and of the force of markers within `reach_mm` of them, where noise
    hides the rim of the contact. The load on the skin is scaled to it; the force of a wider rim is lost.
    """

    force_per_area: NdBSpline
    shear: NdBSpline
    low_mm: Float[np.ndarray, "2"]
    high_mm: Float[np.ndarray, "2"]
    hull: Delaunay
    near: cKDTree
    signs: Float[np.ndarray, " k"]
    reach_mm: float
    shear_mm: float
    normal_N: float

    @classmethod
    def of(cls, gel: GelFrame) -> "GelField | None":
        """None if nothing touches."""
        on, grid = gel.touching, gel.grid
        if not on.any():
            return None
        normal, rest_mm, pitch = gel.force_N[on, 2], grid.rest_mm, grid.pitch
        values = np.column_stack([gel.force_N / grid.areas[:, None], gel.shear_mm])
        shear = float(np.linalg.norm(gel.shear_mm[on], axis=1).max())
        reach = BEYOND * pitch
        margin = reach + shear
        low, high = rest_mm[on].min(axis=0) - margin, rest_mm[on].max(axis=0) + margin
        x, y = (
            np.linspace(a, b, max(int(np.ceil((b - a) / pitch * GRID)) + 1, 4))
            for a, b in zip(low, high, strict=True)
        )
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        known = _continued(rest_mm, values, on, pitch)(places.reshape(-1, 2))
        across = make_interp_spline(x, known.reshape(*places.shape[:2], 5))
        along = make_interp_spline(y, across.c.swapaxes(0, 1))
        knots, values = (across.t, along.t), np.ascontiguousarray(along.c.swapaxes(0, 1))
        near = cKDTree(rest_mm[on])
        rim = ~on & (near.query(rest_mm)[0] < reach)
        return cls(
            force_per_area=NdBSpline(knots, np.ascontiguousarray(values[..., :3]), 3),
            shear=NdBSpline(knots, np.ascontiguousarray(values[..., 3:]), 3),
            low_mm=low,
            high_mm=high,
            hull=grid.hull,
            near=near,
            signs=np.sign(normal),
            reach_mm=reach,
            shear_mm=shear,
            normal_N=max(
                float(np.abs(normal).sum() + np.sign(normal.sum()) * gel.force_N[rim, 2].sum()), 0.0
            ),
        )

    def gel_points(self, y: Float[np.ndarray, "q 2"]) -> Float[np.ndarray, "q 2"]:
        """a = y - s(a)."""
        a = y
        for _ in range(FIXED_POINT):
            a = y - self.shear(a.clip(self.low_mm, self.high_mm))
        return np.asarray(a)

    def traction(self, a: Float[np.ndarray, "q 2"]) -> Float[np.ndarray, "q 3"]:
        """On the fruit; zero where the normal part has another sign than the nearest touching marker's."""
        traction = self.force_per_area(a.clip(self.low_mm, self.high_mm))
        away, who = self.near.query(a, distance_upper_bound=self.reach_mm)
        sign = np.append(self.signs, 0.0)[who]
        inside = (traction[:, 2] * sign > 0) & np.isfinite(away)
        inside[inside] = self.hull.find_simplex(a[inside]) >= 0
        return np.asarray(traction * inside[:, None])


def nodal_force(
    field: GelField, nodes_mm: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 6"]
) -> Float[np.ndarray, "n 3"]:
    """Forces (N, pad frame) on the skin's nodes, which are at `nodes_mm` (pad frame) in this frame.

    `faces`: the skin's T6 faces. Pressure is positive along the pad's z axis, into the fruit.
    """
    nodal_N = np.zeros_like(nodes_mm)
    corners = nodes_mm[faces[:, :3], :2]
    middle = corners.mean(axis=1)
    size = float(np.linalg.norm(corners - middle[:, None], axis=2).max())
    edge, other = (corners[:, k] - corners[:, 0] for k in (1, 2))
    facing = edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0] < 0
    reach = field.reach_mm + field.shear_mm + size
    near = facing & np.isfinite(field.near.query(middle, distance_upper_bound=reach)[0])
    if not near.any():
        return nodal_N
    cells = faces[near]
    points, weights = skin_rule()
    shape, slope = t6_shape(points), t6_gradient(points)
    used, local = np.unique(cells, return_inverse=True)
    a = field.gel_points(nodes_mm[used, :2])[local.reshape(cells.shape)]
    places = np.einsum("qn,mnx->mqx", shape, a, optimize=True)
    first, second = np.moveaxis(np.einsum("qin,mnx->mqix", slope, a, optimize=True), 2, 0)
    area = np.abs(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]) * weights
    load = field.traction(places.reshape(-1, 2)) * area.reshape(-1, 1)
    carried_N = float(np.abs(load[:, 2]).sum())
    if carried_N == 0:
        return nodal_N
    load *= field.normal_N / carried_N
    nodal = np.einsum("qn,mqx->mnx", shape, load.reshape(*area.shape, 3), optimize=True).reshape(-1, 3)
    for x in range(3):
        nodal_N[:, x] = np.bincount(cells.ravel(), nodal[:, x], minlength=len(nodes_mm))
    return nodal_N


def _continued(
    rest_mm: Float[np.ndarray, "n 2"],
    values: Float[np.ndarray, "n 5"],
    on: Bool[np.ndarray, " n"],
    pitch: float,
) -> RBFInterpolator:
    """Spline through the touching markers, extrapolated, and bounded by the others."""
    if on.sum() < FEWEST or _on_a_line(rest_mm[on]):
        return _spline(rest_mm, values)
    near = cKDTree(rest_mm[on])
    spline = _spline(rest_mm[on], values[on])
    beyond = np.flatnonzero(~on & (near.query(rest_mm)[0] < 2 * BEYOND * pitch))
    sign = np.sign(values[on, 2])[near.query(rest_mm[beyond])[1]]
    bounds = np.zeros(0, dtype=np.int64)
    for _ in range(BOUNDS):
        continued = spline(rest_mm[beyond]) if len(beyond) else np.zeros((0, 5))
        more = np.setdiff1d(beyond[continued[:, 2] * sign > 0], bounds)
        if not len(more):
            break
        bounds = np.concatenate([bounds, more])
        known = spline(rest_mm[bounds])
        known[:, 2] = 0.0
        spline = _spline(np.vstack([rest_mm[on], rest_mm[bounds]]), np.vstack([values[on], known]))
    return spline


def _spline(places: Float[np.ndarray, "n 2"], values: Float[np.ndarray, "n 5"]) -> RBFInterpolator:
    return RBFInterpolator(places, values, kernel="cubic", degree=1)


def _on_a_line(places: Float[np.ndarray, "n 2"]) -> bool:
    size = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(size[1] < 1e-6 * size[0])


def skin_rule() -> tuple[Float[np.ndarray, "q 2"], Float[np.ndarray, " q"]]:
    """Points and weights on the unit triangle: three in each of SPLITS^2 equal parts, exact to second degree.

    Many low-order points, since the kink of the pressure at the rim may be anywhere in a face.
    """
    inner = np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]])
    i, j = np.meshgrid(np.arange(SPLITS), np.arange(SPLITS), indexing="ij")
    corner = np.column_stack([i.ravel(), j.ravel()])
    upright = corner[corner.sum(axis=1) < SPLITS]
    turned = corner[corner.sum(axis=1) < SPLITS - 1] + 1
    places = np.concatenate([upright[:, None] + inner, turned[:, None] - inner]).reshape(-1, 2) / SPLITS
    return places, np.full(len(places), 0.5 / len(places))


SPLITS = 4
"""Parts of a face's edge in the rule: with faces of 1 to 3 mm points lie 0.1 to 0.4 mm apart."""
