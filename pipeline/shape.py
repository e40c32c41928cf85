"""A fruit's surface and its pit, in the fruit frame, from photos or from ready meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.cache import Artifact, cached, stage_key
from pipeline.layout import FruitResults, write_whole
from pipeline.outcome import FruitEnded, Outcome
from pipeline.records import MeshRecord, PitRecord
from recon.fruit_frame import fruit_frame
from recon.fruit_mesh import ReconOptions, reconstruct
from recon.mesh_file import read_mesh, write_mesh
from recon.photos import read_photos
from recon.pit import EmbeddedPit, embed_pit, place_pit, require_watertight
from reports.photo import thumbnail_jpeg

if TYPE_CHECKING:
    from pipeline.stages import FruitTask


@dataclass(frozen=True, kw_only=True)
class Shape:
    """The fruit's surface in the fruit frame (mm), and the pose that leads back to the frame it was made in."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    mesh_from_fruit: Float[np.ndarray, "4 4"]
    record: MeshRecord
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Pit:
    """The pit's surface in the fruit frame (mm)."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    record: PitRecord


def fruit_shape(task: FruitTask) -> Shape:
    """The fruit's surface: its own fruit.ply, or reconstructed from its photos; raises ReconFailure."""
    folder = task.folder
    if folder.fruit_ply.is_file():
        vertices, faces = read_mesh(folder.fruit_ply)
        require_watertight(vertices, faces, source=str(folder.fruit_ply.name))
        return _shape(vertices, faces, np.eye(4), source="fruit.ply", facts={})
    if not folder.photo_files():
        raise FruitEnded(Outcome.NO_SHAPE, str(folder.root))
    if task.mat is None and task.given.height_mm is None:
        raise FruitEnded(Outcome.NO_SCALE, task.fruit_id)
    model = task.settings.recon.geometry_model
    model_path = None if model is None else task.batch_root / model
    mat_file = [task.batch_root / "mat.json"] if task.mat is not None else []
    key = stage_key(
        "mesh",
        files=[*folder.photo_files(), *mat_file, *([model_path] if model_path else [])],
        settings=[task.settings.recon.model_dump(), None if task.mat else task.given.height_mm],
        rooms=("recon",),
    )
    made = cached(task.results.cache, "mesh", key, lambda: _from_photos(task, model_path))
    if not task.results.photo.is_file():
        write_whole(task.results.photo, made.arrays["photo"].tobytes())
    return _shape(
        made.arrays["vertices"],
        made.arrays["faces"],
        made.arrays["mesh_from_fruit"],
        source="photos",
        facts=dict(made.facts),
    )
