"""Reads and writes triangle meshes in mm: PLY, STL and OBJ, by trimesh."""

import io
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from recon.plain_file import NotReadable, printable, read_bytes
from recon.recon_failure import ReconFailure, ReconProblem
from recon.surface.coverage import SEEN_BY

SUFFIXES = (".ply", ".stl", ".obj")
SEEN_RGB, UNSEEN_RGB = (252, 189, 120), (150, 155, 160)
"""Of 255: orange where photos show the skin, grey elsewhere."""
MOST_BYTES, MOST_ELEMENTS = 100_000_000, 300_000
"""Vertices and faces, each: what `drupe check` and `drupe grade` carry within the 1000 MiB of one fruit
(pipeline.run.memory). A nectarine's ready mesh, resampled: 300,000 faces peak at 660 MiB in check (7.6 s of
processor time) and at 950 MiB in grade, 400,000 at 780 and 970 MiB, with a pit.ply as fine at 1000 MiB in
check (`/usr/bin/time -f "%U %S %M" drupe check BATCH`); 1.3 million took 1.9 GB. 8000 are enough."""
MOST_ASCII_BYTES = 30_000_000
"""Of numbers written as text, which take thirty times their length while they are read."""
FARTHEST_MM = 1e6
"""A coordinate beyond a kilometre is of no fruit, and squares of larger ones overflow."""
Mesh = tuple[Float[np.ndarray, "_n 3"], Int[np.ndarray, "_m 3"]]


def read_mesh(path: Path) -> Mesh:
    """Vertices (mm) and faces of a mesh file, chosen by its suffix; STL's separate corners are merged, and
    vertices that no face uses are left out: they are of no surface.

    Raises ReconFailure (unreadable-mesh) that names the file and what is wrong in it.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise _unreadable(path, f"has the suffix {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise _unreadable(path, str(error), "a file that can be read") from error
    if kind == ".ply":
        _require_header(path, data)
    elif kind == ".stl":
        _require_stl(path, data)
    if _as_text(kind, data) and len(data) > MOST_ASCII_BYTES:
        raise _unreadable(path, f"is text of {len(data) / 1e6:.0f} MB", "a binary PLY, or fewer faces")
    try:
        mesh = trimesh.load_mesh(
            io.BytesIO(data), file_type=kind[1:], process=False, merge_tex=False, maintain_order=True
        )
        if kind == ".stl":
            mesh.merge_vertices()
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, int)
    except Exception as error:  # a broken file meets trimesh's parsers in a dozen ways
        found = "is broken (what follows its header is not what that says)" if kind == ".ply" else "is broken"
        raise _unreadable(path, found, f"a whole {kind[1:].upper()} file") from error
    if max(len(vertices), len(faces)) > MOST_ELEMENTS:
        raise _too_fine(path, f"{len(vertices)} vertices and {len(faces)} faces")
    if len(vertices) == 0 or len(faces) == 0:
        raise _unreadable(path, f"holds {len(vertices)} vertices and {len(faces)} faces", "a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _unreadable(
            path, f"has a face that names vertex {faces.max()} of {len(vertices)}", "faces of its vertices"
        )
    vertices, faces = _used(vertices, faces)
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "holds a coordinate that is no number", "finite coordinates in mm")
    if (farthest := float(np.abs(vertices).max())) > FARTHEST_MM:
        raise _unreadable(path, f"holds a coordinate of {farthest:.3g} mm", "a fruit's, in mm")
    return vertices, faces


def _used(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Mesh:
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    return (vertices, faces) if used.all() else (vertices[used], (np.cumsum(used) - 1)[faces])


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


def _require_header(path: Path, data: bytes) -> None:
    """Refuse a PLY whose header promises more than the file can hold, before memory is asked for it."""
    end = data.find(b"end_header", 0, 65536)
    if not data.startswith(b"ply") or end < 0:
        raise _unreadable(path, "is broken (no PLY header)", "a whole PLY file")
    for line in data[:end].splitlines():
        words = line.split()
        if words[:1] == [b"element"]:
            count = words[2] if len(words) == 3 and words[2].isdigit() and len(words[2]) < 16 else b""
            if not count:
                raise _unreadable(path, "is broken (an element without a count)", "a whole PLY file")
            if int(count) > MOST_ELEMENTS:
                raise _too_fine(path, f"{int(count)} of {words[1][:20].decode('ascii', 'replace')}")
            if int(count) > len(data) - end:
                raise _unreadable(path, "was cut short (its header promises more)", "a whole PLY file")


def _require_stl(path: Path, data: bytes) -> None:
    """Refuse a binary STL whose count of faces is not what the file holds: 84 bytes, then 50 a face."""
    if data[:5].lower() == b"solid" or len(data) < 84:
        return
    count = int.from_bytes(data[80:84], "little")
    if 84 + 50 * count > len(data):
        raise _unreadable(path, f"was cut short (its header promises {count} faces)", "a whole STL file")
    if count > MOST_ELEMENTS:
        raise _too_fine(path, f"{count} faces")


def _as_text(kind: str, data: bytes) -> bool:
    return kind == ".obj" or (
        b"format ascii" in data[:200] if kind == ".ply" else data[:5].lower() == b"solid"
    )


def _too_fine(path: Path, found: str) -> ReconFailure:
    expected = f"at most {MOST_ELEMENTS} each: decimate it, for example to 200,000 faces"
    return _unreadable(path, f"holds {found}", expected)


def _unreadable(path: Path, found: str, expected: str) -> ReconFailure:
    said = f"{printable(str(path))} {found}; expected {expected}."
    return ReconFailure(ReconProblem.UNREADABLE_MESH, said)
