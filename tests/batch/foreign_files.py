"""Files of other people that are valid, or whose fault has a cause of its own: each case states the numbers
or the message. Names in other cases, meshes of other programs, recordings of other writers, stray files.
"""

import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import trimesh
from file_damage import Change, put, with_bytes, with_hdf5

from recon.surface.mesh_file import mesh_bytes, read_mesh

Row = tuple[str, str, Change, str]
"""Kind, the file's path, the change, and what is expected."""
A, B = "batch/fruits/A", "batch/fruits/B"
MESH_FILE, RECORDING, TABLE = f"{A}/fruit.ply", f"{A}/grasps/grasp-1.h5", "batch/fruits.csv"
SAME = "same"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"4" * 64 + b"\nsize 12345\n"


def _moved(to: str) -> Change:
    """The file under another name in its folder."""

    def change(path: Path, _: np.random.Generator) -> None:
        path.rename(path.with_name(to))

    return change


def _added(*names: str, data: bytes = b"x") -> Change:
    """Further files, by their places in the batch's folder; the case's own file stays as it is."""

    def change(path: Path, _: np.random.Generator) -> None:
        batch = next(place for place in path.parents if place.name == "batch")
        for name in names:
            (batch / name).parent.mkdir(parents=True, exist_ok=True)
            (batch / name).write_bytes(data)

    return change


def _copied(to: str) -> Change:
    """The file a second time, by its name in the same folder."""

    def change(path: Path, _: np.random.Generator) -> None:
        path.with_name(to).write_bytes(path.read_bytes())

    return change


def _named() -> Iterator[Row]:
    """Names in other cases, second candidates for one role, and files that nothing reads."""
    yield "FRUIT.PLY", MESH_FILE, _moved("FRUIT.PLY"), SAME
    yield "recording .H5", RECORDING, _moved("grasp-1.H5"), SAME
    yield "recording .hdf5", RECORDING, _moved("grasp-1.hdf5"), SAME
    yield "recording .mat", RECORDING, _moved("GRASP-1.MAT"), SAME
    yield "Grasps/", f"{A}/grasps", _moved("Grasps"), SAME
    yield "Batch.toml", "batch/batch.toml", _moved("Batch.TOML"), SAME
    yield "recording .hdf5 beside .h5", RECORDING, _copied("grasp-1.hdf5"), r"same displacements and forces"
    said = r"a\.mat: the file: found a MATLAB file of a version before 7\.3.*h5create"
    yield "old .mat", RECORDING, _added("fruits/A/grasps/a.mat", data=b"MATLAB 5.0 MAT-file"), said
    said = r"fruit\.stl is not used: drupe reads one mesh named fruit"
    yield "two meshes", MESH_FILE, _copied("fruit.stl"), said
    said = r"scan\.obj is not used: .* one mesh named fruit"
    yield "mesh of another name", MESH_FILE, _copied("scan.obj"), said
    yield "mesh of another kind", MESH_FILE, _copied("scan.3mf"), r"scan\.3mf is not used: meshes are read as"
    said = r"grasp-2\.h5 is not used: .*grasps/; move it there"
    yield "recording in the fruit's folder", MESH_FILE, _copied("grasp-2.h5"), said
    said = r"press\.csv is not used: .*`drupe convert`"
    yield "table in grasps/", RECORDING, _added("fruits/A/grasps/press.csv"), said
    yield (
        "photos beside photos/",
        f"{B}/photos/000.jpg",
        _added(*(f"fruits/B/{k}.jpg" for k in range(5))),
        (r"0\.jpg, 1\.jpg, 2\.jpg and 2 more are not used: drupe reads photos in"),
    )
    said = r"Recordings is not used: a fruit's folders are photos/"
    yield "folder of another name", RECORDING, _added("fruits/A/Recordings/grasp-2.h5"), said
    yield "mesh in fruits/", MESH_FILE, _added("fruits/C.ply"), r"C\.ply is not used: .*fruits/<fruit_id>/"
    said = r"_C is not used: a fruit_id"
    yield "folder that is no fruit_id", MESH_FILE, _added("fruits/_C/fruit.ply"), said
    yield "recording in the batch's folder", RECORDING, _added("grasp-9.h5"), r"grasp-9\.h5 is not used"
    yield "files that computers make", RECORDING, _added(
        ".DS_Store", "README.md", "results/old.csv", "fruits/@eaDir/a.jpg", "fruits/__MACOSX/a.ply",
        "fruits/A/Thumbs.db", "fruits/A/notes.txt", "fruits/A/grasps/._grasp-1.h5",
        "fruits/A/grasps/@eaDir/a.h5",
        "fruits/System Volume Information/a.jpg",
    ), SAME  # fmt: skip
    said = r"grasp-5: found an empty folder"
    yield "empty folder of a grasp", f"{A}/grasps", lambda path, _: (path / "grasp-5").mkdir(), said
    said = r"day: found no grasp\.toml, but g\.h5"
    yield "folder of recordings in grasps/", RECORDING, _added("fruits/A/grasps/day/g.h5"), said


