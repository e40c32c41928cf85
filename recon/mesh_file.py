"""Reads and writes triangle meshes in mm: PLY, STL and OBJ, by trimesh."""

import io
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from recon.coverage import SEEN_BY
from recon.failure import ReconFailure, ReconProblem

SUFFIXES = (".ply", ".stl", ".obj")
SEEN_RGB, UNSEEN_RGB = (252, 189, 120), (150, 155, 160)
Mesh = tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]


def read_mesh(path: Path) -> Mesh:
    """Vertices (mm) and faces of a mesh file, chosen by its suffix; STL's separate corners are merged.

    Raises ReconFailure (unreadable-mesh) that names the file and what is wrong in it.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise _unreadable(path, f"has the suffix {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, f"cannot be opened ({error.strerror})", "a file that can be read") from error
    if kind == ".ply" and not (data.startswith(b"ply") and b"end_header" in data):
        raise _unreadable(path, "is broken (no PLY header)", "a whole PLY file")
    try:
        mesh = trimesh.load_mesh(
            io.BytesIO(data), file_type=kind[1:], process=False, merge_tex=False, maintain_order=True
        )
        if kind == ".stl":
            mesh.merge_vertices()
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, int)
    except Exception as error:  # a broken file meets trimesh's parsers in a dozen ways
        raise _unreadable(path, f"is broken ({error})", f"a whole {kind[1:].upper()} file") from error
    if len(vertices) == 0 or len(faces) == 0:
        raise _unreadable(path, f"holds {len(vertices)} vertices and {len(faces)} faces", "a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _unreadable(
            path, f"has a face that names vertex {faces.max()} of {len(vertices)}", "faces of its vertices"
        )
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "holds a coordinate that is no number", "finite coordinates in mm")
    return vertices, faces


def mesh_bytes(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    views: Int[np.ndarray, " n"] | None = None,
) -> bytes:
    """A binary PLY (coordinates to a millionth of their size); the same mesh gives the same bytes.

    With `views`, the number of photos that show each vertex, the vertices carry it (views, ushort) and a
    colour (red, green, blue, alpha): orange where they were seen, grey where they were not.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if views is not None:
        mesh.visual.vertex_colors = np.where((views >= SEEN_BY)[:, None], SEEN_RGB, UNSEEN_RGB).astype(
            np.uint8
        )
        mesh.vertex_attributes["views"] = views.astype(np.uint16)
    return bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=False))


def write_mesh(path: Path, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> None:
    """The bytes of `mesh_bytes` as a file."""
    path.write_bytes(mesh_bytes(vertices, faces))


def _unreadable(path: Path, found: str, expected: str) -> ReconFailure:
    return ReconFailure(ReconProblem.UNREADABLE_MESH, f"{path} {found}; expected {expected}.")
