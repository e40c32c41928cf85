"""Reads and writes triangle meshes in mm: PLY (text and binary), STL (text and binary), OBJ."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.failure import ReconFailure, ReconProblem

PLY_TYPES = {
    name: kind
    for kind, names in {
        "i1": "char int8", "u1": "uchar uint8", "i2": "short int16", "u2": "ushort uint16",
        "i4": "int int32", "u4": "uint uint32", "f4": "float float32", "f8": "double float64",
    }.items()
    for name in names.split()
}  # fmt: skip
Mesh = tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]


def read_mesh(path: Path) -> Mesh:
    """Vertices (mm) and faces of a mesh file, chosen by its suffix.

    Raises ReconFailure (unreadable-mesh) that names the file and what is wrong in it.
    """
    readers = {".ply": _read_ply, ".stl": _read_stl, ".obj": _read_obj}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise _unreadable(path, f"has the suffix {path.suffix!r}", "one of .ply, .stl, .obj")
    try:
        vertices, faces = reader(path.read_bytes())
    except OSError as error:
        raise _unreadable(path, f"cannot be opened ({error.strerror})", "a file that can be read") from error
    except (ValueError, KeyError, IndexError, TypeError, struct.error) as error:
        raise _unreadable(
            path, f"is broken ({error})", f"a whole {path.suffix.lower()[1:].upper()} file"
        ) from error
    if len(vertices) == 0 or len(faces) == 0:
        raise _unreadable(path, f"holds {len(vertices)} vertices and {len(faces)} faces", "a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _unreadable(
            path, f"has a face that names vertex {faces.max()} of {len(vertices)}", "faces of its vertices"
        )
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "holds a coordinate that is no number", "finite coordinates in mm")
    return vertices, faces


def write_mesh(path: Path, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> None:
    """A binary little-endian PLY (float64 vertices, int32 faces); the same mesh gives the same bytes."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment units mm\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    path.write_bytes(header.encode() + np.ascontiguousarray(vertices, "<f8").tobytes() + rows.tobytes())


def _read_ply(data: bytes) -> Mesh:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header")
    start = data.index(b"\n", end) + 1
    words = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    layout = next(w[1] for w in words if w[:1] == ["format"])
    elements: list[tuple[str, int, list[list[str]]]] = []
    for word in words:
        if word[:1] == ["element"]:
            elements.append((word[1], int(word[2]), []))
        elif word[:1] == ["property"]:
            elements[-1][2].append(word[1:])
    if layout == "ascii":
        return _ply_text(data[start:], elements)
    return _ply_binary(data, start, elements, "<" if layout == "binary_little_endian" else ">")


def _ply_text(data: bytes, elements: list[tuple[str, int, list[list[str]]]]) -> Mesh:
    lines = data.decode("ascii", "replace").split("\n")
    vertices, faces, at = np.empty((0, 3)), np.empty((0, 3), int), 0
    for name, count, properties in elements:
        rows = [line.split() for line in lines[at : at + count]]
        at += count
        if len(rows) < count or (count and not rows[-1]):
            raise ValueError(f"fewer than {count} {name} rows")
        if name == "vertex":
            columns = [[p[-1] for p in properties].index(axis) for axis in "xyz"]
            vertices = np.array([[float(row[c]) for c in columns] for row in rows])
        elif name == "face":
            faces = _fans([[int(i) for i in row[1 : 1 + int(row[0])]] for row in rows])
    return vertices, faces


def _ply_binary(
    data: bytes, start: int, elements: list[tuple[str, int, list[list[str]]]], order: str
) -> Mesh:
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), int)
    for name, count, properties in elements:
        if all(p[0] != "list" for p in properties):
            kind = np.dtype([(p[1], order + PLY_TYPES[p[0]]) for p in properties])
            rows = np.frombuffer(data, kind, count, start)
            start += kind.itemsize * count
            if name == "vertex":
                vertices = np.stack([rows[axis].astype(float) for axis in "xyz"], axis=1)
            continue
        fields: list[tuple] = []
        for p in properties:
            if p[0] == "list":
                fields += [("n_" + p[3], order + PLY_TYPES[p[1]]), (p[3], order + PLY_TYPES[p[2]], 3)]
            else:
                fields.append((p[1], order + PLY_TYPES[p[0]]))
        kind = np.dtype(fields)
        rows = np.frombuffer(data, kind, count, start)
        start += kind.itemsize * count
        if name == "face":
            lists = [p[3] for p in properties if p[0] == "list"]
            index = next(p for p in lists if p in ("vertex_indices", "vertex_index"))
            if any((rows["n_" + p] != 3).any() for p in lists):
                raise ValueError("faces that are no triangles")
            faces = rows[index].astype(int)
    return vertices, faces


def _read_stl(data: bytes) -> Mesh:
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
        corners = np.frombuffer(data, kind, count, 84)["corners"].astype(float).reshape(-1, 3)
    else:
        rows = [line.split() for line in data.decode("ascii", "strict").splitlines()]
        corners = np.array([[float(x) for x in row[1:4]] for row in rows if row[:1] == ["vertex"]]).reshape(
            -1, 3
        )
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    faces = np.asarray(faces).reshape(-1, 3)
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, faces[distinct]


def _read_obj(data: bytes) -> Mesh:
    rows = [line.split() for line in data.decode("utf-8", "replace").splitlines()]
    vertices = np.array([[float(x) for x in row[1:4]] for row in rows if row[:1] == ["v"]]).reshape(-1, 3)
    polygons = [[int(word.split("/")[0]) for word in row[1:]] for row in rows if row[:1] == ["f"]]
    return vertices, _fans([[i - 1 if i > 0 else len(vertices) + i for i in polygon] for polygon in polygons])


def _fans(polygons: list[list[int]]) -> Int[np.ndarray, "m 3"]:
    triangles = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    return np.array(triangles, int).reshape(-1, 3)


def _unreadable(path: Path, found: str, expected: str) -> ReconFailure:
    return ReconFailure(ReconProblem.UNREADABLE_MESH, f"{path} {found}; expected {expected}.")
