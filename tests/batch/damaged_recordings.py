"""Changes of recordings (HDF5) and of arrays (.npy) that leave the file readable and its contents wrong."""

from collections.abc import Callable
from functools import partial

import h5py
import numpy as np
from file_damage import Change, with_array, with_bytes, with_hdf5


def field(name: str, make: Callable[[np.ndarray], object]) -> Change:
    """The field made anew of its values."""

    def change(file: h5py.File) -> None:
        values = file[name][()]
        del file[name]
        file[name] = make(values)

    return with_hdf5(change)


def lies(name: str, how: str) -> Change:
    """Something else in the place of the field: a link, values elsewhere, no numbers."""

    def change(file: h5py.File) -> None:
        shape = file[name].shape
        if how == "moved":
            file.move(name, "elsewhere")
            file[name] = h5py.SoftLink("/elsewhere")
            return
        del file[name]
        if how == "external":
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif how == "raw":
            file.create_dataset(name, shape, "f8", external=[("/dev/zero", 0, 8 * int(np.prod(shape)))])
        elif how == "claimed":
            file.create_dataset(name, (10**9, *shape[1:]), "f4", chunks=True)
        elif how == "chunk":
            most = (None, *shape[1:])
            file.create_dataset(name, shape, "f4", chunks=(3 * 10**7, *shape[1:]), maxshape=most)
        elif how == "virtual":
            layout = h5py.VirtualLayout(shape=shape, dtype="f8")
            layout[...] = h5py.VirtualSource("other.h5", "x", shape=shape)
            file.create_virtual_dataset(name, layout)
        elif how == "group":
            file.create_group(name)
        elif how == "text":
            file.create_dataset(name, data=["x"] * 5, dtype=h5py.string_dtype())
        elif how == "objects":
            file.create_dataset(name, data=[file.ref] * 3, dtype=h5py.ref_dtype)

    return with_hdf5(change)


def with_last(values: np.ndarray, number: float, at: tuple[int, ...] | None = None) -> np.ndarray:
    """The values with this number in their last place, or at `at`."""
    out = np.array(values, np.float64)
    out[at or (-1,) * out.ndim] = number
    return out


def attribute(name: str, value: object, place: str = "/") -> Change:
    """The attribute of a group with this value; None: removed."""

    def change(file: h5py.File) -> None:
        held = file[place].attrs
        if value is None:
            del held[name]
        else:
            held[name] = value

    return with_hdf5(change)


def recordings() -> dict[str, Change]:
    """Every field and attribute of a recording, wrong in every way."""
    fields = (
        "time_s",
        "aperture_mm",
        *(f"pads/left/{n}" for n in ("pose", "rest_mm", "displacement_mm", "force_N")),
    )
    said: dict[str, Change] = {}
    for name in fields:
        for number in (np.nan, np.inf, -np.inf, 1e300, -1e30):
            said[f"{name}: {number:g}"] = field(name, partial(with_last, number=number))
        for factor in (1e3, 1e-3, 1e6, -1.0, 0.0):
            said[f"{name}: times {factor:g}"] = field(name, lambda v, f=factor: v * f)
        said[f"{name}: a frame less"] = field(name, lambda v: v[:-1])
        said[f"{name}: empty"] = field(name, lambda v: v[:0])
        said[f"{name}: backwards"] = field(name, lambda v: v[::-1])
        said[f"{name}: a scalar"] = field(name, lambda _: 1.0)
        said[f"{name}: removed"] = with_hdf5(lambda file, n=name: file.__delitem__(n))
        for how in ("moved", "external", "raw", "claimed", "chunk", "virtual", "group", "text", "objects"):
            said[f"{name}: {how}"] = lies(name, how)
    pads = [
        ("pads/left", n) for n in ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm", "thickness_mm", "E_MPa", "nu")
    ]
    root = [("/", n) for n in ("format", "version", "fruit_id", "category", "loading", "sensor")]
    values = (
        None,
        0.0,
        -1.0,
        np.nan,
        np.inf,
        1e300,
        "x" * 3000,
        "a\x1b[31mb",
        np.zeros(7000),
        np.bytes_(b"\xff\xfe"),
    )
    for place, name in (*root, *pads):
        for k, value in enumerate(values):
            said[f"attribute {name}: {k}"] = attribute(name, value, place)
    return said


NPY: dict[str, Change] = {
    "10^12 values claimed": with_bytes(lambda d: d.replace(b"(20,", b"(999999999999,")),
    "nan": with_array(lambda v: v * np.nan),
    "1e300": with_array(lambda v: v * 1e300 + 1e300),
    "a frame less": with_array(lambda v: v[:-1]),
    "objects": with_array(lambda _: np.array([{}] * 20, object)),
}
