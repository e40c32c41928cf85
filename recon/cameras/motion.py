"""Cameras without a mat, from the ground's texture or by pycolmap, upright on the plane under the fruit."""

import signal
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from recon.cameras.camera import Camera, aim_of
from recon.cameras.ground_plane import ground_plane, upright
from recon.cameras.mat_poses import Poses
from recon.cameras.photos import FEWEST_PHOTOS, Photo, require_enough
from recon.cameras.plane_motion import cameras_from_ground, placed
from recon.cameras.similarity import affine
from recon.learned.fruit_model import FruitModel
from recon.recon_failure import ReconFailure, ReconProblem

# pycolmap's own SIGTERM handler would print a stack; the handler of the process must stay
_before = signal.getsignal(signal.SIGTERM)
_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})

try:
    import pycolmap  # its import replaces the handler of SIGTERM, which is blocked meanwhile
except (ImportError, OSError):
    pycolmap = None  # pip has no package of it for Linux on ARM
finally:
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _before if _before is not None else signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, _mask)

MOST_FEATURES = 4000
"""Most features of a photo: more are fainter, and matching costs their square. Set by hand."""
LONGEST_SIDE_PX = 1280
"""Longest side of reduced photos, px: ground and fruit keep enough detail. Set by hand."""
MOST_TRIALS = 1000
"""RANSAC trials for a pair of photos: bounds the time of pairs without overlap. Set by hand."""
SEED = 1
"""Arbitrary, fixed so that runs repeat."""


def cameras_from_motion(
    photos: Sequence[Photo], *, height_mm: float, model: FruitModel | None = None
) -> Poses:
    """Cameras from the flat ground's texture, or if that leaves photos out, from features of the scene.

    The method that places more photos counts; if equal, the ground. World and box: see
    `cameras_from_features`. Raises ReconFailure: too-few-views, no-overlap, no-fruit, missing-library.
    """
    require_enough(len(photos), where="The set")
    try:
        ground = cameras_from_ground(photos, height_mm=height_mm, model=model)
    except ReconFailure as failure:
        try:
            return cameras_from_features(photos, height_mm=height_mm, model=model)
        except ReconFailure as other:
            raise ReconFailure(other.problem, f"{other.detail} {failure.detail}") from None
    if len(ground.used) == len(photos):
        return ground
    try:
        features = cameras_from_features(photos, height_mm=height_mm, model=model)
    except ReconFailure:
        return ground
    return features if len(features.used) > len(ground.used) else ground


def cameras_from_features(
    photos: Sequence[Photo], *, height_mm: float, model: FruitModel | None = None
) -> Poses:
    """Cameras from SIFT features of all pairs and incremental mapping (Schönberger, Frahm 2016).

    World: about millimetres (the fruit is assumed `height_mm` tall), z up from the support plane. The fruit
    is near the z axis; x points to the first camera. Writes PNG to a scratch folder, as pycolmap reads only
    files. Raises ReconFailure: no-overlap (under three photos, or half of them, or not the first, are
    connected, or the first looks straight down), too-few-views, no-fruit, missing-library.
    """
    require_enough(len(photos), where="The set")
    if pycolmap is None:
        raise ReconProblem.MISSING_LIBRARY.failure(
            "The photos show no mat, and the ground's texture does not join them. The other method needs "
            "pycolmap, which is not installed here (pip has no package of it for Linux on ARM). "
            "Photograph the fruit on the mat (drupe mat), or give its mesh as fruit.ply."
        )
    with tempfile.TemporaryDirectory() as scratch:
        mapped = _mapped(photos, Path(scratch))
    registered = 0 if mapped is None else mapped.num_reg_images()
    if mapped is None or registered < max(FEWEST_PHOTOS, len(photos) / 2):
        raise ReconProblem.NO_OVERLAP.failure(
            f"Features of the photos give camera poses for only {registered} of {len(photos)} photos. "
            "Without a mat, the fruit needs a textured ground, and neighbouring photos must be within 20 "
            "degrees. Print the mat (drupe mat) or take more photos."
        )
    rows = sorted((int(image.name[:6]), image) for image in mapped.images.values() if image.has_pose)
    if rows[0][0] != 0:
        raise ReconProblem.NO_OVERLAP.failure(
            f"The first photo ({photos[0].name}) shares too few features with the others. Without a "
            "mat it defines the suture's direction, and with it the places of pit and pads. Retake "
            "it from the suture's side, within 20 degrees of the next, or use the mat (drupe mat)."
        )
    cameras = [_camera(photos[i], image) for i, image in rows]
    cloud = np.array([p.xyz for p in mapped.points3D.values() if p.track.length() >= 3])
    level = _level(cloud, cameras)
    cameras = [c.moved(level) for c in cameras]
    world, box = placed([photos[i] for i, _ in rows], cameras, height_mm, model)
    cameras = [c.moved(world) for c in cameras]
    focal = mapped.cameras[rows[0][1].camera_id]
    return Poses(
        cameras=tuple(cameras),
        used=np.array([i for i, _ in rows], int),
        reprojection_px=float(mapped.compute_mean_reprojection_error()),
        scale_sd=float("inf"),
        focal_sd_px=0.002 * float(focal.params[0]),
        box=box,
        warnings=()
        if registered > 0.8 * len(photos)
        else (f"drupe found no camera pose for {len(photos) - registered} of {len(photos)} photos.",),
    )


