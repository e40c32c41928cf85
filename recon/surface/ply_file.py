"""Reads vertices and faces of a PLY file, text or binary. Faces may have any number of corners; other columns
are skipped.

Format: G. Turk, The PLY Polygon File Format, 1994. A header lists the elements in the order of their rows,
and the columns of each row. A list begins with the number of its items.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from recon.triangle_mesh import Mesh

TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H",
    "uint16": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I", "long": "q", "int64": "q",
    "ulong": "Q", "uint64": "Q", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
"""Names of types in headers, and their codes in struct and NumPy."""
ENDIAN = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
MOST_HEADER_BYTES = 65536
"""Longest header; one with 20 properties and comments has 1 kB. Set by hand."""
CORNERS = ("vertex_indices", "vertex_index")


class NotPly(Exception):
    """The fault of a file, as the end of a sentence: "is broken (...)"."""


@dataclass(frozen=True)
class PlyProperty:
    """One property; `counted`: the type of a list's length, empty for a single number."""

    name: str
    type: str
    counted: str = ""


@dataclass(frozen=True)
class Element:
    """Name, number of rows, and columns of one element of the header."""

    name: str
    count: int
    columns: tuple[PlyProperty, ...]

    @property
    def least_bytes(self) -> int:
        """Least size of the rows, with empty lists."""
        return self.count * max(sum(struct.calcsize(f"<{c.counted or c.type}") for c in self.columns), 1)


@dataclass(frozen=True)
class PlyHeader:
    """The elements, NumPy's sign of the byte order (empty: text), and the offset of the rows."""

    elements: tuple[Element, ...]
    endian: str
    length: int

    def count(self, name: str) -> int:
        """Number of rows of this element; 0 if it is missing."""
        return sum(element.count for element in self.elements if element.name == name)


def read_header(data: bytes) -> PlyHeader:
    """The header of a PLY file; raises NotPly if it is broken, or if the file is too short for its counts."""
    end = data.find(b"end_header", 0, MOST_HEADER_BYTES)
    if not data.startswith(b"ply") or end < 0:
        raise NotPly("is broken (no PLY header)")
    length = data.find(b"\n", end) + 1 or len(data)
    if data[end + 10 : end + 11] == b"\r" and data[end + 11 : end + 12] != b"\n":
        length = end + 11  # line ends of old Macs
    elements: list[Element] = []
    endian = None
    for line in data[:end].splitlines():
        words = line.split()
        if words[:1] == [b"format"] and len(words) > 1:
            endian = ENDIAN.get(words[1])
        elif words[:1] == [b"element"]:
            whole = len(words) == 3 and words[2].isdigit() and len(words[2]) < 16
            if not whole:
                raise NotPly("is broken (an element without a count)")
            elements.append(Element(words[1][:20].decode("ascii", "replace"), int(words[2]), ()))
        elif words[:1] == [b"property"]:
            column = _property([word.decode("ascii", "replace") for word in words])
            if column is None or not elements:
                raise NotPly("is broken (a property of an unknown type)")
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, (*last.columns, column))
    if endian is None:
        raise NotPly("is broken (no known format in its header)")
    if sum(element.least_bytes if endian else element.count for element in elements) > len(data) - end:
        raise NotPly("was cut short (its header promises more)")
    return PlyHeader(tuple(elements), endian, length)


