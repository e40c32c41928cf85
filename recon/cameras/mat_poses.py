"""Camera poses and focal length from the mat's tags: start by homographies, then bundle adjustment."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.cameras.camera import Camera, middle_of, pinhole
from recon.cameras.photos import FEWEST_PHOTOS, Photo, require_enough
from recon.cameras.plane_bundle import RIGID, PlaneScene, Sightings, adjusted
from recon.cameras.printed_mat import Mat, detect_tags
from recon.cameras.similarity import affine, fitted_similarity
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import PRINT_SCALE_SD, Box, blank_box

FEWEST_TAGS = 4
"""Least number of tags for a photo's pose: sixteen corners. Set by hand."""
LONGEST_ERROR_PX = 3.0
"""Largest reprojection error of a corner, px: sharp ones err by fractions of a pixel. Set by hand."""
UNKNOWN_FOCAL_SD = 1.0
"""Prior standard deviation of the log focal length before the tags: wide enough to have no effect."""


@dataclass(frozen=True, kw_only=True)
class Poses:
    """Cameras of the photos with a pose (their indices: `used`), their errors, and the fruit's box."""

    cameras: tuple[Camera, ...]
    used: Int[np.ndarray, " v"]
    reprojection_px: float
    scale_sd: float
    focal_sd_px: float
    box: Box
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Sighting:
    photo: int
    corners_mm: Float[np.ndarray, "n 3"]
    corners_px: Float[np.ndarray, "n 2"]


def cameras_from_mat(photos: Sequence[Photo], mat: Mat) -> Poses:
    """Cameras in the mat's frame (mm, z up) with one focal length and one radial term.

    Minimises the reprojection error of tag corners (px). EXIF only gives a start if homographies fail. Photos
    of an unusual size are left out, with a warning. `scale_sd` combines the printed mat's relative error with
    that of its similarity to freely triangulated corners. Raises ReconFailure: mat-not-found (no photo shows
    four tags, or fewer than three fit the mat), too-few-views (fewer than three of one size with four tags).
    """
    require_enough(len(photos), where="The set")
    sightings, size, warnings = _of_one_size(_sightings(photos, mat), photos)
    known = [f for s in sightings if (f := photos[s.photo].focal_px) is not None]
    focal_px = focal_from_homographies(sightings, size) or (
        float(np.median(known)) if known else 1.2 * max(size)
    )
    start = [_first_pose(s, focal_px, size) for s in sightings]
    for _ in range(2):
        cameras, focal_sd_px = _adjusted(photos, sightings, start, focal_px)
        errors = [
            np.linalg.norm(c.project(s.corners_mm) - s.corners_px, axis=1)
            for c, s in zip(cameras, sightings, strict=True)
        ]
        good = [e < LONGEST_ERROR_PX for e in errors]
        if all(g.all() for g in good):
            break
        kept = _consistent(good)
        sightings = [
            _Sighting(sightings[i].photo, sightings[i].corners_mm[good[i]], sightings[i].corners_px[good[i]])
            for i in kept
        ]
        start, focal_px = [cameras[i].cam_from_world for i in kept], cameras[0].focal_px
    else:
        cameras = [cameras[i] for i in kept]
        errors = [errors[i][good[i]] for i in kept]
    every = np.concatenate(errors)
    return Poses(
        cameras=tuple(cameras),
        used=np.array([s.photo for s in sightings], int),
        reprojection_px=float(np.sqrt(np.mean(every**2) / 2)),
        scale_sd=float(np.hypot(_scale_error(sightings, cameras), PRINT_SCALE_SD)),
        focal_sd_px=focal_sd_px,
        box=blank_box(mat),
        warnings=warnings,
    )


def _sightings(photos: Sequence[Photo], mat: Mat) -> list[_Sighting]:
    """Tag corners of the photos with FEWEST_TAGS or more; raises ReconFailure for under three photos."""
    seen = [photo.tags or detect_tags(photo.image, mat) for photo in photos]
    sightings = [
        _Sighting(i, np.concatenate([mat.corners_mm[t] for t in tags.tolist()]), corners.reshape(-1, 2))
        for i, (tags, corners) in enumerate(seen)
        if len(tags) >= FEWEST_TAGS
    ]
    most = max(len(tags) for tags, _ in seen)
    if most == 0:
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"No marker of the mat ({mat.dictionary}, {len(mat.corners_mm)} tags) is visible in any "
            f"of {len(photos)} photos; check that mat.json belongs to the printed mat and that the "
            "photos show the mat."
        )
    if len(sightings) < FEWEST_PHOTOS:
        raise ReconFailure(
            ReconProblem.TOO_FEW_VIEWS if most >= FEWEST_TAGS else ReconProblem.MAT_NOT_FOUND,
            f"Only {len(sightings)} of {len(photos)} photos show at least {FEWEST_TAGS} tags of the "
            f"mat (at most {most} tags per photo); expected at least {FEWEST_PHOTOS} such photos. "
            "Keep the mat uncovered and in focus.",
        )
    return sightings


def _consistent(good: Sequence[Bool[np.ndarray, " _"]]) -> list[int]:
    """Sightings with most corners consistent; raises ReconFailure (mat-not-found) for fewer than three."""
    kept = [i for i, g in enumerate(good) if g.sum() >= 2 * FEWEST_TAGS and g.mean() > 0.5]
    if len(kept) < FEWEST_PHOTOS:
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"The tags in {len(good)} photos do not fit the mat of mat.json: only {len(kept)} photos "
            f"have half of their corners within {LONGEST_ERROR_PX:g} px. Check that mat.json belongs "
            "to the printed mat, that the mat lies flat, and that no photo is mirrored."
        )
    return kept


