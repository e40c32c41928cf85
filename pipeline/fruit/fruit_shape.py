"""A fruit's surface and its pit, in the fruit frame, from photos or from ready meshes."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from pipeline.batch.cache import cached, stage_key
from pipeline.batch.confirmed_effects import PitFound, pit_found
from pipeline.batch.layout import FruitResults, write_whole
from pipeline.batch.outcome import FruitEnded, Outcome
from pipeline.batch.records import MeshRecord, OrientationRecord, PitRecord
from pipeline.batch.task import FruitTask
from pipeline.fruit.category_doubts import size_doubts
from pipeline.fruit.photographed import KeptMesh, photographed
from pipeline.fruit.trace_geometry import stated_in_table
from recon.learned.onnx_file import model_files
from recon.pit.placement import embed_pit, place_pit, require_closed
from recon.surface.mesh_file import mesh_bytes, read_mesh
from recon.surface.orientation import orientation_of, orientation_warnings
from recon.triangle_mesh import Mesh, volume_mm3


@dataclass(frozen=True, kw_only=True)
class FruitShape:
    """The fruit's surface in the fruit frame (mm), and the pose back to the frame in which it was made.

    `views`: number of photos that show each vertex, `sd_mm`: standard deviation of the skin's place there, if
    it is known. `mat_from_fruit`: the fruit frame in the mat's; None without a mat. `skin`: JPEG of the skin
    (reports.skin_texture), empty without photos.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    mesh_from_fruit: Float[np.ndarray, "4 4"]
    record: MeshRecord
    warnings: tuple[str, ...]
    views: Int[np.ndarray, " n"] | None = None
    sd_mm: Float[np.ndarray, " n"] | None = None
    mat_from_fruit: Float[np.ndarray, "4 4"] | None = None
    skin: bytes = b""