def _property(words: list[str]) -> PlyProperty | None:
    """The property in a header's line; None for a line without a known type."""
    if len(words) == 3 and words[1] in TYPES:
        return PlyProperty(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in TYPES and words[3] in TYPES:
        return PlyProperty(words[4], TYPES[words[3]], TYPES[words[2]])
    return None


def read_ply(data: bytes, header: PlyHeader) -> Mesh:
    """Vertices in the file's unit, and triangles; polygons are cut into fans around their first corner.

    Raises NotPly if the rows do not match the header.
    """
    try:
        rows = _rows(data, header)
        vertices = np.column_stack([rows["vertex"][axis] for axis in "xyz"]).astype(float)
        face = rows["face"]
        polygons = next(face[name] for name in CORNERS if name in face)
        with np.errstate(all="ignore"):  # the caller checks the numbers of vertices
            return vertices, _fans(polygons)
    except (KeyError, StopIteration, ValueError, IndexError, TypeError, OverflowError, struct.error) as cause:
        raise NotPly("is broken (what follows its header is not what that says)") from cause


Values = Sequence[np.ndarray] | np.ndarray
Rows = dict[str, Mapping[str, Values]]
"""Values by element and column: a number a row, or for a list an array a row (a table for even lists)."""


def _fans(polygons: Values) -> Int[np.ndarray, "m 3"]:
    """Triangles (corner 0, k, k + 1) of each polygon; raises ValueError for fewer than 3 corners."""
    if isinstance(polygons, np.ndarray):
        groups = [polygons.astype(np.int64)]
    else:
        sizes = np.array([len(polygon) for polygon in polygons])
        groups = [
            np.array([polygons[k] for k in np.flatnonzero(sizes == size).tolist()], np.int64)
            for size in np.unique(sizes)
        ]
    if any(group.shape[1] < 3 for group in groups):
        raise ValueError("a face of fewer than three corners")
    return np.concatenate([group[:, [0, k, k + 1]] for group in groups for k in range(1, group.shape[1] - 1)])


def _rows(data: bytes, header: PlyHeader) -> Rows:
    """Values of all rows; raises ValueError or struct.error if they do not match the header."""
    if not header.endian:
        numbers = np.array(data[header.length :].split(), "<f8").tobytes()
        as_numbers = [replace(e, columns=tuple(map(_as_number, e.columns))) for e in header.elements]
        data, header = numbers, PlyHeader(tuple(as_numbers), "<", 0)
    rows: Rows = {}
    at = header.length
    for element in header.elements:
        if element.count == 0:
            continue
        table = _even_rows(data, at, element, header.endian)
        if table is None:
            rows[element.name], at = _uneven_rows(data, at, element, header.endian)
            continue
        rows[element.name] = {column.name: table[f"v{k}"] for k, column in enumerate(element.columns)}
        at += table.nbytes
    if data[at:].strip():
        raise ValueError("more or fewer bytes than the header says")
    return rows


def _as_number(column: PlyProperty) -> PlyProperty:
    """The property as text has it: all numbers, also the lengths of lists, as doubles."""
    return replace(column, type="d", counted=column.counted and "d")


def _even_rows(data: bytes, at: int, element: Element, endian: str) -> np.ndarray | None:
    """The rows as a table of columns v0, v1, ...; None if a list is not as long as the first row's.

    Raises ValueError if rows without lists do not fit.
    """
    start = at
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    lengths: dict[str, int] = {}
    for k, column in enumerate(element.columns):
        kind = endian + column.type
        if not column.counted:
            fields.append((f"v{k}", kind))
            at += struct.calcsize(f"<{column.type}")
            continue
        size = int(struct.unpack_from(endian + column.counted, data, at)[0])
        lengths[f"n{k}"] = size
        fields += [(f"n{k}", endian + column.counted), (f"v{k}", kind, (size,))]
        at += struct.calcsize(f"<{column.counted}") + size * struct.calcsize(f"<{column.type}")
    row = np.dtype(fields)
    if lengths and row.itemsize * element.count > len(data) - start:
        return None
    table = np.frombuffer(data, row, element.count, start)
    return table if all((table[name] == size).all() for name, size in lengths.items()) else None


def _uneven_rows(
    data: bytes, at: int, element: Element, endian: str
) -> tuple[dict[str, list[np.ndarray]], int]:
    """The rows' lists, read one by one, and where they end; other columns are not needed."""
    lists: dict[str, list[np.ndarray]] = {c.name: [] for c in element.columns if c.counted}
    kinds = [np.dtype(endian + column.type) for column in element.columns]
    for _ in range(element.count):
        for column, kind in zip(element.columns, kinds, strict=True):
            size = 1
            if column.counted:
                size = int(struct.unpack_from(endian + column.counted, data, at)[0])
                at += struct.calcsize(f"<{column.counted}")
                if size < 0:
                    raise ValueError("a list of negative length")
                lists[column.name].append(np.frombuffer(data, kind, size, at))
            at += size * kind.itemsize
    return lists, at