def _of_one_size(
    sightings: list[_Sighting], photos: Sequence[Photo]
) -> tuple[list[_Sighting], tuple[int, int], tuple[str, ...]]:
    """Sightings in photos of the commonest (height, width), that size, and a warning for those left out."""
    sizes = [photos[s.photo].image.shape[:2] for s in sightings]
    (size, count), *others = Counter(sizes).most_common()
    if not others:
        return sightings, size, ()
    fault = (
        f"{len(sizes) - count} of {len(sizes)} photos of the mat do not have the usual size of "
        f"{size[1]} x {size[0]} pixels"
    )
    advice = "take all photos with one camera, one zoom and one way up"
    if count < FEWEST_PHOTOS:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"{fault}, and only {count} of one size remain, expected at least {FEWEST_PHOTOS}; {advice}."
        )
    kept = [s for s, other in zip(sightings, sizes, strict=True) if other == size]
    return kept, size, (f"{fault}, so drupe left them out; {advice}.",)


def focal_from_homographies(sightings: Sequence[_Sighting], size: tuple[int, int]) -> float | None:
    """Focal length (px) that makes the mat's axes orthogonal and equally long in each view; weighted median.

    h1, h2 are the first columns of a view's homography about the picture's middle. Conditions: h1' w h2 = 0,
    h1' w h1 = h2' w h2 with w = diag(1/f², 1/f², 1) (Zhang 2000, IEEE PAMI 22:1330; known c, no skew).
    """
    squares, weights = [], []
    for s in sightings:
        H, _ = cv2.findHomography(s.corners_mm[:, :2], s.corners_px - middle_of(size), cv2.RANSAC, 4.0)
        if H is None:
            continue
        h1, h2 = H[:, 0] / np.linalg.norm(H[:, 0]), H[:, 1] / np.linalg.norm(H[:, 0])
        over = np.array([h1[:2] @ h2[:2], h1[:2] @ h1[:2] - h2[:2] @ h2[:2]])
        under = -np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
        weight = float(np.sum(under**2))
        if weight > 0:
            squares.append(float(over @ under) / weight)
            weights.append(np.sqrt(weight))
    if not squares:
        return None
    order = np.argsort(squares)
    share = np.cumsum(np.array(weights)[order])
    square = float(np.array(squares)[order][np.searchsorted(share, share[-1] / 2)])
    longest = max(size)
    return float(np.sqrt(square)) if (0.4 * longest) ** 2 < square < (20.0 * longest) ** 2 else None


def _first_pose(sighting: _Sighting, focal_px: float, size: tuple[int, int]) -> Float[np.ndarray, "4 4"]:
    _, turn, shift = cv2.solvePnP(
        sighting.corners_mm, sighting.corners_px, pinhole(focal_px, size), None, flags=cv2.SOLVEPNP_IPPE
    )
    return affine(cv2.Rodrigues(turn)[0], np.ravel(shift))


def _adjusted(
    photos: Sequence[Photo],
    sightings: Sequence[_Sighting],
    start: Sequence[Float[np.ndarray, "4 4"]],
    focal_px: float,
) -> tuple[list[Camera], float]:
    """One bundle adjustment with fixed corners: the cameras, and the focal length's error (px)."""
    corners, point = np.unique(np.concatenate([s.corners_mm for s in sightings]), axis=0, return_inverse=True)
    seen = Sightings(
        view=np.repeat(np.arange(len(sightings)), [len(s.corners_mm) for s in sightings]),
        point=point,
        places_px=np.concatenate([s.corners_px for s in sightings]),
        whiten=np.broadcast_to(np.eye(2), (len(point), 2, 2)),
    )
    scene = PlaneScene(np.array(start), np.full(len(sightings), focal_px), 0.0, corners[:, :2])
    best = adjusted(
        scene,
        seen,
        photos[sightings[0].photo].image.shape[:2],
        focal_prior=(float(np.log(focal_px)), UNKNOWN_FOCAL_SD),
        breathing_sd=RIGID,
        ground_held=True,
    )
    focal_px = float(np.mean(best.scene.focals_px))
    cameras = [
        Camera.of(photos[s.photo], focal_px, best.scene.k1, pose)
        for s, pose in zip(sightings, best.scene.poses, strict=True)
    ]
    return cameras, best.focal_sd * focal_px


def _scale_error(sightings: Sequence[_Sighting], cameras: Sequence[Camera]) -> float:
    """Relative standard error of the scale, by the similarity of printed and freely triangulated corners."""
    rays: dict[tuple[float, ...], list[Float[np.ndarray, "2 4"]]] = {}
    for s, camera in zip(sightings, cameras, strict=True):
        P = camera.intrinsics @ camera.cam_from_world[:3]
        bent_px = camera.project(s.corners_mm) - replace(camera, k1=0.0).project(s.corners_mm)
        plain = s.corners_px - bent_px
        for corner, pixel in zip(s.corners_mm.tolist(), plain, strict=True):
            rays.setdefault(tuple(corner), []).append(np.outer(pixel, P[2]) - P[:2])
    printed = np.array([k for k, rows in rays.items() if len(rows) >= 3])
    if len(printed) < 4:
        return float("inf")
    triangulated = np.empty_like(printed)
    for i, key in enumerate(map(tuple, printed.tolist())):
        A = np.concatenate(rays[key])
        A /= np.linalg.norm(A[:, :3], axis=1, keepdims=True)
        triangulated[i] = np.linalg.lstsq(A[:, :3], -A[:, 3], rcond=None)[0]
    T, away = fitted_similarity(printed, triangulated)
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    variance = float(np.sum(away**2)) / max(3 * len(printed) - 7, 1)
    return float(np.sqrt(variance / np.sum((printed - printed.mean(0)) ** 2) + (scale - 1) ** 2))
