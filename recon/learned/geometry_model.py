"""A learned geometry model (ONNX, VGGT's names): photos in, one 3D point for each pixel out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from recon.cameras.photos import Photo
from recon.learned.model_cameras import camera_places, first_place, unprojected
from recon.learned.onnx_file import bad_model
from recon.learned.onnx_session import Session, opened, ran

MULTIPLE = 14
"""px: sides must be a multiple of the model's patch, 14 in VGGT."""
WIDTH_PX = 518
"""Width that VGGT was trained on, for models that leave it open."""
ENOUGH = (("world_points",), ("depth", "pose_enc"))
KINDS = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
FEWEST_POINTS = 200
"""Of all photos, at least: fewer are no surface. Set by hand."""


@dataclass(frozen=True)
class PointMaps:
    """Per photo and pixel of the model's grid: a point in the model's own world, and how much it is
    trusted; and where the photos were taken: all of them if the model says so, else at least the first, from
    how its points lie in its picture; None where they do not tell.
    """

    points: Float[np.ndarray, "s h w 3"]
    confidence: Float[np.ndarray, "s h w"]
    photo_px_per_cell: Float[np.ndarray, "s 2"]
    places: Float[np.ndarray, "p 3"] | None = None

    def cells_of(self, view: int, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Photo pixels (column, row) as cells of the grid."""
        return np.asarray((pixels + 0.5) / self.photo_px_per_cell[view] - 0.5)


def point_maps(
    photos: Sequence[Photo], model: Path, *, providers: Sequence[str] = ("CPUExecutionProvider",)
) -> PointMaps:
    """Run a model of signature images (1, S, 3, H, W), RGB in [0, 1] -> depth (1, S, H, W, 1), depth_conf,
    world_points (1, S, H, W, 3), world_points_conf, pose_enc (1, S, 9); world_points, or depth with pose_enc,
    is enough.

    H and W are multiples of 14 (W 518 where the model leaves it open). pose_enc is translation (3) and
    quaternion (4, scalar last) of the camera from the world, then the vertical and horizontal angle of view
    in radians. Runs on the first of `providers` that this machine has. Raises ReconFailure
    (bad-geometry-model) that names the file and the input, output or provider that is missing or misshapen.
    """
    session = opened(model, providers)
    offered = {o.name for o in session.get_outputs()}
    _require_signature(model, session, offered, photos=len(photos))
    shape = session.get_inputs()[0].shape
    height, width = photos[0].image.shape[:2]
    columns = shape[4] if isinstance(shape[4], int) else WIDTH_PX
    rows = (
        shape[3]
        if isinstance(shape[3], int)
        else max(1, round(height / width * columns / MULTIPLE)) * MULTIPLE
    )
    small = [cv2.resize(p.image, (columns, rows), interpolation=cv2.INTER_AREA) for p in photos]
    images = np.stack(small)[None, ..., ::-1].transpose(0, 1, 4, 2, 3).astype(np.float32) / np.float32(255)
    outputs = _outputs(model, session, images, offered)
    poses = None if "pose_enc" not in outputs else np.asarray(outputs["pose_enc"][0], float)
    points, trust = _trusted_points(model, outputs, poses)
    scale = np.array([[p.image.shape[1] / columns, p.image.shape[0] / rows] for p in photos])
    places = first_place(points[0], trust[0]) if poses is None else camera_places(poses)
    return PointMaps(points, trust, scale, places)


def _require_signature(model: Path, session: Session, offered: set[str], *, photos: int) -> None:
    """Raises ReconFailure where it does not take so many images, or offers too little."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    if list(inputs) != ["images"]:
        raise bad_model(
            model, f"takes the inputs {sorted(inputs)}", 'one input "images" of shape (1, S, 3, H, W)'
        )
    shape = inputs["images"]
    if len(shape) != 5 or (shape[2] not in (3, "3") and isinstance(shape[2], int)):
        raise bad_model(model, f'has the input "images" of shape {shape}', "(1, S, 3, H, W)")
    if not any(set(names) <= offered for names in ENOUGH):
        missing = '"world_points"'
        half = {"depth": "pose_enc", "pose_enc": "depth"}
        lacks = next(
            (f'"{other}" beside its "{output}"' for output, other in half.items() if output in offered), None
        )
        raise bad_model(
            model,
            f"has no output {lacks or missing} (its outputs are {', '.join(sorted(offered)) or 'none'})",
            '"world_points", or "depth" with "pose_enc"',
        )
    if isinstance(shape[1], int) and shape[1] != photos:
        raise bad_model(
            model, f"takes exactly {shape[1]} photos, not {photos}", "a model for any number of photos"
        )
    kind = session.get_inputs()[0].type
    if kind not in KINDS:
        raise bad_model(model, f'takes "images" as {kind}', "float or float16")


def _outputs(
    model: Path, session: Session, images: Float[np.ndarray, "1 s 3 h w"], offered: set[str]
) -> dict[str, np.ndarray]:
    """What it gives for the images, of the shapes that it should be; raises ReconFailure."""
    kind = session.get_inputs()[0].type
    wanted = [
        n for n in ("world_points", "world_points_conf", "depth", "depth_conf", "pose_enc") if n in offered
    ]
    try:
        outputs = dict(zip(wanted, ran(session, wanted, {"images": images.astype(KINDS[kind])}), strict=True))
    except Exception as error:  # onnxruntime raises its own classes, all straight from Exception
        raise bad_model(
            model, f"failed while it ran ({error})", "a model that runs on images (1, S, 3, H, W)"
        ) from error
    _, photos, _, rows, columns = images.shape
    grid = (1, photos, rows, columns)
    expected = {
        "world_points": (*grid, 3), "depth": (*grid, 1), "world_points_conf": grid, "depth_conf": grid,
        "pose_enc": (1, photos, 9),
    }  # fmt: skip
    for name, full in expected.items():
        if name in outputs and outputs[name].shape != full:
            raise bad_model(model, f'gives "{name}" of shape {outputs[name].shape}', f"{full}")
    return outputs


def _trusted_points(
    model: Path, outputs: Mapping[str, np.ndarray], poses: Float[np.ndarray, "s 9"] | None
) -> tuple[Float[np.ndarray, "s h w 3"], Float[np.ndarray, "s h w"]]:
    """Points and how far to trust each, -inf where it is none; raises ReconFailure for too few."""
    if poses is not None and not (np.isfinite(poses).all() and poses[:, 3:7].any(axis=1).all()):
        raise bad_model(
            model, 'gives a "pose_enc" without a turn', "finite numbers and quaternions that are not 0"
        )
    if poses is None or "world_points" in outputs:
        points = np.asarray(outputs["world_points"][0], float)
        confidence = outputs.get("world_points_conf", outputs.get("depth_conf"))
    else:
        depth = np.asarray(outputs["depth"][0, ..., 0], float)
        points = unprojected(np.where(depth > 0, depth, np.nan), poses)
        confidence = outputs.get("depth_conf")
    trust = np.ones(points.shape[:3]) if confidence is None else np.asarray(confidence[0], float)
    trust = np.where(np.isfinite(points).all(3) & np.isfinite(trust), trust, -np.inf)
    if np.isfinite(trust).sum() < FEWEST_POINTS:
        raise bad_model(
            model, f"gives {int(np.isfinite(trust).sum())} finite points", f"at least {FEWEST_POINTS}"
        )
    return np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0), trust
