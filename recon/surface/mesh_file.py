"""Reads and writes triangle meshes in mm: PLY, and by trimesh STL, OBJ and GLB."""

import io
import logging
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Int

from pipeline.files.plain_file import NotReadable, json_of, printable, read_bytes
from recon.recon_failure import ReconFailure, ReconProblem
from recon.surface.ply_file import NotPly, read_header, read_ply
from recon.surface.ray_mesh import SEEN_BY, consistently_oriented
from recon.triangle_mesh import (
    Faces,
    Mesh,
    Vertices,
    open_edges,
    used_part,
    volume_mm3,
)

logging.getLogger("trimesh").addHandler(logging.NullHandler())
# Without any handler Python would print trimesh's warnings, with tracebacks, on standard error.
SUFFIXES = (".ply", ".stl", ".obj", ".glb")
MM_IN_A_METRE = 1000.0
"""By definition; lengths in glTF are in metres."""
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""glTF 2.0 has metres and +Y up (3.4): (x, y, z) there is (x, -z, y) here."""
SEEN_RGB, UNSEEN_RGB = (252, 189, 120), (150, 155, 160)
"""Colours of 255: orange where photos show the skin, grey elsewhere."""
MOST_BYTES, MOST_ELEMENTS = 100_000_000, 300_000
"""Largest file; most vertices and faces, each, for the 1000 MiB of one fruit (pipeline.run.memory). 300,000
faces peak at 950 MiB in `drupe grade`, 1.3 million took 1.9 GB. 8000 are enough."""
MOST_ASCII_BYTES = 30_000_000
"""Largest text file: numbers as text take thirty times their length while they are read."""
FARTHEST_MM = 1e6
"""Largest coordinate: no fruit lies beyond a kilometre, and squares of larger ones overflow."""


def read_mesh(path: Path) -> Mesh:
    """Vertices (mm) and triangles of a mesh file, read by its suffix.

    Faces of more corners are cut into triangles. If the surface is not closed, coincident corners are merged
    and faces oriented consistently. Unused vertices are removed. glTF (metres, y up) becomes mm with z up.
    Raises ReconFailure (unreadable-mesh) that names the file and its fault.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise _unreadable(path, f"has the suffix {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise _unreadable(path, str(error), "a file that can be read") from error
    if _as_text(kind, data) and len(data) > MOST_ASCII_BYTES:
        raise _unreadable(path, f"is text of {len(data) / 1e6:.0f} MB", "a binary PLY, or fewer faces")
    vertices, faces = _of_ply(path, data) if kind == ".ply" else _by_trimesh(path, kind, data)
    if max(len(vertices), len(faces)) > MOST_ELEMENTS:
        raise _too_fine(path, f"{len(vertices)} vertices and {len(faces)} faces")
    if len(vertices) and not len(faces):
        raise _points_alone(path, len(vertices))
    if len(vertices) == 0:
        raise _unreadable(path, "holds 0 vertices and 0 faces", "a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _unreadable(
            path, f"has a face that names vertex {faces.max()} of {len(vertices)}", "faces of its vertices"
        )
    vertices, faces = used_part(vertices, faces)
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "holds a coordinate that is no number", "finite coordinates in mm")
    vertices = MM_IN_A_METRE * vertices @ Z_UP.T if kind == ".glb" else vertices
    if (farthest := float(np.abs(vertices).max())) > FARTHEST_MM:
        raise _unreadable(path, f"holds a coordinate of {farthest:.3g} mm", "a fruit's, in mm")
    return _joined(vertices, faces)


def _of_ply(path: Path, data: bytes) -> Mesh:
    """The mesh of a PLY file; its header is checked before memory is allocated."""
    try:
        header = read_header(data)
        for element in header.elements:
            if element.count > MOST_ELEMENTS:
                raise _too_fine(path, f"{element.count} of {element.name}")
        if header.count("vertex") and not header.count("face"):
            if header.count("tristrips"):
                raise _unreadable(path, "holds strips of triangles", "faces: export it with triangles")
            raise _points_alone(path, header.count("vertex"))
        return read_ply(data, header)
    except NotPly as wrong:
        raise _unreadable(path, str(wrong), "a whole PLY file") from wrong


def _by_trimesh(path: Path, kind: str, data: bytes) -> Mesh:
    """The mesh by trimesh, without textures and materials, which may be other files."""
    if kind == ".stl":
        _require_stl(path, data)
    elif kind == ".glb":
        _require_glb(path, data)
    options = {"merge_tex": False, "maintain_order": True} if kind == ".obj" else {}
    try:
        mesh = trimesh.load_mesh(
            io.BytesIO(data), file_type=kind[1:], process=False, skip_materials=True, **options
        )
        return np.array(mesh.vertices, float), np.array(mesh.faces, int).reshape(-1, 3)
    except Exception as error:  # trimesh's parsers fail in a dozen ways
        raise _unreadable(path, "is broken", f"a whole {kind[1:].upper()} file") from error