def _mapped(photos: Sequence[Photo], scratch: Path) -> "pycolmap.Reconstruction | None":
    """COLMAP's reconstruction with the most photos, from SIFT features; None if it finds none."""
    pictures = scratch / "pictures"
    pictures.mkdir()
    for i, photo in enumerate(photos):
        cv2.imwrite(str(pictures / f"{i:06d}.png"), photo.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    database = scratch / "features.db"
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    pycolmap.set_random_seed(SEED)
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = 1, False
    extraction.max_image_size = LONGEST_SIDE_PX
    extraction.sift.max_num_features = MOST_FEATURES
    extraction.sift.first_octave = 0
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = 1, False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed, verification.ransac.max_num_trials = SEED, MOST_TRIALS
    same_size = len({p.image.shape for p in photos}) == 1
    mode = pycolmap.CameraMode.SINGLE if same_size else pycolmap.CameraMode.PER_IMAGE
    known = [p.focal_px for p in photos if p.focal_px is not None]
    if known and same_size:
        height, width = photos[0].image.shape[:2]
        reader.camera_params = f"{float(np.median(known))},{width / 2},{height / 2},0"
    pycolmap.extract_features(
        database,
        pictures,
        camera_mode=mode,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    pycolmap.match_exhaustive(
        database, matching_options=matching, verification_options=verification, device=pycolmap.Device.cpu
    )
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, SEED
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.4
    options.ba_global_max_refinements = 2
    options.mapper.num_threads, options.mapper.random_seed = 1, SEED
    options.triangulation.random_seed = SEED
    options.min_model_size, options.multiple_models, options.extract_colors = FEWEST_PHOTOS, False, False
    models = pycolmap.incremental_mapping(database, pictures, scratch, options=options)
    return max(models.values(), key=lambda m: m.num_reg_images()) if models else None


def _camera(photo: Photo, image: "pycolmap.Image") -> Camera:
    """The camera of a COLMAP image (SIMPLE_RADIAL)."""
    matrix, params = image.cam_from_world().matrix(), image.camera.params
    return Camera.of(photo, params[0], params[3], affine(matrix[:, :3], matrix[:, 3]))


def _level(cloud: Float[np.ndarray, "n 3"], cameras: Sequence[Camera]) -> Float[np.ndarray, "4 4"]:
    """The rigid transform that moves the plane of most points to z = 0 and the cameras' aim to x = y = 0."""
    aim = aim_of(np.array([c.cam_from_world for c in cameras]))
    places = np.array([c.place for c in cameras])
    distance = float(np.median(np.linalg.norm(places - aim, axis=1)))
    near = cloud[np.linalg.norm(cloud - aim, axis=1) < 0.8 * distance]
    if len(near) < 20:
        raise ReconProblem.NO_OVERLAP.failure(
            f"drupe found only {len(near)} points in the common field of view; use the mat or a "
            "textured ground."
        )
    middle, up = ground_plane(near, tolerance=0.005 * distance, above=places, rng=np.random.default_rng(SEED))
    foot = aim - ((aim - middle) @ up) * up
    return upright(up, foot, places[0] - foot)
