"""Where on the fruit's surface each marker sits.

A pad's normal leads from a marker at its first touch to the fruit's mesh. The distance along it is the joint
error of pose and scan, plus the flesh's deformation before that marker touched. Its mean over a pad is the
gap between pad and mesh; its scatter is the quality of the registration. The pose stays as recorded: each
marker is projected along the normal, and a pad moved along that normal would project it to the same place.
The surface only determines *where* a marker sits, never how far it moved: a scan is off by a tenth of a
millimetre, a press is one or two.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.contact import Contact, PadContact
from tactile.tactile_failure import TactileProblem

FARTHEST_SHARE = 0.15
"""A pad is off the fruit if its first touches are farther from the mesh than this share of the fruit's
diameter."""
FEWEST_HITS = 0.5
"""Share of the touching markers whose normal must meet the mesh."""
MARGIN_MM = 1e-6
"""Around a triangle, beyond which a line certainly misses it: far more than rounding."""
POINTS_AT_ONCE = 64
"""Points compared with all triangles together: some megabytes for a scan of 50 000 triangles."""


@dataclass(frozen=True, kw_only=True)
class PadRegistration:
    """One pad: `surface_mm` is each marker's place on the mesh, at its first touch, or at the peak force if
    it has none.

    `on_skin`: the pad's normal through the marker meets the mesh. A gel is often wider than a small fruit: a
    marker beside the fruit has no place on it, and its `surface_mm` is beside the fruit too. `shift_mm` is
    the mean distance of first touches from the mesh along the pad's normal (positive: the mesh lies ahead).
    It is a measure and no correction of the pose. `residual_mm` is the standard deviation of those distances.
    """

    name: str
    surface_mm: Float[np.ndarray, "n 3"]
    on_skin: Bool[np.ndarray, " n"]
    normal: Float[np.ndarray, " 3"]
    shift_mm: float
    residual_mm: float


def register(
    contact: Contact,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    source: str,
) -> tuple[PadRegistration, ...]:
    """Each pad of `contact` on the fruit's mesh (mm, fruit frame, outward faces).

    Raises TactileFailure (pads-off-fruit) if first touches are far from the mesh; `source` names the
    recording in it.
    """
    size_mm = float(np.ptp(vertices, axis=0).mean())
    return tuple(_register_pad(pad, vertices[faces], size_mm=size_mm, source=source) for pad in contact.pads)


def _register_pad(
    pad: PadContact, triangles: Float[np.ndarray, "f 3 3"], *, size_mm: float, source: str
) -> PadRegistration:
    """One pad's markers projected along its normal onto the skin; those beside it move by the mean distance
    (mm)."""
    touched = pad.onset >= 0
    peak = int(np.argmax(pad.total_normal_N))
    frame = np.where(touched, pad.onset, peak)
    where = pad.position_mm[frame, np.arange(len(frame))]
    normal = pad.pose[peak, :3, 2]
    depth = depth_along(where, normal, triangles)
    on_skin = np.isfinite(depth)
    met = touched & on_skin
    shift = float(np.mean(depth[met])) if met.any() else np.inf
    if met.sum() < max(1.0, FEWEST_HITS * touched.sum()) or abs(shift) > FARTHEST_SHARE * size_mm:
        fault = f"first touches {abs(shift):.1f} mm from" if np.isfinite(shift) else "first touches beside"
        raise TactileProblem.PADS_OFF_FRUIT.failure(
            f"{source}: pads/{pad.name}/pose: found {fault} the fruit's surface, expected within "
            f"{FARTHEST_SHARE * size_mm:.1f} mm. Poses and mesh use different frames: check the "
            "robot's calibration (drupe robot), the units (mm) and the orientation of the fruit.",
        )
    depth = np.where(on_skin, depth, shift)
    return PadRegistration(
        name=pad.name,
        surface_mm=where + depth[:, None] * normal,
        on_skin=on_skin,
        normal=normal,
        shift_mm=shift,
        residual_mm=float(np.std(depth[met])),
    )


def depth_along(
    points: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, " 3"],
    triangles: Float[np.ndarray, "f 3 3"],
) -> Float[np.ndarray, " n"]:
    """Signed distance along `direction` to the nearest triangle that faces it; NaN where the line meets none.

    Möller and Trumbore (1997), "Fast, minimum storage ray-triangle intersection", for parallel lines: one
    direction reduces the test to a point in a triangle of the projected mesh.

    >>> floor = np.array([[[0.0, 0, 0], [0, 9, 0], [9, 0, 0]]])
    >>> depth_along(np.array([[1.0, 1, -5]]), np.array([0.0, 0, 1]), floor)
    array([5.])
    """
    across = np.linalg.svd(direction[None])[2][1:]
    flat, spots = triangles @ across.T, points @ across.T
    edge_1, edge_2 = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = _cross(edge_1, edge_2)
    first = triangles[:, 0]
    normals = np.cross(triangles[:, 1] - first, triangles[:, 2] - first)
    low, high = spots.min(axis=0), spots.max(axis=0)
    near = (flat.max(axis=1) >= low).all(axis=1) & (flat.min(axis=1) <= high).all(axis=1)
    facing = np.flatnonzero(near & (normals @ direction < 0) & (np.abs(area) > 0))
    first, edge_1, edge_2 = flat[facing, 0], edge_1[facing], edge_2[facing]
    lowest, highest = (flat[facing].min(axis=1) - MARGIN_MM).T, (flat[facing].max(axis=1) + MARGIN_MM).T
    reach = np.full(len(points), np.nan)
    for start in range(0, len(points), POINTS_AT_ONCE):
        x, y = spots[start : start + POINTS_AT_ONCE].T[:, :, None]
        n, close = np.nonzero((lowest[0] <= x) & (x <= highest[0]) & (lowest[1] <= y) & (y <= highest[1]))
        n += start
        offset, doubled = spots[n] - first[close], area[facing[close]]
        u = _cross(offset, edge_2[close]) / doubled
        v = _cross(edge_1[close], offset) / doubled
        met = (u >= 0) & (v >= 0) & (u + v <= 1)
        n, inside = n[met], facing[close[met]]
        # Distance along the direction to the plane of a hit triangle.
        gap = ((triangles[inside, 0] - points[n]) * normals[inside]).sum(1) / (normals[inside] @ direction)
        nearest_last = np.argsort(np.abs(gap), kind="stable")[::-1]
        reach[n[nearest_last]] = gap[nearest_last]
    return reach


def _cross(a: Float[np.ndarray, "m 2"], b: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
