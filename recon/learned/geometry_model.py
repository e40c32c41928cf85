"""A learned geometry model (ONNX, VGGT's names) maps photos of a fruit on the mat to points of its skin."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from onnxruntime import InferenceSession

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat, detect_tags
from recon.cameras.similarity import moved, robust_similarity
from recon.learned.onnx_file import bad_model
from recon.learned.onnx_session import INPUT, opened, ran
from recon.picture_values import sampled
from recon.recon_failure import ReconProblem
from recon.scale import PRINT_SCALE_SD, blank_box

MULTIPLE = 14
"""Divisor of the sides, px: the model's patch, 14 in VGGT."""
WIDTH_PX = 518
"""Width that VGGT was trained on, for models that leave it open."""
SIGNATURE = "(1, S, 3, H, W)"
POINTS, TRUST = "world_points", "world_points_conf"
TRUSTED_SHARE = 0.6
"""Share of the points that are kept: the model trusts background and rims least. Set by hand."""
FEWEST_CORNERS = 16
"""Least number of the mat's corners for scale and pose: those of four tags."""
FEWEST_POINTS = 200
"""Least number of points above the ground: fewer are no fruit. Set by hand."""
MOST_POINTS = 60000
"""Most points kept: 0.4 mm apart on a fruit of 60 mm. Set by hand."""
SEED = 1
"""Arbitrary, fixed so that runs repeat."""


def fruit_points(
    photos: Sequence[Photo], model: Path, *, mat: Mat, providers: Sequence[str] = ("CPUExecutionProvider",)
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], float]:
    """Points of the skin in the mat's frame (mm, z up), outward normals, and the relative scale error.

    Only the 60 % most trusted points count. Points at the tags' corners fix the similarity to the mat. Raises
    ReconFailure: bad-geometry-model, mat-not-found (fewer corners than four tags have), no-fruit.
    """
    points, trust = point_maps(photos, model, providers=providers)
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=2))  # towards the camera
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    usable = np.isfinite(trust)
    trusted = usable & (trust >= np.quantile(trust[usable], 1 - TRUSTED_SHARE))
    world, scale_sd = _world_from_tags(points, photos, mat)
    placed = moved(points, world)
    turn = world[:3, :3] / np.cbrt(np.linalg.det(world[:3, :3]))
    low, high = blank_box(mat)
    inside = ((placed >= low) & (placed <= high)).all(axis=-1)
    above_ground = trusted & inside & (placed[..., 2] > 0.02 * high[2])
    if above_ground.sum() < FEWEST_POINTS:
        raise ReconProblem.NO_FRUIT.failure(
            f"Only {int(above_ground.sum())} trusted points of the geometry model lie above the "
            "ground at the fruit; check the photos, or remove the model."
        )
    chosen = np.flatnonzero(above_ground)
    if len(chosen) > MOST_POINTS:
        chosen = np.random.default_rng(SEED).choice(chosen, MOST_POINTS, replace=False)
    return placed.reshape(-1, 3)[chosen], normals.reshape(-1, 3)[chosen] @ turn.T, scale_sd


def point_maps(
    photos: Sequence[Photo], model: Path, *, providers: Sequence[str] = ("CPUExecutionProvider",)
) -> tuple[Float[np.ndarray, "s h w 3"], Float[np.ndarray, "s h w"]]:
    """Each photo's points in the model's world frame, and their confidence (-inf: no point).

    Input: images (1, S, 3, H, W), RGB in [0, 1]. Outputs: world_points (1, S, H, W, 3), and world_points_conf
    (1, S, H, W) if it has one. H and W are multiples of 14 (W 518 if the model leaves it open). It runs on
    the first of `providers` that this machine has. Raises ReconFailure (bad-geometry-model) that names the
    file and the missing or misshapen input, output or provider.
    """
    session = opened(model, providers)
    require_geometry_model(model, session)
    offered = [o.name for o in session.get_outputs()]
    (given,) = session.get_inputs()
    kind = "float16" if "float16" in given.type else "float32"
    rows, columns = given.shape[3:]
    height, width = photos[0].image.shape[:2]
    columns = columns if isinstance(columns, int) else WIDTH_PX
    if not isinstance(rows, int):
        rows = max(1, round(height / width * columns / MULTIPLE)) * MULTIPLE
    small = [cv2.resize(p.image, (columns, rows), interpolation=cv2.INTER_AREA) for p in photos]
    images = np.stack(small)[None, ..., ::-1].transpose(0, 1, 4, 2, 3).astype(np.float32) / 255
    wanted = [name for name in (POINTS, TRUST) if name in offered]
    outputs = ran(model, session, wanted, images.astype(kind), signature=SIGNATURE)
    grid = (1, len(photos), rows, columns)
    for name, output, expected in zip(wanted, outputs, ((*grid, 3), grid), strict=False):
        if output.shape != expected:
            raise bad_model(model, f'gives "{name}" of shape {output.shape}', f"{expected}")
    points = np.asarray(outputs[0][0], float)
    trust = np.asarray(outputs[1][0], float) if len(wanted) > 1 else np.ones(grid[1:])
    trust = np.where(np.isfinite(points).all(3) & np.isfinite(trust), trust, -np.inf)
    if np.isfinite(trust).sum() < FEWEST_POINTS:
        fault = f"gives {int(np.isfinite(trust).sum())} finite points"
        raise bad_model(model, fault, f"at least {FEWEST_POINTS}")
    return np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0), trust


def require_geometry_model(model: Path, session: InferenceSession) -> None:
    """Raises ReconFailure (bad-geometry-model) if an open model has other inputs or lacks the points."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    if list(inputs) != [INPUT] or len(inputs[INPUT]) != 5:
        raise bad_model(model, f"takes the inputs {inputs}", f'one input "{INPUT}" of shape {SIGNATURE}')
    offered = [o.name for o in session.get_outputs()]
    if POINTS not in offered:
        others = ", ".join(sorted(offered)) or "none"
        raise bad_model(model, f'has no output "{POINTS}" (its outputs are {others})', f'"{POINTS}"')


def _world_from_tags(
    points: Float[np.ndarray, "s h w 3"], photos: Sequence[Photo], mat: Mat
) -> tuple[Float[np.ndarray, "4 4"], float]:
    """Similarity transform from the points to the mat by its tags' corners, and the scale's relative sd."""
    seen, printed = [np.empty((0, 3))], [np.empty((0, 3))]
    for picture, photo in zip(points, photos, strict=True):
        tags, corners = detect_tags(photo.image, mat)
        cells_per_px = np.array(picture.shape[1::-1]) / photo.image.shape[1::-1]
        cells = (corners + 0.5) * cells_per_px - 0.5
        seen += list(sampled(picture.astype(np.float32), cells, outside=float("nan")))
        printed += [mat.corners_mm[tag] for tag in tags.tolist()]
    source, target = np.concatenate(seen).astype(float), np.concatenate(printed)
    known = np.isfinite(source).all(axis=1)
    if known.sum() < FEWEST_CORNERS:
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"The photos show {len(printed) - 1} tags of the mat ({len(photos)} photos); aligning the "
            "model needs at least 4."
        )
    T, away = robust_similarity(source[known], target[known])
    spread = float(np.sqrt(np.sum((target - target.mean(0)) ** 2)))
    return T, float(np.hypot(np.sqrt(np.mean(away**2)) / spread, PRINT_SCALE_SD))
