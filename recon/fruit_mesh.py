"""The photo route on one page: photos -> cameras -> outlines -> hull -> depth -> Poisson surface -> closed,
scaled mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree

from recon.cameras.camera import Camera, straightened
from recon.cameras.coin import Coin
from recon.cameras.mat_poses import Poses, cameras_from_mat
from recon.cameras.motion import cameras_from_motion
from recon.cameras.photos import Photo, require_enough
from recon.cameras.printed_mat import Mat
from recon.checks.ground_check import rim_evidence
from recon.checks.quality import (
    NOTHING_KNOWN,
    ReconQuality,
    depth_doubts,
    outline_rms_mm,
    warnings_of,
    widest_gap_deg,
)
from recon.checks.surface_error import SurfaceError, surface_error
from recon.checks.surface_verdict import surface_doubts, surface_offset
from recon.learned.fruit_model import SHIPPED, FruitModel, fruit_model, is_fruit_model
from recon.learned.geometry_model import point_maps
from recon.point_route import fruit_points
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import scale_without_mat, scaled_to_height, spread_of_scale
from recon.silhouettes.all_views import FoundFruit, find_fruit
from recon.silhouettes.carve import AGREEMENT
from recon.stage_clock import Progress, StageClock, one_thread
from recon.surface.coverage import seeing_views, seen_and_unseen
from recon.surface.poisson import distances_mm, poisson_surface
from recon.surface.relief import relief
from recon.surface.repair import RepairedMesh, repaired
from recon.surface.unseen_top import top_share
from recon.triangle_mesh import vertex_normals

LOOSE_AGREEMENT = 0.6
"""Share of the views that must take a cell of the first block for fruit, where AGREEMENT gave a mesh that the
photos contradict. White fruit without the fruit model: 1.8 and 12.6 mm off with 0.85, 0.36 and 0.07 mm with
0.6; dark and red fruit the other way round (benchmarks/photo_bank_score.py --without-model, sets 26 and 34
against 12 and 54)."""
MADE_TWICE = (
    "The photos contradicted the first mesh, so drupe made another from a looser start. Check "
    "its picture, and use a ground of another colour next time."
)


@dataclass(frozen=True, kw_only=True)
class ReconOptions:
    """What a batch may set: faces of the mesh, fineness of the hull (ball level), the search for relief, and
    the fruit model that is asked where outlines are found (None: none).
    """

    max_faces: int = 6000
    level: int = 6
    relief: bool = True
    height_sd_mm: float = 0.2
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    coin: Coin | None = None
    fruit_model: Path | None = SHIPPED


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """A closed fruit mesh (mm, faces outward), its relative scale error and surface error, and how it came
    about.

    `frame` is "mat" (the mat's frame: z up, z = 0 on the paper) or "shape" (z up, the support plane at z =
    0). `cameras` are those of the photos used, in that frame, without distortion; `views` tells how many of
    them each vertex faces; `sd_mm` is the standard deviation of the skin's place at each vertex, and
    `surface_sd_mm` its root mean square over the skin that was seen. A geometry model gives none of these.
    `outlines` are the fruit's in each of these photos, pixels (column, row) of the photo without distortion.
    `notes` tell of what was done otherwise than usual, without a doubt of the mesh; `unplaced` are the photos
    whose camera was not found.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    scale_sd: float
    surface_sd_mm: float
    quality: ReconQuality
    warnings: tuple[str, ...]
    seconds: dict[str, float]
    frame: str
    cameras: tuple[Camera, ...] = ()
    outlines: tuple[Float[np.ndarray, "_ 2"], ...] = ()
    views: Int[np.ndarray, " n"] | None = None
    sd_mm: Float[np.ndarray, " n"] | None = None
    notes: tuple[str, ...] = ()
    unplaced: tuple[str, ...] = ()


