"""Files of other people that are valid, or whose fault has a cause of its own: each case states the numbers
or the message. Names in other cases, meshes of other programs, recordings of other writers, stray files.
"""

from collections.abc import Iterator
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


def _opened(path: Path, _: np.random.Generator) -> None:
    vertices, faces = read_mesh(path)
    put(path, mesh_bytes(vertices, faces[1:]))


def _meshes() -> Iterator[Row]:
    """Formats and faults beside those of tests/recon/test_mesh_file.py."""
    yield "GLB in metres", MESH_FILE, _exported(".glb", 1e-3), SAME
    yield "OBJ", MESH_FILE, _exported(".obj"), SAME
    yield "STL in metres", MESH_FILE, _exported(".stl", 1e-3), r"fruit\.stl: .* in m "
    yield "open by one face", MESH_FILE, _opened, r"not watertight: 3 edges"


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
    yield "left open by its writer", RECORDING, _left_open, r"its writer has not closed.*h5clear -s"
    said = r"found no HDF5 file \(it begins with b'%PDF-1\.7"
    yield "another kind of file", RECORDING, with_bytes(lambda _: b"%PDF-1.7 and more"), said


# --- Git LFS


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


def others_files() -> Iterator[Row]:
    """Every case."""
    yield from _named()
    yield from _meshes()
    yield from _recordings()
    yield from _pointers()
