"""A geometry model's points to a scaled, closed fruit mesh: align to mat or ground, keep the fruit, close."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from recon.cameras.ground_plane import ground_plane, upright
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat, detect_tags
from recon.cameras.similarity import moved, robust_similarity
from recon.learned.geometry_model import PointMaps
from recon.picture_values import sampled
from recon.recon_failure import ReconProblem
from recon.scale import PRINT_SCALE_SD, Box, blank_box, box_about_z

TRUSTED_SHARE = 0.6
"""Of a model's points, by its own confidence. Set by hand: what it trusts least is background and rims."""
FEWEST_CORNERS = 16
"""Of the mat, at least, that scale and pose rest on: as many as FEWEST_TAGS tags have."""
FEWEST_POINTS = 200
"""Above the ground, at least: fewer are no fruit. Set by hand."""
MOST_POINTS = 60000
"""Kept at most: 0.4 mm apart on a fruit of 60 mm. Set by hand."""
SEED = 1
"""Any number does, kept so that runs repeat."""


def fruit_points(
    maps: PointMaps, photos: Sequence[Photo], *, mat: Mat | None, height_mm: float | None
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], float]:
    """Points of the skin in mm (z up, ground at z = 0), outward normals, and the relative scale error.

    The more trusted 60 % of the points count. With a mat, the tag corners' points fix the similarity to the
    mat's frame; without it, the ground's plane fixes z, the fruit's height the scale (fixed later on the
    mesh), and x points to where the model says that the first photo was taken: by convention from the
    suture's side. Raises ReconFailure: mat-not-found (fewer than four tags seen), bad-geometry-model (no mat
    and no poses), no-overlap (no ground, or a first photo from straight above), no-fruit.
    """
    normals = _grid_normals(maps.points)
    usable = np.isfinite(maps.confidence)
    trusted = usable & (maps.confidence >= np.quantile(maps.confidence[usable], 1 - TRUSTED_SHARE))
    if mat is not None:
        world, scale_sd = _world_from_tags(maps, photos, mat)
        box = blank_box(mat)
    elif maps.places is None:
        raise ReconProblem.BAD_GEOMETRY_MODEL.failure(
            'The geometry model has no output "pose_enc". Its points do not show the first photo\'s '
            "position, and so not the suture's direction. Use the mat (drupe mat), or a model with "
            '"pose_enc".'
        )
    else:
        world, box = _world_from_ground(maps.points[trusted], maps.places[0], height_mm or 1.0)
        scale_sd = float("inf")
    points = moved(maps.points, world)
    turn = world[:3, :3] / np.cbrt(np.linalg.det(world[:3, :3]))
    low, high = box
    inside = ((points >= low) & (points <= high)).all(axis=-1)
    above_ground = trusted & inside & (points[..., 2] > 0.02 * high[2])
    if above_ground.sum() < FEWEST_POINTS:
        raise ReconProblem.NO_FRUIT.failure(
            f"Only {int(above_ground.sum())} trusted points of the geometry model lie above the "
            "ground at the fruit; check the photos, or remove the model."
        )
    skin_points, outward = points[above_ground], normals[above_ground] @ turn.T
    if len(skin_points) > MOST_POINTS:
        pick = np.random.default_rng(SEED).choice(len(skin_points), MOST_POINTS, replace=False)
        skin_points, outward = skin_points[pick], outward[pick]
    return skin_points, outward, scale_sd


def _world_from_tags(
    maps: PointMaps, photos: Sequence[Photo], mat: Mat
) -> tuple[Float[np.ndarray, "4 4"], float]:
    """The similarity that takes the points to the mat, by its tags' corners; and the scale's relative sd."""
    seen, printed = [], []
    for view, photo in enumerate(photos):
        tags, corners = detect_tags(photo.image, mat)
        for tag, pixels in zip(tags.tolist(), corners, strict=True):
            picture = maps.points[view].astype(np.float32)
            seen.append(sampled(picture, maps.cells_of(view, pixels), outside=float("nan")))
            printed.append(mat.corners_mm[tag])
    source = np.concatenate(seen) if seen else np.empty((0, 3))
    target = np.concatenate(printed) if printed else np.empty((0, 3))
    known = np.isfinite(source).all(axis=1)
    if known.sum() < FEWEST_CORNERS:
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"The photos show {len(printed)} tags of the mat ({len(photos)} photos); aligning the "
            "model needs at least 4."
        )
    T, away = robust_similarity(source[known].astype(float), target[known])
    spread = float(np.sqrt(np.sum((target - target.mean(0)) ** 2)))
    return T, float(np.hypot(np.sqrt(np.mean(away**2)) / spread, PRINT_SCALE_SD))


def _world_from_ground(
    points: Float[np.ndarray, "n 3"], first_place: Float[np.ndarray, "3"], height_mm: float
) -> tuple[Float[np.ndarray, "4 4"], Box]:
    """The similarity that puts the points on z = 0 at the height given, and the box around the fruit."""
    rng = np.random.default_rng(SEED)
    some = points[rng.choice(len(points), min(4000, len(points)), replace=False)]
    size = float(np.median(np.linalg.norm(some - np.median(some, axis=0), axis=1)))
    middle, up = ground_plane(some, tolerance=0.02 * size, above=None, rng=rng)
    height = (some - middle) @ up
    over = some[height > 0.1 * max(float(np.percentile(height, 99)), 1e-9)]
    foot = np.median(over, axis=0)
    foot = foot - ((foot - middle) @ up) * up
    T = upright(up, foot, first_place - foot)
    above_ground = moved(over, T)
    tall = float(np.percentile(above_ground[:, 2], 99))
    wide = float(np.percentile(np.hypot(above_ground[:, 0], above_ground[:, 1]), 90))
    T[:3] *= height_mm / tall
    half = 1.7 * height_mm / tall * max(wide, 0.5 * tall)
    return T, box_about_z(half, 1.7 * height_mm)


def _grid_normals(points: Float[np.ndarray, "s h w 3"]) -> Float[np.ndarray, "s h w 3"]:
    """Normals towards the camera, from the neighbours to the right and below."""
    right = np.gradient(points, axis=2)
    down = np.gradient(points, axis=1)
    normal = np.cross(down, right)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12))