# --- meshes


def _exported(kind: str, per_mm: float = 1.0) -> Change:
    """The same surface in another format, in place of the PLY."""

    def change(path: Path, _: np.random.Generator) -> None:
        vertices, faces = read_mesh(path)
        path.unlink()
        if kind == ".glb":  # +Y up, by its standard
            vertices = vertices[:, [0, 2, 1]] * [1, 1, -1]
        trimesh.Trimesh(vertices * per_mm, faces, process=False).export(path.with_suffix(kind))

    return change


def _rewritten(write: Callable[[np.ndarray, np.ndarray], bytes]) -> Change:
    def change(path: Path, _: np.random.Generator) -> None:
        put(path, write(*read_mesh(path)))

    return change


def _ply(
    vertices: np.ndarray, faces: list[list[int]], *, more: str = "", row: bytes = b"", endian: str = "<"
) -> bytes:
    """A binary PLY with faces of any number of corners; `row` follows each face's corners."""
    kind = "binary_little_endian" if endian == "<" else "binary_big_endian"
    head = f"ply\nformat {kind} 1.0\ncomment TextureFile skin.png\nelement vertex {len(vertices)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{more}end_header\n"
    body = b"".join(struct.pack(f"{endian}B{len(f)}i", len(f), *f) + row for f in faces)
    return head.encode() + vertices.astype(f"{endian}f8").tobytes() + body