def _joined(vertices: Vertices, faces: Faces) -> Mesh:
    """A closed mesh unchanged; else with coincident corners merged and degenerate faces removed. If that does
    not close it, its faces are oriented consistently and outward, if that does. A closed surface is not
    reoriented: as a fruit, `require_closed` refuses it inside out.
    """
    if not open_edges(faces):
        return vertices, faces
    places, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)  # -0 is 0
    merged = index.reshape(-1)[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (c != a)]
    if len(merged) == 0:
        return vertices, faces
    if open_edges(merged) < open_edges(faces):
        vertices, faces = places, merged
    if not open_edges(faces):
        return vertices, faces
    turned = consistently_oriented(faces)
    if not open_edges(turned):
        faces = turned if volume_mm3(vertices, turned) > 0 else turned[:, ::-1]
    return vertices, faces


def mesh_bytes(vertices: Vertices, faces: Faces, *, views: Int[np.ndarray, " n"] | None = None) -> bytes:
    """A binary PLY (coordinates to a millionth of their size); the same mesh gives the same bytes.

    `views`: number of photos that show each vertex. It becomes a property of the vertices (views, ushort),
    with a colour (red, green, blue, alpha): orange from SEEN_BY photos on, else grey.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if views is not None:
        mesh.visual.vertex_colors = np.where((views >= SEEN_BY)[:, None], SEEN_RGB, UNSEEN_RGB).astype(
            np.uint8
        )
        mesh.vertex_attributes["views"] = views.astype(np.uint16)
    return bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=False))


def write_mesh(path: Path, vertices: Vertices, faces: Faces) -> None:
    """Write `mesh_bytes` to a file."""
    path.write_bytes(mesh_bytes(vertices, faces))


def _require_stl(path: Path, data: bytes) -> None:
    """Refuse a binary STL with fewer faces than its header states (84 bytes, then 50 a face), or too many."""
    if data[:5].lower() == b"solid" or len(data) < 84:
        return
    count = int.from_bytes(data[80:84], "little")
    if 84 + 50 * count > len(data):
        raise _unreadable(path, f"was cut short (its header promises {count} faces)", "a whole STL file")
    if count > MOST_ELEMENTS:
        raise _too_fine(path, f"{count} faces")


def _require_glb(path: Path, data: bytes) -> None:
    """Refuse a binary glTF that is cut short, compressed, drupe's own picture (in mm, z up), or too large. It
    is checked before memory is allocated (glTF 2.0, 4.4: a header of 12 bytes, then a chunk of JSON with its
    length and kind).
    """
    whole = "a whole GLB file (binary glTF 2.0)"
    if data[:4] != b"glTF" or data[16:20] != b"JSON" or int.from_bytes(data[8:12], "little") > len(data):
        raise _unreadable(path, "is broken or was cut short", whole)
    try:
        said = json_of(data[20 : 20 + int.from_bytes(data[12:16], "little")].decode("utf-8", "replace"))
        compressed = [
            extension for extension in said.get("extensionsRequired", []) if "compression" in extension
        ]
        counts = [int(accessor["count"]) for accessor in said.get("accessors", [])]
        placed = sum("mesh" in node for node in said.get("nodes", []))
        generator = said.get("asset", {}).get("generator")
    except (NotReadable, KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(path, "is broken (its description cannot be read)", whole) from error
    if generator == "drupe":
        raise _unreadable(
            path, "is a picture of drupe's results, coarse and in mm", "the fruit.ply beside it"
        )
    if compressed:
        raise _unreadable(path, f"is compressed ({compressed[0][:40]})", "GLB exported without compression")
    if max(counts, default=0) * max(placed, 1) > 3 * MOST_ELEMENTS:
        raise _too_fine(path, f"{max(counts)} values in a list, for {placed} meshes")


def _as_text(kind: str, data: bytes) -> bool:
    return kind == ".obj" or (
        b"format ascii" in data[:200] if kind == ".ply" else kind == ".stl" and data[:5].lower() == b"solid"
    )


def _points_alone(path: Path, count: int) -> ReconFailure:
    expected = "a surface: mesh the points first (for example Poisson in MeshLab), and save that mesh"
    return _unreadable(path, f"is a cloud of {count} points without faces", expected)


def _too_fine(path: Path, content: str) -> ReconFailure:
    expected = f"at most {MOST_ELEMENTS} each: decimate it, for example to 200,000 faces"
    return _unreadable(path, f"holds {content}", expected)


def _unreadable(path: Path, fault: str, expected: str) -> ReconFailure:
    said = f"The mesh {printable(str(path))} {fault}; expected {expected}."
    return ReconProblem.UNREADABLE_MESH.failure(said)
