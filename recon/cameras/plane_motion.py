"""Cameras without a mat from the flat ground that the fruit stands on: few photos, taken from far apart."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from recon.cameras.camera import Camera, aim_of, pinhole, place_of, straightened
from recon.cameras.ground_plane import upright
from recon.cameras.mat_poses import Poses
from recon.cameras.photos import FEWEST_PHOTOS, Photo
from recon.cameras.plane_bundle import RIGID, Adjusted, PlaneScene, Sightings, adjusted
from recon.cameras.plane_start import (
    KNOWN_FOCAL_SD,
    USUAL_FOCAL,
    USUAL_FOCAL_SD,
    GroundPair,
    chained,
    ground_features,
    ground_pairs,
    joined,
    start_cameras,
)
from recon.cameras.plane_tracks import ground_tracks
from recon.cameras.similarity import affine, scaling
from recon.cameras.view_plan import missing_views
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import Box, box_about_z
from recon.silhouettes.segmentation import SegmentationScene, first_block
from recon.wording import listed

FEWER_FEATURES, MORE_FEATURES = 700, 1600
"""Features of each picture from above, and where photos do not join with these; time goes by the square."""
MOST_POINTS = 2500
"""In the first adjustment, of all photos together: bounds its time. Set by hand."""
START_LOSS_PX, LOSS_PX = 4.0, 1.0
"""px from where on a miss counts for less, while cameras are rough and at the end. Set by hand."""
SEARCHES_PX = (10, 4, 3)
"""px of the ground seen from above by which points are looked for, round by round as cameras get better."""
FEWEST_TRACKS = 30
"""Points of the ground, at least, that a set of cameras rests on. Set by hand."""
MOST_MISS_PX = 1.5
"""Median miss from which on ground points do not lie on one plane."""


def cameras_from_ground(photos: Sequence[Photo], *, height_mm: float) -> Poses:
    """Cameras from the ground's texture, matched as from above, on the plane z = 0.

    Homographies of the ground between all pairs give focal length and poses at once; patches of the ground
    measured in every photo then refine them, each photo with a focal length of its own about the common one.
    World and box as in recon.cameras.motion. Photos of one size. Raises ReconFailure: no-overlap where
    fewer than three photos, or fewer than half, or not the first, hang together; no-fruit.
    """
    if len({p.image.shape for p in photos}) != 1:
        raise ReconProblem.NO_OVERLAP.failure(
            "The photos differ in size; use one camera, one zoom setting and one orientation for all photos."
        )
    pairs = ground_pairs([ground_features(p, most=FEWER_FEATURES) for p in photos])
    members = joined(pairs, len(photos))[0]
    if len(members) < len(photos):
        pairs = ground_pairs([ground_features(p, most=MORE_FEATURES) for p in photos])
        members = joined(pairs, len(photos))[0]
    size = (photos[0].image.shape[0], photos[0].image.shape[1])
    known = [p.focal_px for p in photos if p.focal_px is not None]
    focal_px = float(np.median(known)) if known else None
    if len(members) < max(FEWEST_PHOTOS, len(photos) / 2) or 0 not in members:
        raise _apart(photos, members, pairs, size, focal_px)
    adjustment = _refined(
        [photos[i] for i in members], _started(pairs, members, size, focal_px), size, focal_px
    )
    scene, placed = adjustment.scene, [photos[m] for m in members]
    foot = aim_of(scene.poses) * [1.0, 1.0, 0.0]
    level = upright(np.array([0.0, 0.0, 1.0]), foot, place_of(scene.poses[0]) - foot)
    cameras = [
        Camera.of(photo, focal_px, scene.k1, pose).moved(level)
        for photo, focal_px, pose in zip(placed, scene.focals_px, scene.poses, strict=True)
    ]
    world, box = _placed(placed, cameras, height_mm)
    lost = len(photos) - len(members)
    lacking = _lacking(photos, members, [c.place for c in cameras], np.zeros(3))
    return Poses(
        cameras=tuple(c.moved(world) for c in cameras),
        used=np.array(members, int),
        reprojection_px=float(np.median(adjustment.miss_px)),
        scale_sd=float("inf"),
        focal_sd_px=adjustment.focal_sd * cameras[0].focal_px,
        box=box,
        warnings=(f"drupe found no camera pose for {lost} of {len(photos)} photos. {lacking}",)
        if lost
        else (),
    )


def _lacking(
    photos: Sequence[Photo],
    members: Sequence[int],
    places: Sequence[Float[np.ndarray, "3"]],
    middle: Float[np.ndarray, "3"],
) -> str:
    """Which views are missing where the photos `members` were taken around the middle."""
    names = [p.name for p in photos]
    unplaced = [name for i, name in enumerate(names) if i not in members]
    return missing_views(
        [names[i] for i in members], np.array(places), middle, given=names, unplaced=unplaced
    )


def _apart(
    photos: Sequence[Photo],
    largest: Sequence[int],
    pairs: Sequence[GroundPair],
    size: tuple[int, int],
    focal_px: float | None,
) -> ReconFailure:
    """Which photos hang together and which do not, and where more are needed."""
    if len(largest) < FEWEST_PHOTOS:
        return ReconProblem.NO_OVERLAP.failure(
            f"Of {len(photos)} photos no three show the same ground (at most {len(largest)} overlap); "
            f"expected {FEWEST_PHOTOS} or more. Lay a printed cloth or paper under the fruit and take "
            "the photos again."
        )
    scene = _started(pairs, largest, size, focal_px)
    lacking = _lacking(photos, largest, [place_of(p) for p in scene.poses], aim_of(scene.poses))
    joined_names = listed([photos[i].name for i in largest])
    return ReconProblem.NO_OVERLAP.failure(f"The ground connects only {joined_names}. {lacking}")


def _started(
    pairs: Sequence[GroundPair], members: Sequence[int], size: tuple[int, int], focal_px: float | None
) -> PlaneScene:
    """Poses and focal length from the homographies, then from all matches."""
    _, from_first = chained(pairs, members)
    start_px, poses = start_cameras(from_first, size, focal_px)
    K = pinhole(start_px, size)
    number = {m: i for i, m in enumerate(members)}
    inner = [p for p in pairs if p.a in number and p.b in number]
    most = max(8, MOST_POINTS // len(inner))
    view, places, ground = [], [], []
    for pair in inner:
        some = np.unique(np.linspace(0, len(pair.places_a) - 1, most).astype(int))
        a, b = pair.places_a[some], pair.places_b[some]
        pose = poses[pair.a]
        onto = np.linalg.inv(K @ pose[:3, [0, 1, 3]])
        at = np.column_stack([a, np.ones(len(a))]) @ onto.T
        ahead = at[:, 2] > 1e-9  # the inverse of the depth
        ground.append(at[ahead, :2] / at[ahead, 2:])
        places.append(np.stack([a[ahead], b[ahead]], axis=1))
        view.append(np.tile([number[pair.a], number[pair.b]], (int(ahead.sum()), 1)))
    at = np.concatenate(ground)
    away = np.linalg.norm(at - np.median(at, axis=0), axis=1)
    near = away < 10 * np.median(away)
    seen = Sightings(
        np.concatenate(view)[near].ravel(),
        np.repeat(np.arange(int(near.sum())), 2),
        np.concatenate(places)[near].reshape(-1, 2),
        np.tile(np.eye(2), (2 * int(near.sum()), 1, 1)),
    )
    scene = PlaneScene(np.stack([poses[m] for m in members]), np.full(len(members), start_px), 0.0, at[near])
    prior = _focal_prior(size, focal_px)
    return adjusted(scene, seen, size, focal_prior=prior, breathing_sd=RIGID, loss_px=START_LOSS_PX).scene


def _focal_prior(size: tuple[int, int], focal_px: float | None) -> tuple[float, float]:
    if focal_px is not None:
        return float(np.log(focal_px)), KNOWN_FOCAL_SD
    return float(np.log(USUAL_FOCAL * max(size))), USUAL_FOCAL_SD


def _refined(
    photos: Sequence[Photo], scene: PlaneScene, size: tuple[int, int], focal_px: float | None
) -> Adjusted:
    """The scene from patches of the ground, searched in smaller and smaller windows."""
    adjustment = None
    for search_px in SEARCHES_PX:
        seen, ground = ground_tracks(photos, scene, aim_of(scene.poses)[:2], search_px=search_px)
        least = np.bincount(seen.view, minlength=len(photos)).min()
        if len(ground) < FEWEST_TRACKS or least < 8:
            break
        start = PlaneScene(scene.poses, scene.focals_px, scene.k1, ground)
        adjustment = adjusted(start, seen, size, focal_prior=_focal_prior(size, focal_px), loss_px=LOSS_PX)
        scene = adjustment.scene
    if adjustment is None or float(np.median(adjustment.miss_px)) > MOST_MISS_PX:
        raise ReconProblem.NO_OVERLAP.failure(
            "The common ground of the photos is not flat, or has too little texture; expected at "
            f"least {FEWEST_TRACKS} patches within {MOST_MISS_PX:g} px of one plane. Lay a printed "
            "cloth or paper flat under the fruit, or use the mat (drupe mat)."
        )
    return adjustment


def _placed(
    photos: Sequence[Photo], cameras: Sequence[Camera], height_mm: float
) -> tuple[Float[np.ndarray, "4 4"], Box]:
    """Shift and scale to about millimetres with the fruit on the z axis, and the box that it stands in.

    What stands on the ground near the place that the photos look at is the fruit: a block that the photos
    agree on.
    """
    distance = float(np.median([np.linalg.norm(c.place) for c in cameras]))
    guess = scaling(100 / distance)
    pairs = [straightened(p, c.moved(guess)) for p, c in zip(photos, cameras, strict=True)]
    images, plain = [image for image, _ in pairs], [camera for _, camera in pairs]
    scene = SegmentationScene(images, plain, *box_about_z(32.0, 55.0))
    cells = first_block(scene).points * distance / 100
    low, high = cells.min(0), cells.max(0)
    factor = height_mm / high[2]
    world = affine(factor * np.eye(3), -factor * (low + high) / 2 * [1, 1, 0])
    half = factor * 0.85 * max(float((high - low)[:2].max()), float(high[2]))
    return world, box_about_z(half, 1.7 * height_mm)