def _text_ply(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_index\nend_header\n"
    rows = [" ".join(f"{x:.9g}" for x in row) for row in vertices]
    rows += [" ".join(map(str, (len(face), *face))) for face in faces]
    return (head + "\n".join(rows) + "\n").encode()


def _quads(faces: np.ndarray) -> list[list[int]]:
    """The same surface with pairs of triangles (a, b, c) and (a, c, d) as quadrilaterals (a, b, c, d)."""
    left = {tuple(face): None for face in faces.tolist()}
    neighbour = {(face[k], face[(k + 1) % 3]): face for face in left for k in range(3)}
    polygons: list[list[int]] = []
    for face in list(left):
        for k in range(3) if face in left else ():
            a, b, c = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            other = neighbour[a, c]
            if other in left and other != face:
                (d,) = set(other) - {a, c}
                polygons.append([a, b, c, d])
                del left[face], left[other]
                break
    return polygons + [list(face) for face in left]


def _every_third_turned(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    turned = faces.copy()
    turned[::3] = turned[::3, ::-1]
    return mesh_bytes(vertices, turned)


def _points(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    return mesh_bytes(vertices, faces).replace(b"element face %d" % len(faces), b"element face 0")[
        : -13 * len(faces)
    ]


def _meshes() -> Iterator[Row]:
    """The sound mesh (642 vertices) as other programs write it, and what is no closed surface in mm."""
    corners = b"\x06" + struct.pack("<6f", 0, 0, 1, 0, 0, 1)
    yield "GLB in metres", MESH_FILE, _exported(".glb", 1e-3), SAME
    yield "STL", MESH_FILE, _exported(".stl"), SAME
    yield "OBJ", MESH_FILE, _exported(".obj"), SAME
    yield "triangles and quadrilaterals", MESH_FILE, _rewritten(lambda v, f: _ply(v, _quads(f))), SAME
    yield "triangles and quadrilaterals, big endian", MESH_FILE, _rewritten(
        lambda v, f: _ply(v, _quads(f), endian=">")
    ), SAME  # fmt: skip
    yield "text with quadrilaterals", MESH_FILE, _rewritten(lambda v, f: _text_ply(v, _quads(f))), SAME
    yield "mixed winding", MESH_FILE, _rewritten(_every_third_turned), SAME
    yield "three vertices for each face", MESH_FILE, _rewritten(
        lambda v, f: _ply(v[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3).tolist())
    ), SAME  # fmt: skip
    yield "texture coordinates", MESH_FILE, _rewritten(
        lambda v, f: _ply(v, f.tolist(), more="property list uchar float texcoord\n", row=corners)
    ), SAME  # fmt: skip
    said = r"fruit\.ply is a cloud of 642 points without faces; expected a surface: mesh the points first"
    yield "points without faces", MESH_FILE, _rewritten(_points), said
    yield "STL in metres", MESH_FILE, _exported(".stl", 1e-3), r"fruit\.stl: .* in m "
    yield "compressed GLB", MESH_FILE, _compressed, r"fruit\.glb is compressed \(KHR_draco_mesh_compression\)"
    said = r"not watertight: 3 edges"
    yield "open by one face", MESH_FILE, _rewritten(lambda v, f: mesh_bytes(v, f[1:])), said
    said = r"The mesh is 53\.8 mm high, but fruits\.csv says height_mm 55\.9 \(3\.\d % difference\)"
    yield "4 % smaller than the height", MESH_FILE, _rewritten(lambda v, f: mesh_bytes(0.96 * v, f)), said


def _compressed(path: Path, _: np.random.Generator) -> None:
    said = b'{"asset":{"version":"2.0"},"extensionsRequired":["KHR_draco_mesh_compression"]}'
    said += b" " * (-len(said) % 4)
    path.unlink()
    path.with_suffix(".glb").write_bytes(
        b"glTF" + struct.pack("<III", 2, 20 + len(said), len(said)) + b"JSON" + said
    )


# --- recordings


def _reversed(file: h5py.File, names: tuple[str, ...] = ()) -> None:
    """The datasets as MATLAB writes them: dimensions reversed, vectors as one row."""
    datasets: list[str] = []
    file.visititems(lambda name, node: datasets.append(name) if isinstance(node, h5py.Dataset) else None)
    for name in names or datasets:
        values = file[name][()]
        del file[name]
        file[name] = values.T if values.ndim > 1 else values[None]


def _epoch_in_32_bits(file: h5py.File) -> None:
    values = file["time_s"][()]
    del file["time_s"]
    file["time_s"] = (values + 1.79e9).astype(np.float32)


def _packed(number: int) -> Callable[[h5py.File], None]:
    """Forces packed by a filter that the library has no code for."""

    def change(file: h5py.File) -> None:
        name = "pads/left/force_N"
        values = file[name][()].astype(np.float32)
        del file[name]
        steps = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        steps.set_chunk(values.shape)
        steps.set_filter(number, h5py.h5z.FLAG_OPTIONAL, (3,))
        space = h5py.h5s.create_simple(values.shape)
        data = h5py.h5d.create(file.id, name.encode(), h5py.h5t.NATIVE_FLOAT, space, steps)
        data.write_direct_chunk((0,) * values.ndim, values.tobytes(), 0)

    return change


def _left_open(path: Path, _: np.random.Generator) -> None:
    """A copy of the file while its writer, which uses the latest format, has it open."""
    draft = path.with_name("draft")
    with h5py.File(draft, "w", libver="latest") as writer, h5py.File(path, "r") as source:
        writer.attrs.update(source.attrs)
        for name in source:
            source.copy(name, writer)
        writer.flush()
        put(path, draft.read_bytes())
    draft.unlink()


def _recordings() -> Iterator[Row]:
    yield "MATLAB's vectors", RECORDING, with_hdf5(partial(_reversed, names=("time_s", "aperture_mm"))), SAME
    for name, shape in (
        ("displacement_mm", r"\(3, 25, 20\)"),
        ("rest_mm", r"\(3, 25\)"),
        ("pose", r"\(4, 4, 20\)"),
    ):
        field = f"pads/left/{name}"
        said = rf"{field}: found shape {shape}, expected shape .*reversed, as MATLAB writes them"
        yield f"{name} reversed alone", RECORDING, with_hdf5(partial(_reversed, names=(field,))), said
    said = r"time_s: found .* s in frame \d+ after .*write float64"
    yield "epoch seconds in 32 bits", RECORDING, with_hdf5(_epoch_in_32_bits), said
    for number in (32015, 32001, 307, 500):
        said = rf"force_N: found values packed by the HDF5 filter {number}, which is not installed"
        yield f"filter {number}", RECORDING, with_hdf5(_packed(number)), said
    yield "left open by its writer", RECORDING, _left_open, r"its writer has not closed.*h5clear -s"
    said = r"found no HDF5 file \(it begins with b'%PDF-1\.7"
    yield "another kind of file", RECORDING, with_bytes(lambda _: b"%PDF-1.7 and more"), said


# --- Git LFS, and tables


def _pointers() -> Iterator[Row]:
    raw = f"{B}/grasps/raw"
    for path in (
        MESH_FILE, RECORDING, TABLE, "batch/batch.toml", "batch/mat.json", "batch/mine.toml",
        "batch/model.onnx",
        f"{B}/photos/000.jpg", f"{raw}/grasp.toml", f"{raw}/log.csv", f"{raw}/sensor.toml",
        f"{raw}/left/reference.png",
    ):  # fmt: skip
        said = rf"{path.rpartition('/')[2].replace('.', '[.]')}.* is a Git LFS pointer, .*git lfs pull"
        yield f"pointer: {path.rpartition('/')[2]}", path, with_bytes(lambda _: POINTER), said


def _table(make: Callable[[list[str]], str]) -> Change:
    """The table made again from its lines."""
    return with_bytes(lambda data: make(data.decode().splitlines()).encode())


def _semicolons(lines: list[str]) -> str:
    return "".join(line.replace(",", ";").replace(".", ",") + "\r\n" for line in lines)


def _tables() -> Iterator[Row]:
    yield (
        "empty columns and rows at the end",
        TABLE,
        _table(lambda lines: "".join(f"{line},,,\n" for line in lines) + ",,,,,,,,\n" * 3),
        SAME,
    )
    yield "empty rows in the middle", TABLE, _table(lambda ls: "\n,,,,,\n".join(ls) + "\n"), SAME
    yield "sep=; of Excel", TABLE, _table(lambda lines: "sep=;\r\n" + _semicolons(lines)), SAME
    yield "sep=, of Excel", TABLE, _table(lambda lines: "sep=,\r\n" + "\r\n".join(lines)), SAME
    yield (
        "a cell below no name",
        TABLE,
        _table(lambda ls: "\n".join([f"{ls[0]},", *(f"{r},7" for r in ls[1:])])),
        (r"fruits\.csv: line 2 has more cells than the header"),
    )


def others_files() -> Iterator[Row]:
    """Every case."""
    yield from _named()
    yield from _meshes()
    yield from _recordings()
    yield from _pointers()
    yield from _tables()