@dataclass(frozen=True, kw_only=True)
class FruitPit:
    """The pit's surface, and the flesh's skin around it, after the Boolean cut; fruit frame, mm.

    Without a pit there is a skin alone, and no record.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    skin: Mesh
    record: PitRecord | None


def fruit_shape(task: FruitTask) -> FruitShape:
    """The fruit's surface: its own fruit.ply, or reconstructed from its photos; raises ReconFailure.

    Its warnings name doubts about photos, size and orientation.
    """
    shape = _fruit_shape(task)
    on_mat = task.mat is not None
    by_coin = task.settings.photos.scale is not None
    doubts = size_doubts(task.given, shape.record, task.prior, on_mat=on_mat, by_coin=by_coin, body=task.body)
    record = shape.record
    if task.body.stem_and_suture:
        orientation = orientation_of(shape.vertices, shape.faces)
        stance = OrientationRecord.model_validate(orientation, from_attributes=True)
        record = record.model_copy(update={"stance": stance})
        if not task.folder.pit_ply.is_file():
            doubts = [*doubts, *orientation_warnings(orientation)]
    known = on_mat or record.source == "fruit.ply"  # a ready mesh is in the frame of the poses
    return replace(
        shape,
        warnings=(*shape.warnings, *doubts),
        record=record,
        mat_from_fruit=shape.mesh_from_fruit if known else None,
    )


def _fruit_shape(task: FruitTask) -> FruitShape:
    """The surface without the doubts about its size and orientation; cached until photos, settings or code
    change.
    """
    folder = task.folder
    if folder.fruit_ply.is_file():
        vertices, faces = read_mesh(folder.fruit_ply)
        require_closed(vertices, faces, what=folder.fruit_ply.name)
        record = measured(vertices, faces, source="fruit.ply")
        return FruitShape(
            vertices=vertices, faces=faces, mesh_from_fruit=np.eye(4), record=record, warnings=()
        )
    if not folder.photo_files():
        where = str(folder.root)
        if stated_in_table(task.given).specimen.diameters_mm is not None:
            where += (
                ", nor is there a recording of bare plates alone in grasps/, for which the three "
                "diameters of fruits.csv suffice"
            )
        raise FruitEnded(Outcome.NO_SHAPE, where)
    if task.mat is None and task.given.height_mm is None:
        raise FruitEnded(Outcome.NO_SCALE, task.fruit_id)
    model = task.settings.recon.geometry_model
    model_path = None if model is None else task.batch_root / model
    mat_file = [task.batch_root / "mat.json"] if task.mat is not None else []
    key = stage_key(
        "mesh",
        files=[
            *folder.photo_files(),
            *folder.flipped_files(),
            *mat_file,
            *(model_files(model_path) if model_path else []),
        ],
        settings=[
            task.settings.recon.model_dump(),
            task.settings.photos.model_dump(),
            None if task.mat else task.given.height_mm,
            repr(task.body),
        ],
        rooms=("pipeline", "recon", "reports"),
    )
    made = cached(task.results.cache, "mesh", key, lambda: photographed(task, model_path), record=KeptMesh)
    write_whole(task.results.photo, made.photo.tobytes())
    if len(made.outlines):
        write_whole(task.results.outlines, made.outlines.tobytes())
    quality = {"scale_sd": made.scale_sd, "surface_sd_mm": made.surface_sd_mm, "quality": made.quality}
    return FruitShape(
        vertices=made.vertices,
        faces=made.faces,
        mesh_from_fruit=made.mesh_from_fruit,
        record=measured(made.vertices, made.faces, source="photos").model_copy(update=quality),
        warnings=(*folder.unused_photos(), *made.warnings),
        views=made.views,
        sd_mm=made.sd_mm,
        skin=made.skin.tobytes(),
    )


def measured(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    source: Literal["photos", "fruit.ply"],
) -> MeshRecord:
    """Counts, size and volume of a surface (mm), without measures of its quality."""
    box = np.ptp(vertices, axis=0).tolist()
    return MeshRecord(
        source=source,
        vertices=len(vertices),
        faces=len(faces),
        volume_mm3=volume_mm3(vertices, faces),
        height_mm=box[2],
        box_mm=tuple(box),
    )


def embedded_pit(task: FruitTask, shape: FruitShape) -> FruitPit:
    """The fruit's own pit.ply, or the prior's pit, cut out of the fruit; or none. Raises ReconFailure."""
    if task.folder.pit_ply.is_file():
        vertices, faces = read_mesh(task.folder.pit_ply)
        require_closed(vertices, faces, what=task.folder.pit_ply.name)
        source = "pit.ply"
    elif task.settings.pit.none:
        return FruitPit(
            vertices=np.empty((0, 3)),
            faces=np.empty((0, 3), dtype=np.int64),
            skin=(shape.vertices, shape.faces),
            record=None,
        )
    elif task.prior is not None:
        vertices, faces = place_pit(shape.vertices, shape.faces, task.prior)
        kind = "prior" if task.prior.measured is None else "measured pit, placed as"
        source = f"{kind} for {task.prior.category}"
    else:
        raise ValueError("a batch without a prior has a fruit without a pit.ply")
    found_pit = pit_found(task.settings.mismatch)
    if found_pit != PitFound():
        vertices = found_pit.moved(vertices)
        source += ", moved to where it was found"
    embedded = embed_pit(shape.vertices, shape.faces, vertices, faces)
    skin, pit = embedded.skin, embedded.pit
    low, high = pit[0].min(axis=0), pit[0].max(axis=0)
    return FruitPit(
        vertices=pit[0],
        faces=pit[1],
        skin=skin,
        record=PitRecord(
            source=source,
            volume_mm3=embedded.pit_volume_mm3,
            centre_mm=tuple(((low + high) / 2).tolist()),
            box_mm=tuple((high - low).tolist()),
            thinnest_flesh_mm=embedded.thinnest_flesh_mm,
            flesh_volume_mm3=embedded.flesh_volume_mm3,
        ),
    )


def write_meshes(results: FruitResults, shape: FruitShape, pit: FruitPit) -> None:
    """Writes fruit.ply and pit.ply, if any, in the frame that the mesh was made in (with a mat: the
    mat's)."""
    for path, part, views in ((results.fruit_ply, shape, shape.views), (results.pit_ply, pit, None)):
        if not len(part.faces):
            continue
        placed = part.vertices @ shape.mesh_from_fruit[:3, :3].T + shape.mesh_from_fruit[:3, 3]
        write_whole(path, mesh_bytes(placed, part.faces, views=views))