def reconstruct(
    photos: Sequence[Photo],
    *,
    mat: Mat | None,
    height_mm: float | None,
    options: ReconOptions | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The fruit of a set of photos as a closed mesh in mm.

    Scale comes from the mat, or without one from the fruit's height. The same photos give the same mesh:
    every library runs in one thread with a fixed seed. Where the photos contradict the mesh, as with white
    fruit on white paper of which the first block lacks a side, it is made once more from a block that fewer
    photos must agree on. Raises ReconFailure: too-few-views, mat-not-found, no-overlap, no-fruit,
    fruit-cut-off, no-scale, no-surface, not-watertight, surface-contradicted, bad-geometry-model,
    missing-library.
    """
    options = options or ReconOptions()
    _require_scale(photos, mat, height_mm)
    clock = StageClock(progress)
    model = None
    if options.fruit_model is not None:
        model = fruit_model(options.fruit_model, providers=options.providers)
    with one_thread(), clock.stage("poses", 0.0):
        poses = (
            cameras_from_mat(photos, mat) if mat else cameras_from_motion(photos, height_mm=height_mm or 1.0)
        )
        pairs = [straightened(photos[i], c) for i, c in zip(poses.used.tolist(), poses.cameras, strict=True)]
    try:
        return _reconstructed(photos, poses, pairs, mat, height_mm, options, model, AGREEMENT, clock)
    except ReconFailure as failure:
        if failure.problem is not ReconProblem.SURFACE_CONTRADICTED:
            raise
        try:
            second = _reconstructed(
                photos, poses, pairs, mat, height_mm, options, model, LOOSE_AGREEMENT, clock
            )
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
    clock: StageClock,
) -> Reconstruction:
    """Outlines to surface to closed mesh, with its quality and the warnings that follow."""
    images, cameras = [image for image, _ in pairs], [camera for _, camera in pairs]
    with one_thread():
        with clock.stage("outlines", 0.25):
            fruit = find_fruit(
                images,
                cameras,
                low_mm=poses.box[0],
                high_mm=poses.box[1],
                level=options.level,
                agreement=agreement,
                model=model,
            )
            images, cameras = (
                [images[i] for i in fruit.used.tolist()],
                [cameras[i] for i in fruit.used.tolist()],
            )
        with clock.stage("relief", 0.7):
            skin = _skin(fruit, images, cameras, with_relief=options.relief)
            tree = cKDTree(skin.vertices)
        with clock.stage("surface", 0.85):
            mesh = closed_surface(
                skin.vertices, vertex_normals(skin.vertices, fruit.faces), max_faces=options.max_faces
            )
            bridged = skin.bridged[tree.query(mesh.vertices)[1]]
        with clock.stage("quality", 0.95):
            scaled = _scaled(mesh, fruit, poses, images, cameras, mat, height_mm, options, skin.top_measured)
            checked = _checked(scaled, images, mesh.faces, bridged)
            quality = replace(
                checked.quality,
                views_given=len(photos),
                views_used=len(fruit.used),
                reprojection_px=poses.reprojection_px,
                silhouette_iou=fruit.agreement,
                clear_outline_share=fruit.clear_share,
                focal_px=poses.cameras[0].focal_px,
                focal_sd_px=poses.focal_sd_px,
                k1=poses.cameras[0].k1,
                widest_gap_deg=widest_gap_deg(np.array([c.place for c in cameras]), fruit.vertices.mean(0)),
                decimation_rms_mm=mesh.deviation_rms_mm,
                relief_share=skin.relief_share,
            )
    return Reconstruction(
        vertices=scaled.vertices,
        faces=mesh.faces,
        scale_sd=scaled.sd,
        surface_sd_mm=checked.error.rms_mm,
        quality=quality,
        warnings=poses.warnings
        + scaled.warnings
        + warnings_of(quality, largest_mm=float(np.ptp(scaled.vertices, axis=0).max()))
        + checked.doubts
        + depth_doubts(skin.edge_depth_mm * scaled.per_mm),
        seconds=clock.seconds,
        frame="mat" if mat is not None else "shape",
        cameras=tuple(scaled.cameras),
        outlines=tuple(one.outline_px() for one in fruit.silhouettes),
        views=checked.views,
        sd_mm=checked.error.sd_mm,
        unplaced=tuple(p.name for i, p in enumerate(photos) if i not in poses.used),
    )


@dataclass(frozen=True, kw_only=True)
class _Skin:
    """The hull after the search for relief: its vertices; the share of them, and of the top, that relief has
    measured; how far the hull bridges a hollow where it has not, at each vertex; `Relief.edge_depth_mm`.
    """

    vertices: Float[np.ndarray, "n 3"]
    relief_share: float
    top_measured: float
    bridged: Float[np.ndarray, " n"]
    edge_depth_mm: float = 0.0


def _skin(
    fruit: FoundFruit, images: Sequence[UInt8[np.ndarray, "_ _ 3"]], cameras: Sequence[Camera], *,
    with_relief: bool,
) -> _Skin:  # fmt: skip
    """The skin with what no outline shows, where that is looked for."""
    if not with_relief:
        return _Skin(
            vertices=fruit.vertices,
            relief_share=0.0,
            top_measured=0.0,
            bridged=np.zeros(len(fruit.vertices)),
        )
    found = relief(fruit.vertices, fruit.faces, images, cameras, support=fruit.support)
    return _Skin(
        vertices=found.vertices,
        relief_share=float(found.measured.mean()),
        top_measured=top_share(found.vertices, found.measured),
        bridged=np.where(found.measured, 0.0, found.bridged),
        edge_depth_mm=found.edge_depth_mm,
    )


@dataclass(frozen=True, kw_only=True)
class _Scaled:
    """Mesh and cameras in mm: vertices, cameras, deviation from the outlines, the scale's relative error, mm
    per unit before.
    """

    vertices: Float[np.ndarray, "n 3"]
    cameras: Sequence[Camera]
    outline_mm: float
    sd: float
    warnings: tuple[str, ...]
    per_mm: float = 1.0


def _scaled(
    mesh: RepairedMesh, fruit: FoundFruit, poses: Poses, images: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    cameras: Sequence[Camera], mat: Mat | None, height_mm: float | None, options: ReconOptions,
    top_measured: float,
) -> _Scaled:  # fmt: skip
    """By the mat as it is; without one by the fruit's height or a coin."""
    outline_mm = outline_rms_mm(mesh.vertices, mesh.faces, fruit.silhouettes)
    if mat is not None or height_mm is None:
        return _Scaled(
            vertices=mesh.vertices, cameras=cameras, outline_mm=outline_mm, sd=poses.scale_sd, warnings=()
        )
    scale = scale_without_mat(
        mesh.vertices,
        images,
        cameras,
        height_mm=height_mm,
        height_sd_mm=options.height_sd_mm,
        surface_sd=outline_mm,
        coin=options.coin,
        top_measured=top_measured,
    )
    factor = scale.factor
    return _Scaled(
        vertices=mesh.vertices * factor,
        cameras=[c.moved(np.diag([factor, factor, factor, 1.0])) for c in cameras],
        outline_mm=outline_mm * factor,
        sd=scale.sd,
        warnings=scale.warnings,
        per_mm=factor,
    )


@dataclass(frozen=True, kw_only=True)
class _Checked:
    """The mesh held against its photos: views of each vertex, the skin's error, what of `quality` that
    makes, and what it casts doubt on.
    """

    views: Int[np.ndarray, " n"]
    error: SurfaceError
    quality: ReconQuality
    doubts: tuple[str, ...]


def _checked(
    scaled: _Scaled, images: Sequence[UInt8[np.ndarray, "_ _ 3"]], faces: Int[np.ndarray, "m 3"],
    bridged: Float[np.ndarray, " n"],
) -> _Checked:  # fmt: skip
    """Raises ReconFailure, surface-contradicted, where the photos do not show the mesh."""
    vertices, places = scaled.vertices, np.array([c.place for c in scaled.cameras])
    views = seeing_views(vertices, faces, places)
    share, hole_mm2 = seen_and_unseen(vertices, faces, views)
    evidence = rim_evidence(images, scaled.cameras, vertices, faces)
    error = surface_error(evidence, vertices, faces, places, views, bridged=bridged)
    offset = surface_offset(error, vertices, faces, views)
    doubts = surface_doubts(offset, error, evidence, vertices, faces, views)
    quality = replace(
        NOTHING_KNOWN,
        outline_rms_mm=scaled.outline_mm,
        seen_share=share,
        unseen_mm2=hole_mm2,
        offset_rms_mm=offset.rms_mm,
        offset_local_mm=offset.local_mm,
        offset_volume_share=offset.volume_share,
        ground_known_share=float(evidence.known.mean()) if len(evidence.known) else 0.0,
    )
    return _Checked(views=views, error=error, quality=quality, doubts=doubts)


def reconstruct_with_model(
    photos: Sequence[Photo],
    model: Path,
    *,
    mat: Mat | None,
    height_mm: float | None,
    options: ReconOptions | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The same with a model of the user's own (ONNX), of either kind, told by its outputs.

    A fruit model takes the shipped one's place in `reconstruct`; the points of a geometry model take the
    outlines' place, with scale and frame as there. Raises ReconFailure: bad-geometry-model, and what
    `reconstruct` raises.
    """
    options = options or ReconOptions()
    if is_fruit_model(model, providers=options.providers):
        own = replace(options, fruit_model=model)
        return reconstruct(photos, mat=mat, height_mm=height_mm, options=own, progress=progress)
    _require_scale(photos, mat, height_mm)
    clock = StageClock(progress)
    with one_thread():
        with clock.stage("model", 0.0):
            maps = point_maps(photos, model, providers=options.providers)
            points, normals, scale_sd = fruit_points(maps, photos, mat=mat, height_mm=height_mm)
        with clock.stage("surface", 0.7):
            mesh = closed_surface(points, normals, max_faces=options.max_faces)
            vertices, faces = mesh.vertices, mesh.faces
            vertices[:, 2] = np.maximum(vertices[:, 2], 0.0)
        with clock.stage("quality", 0.9):
            miss_mm = float(np.sqrt(np.mean(distances_mm(points, vertices, faces) ** 2)))
            if mat is None and height_mm is not None:
                vertices, factor = scaled_to_height(vertices, height_mm)
                miss_mm *= factor
                scale_sd = spread_of_scale(height_mm, options.height_sd_mm, miss_mm)
            quality = replace(
                NOTHING_KNOWN,
                views_given=len(photos),
                views_used=len(photos),
                outline_rms_mm=miss_mm,
                decimation_rms_mm=mesh.deviation_rms_mm,
                relief_share=1.0,
            )
    return Reconstruction(
        vertices=vertices,
        faces=faces,
        scale_sd=scale_sd,
        surface_sd_mm=float(np.hypot(miss_mm, mesh.deviation_rms_mm)),
        quality=quality,
        warnings=(
            "The shape comes from a geometry model; only the scatter of its points indicates its error.",
        ),
        seconds=clock.seconds,
        frame="mat" if mat is not None else "shape",
    )


def _require_scale(photos: Sequence[Photo], mat: Mat | None, height_mm: float | None) -> None:
    require_enough(len(photos), where="The set")
    if mat is None and (height_mm is None or not height_mm > 0):
        raise ReconFailure(
            ReconProblem.NO_SCALE,
            "This fruit has neither a marker mat (mat.json) nor a positive height_mm; give one of "
            "them for scale.",
        )


def closed_surface(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], *, max_faces: int
) -> RepairedMesh:
    """Oriented points to one closed mesh: Poisson, then repair and decimation."""
    vertices, faces = poisson_surface(points, normals)
    return repaired(vertices, faces, max_faces=max_faces)
