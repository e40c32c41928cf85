"""Reconstruction from photos: cameras -> outlines -> hull -> depth -> closed, scaled mesh."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from recon.cameras.camera import Camera, straightened
from recon.cameras.coin import Coin
from recon.cameras.mat_poses import Poses, cameras_from_mat
from recon.cameras.motion import cameras_from_motion
from recon.cameras.photos import Photo, require_enough
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import scaling
from recon.checks.ground_check import rim_evidence
from recon.checks.quality import ReconQuality, depth_doubts, outline_rms_mm, warnings_of, widest_gap_deg
from recon.checks.surface_error import surface_error
from recon.checks.surface_verdict import moved_doubts, surface_doubts, surface_offset
from recon.learned.fruit_model import SHIPPED, FruitModel, fruit_model, is_fruit_model
from recon.learned.geometry_model import fruit_points
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import Scale, scale_without_mat, top_share
from recon.silhouettes.all_views import find_fruit
from recon.silhouettes.segmentation import AGREEMENT
from recon.surface.ray_mesh import RayMesh, seeing_views, seen_and_unseen
from recon.surface.relief import relief
from recon.surface.repair import RepairedMesh, poisson_surface, repaired
from recon.triangle_mesh import Faces, Vertices, vertex_normals


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV and BLAS to one thread and set OpenCV's seed, so that runs repeat."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    cv2.setRNGSeed(1)
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        cv2.setNumThreads(before)


LOOSE_AGREEMENT = 0.6
"""Share of the views that must not classify a cell of the first block as ground, if the photos contradict
the mesh made with AGREEMENT. White fruit without the fruit model: 1.8 and 12.6 mm off with 0.85, 0.36 and
0.07 mm with 0.6 (benchmarks/photo_bank_score.py --without-model, sets 26 and 34). For dark and red fruit 0.85
is better (sets 12 and 54)."""
HEIGHT_SD_MM = 0.2
"""Standard deviation of a height in fruits.csv, by a caliper on a soft, round body (assumed)."""
MADE_TWICE = (
    "The photos contradicted the first mesh, so drupe made another from a looser start. Check "
    "its picture, and use a ground of another colour next time."
)


@dataclass(frozen=True, kw_only=True)
class ReconOptions:
    """Settings of a batch: most faces of the mesh, ball level of the hull, providers of ONNX Runtime, coin
    for the scale. `fruit_model`: the model that helps to find outlines (None: no model).
    """

    max_faces: int = 6000
    level: int = 6
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    coin: Coin | None = None
    fruit_model: Path | None = SHIPPED


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """A closed fruit mesh (mm, faces outward), its scale error (relative), surface error, and origin.

    `frame` is "mat" (the mat's frame: z up, z = 0 on the paper) or "shape" (z up, the support plane at z =
    0). `cameras` are those of the photos used, in that frame, without distortion; `views` counts the cameras
    that see each vertex. `sd_mm` is the standard deviation of the skin's place at each vertex,
    `surface_sd_mm` its root mean square over visible skin. A geometry model gives no cameras, views or
    `sd_mm`. `outlines` are the fruit's in each of these photos, pixels (column, row) without distortion.
    `notes` report unusual steps that cast no doubt on the mesh. `unplaced` are the photos without a camera
    pose. `flipped_cameras` are those of photos of the fruit upside down, in the same frame, with their
    distortion.
    """

    vertices: Vertices
    faces: Faces
    scale_sd: float
    surface_sd_mm: float
    quality: ReconQuality
    warnings: tuple[str, ...]
    frame: str
    cameras: tuple[Camera, ...] = ()
    outlines: tuple[Float[np.ndarray, "_ 2"], ...] = ()
    views: Int[np.ndarray, " n"] | None = None
    sd_mm: Float[np.ndarray, " n"] | None = None
    notes: tuple[str, ...] = ()
    unplaced: tuple[str, ...] = ()
    flipped_cameras: tuple[Camera, ...] = ()


def reconstruct(
    photos: Sequence[Photo],
    *,
    mat: Mat | None,
    height_mm: float | None,
    options: ReconOptions | None = None,
) -> Reconstruction:
    """The fruit as a closed mesh in mm, scaled by the mat, or without one by a coin or the fruit's height.

    One thread and fixed seeds: the same photos give the same mesh. If the photos contradict the mesh, it is
    made once more from a block that fewer photos must agree on. Raises ReconFailure: too-few-views,
    mat-not-found, no-overlap, no-fruit, fruit-cut-off, no-scale, no-surface, not-watertight,
    surface-contradicted, bad-geometry-model, missing-library.
    """
    options = options or ReconOptions()
    _require_scale(photos, mat, height_mm)
    model = None
    if options.fruit_model is not None:
        model = fruit_model(options.fruit_model, providers=options.providers)
    with one_thread():
        poses = (
            cameras_from_mat(photos, mat)
            if mat
            else cameras_from_motion(photos, height_mm=height_mm or 1.0, model=model)
        )
        pairs = [straightened(photos[i], c) for i, c in zip(poses.used.tolist(), poses.cameras, strict=True)]
    try:
        return _reconstructed(photos, poses, pairs, mat, height_mm, options, model, AGREEMENT)
    except ReconFailure as failure:
        if failure.problem is not ReconProblem.SURFACE_CONTRADICTED:
            raise
        try:
            second = _reconstructed(photos, poses, pairs, mat, height_mm, options, model, LOOSE_AGREEMENT)
        except ReconFailure:
            raise failure from None
        return replace(second, notes=(MADE_TWICE,))


def _reconstructed(
    photos: Sequence[Photo],
    poses: Poses,
    pairs: Sequence[tuple[UInt8[np.ndarray, "_ _ 3"], Camera]],
    mat: Mat | None,
    height_mm: float | None,
    options: ReconOptions,
    model: FruitModel | None,
    agreement: float,
) -> Reconstruction:
    """The closed mesh from outlines and relief, with its quality and warnings.

    Raises ReconFailure, among others surface-contradicted if the photos do not show the mesh.
    """
    low_mm, high_mm = poses.box
    with one_thread():
        fruit = find_fruit(
            *zip(*pairs, strict=True),
            low_mm=low_mm,
            high_mm=high_mm,
            level=options.level,
            agreement=agreement,
            model=model,
        )
        images, cameras = zip(*(pairs[i] for i in fruit.used.tolist()), strict=True)
        skin = relief(fruit.vertices, fruit.faces, images, cameras, support=fruit.support)
        tree = cKDTree(skin.vertices)
        mesh = closed_surface(
            skin.vertices, vertex_normals(skin.vertices, fruit.faces), max_faces=options.max_faces
        )
        bridged = np.where(skin.measured, 0.0, skin.bridged)[tree.query(mesh.vertices)[1]]
        outline_mm = outline_rms_mm(mesh.vertices, mesh.faces, fruit.silhouettes)
        scale = Scale(factor=1.0, sd=poses.scale_sd)
        if mat is None and height_mm is not None:
            scale = scale_without_mat(
                mesh.vertices,
                images,
                cameras,
                height_mm=height_mm,
                height_sd_mm=HEIGHT_SD_MM,
                surface_sd=outline_mm,
                coin=options.coin,
                top_measured=top_share(skin.vertices, skin.measured),
            )
        vertices, faces = mesh.vertices * scale.factor, mesh.faces
        cameras = tuple(c.moved(scaling(scale.factor)) for c in cameras)
        places = np.array([c.place for c in cameras])
        views = seeing_views(vertices, faces, places)
        share, hole_mm2 = seen_and_unseen(vertices, faces, views)
        evidence = rim_evidence(images, cameras, vertices, faces)
        error = surface_error(evidence, vertices, faces, places, views, bridged=bridged)
        offset = surface_offset(error, vertices, faces, views)
        doubts = surface_doubts(offset, error, evidence, vertices, faces, views)
        largest_mm = float(np.ptp(vertices, axis=0).max())
        doubts += moved_doubts(evidence, [c.name for c in cameras], largest_mm)
        quality = ReconQuality(
            views_given=len(photos),
            views_used=len(fruit.used),
            reprojection_px=poses.reprojection_px,
            silhouette_iou=fruit.agreement,
            outline_rms_mm=outline_mm * scale.factor,
            clear_outline_share=fruit.clear_share,
            focal_px=poses.cameras[0].focal_px,
            focal_sd_px=poses.focal_sd_px,
            k1=poses.cameras[0].k1,
            widest_gap_deg=widest_gap_deg(places, fruit.vertices.mean(0) * scale.factor),
            seen_share=share,
            unseen_mm2=hole_mm2,
            decimation_rms_mm=mesh.deviation_rms_mm,
            relief_share=float(skin.measured.mean()),
            offset_rms_mm=offset.rms_mm,
            offset_local_mm=offset.local_mm,
            offset_volume_share=offset.volume_share,
            ground_known_share=float(evidence.known.mean()) if len(evidence.known) else 0.0,
        )
    return Reconstruction(
        vertices=vertices,
        faces=faces,
        scale_sd=scale.sd,
        surface_sd_mm=error.rms_mm,
        quality=quality,
        warnings=poses.warnings
        + scale.warnings
        + warnings_of(quality, largest_mm=largest_mm)
        + doubts
        + depth_doubts(skin.edge_depth_mm * scale.factor),
        frame="mat" if mat is not None else "shape",
        cameras=cameras,
        outlines=tuple(silhouette.outline_px() for silhouette in fruit.silhouettes),
        views=views,
        sd_mm=error.sd_mm,
        unplaced=tuple(p.name for i, p in enumerate(photos) if i not in poses.used),
    )


def reconstruct_with_model(
    photos: Sequence[Photo],
    model: Path,
    *,
    mat: Mat | None,
    height_mm: float | None,
    options: ReconOptions | None = None,
) -> Reconstruction:
    """`reconstruct` with the user's ONNX model; its outputs distinguish fruit from geometry models.

    A fruit model replaces the shipped one. The points of a geometry model replace the outlines and need the
    mat. Raises ReconFailure: bad-geometry-model, and those of `reconstruct`.
    """
    options = options or ReconOptions()
    if is_fruit_model(model, providers=options.providers):
        options = replace(options, fruit_model=model)
        return reconstruct(photos, mat=mat, height_mm=height_mm, options=options)
    require_enough(len(photos), where="The set")
    if mat is None:
        raise ReconProblem.NO_SCALE.failure(
            "A geometry model needs the marker mat (mat.json) for the scale; photograph the fruit on it "
            "(drupe mat), or remove the model."
        )
    with one_thread():
        points, normals, scale_sd = fruit_points(photos, model, mat=mat, providers=options.providers)
        mesh = closed_surface(points, normals, max_faces=options.max_faces)
        mesh.vertices[:, 2] = np.maximum(mesh.vertices[:, 2], 0.0)
        away_mm = RayMesh(mesh.vertices, mesh.faces).distances_mm(points)
        miss_mm = float(np.sqrt(np.mean(away_mm**2)))
    quality = ReconQuality(
        views_given=len(photos),
        views_used=len(photos),
        outline_rms_mm=miss_mm,
        decimation_rms_mm=mesh.deviation_rms_mm,
        relief_share=1.0,
    )
    return Reconstruction(
        vertices=mesh.vertices,
        faces=mesh.faces,
        scale_sd=scale_sd,
        surface_sd_mm=float(np.hypot(miss_mm, mesh.deviation_rms_mm)),
        quality=quality,
        warnings=(
            "The shape comes from a geometry model; only the scatter of its points indicates its error.",
        ),
        frame="mat",
    )


def _require_scale(photos: Sequence[Photo], mat: Mat | None, height_mm: float | None) -> None:
    require_enough(len(photos), where="The set")
    if mat is None and (height_mm is None or not height_mm > 0):
        raise ReconProblem.NO_SCALE.failure(
            "This fruit has neither a marker mat (mat.json) nor a positive height_mm; give one of "
            "them for scale."
        )


def closed_surface(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], *, max_faces: int
) -> RepairedMesh:
    """Oriented points to one closed mesh: Poisson, then repair and decimation."""
    vertices, faces = poisson_surface(points, normals)
    return repaired(vertices, faces, max_faces=max_faces)
