"""Photos of the fruit upside down: their mesh is registered on the upright one and gives the side that stood
on the mat.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import affine, moved
from recon.checks.photo_check import checked_photos
from recon.checks.quality import require_seen, seen_doubts
from recon.fruit_mesh import Reconstruction
from recon.recon_failure import ReconFailure, ReconProblem
from recon.surface.ray_mesh import RayMesh, seeing_views, seen_and_unseen
from recon.surface.repair import repaired
from recon.triangle_mesh import Faces, Vertices, facing, vertex_normals

VIEWS = 3
"""Rank of the camera that rates how well skin was seen: three photos or more measure it."""
GRAZING, FULL = 0.0, 0.3
"""Cosines between the normal and the direction to that camera at which skin is unseen, and fully seen."""
TURNS, TRIAL_POINTS, TRIAL_STEPS, STEPS, FINALISTS = 24, 500, 20, 40, 4
"""Starts 15 degrees apart; points and steps of a trial; steps and number of the finalists. Set by hand."""
RING_DEG = (15.0, 50.0)
"""Elevations assumed for unknown cameras: a low and a high ring, as drupe advises."""
FEWEST = 60
"""Least number of points on skin that both meshes saw; a trial has 500 points."""
OUTLIER = 3.0
"""Scale of Geman and McClure's weight, in robust spreads. Set by hand, as usual in robust statistics."""
MOST_MISS_SHARE, MOST_LARGER, MOST_LARGER_BY_HEIGHT = 0.012, 0.01, 0.12
"""Largest misfit (of the fruit's size) and scale difference of two meshes of one fruit. The last applies to
scales by height, which differs for a fruit that lies tilted."""
LIKE, APART_DEG, SAME_SHARE = 1.15, 10.0, 0.006
"""A rival pose fits within this factor, is rotated by more than this, and changes the skin by this share."""
CONVENTION_DEG = 40.0
"""Largest angle from turning the fruit about the mat's arrow; of rival poses the one within it counts."""


@dataclass(frozen=True)
class ScannedSide:
    """One closed mesh of the fruit (mm, faces outward), and how well each vertex was seen (0 to 1)."""

    vertices: Vertices
    faces: Faces
    seen: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, vertices: Vertices, faces: Faces, places: Float[np.ndarray, "v 3"]) -> "ScannedSide":
        """Rate each vertex by the camera with the third-largest cosine to its normal.

        Without `places` (camera centres, mm), two rings of cameras at RING_DEG above the mat are assumed.
        """
        normals = vertex_normals(vertices, faces)
        if not len(places):
            places = _ring(vertices)
        cosine = np.stack([facing(vertices, normals, place) for place in places])
        best = np.sort(cosine, axis=0)[-min(VIEWS, len(places))]
        return cls(vertices, faces, np.clip((best - GRAZING) / (FULL - GRAZING), 0.0, 1.0))


def _ring(vertices: Vertices) -> Float[np.ndarray, "v 3"]:
    """Camera centres at RING_DEG around a fruit on the mat, ten of its sizes away."""
    around, up = (g.ravel() for g in np.meshgrid(np.arange(12) * np.pi / 6, np.radians(RING_DEG)))
    way = np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=1)
    return np.asarray(vertices.mean(0) + 10 * float(np.ptp(vertices, axis=0).max()) * way)


@dataclass(frozen=True)
class BothSides:
    """Vertices of the upright mesh on the mean of both skins; `upright_from_over`: pose of the other mesh.

    `miss_mm`: root mean square distance of the meshes where both saw the skin. `by_convention`: another
    rotation fits as well, and this one is about the mat's arrow.
    """

    vertices: Vertices
    upright_from_over: Float[np.ndarray, "4 4"]
    miss_mm: float
    by_convention: bool = False


@dataclass(frozen=True)
class _Laid:
    """A registration of the other mesh on the first: pose, misfit, and by what share the other is larger."""

    pose: Float[np.ndarray, "4 4"]
    miss_mm: float
    larger: float


