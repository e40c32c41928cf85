"""Mat tags to camera poses and focal length, by OpenCV's calibration from a plane."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.cameras.camera import Camera, pinhole
from recon.cameras.photos import FEWEST_PHOTOS, Photo, require_enough
from recon.cameras.printed_mat import Mat, detect_tags
from recon.cameras.similarity import affine
from recon.one_thread import one_thread
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import PRINT_SCALE_SD, Box, blank_box

FEWEST_TAGS = 4
"""Tags that place a photo, at least: sixteen corners. Set by hand."""
LONGEST_ERROR_PX = 3.0
"""px by which a corner may miss the mat: sharp ones miss by fractions of a pixel. Set by hand."""
ROUGH_ERROR_PX = 8.0
"""px by which a corner may miss its photo's homography of the mat before the lens is known. Set by hand."""
ROUNDS = 3
"""Of calibration, each without the corners that missed in the one before. Set by hand."""
ONE_FOCAL_AND_K1 = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)


@dataclass(frozen=True, kw_only=True)
class Poses:
    """Cameras of the photos that could be placed, and how well they explain the pictures."""

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


@one_thread()
def cameras_from_mat(photos: Sequence[Photo], mat: Mat) -> Poses:
    """Cameras in the mat's frame (mm, z up) with one focal length and one radial term, without EXIF.

    Minimises the distance in pixels of seen and projected tag corners. Photos of another size than most are
    left out, with a warning. `scale_sd`: relative, of the print, and of a scale from the corners seen (their
    miss over the root sum of squares of their distances from the middle of their photo's). Raises
    ReconFailure: mat-not-found (no tag anywhere), too-few-views (fewer than three photos of one size with
    four tags).
    """
    require_enough(len(photos), where="The set")
    sightings, size, warnings = _of_one_size(_sightings(photos, mat), photos)
    good = [_rough_fit(s) for s in sightings]
    for _ in range(ROUNDS):
        sightings = [
            _Sighting(sightings[i].photo, sightings[i].corners_mm[good[i]], sightings[i].corners_px[good[i]])
            for i in _consistent(good)
        ]
        cameras, focal_sd_px = _calibrated(photos, sightings, size)
        errors = [
            np.linalg.norm(c.project(s.corners_mm) - s.corners_px, axis=1)
            for c, s in zip(cameras, sightings, strict=True)
        ]
        good = [e < LONGEST_ERROR_PX for e in errors]
        if all(g.all() for g in good):
            break
    miss_px = float(np.sqrt(np.mean(np.concatenate(errors) ** 2) / 2))
    spread_px = np.linalg.norm(np.concatenate([s.corners_px - s.corners_px.mean(axis=0) for s in sightings]))
    return Poses(
        cameras=tuple(cameras),
        used=np.array([s.photo for s in sightings], int),
        reprojection_px=miss_px,
        scale_sd=float(np.hypot(miss_px / spread_px, PRINT_SCALE_SD)),
        focal_sd_px=focal_sd_px,
        box=blank_box(mat),
        warnings=warnings,
    )


def _sightings(photos: Sequence[Photo], mat: Mat) -> list[_Sighting]:
    """Corners of tags in the photos that show enough of them; raises ReconFailure where too few do."""
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
    """Sightings of which most corners fit; raises ReconFailure (mat-not-found) where too few are left."""
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
    """Sightings in photos of the commonest (height, width), that size, and a warning if others are left."""
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


def _rough_fit(sighting: _Sighting) -> Bool[np.ndarray, " n"]:
    """Corners within ROUGH_ERROR_PX of one homography of the mat: a lens bends it by less."""
    flat = sighting.corners_mm[:, :2]
    H, fits = cv2.findHomography(flat, sighting.corners_px, cv2.RANSAC, ROUGH_ERROR_PX)
    return np.zeros(len(flat), bool) if H is None else fits[:, 0] > 0


def _calibrated(
    photos: Sequence[Photo], sightings: Sequence[_Sighting], size: tuple[int, int]
) -> tuple[list[Camera], float]:
    """The cameras of least squared misses (OpenCV's calibration after Zhang 2000, IEEE PAMI 22:1330: focal
    length, one radial term, poses), and the focal length's standard deviation (px).
    """
    printed = [s.corners_mm.astype(np.float32) for s in sightings]
    seen = [s.corners_px.astype(np.float32) for s in sightings]
    start = cv2.initCameraMatrix2D(printed, seen, size[::-1], 1.0)
    start[:2, 2] = pinhole(1.0, size)[:2, 2]
    _, K, bend, turns, shifts, sd, _, _ = cv2.calibrateCameraExtended(
        printed, seen, size[::-1], start, np.zeros(5), flags=ONE_FOCAL_AND_K1
    )
    poses = [affine(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
    cameras = [
        Camera.of(photos[s.photo], K[0, 0], np.ravel(bend)[0], pose)
        for s, pose in zip(sightings, poses, strict=True)
    ]
    return cameras, float(np.max(sd[:2]))