def both_sides(upright: ScannedSide, over: ScannedSide, *, on_mat: bool = True) -> BothSides:
    """`over`, the fruit laid upside down, registered on `upright`, and both merged into one skin.

    Point-to-plane registration (Chen, Medioni 1992) on skin that both saw, with Geman and McClure's weights,
    from TURNS rotations about the vertical. Each vertex then moves to the mean of both skins, weighted by how
    well each saw it. `on_mat`: both are to scale, and the mat's arrow decides between rotations that the
    shape leaves open; else the second's scale follows the first's. Raises ReconFailure (no-overlap): another
    fruit, another scale, or an ambiguous rotation.
    """
    skin = _Skin(upright)
    size = float(np.ptp(upright.vertices, axis=0).max())
    first = _turned_over(upright, over, 0.0)
    spread = np.random.default_rng(0).permutation(np.flatnonzero(over.seen > 0))
    trials = [
        _laid(skin, over, spread[:TRIAL_POINTS], _turned_over(upright, over, turn), size, TRIAL_STEPS, on_mat)
        for turn in np.arange(TURNS) * 360.0 / TURNS
    ]
    ways = [
        _laid(skin, over, spread, trial.pose, size, STEPS, on_mat) for trial in _different(trials)[:FINALISTS]
    ]
    ways.sort(key=lambda way: way.miss_mm)
    best = ways[0]
    if not best.miss_mm <= MOST_MISS_SHARE * size:
        raise ReconProblem.NO_OVERLAP.failure(
            f"the two meshes differ by {best.miss_mm:.2f} mm (root mean square) on their common skin: "
            "another fruit, or poor photos"
        )
    if abs(best.larger) > (MOST_LARGER if on_mat else MOST_LARGER_BY_HEIGHT):
        raise ReconProblem.NO_OVERLAP.failure(
            f"they show the fruit {100 * best.larger:+.1f} % larger than the upright photos: another "
            "fruit, or another mat or height"
        )
    vertices = _merged_skin(upright, over, best)
    rivals = [
        other
        for other in _different(ways)[1:]
        if other.miss_mm < LIKE * best.miss_mm
        and _apart_mm(upright, vertices, _merged_skin(upright, over, other)) > SAME_SHARE * size
    ]
    if rivals:
        known = [way for way in (best, *rivals) if on_mat and _turn_from(first, way.pose) < CONVENTION_DEG]
        if len(known) != 1:
            raise ReconProblem.NO_OVERLAP.failure(
                "the fruit is so round that they fit the upright photos in two ways with different "
                "undersides. Turn it over about the mat's arrow, so that the suture still points "
                "along the arrow"
            )
        best = known[0]
        vertices = _merged_skin(upright, over, best)
    return BothSides(vertices, best.pose, best.miss_mm, by_convention=bool(rivals))


def _apart_mm(upright: ScannedSide, a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square distance of two skins along the normals, where the upright mesh was not seen well."""
    off = np.einsum("ij,ij->i", b - a, vertex_normals(a, upright.faces))
    return float(np.sqrt(np.mean(off[upright.seen < 0.5] ** 2)))


def _turn_from(first: Float[np.ndarray, "4 4"], pose: Float[np.ndarray, "4 4"]) -> float:
    """Angle between two poses about the vertical, degrees."""
    R = pose[:3, :3] @ first[:3, :3].T
    return float(np.degrees(abs(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))))


class _Skin:
    """A scanned side with queries of nearest points."""

    def __init__(self, side: ScannedSide) -> None:
        self._mesh = RayMesh(side.vertices, side.faces)
        self._side = side
        self._normals = vertex_normals(side.vertices, side.faces)

    def nearest(
        self, points: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
        """The nearest points of the skin, its interpolated normals, and how well it was seen there."""
        corners, weights = self._mesh.nearest(points)
        normals = np.einsum("kc,kcx->kx", weights, self._normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        places = np.einsum("kc,kcx->kx", weights, self._side.vertices[corners])
        return places, normals, np.einsum("kc,kc->k", weights, self._side.seen[corners])


def _turned_over(upright: ScannedSide, over: ScannedSide, turn_deg: float) -> Float[np.ndarray, "4 4"]:
    """Pose that turns the other mesh about z, then over about x, and aligns the middles of both boxes."""
    R = Rotation.from_euler("zx", [turn_deg, 180.0], degrees=True).as_matrix()
    target, middle = ((side.vertices.min(0) + side.vertices.max(0)) / 2 for side in (upright, over))
    return affine(R, target - R @ middle)


def _laid(
    skin: _Skin,
    over: ScannedSide,
    which: Int[np.ndarray, " k"],
    pose: Float[np.ndarray, "4 4"],
    size: float,
    steps: int,
    on_mat: bool,
) -> _Laid:
    """Point-to-plane registration from a start; the scale is always solved for, and applied without a mat.

    The misfit is infinite if the two share too little skin.
    """
    source, source_seen = over.vertices[which], over.seen[which]
    left = 1.0
    for turn in range(steps + 1):
        points = moved(source, pose)
        near, normals, seen = skin.nearest(points)
        away = np.einsum("ij,ij->i", near - points, normals)
        weight = source_seen * seen
        both: Bool[np.ndarray, " k"] = weight > 0.05
        if both.sum() < FEWEST:
            return _Laid(pose, float("inf"), 0.0)
        squares = np.minimum(np.abs(away[both]), 0.05 * size) ** 2
        miss = float(np.sqrt(np.average(squares, weights=weight[both])))
        if turn == steps:
            break
        reach = max(OUTLIER * 1.48 * float(np.median(np.abs(away[both]))), 1e-3 * size)
        weight = weight / (1 + (away / reach) ** 2) ** 2
        middle = np.average(points[both], axis=0, weights=weight[both])
        arm = points - middle
        A = np.concatenate(
            [np.cross(arm, normals) / size, normals, np.einsum("ij,ij->i", arm, normals)[:, None] / size],
            axis=1,
        )
        normal_of = A.T @ (weight[:, None] * A)
        normal_of += np.diag([1e-3] * 3 + [1e-9] * 3 + [1e-3]) * float(np.trace(normal_of)) / 7
        step = np.linalg.solve(normal_of, A.T @ (weight * away))
        left = 1 + step[6] / size
        R = Rotation.from_rotvec(step[:3] / size).as_matrix() * (1.0 if on_mat else left)
        pose = affine(R, middle - R @ middle + step[3:6]) @ pose
        if np.abs(step).max() < 1e-5 * size:
            break
    scale = float(np.cbrt(np.linalg.det(pose[:3, :3]))) * (left if on_mat else 1.0)
    return _Laid(pose, miss, 1 / scale - 1)


def _different(ways: Sequence[_Laid]) -> list[_Laid]:
    """The registrations by misfit, without those that end within APART_DEG of a better one."""
    kept: list[_Laid] = []
    for way in sorted(ways, key=lambda way: way.miss_mm):
        turns = [Rotation.from_matrix(_turn(way) @ _turn(other).T).magnitude() for other in kept]
        if all(np.degrees(turn) > APART_DEG for turn in turns):
            kept.append(way)
    return kept


def _turn(way: _Laid) -> Float[np.ndarray, "3 3"]:
    return np.asarray(way.pose[:3, :3] / np.cbrt(np.linalg.det(way.pose[:3, :3])))


def _merged_skin(upright: ScannedSide, over: ScannedSide, way: _Laid) -> Float[np.ndarray, "n 3"]:
    """The first mesh's vertices, moved to the weighted mean of both skins."""
    placed = ScannedSide(moved(over.vertices, way.pose), over.faces, over.seen)
    near, _, seen = _Skin(placed).nearest(upright.vertices)
    share = seen / np.maximum(seen + upright.seen, 1e-3)
    return np.asarray(upright.vertices + share[:, None] * (near - upright.vertices))


WHERE = "photos-flipped/"
Route = Callable[[Sequence[Photo]], Reconstruction]


def with_underside(
    upright: Reconstruction, read: Callable[[], Sequence[Photo]], route: Route, *, mat: Mat | None
) -> Reconstruction:
    """The upright reconstruction with its underside; if that fails, unchanged but for a warning.

    `read` gives the photos of the fruit upside down; `route` reconstructs them as it did the upright ones.
    """
    try:
        return _merged(upright, read(), route, mat)
    except ReconFailure as failure:
        why = failure.detail.rstrip(".")
        return replace(upright, warnings=(*upright.warnings, f"drupe did not use {WHERE}: {why}."))


def _merged(
    upright: Reconstruction, photos: Sequence[Photo], route: Route, mat: Mat | None
) -> Reconstruction:
    """The upright mesh with its underside from the photos of the fruit upside down; raises ReconFailure."""
    checked = checked_photos(photos, mat)
    over = route(checked.photos)
    require_seen(over.quality, left_out=checked.warnings)
    joined = both_sides(_side(upright), _side(over), on_mat=mat is not None)
    mesh = repaired(joined.vertices, upright.faces, max_faces=len(upright.faces))
    quality, views = upright.quality, None
    if upright.cameras and over.cameras:
        places = np.concatenate([_places(upright), moved(_places(over), joined.upright_from_over)])
        views = seeing_views(mesh.vertices, mesh.faces, places)
        share, hole_mm2 = seen_and_unseen(mesh.vertices, mesh.faces, views)
        quality = replace(quality, seen_share=share, unseen_mm2=hole_mm2)
    quality = replace(quality, flipped_views=over.quality.views_used, flipped_miss_mm=joined.miss_mm)
    kept = [w for w in upright.warnings if w not in seen_doubts(upright.quality)]
    said = [
        f"In {WHERE}: {w}"
        for w in (*checked.warnings, *over.warnings, *over.notes)
        if w not in seen_doubts(over.quality)
    ]
    if joined.by_convention:
        said.append(
            f"The fruit is so round that {WHERE} fits in two ways. drupe assumed that you turned the "
            "fruit over about the mat's arrow, with the suture still along the arrow."
        )
    return replace(
        upright,
        vertices=mesh.vertices,
        faces=mesh.faces,
        surface_sd_mm=max(upright.surface_sd_mm, joined.miss_mm / float(np.sqrt(2))),
        quality=quality,
        views=views,
        sd_mm=None,
        flipped_cameras=tuple(
            replace(camera, k1=over.quality.k1).moved(joined.upright_from_over) for camera in over.cameras
        ),
        warnings=(*kept, *seen_doubts(quality), *said),
    )


def _side(made: Reconstruction) -> ScannedSide:
    return ScannedSide.of(made.vertices, made.faces, _places(made))


def _places(made: Reconstruction) -> Float[np.ndarray, "v 3"]:
    return np.array([camera.place for camera in made.cameras]).reshape(-1, 3)
