"""Reading single fields of a recording, each with the check that its kind needs."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.files.limited_memory import limited_memory
from pipeline.files.plain_file import printable
from tactile.io.hdf5_faults import unknown_filter
from tactile.io.limited_process import lacks_memory
from tactile.io.pictures import MOST_PIXELS
from tactile.tactile_failure import TactileFailure, TactileProblem

Shape: TypeAlias = tuple[int | None, ...]
"""Lengths of an array; None: any from 1."""
RIGID_TOLERANCE = 1e-4
"""Largest entry of R'R - I that still counts as a rotation: poses stored in single precision pass."""
MOST_READ_BYTES = 500_000_000
"""Of all fields that are read from one file, in double precision: two pads of 400 markers for a minute at 30
frames a second take 70 MB. Grading takes some times as much."""
MOST_IMAGE_BYTES = 20_000_000_000
"""Of all pictures of a pad, which are read one by one: 5 minutes of 640 x 480 in colour at 60 frames/s are
17 GB. Set by hand."""
SPARE_BYTES = 100_000_000
"""What the library may take beside twice the values and four times a chunk, which it unpacks in a buffer that
grows by doubling."""
MOST_CHUNK_BYTES = 256_000_000
"""The library unpacks a whole chunk to read one value of it."""
MOST_DROPPED = 0.1
"""Share of the frames that may be dropped for their missing values, at most; a third left out is a finding of
its own (tactile/checks/time_order.py). It chooses the advice, no more."""
MOST_CHARACTERS = 200
"""Of a name in a recording. Set by hand: longer text is no name."""
MOST_ATTRIBUTE_BYTES = 65_536
"""Of an attribute: HDF5 itself keeps no larger one in an object's header."""
COARSEST_TIME_S = 1e-3
"""Times that a type of number cannot hold more finely are no times of frames."""
FARTHEST_MM = 1e5
"""A pose's shift beyond 100 m is of no gripper."""
REWRITE = "write the field again as plain numbers or text: HDF5 holds more types than arrays do"


@dataclass(frozen=True)
class Limit:
    """The largest that a number can be, either sign, and its unit with what a larger one may have been; of a
    constant, which is above zero, the least too.
    """

    largest: float
    unit: str
    least: float = 0.0


ANY = Limit(1e12, "in any unit")
"""Of a field without a limit of its own: far beyond any, and its square is finite."""


def chunk_bytes(data: Any) -> int:
    """Bytes of one chunk of a dataset, unpacked; 0 where it has none."""
    return int(np.prod(data.chunks or (0,), dtype=np.float64)) * int(data.dtype.itemsize)


def first_line(cause: Exception) -> str:
    """What the HDF5 library says, without the lines below it."""
    return str(cause).splitlines()[0][:120] if str(cause) else type(cause).__name__


def unreadable(path: Path, field: str, fault: str, expected: str, advice: str) -> TactileFailure:
    """The failure sentence of this format: where, what was found, what was expected, what to do."""
    fault = fault if len(fault) <= 200 else f"{fault[:197]}..."
    detail = f"{path.name}: {field}: found {fault}, expected {expected}; {advice}."
    return TactileFailure(TactileProblem.UNREADABLE_RECORDING, printable(detail))


@dataclass
class ReadBudget:
    """Bytes of the fields that were read from one file so far, and their names: each counts once."""

    used: int = 0
    counted: set[str] = field(default_factory=set)


class FramesRead(int):
    """A number of frames as the first length of a field: `part` of the `total` in the file is read."""

    part: slice
    total: int

    def __new__(cls, part: slice, total: int) -> "FramesRead":
        """As many as `part` has."""
        made = super().__new__(cls, len(range(*part.indices(total))))
        made.part, made.total = part, total
        return made


@dataclass(frozen=True, kw_only=True)
class GroupReader:
    """One HDF5 group of one file, and the name it goes by in failures (`prefix`, empty for the root).

    `reversed_dimensions`: every dataset has its dimensions in the opposite order and is read so. `budget`:
    that of the file, which its groups share.
    """

    path: Path
    group: Any
    prefix: str = ""
    reversed_dimensions: bool = False
    budget: ReadBudget = field(default_factory=ReadBudget)

    def __contains__(self, name: str) -> bool:
        self._require_own(name)
        return name in self.group

    def child(self, name: str) -> "GroupReader":
        """The group `name` below this one."""
        if name not in self or not hasattr(self.group[name], "keys"):
            raise self._refuse(name, "no such group", "a group", "record it, or check the loading attribute")
        return replace(self, group=self.group[name], prefix=f"{self.prefix}{name}/")

    def text(self, name: str) -> str:
        """A text attribute."""
        value = self._attribute(name)
        field = f"attribute {name}"
        try:
            value = value.decode("utf-8") if isinstance(value, bytes) else value
            if isinstance(value, str):
                value.encode("utf-8")
        except UnicodeError as cause:
            fault = "bytes that are no UTF-8"
            raise self._refuse(field, fault, "a text in UTF-8", "write it as a string") from cause
        if not isinstance(value, str):
            raise self._refuse(field, _said(value), "a text", "write it as a string")
        if len(value) > MOST_CHARACTERS:
            fault = f"{len(value)} characters"
            raise self._refuse(field, fault, f"at most {MOST_CHARACTERS}", "shorten it")
        return printable(value)

    def choice(self, name: str, allowed: set[str], *, default: str | None = None) -> str:
        """A text attribute that must be one of `allowed`; `default` where it may be left out."""
        if default is not None and name not in self.group.attrs:
            return default
        value = self.text(name)
        if value not in allowed:
            expected = " or ".join(sorted(allowed))
            raise self._refuse(f"attribute {name}", _said(value), expected, "is it a drupe recording?")
        return value

    def version(self, name: str, known: int) -> None:
        """The format's version, which must be `known`, as a number of any type: 1.0 is version 1."""
        value = self._attribute(name)
        if not isinstance(value, int | np.integer | np.floating) or value != known:
            advice = "convert the file, or use a release of drupe that reads this version"
            raise self._refuse(f"attribute {name}", _said(value), f"version {known}", advice)

    def positive(self, name: str, *, limit: Limit) -> float:
        """A numeric attribute above zero, up to its limit."""
        value = self._attribute(name)
        number = float(value) if isinstance(value, int | float | np.number) else float("nan")
        if not (np.isfinite(number) and number > 0):
            raise self._refuse(
                f"attribute {name}", _said(value), "a number above zero", "correct the sensor's constants"
            )
        if not limit.least <= number <= limit.largest:
            expected = f"{limit.least:g} to {limit.largest:g} {limit.unit}".rstrip()
            raise self._refuse(f"attribute {name}", f"{number:g}", expected, "correct the sensor's constants")
        return number

    def share(self, name: str) -> float:
        """A numeric attribute from 0 up to less than 1."""
        value = self._attribute(name)
        number = float(value) if isinstance(value, int | float | np.number) else float("nan")
        if not 0 <= number < 1:
            raise self._refuse(f"attribute {name}", _said(value), "a share, 0 to less than 1", "correct it")
        return number

    def optional_positive(self, name: str, *, limit: Limit) -> float | None:
        """A numeric attribute above zero, or None where the file leaves it out."""
        return self.positive(name, limit=limit) if name in self.group.attrs else None

    def array(
        self, name: str, shape: Shape, *, limit: Limit = ANY, holes: bool = False
    ) -> Float[np.ndarray, "..."]:
        """A dataset of numbers with `shape` (None: any length above zero), in double precision, all finite
        (with `holes` NaN as well) and none beyond the limit.
        """
        data = self._dataset(name)
        self._require_shape(name, data, shape)
        if data.dtype.kind not in "fiu":
            raise self._refuse(
                name, f"values of type {data.dtype}", "numbers", "write the field as floating point"
            )
        self._require_budget(name, data, 8)
        values = _chosen(np.asarray(self._values(name, data, axes=len(shape)), dtype=np.float64), shape)
        bad = ~np.isfinite(values) & ~(holes & np.isnan(values))
        if bad.any():
            raise self._refuse(name, *_not_finite(bad, of_markers=shape[-1] == 3))
        self.require_within(name, values, limit)
        return values

    def require_within(self, name: str, values: Float[np.ndarray, "..."], limit: Limit) -> None:
        """Refuses values beyond the limit."""
        beyond = (values > limit.largest) | (values < -limit.largest)
        if beyond.any():
            where = tuple(int(i) for i in np.argwhere(beyond)[0])
            fault = f"{values[where]:g} at index {where}"
            expected = f"at most {limit.largest:g} {limit.unit}"
            raise self._refuse(name, fault, expected, "repair or drop those frames in the recorder")

    def refuse(self, name: str, wrong: tuple[str, str, str] | None) -> None:
        """Refuses a field with what was found, what was expected and what to do; None: nothing is wrong."""
        if wrong is not None:
            raise self._refuse(name, *wrong)

    def refuse_negative(
        self,
        name: str,
        values: Float[np.ndarray, "..."],
        *,
        expected: str = "0 or more",
        advice: str = "leave the field out, or write it again",
    ) -> None:
        """Refuses a field with a value below 0."""
        if (values < 0).any():
            raise self._refuse(name, f"{values.min():g}", expected, advice)

    def time(self, name: str, *, limit: Limit = ANY) -> Float[np.ndarray, " t"]:
        """A strictly increasing dataset."""
        values = self.array(name, (None,), limit=limit)
        self.require_increasing(name, values)
        return values

    def require_increasing(self, name: str, values: Float[np.ndarray, " t"]) -> None:
        """Refuses times that stand still or run back."""
        back = np.flatnonzero(np.diff(values) <= 0)
        if len(back):
            k = int(back[0]) + 1
            step_s = _step_of(self._dataset(name).dtype, values[k])
            if values[k] == values[k - 1] and step_s > COARSEST_TIME_S:
                fault = f"equal times in frames {k - 1} and {k}: {values[k]:.0f} s in 32 bits"
                expected = f"strictly increasing times (float32 has steps of {step_s:g} s there)"
                raise self._refuse(name, fault, expected, "write float64, or seconds from the first frame")
            fault = f"{values[k]:g} s in frame {k} after {values[k - 1]:g} s"
            raise self._refuse(name, fault, "strictly increasing times", "leave out the repeated frames")

    def poses(self, name: str, frames: int) -> Float[np.ndarray, "t 4 4"]:
        """Rigid transforms, one per frame."""
        values = self.array(name, (frames, 4, 4), limit=Limit(FARTHEST_MM, "millimetres"))
        rotation = values[:, :3, :3]
        skew = np.abs(np.einsum("tki,tkj->tij", rotation, rotation) - np.eye(3)).max(axis=(1, 2))
        last_row = np.abs(values[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
        wrong = (skew > RIGID_TOLERANCE) | (np.linalg.det(rotation) < 0) | (last_row > RIGID_TOLERANCE)
        if wrong.any():
            fault = f"a matrix in frame {int(np.argmax(wrong))} that is not a rotation and a shift"
            advice = "write the 4x4 pad-to-fruit pose, lengths in mm, right-handed"
            raise self._refuse(name, fault, "rigid motions", advice)
        return values

    def images(self, name: str) -> Any:
        """A dataset to be read frame by frame, none of which is larger than a camera's."""
        data = self._dataset(name)
        if data.shape is None or len(data.shape) == 0:
            raise self._refuse(name, "no frames", "frames", "record the field or write it again")
        self._require_own_values(name, data)
        shape = tuple(data.shape)
        if data.nbytes > MOST_IMAGE_BYTES or data.nbytes > 3 * MOST_PIXELS * len(data):
            fault = f"shape {shape}, {data.nbytes / 1e9:.1f} GB"
            expected = (
                f"at most {MOST_IMAGE_BYTES / 1e9:g} GB, and {MOST_PIXELS / 1e6:g} million pixels a frame"
            )
            raise self._refuse(name, fault, expected, "divide the recording")
        return data

    def picture(self, name: str) -> UInt8[np.ndarray, "h w 3"]:
        """One raw colour frame."""
        data, shape = self._dataset(name), (None, None, 3)
        self._require_shape(name, data, shape)
        if data.dtype != np.uint8:
            raise self._refuse(name, f"values of type {data.dtype}", "uint8", "store the raw 8-bit frames")
        self._require_budget(name, data, 1)
        return np.asarray(self._values(name, data, axes=3), dtype=np.uint8)

    def _attribute(self, name: str) -> Any:
        """What an attribute holds; an array of one is that one, as MATLAB and Julia write them."""
        if name not in self.group.attrs:
            raise self._refuse(
                f"attribute {name}", "nothing", "the attribute to be present", "add it to the file"
            )
        try:
            held = self.group.attrs.get_id(name)
            null = held.get_space().get_simple_extent_type() == h5py.h5s.NULL
            length = 0 if null else int(np.prod(held.shape, dtype=np.float64)) * held.dtype.itemsize
            text = h5py.check_string_dtype(held.dtype) is not None
            if length > MOST_ATTRIBUTE_BYTES or not (null or text or held.dtype.kind in "fiubS"):
                fault = f"{length} bytes of type {held.dtype}"
                raise self._refuse(f"attribute {name}", fault, "one number or text", REWRITE)
            with limited_memory(SPARE_BYTES):
                value = self.group.attrs[name]
            return value.flat[0] if isinstance(value, np.ndarray) and value.size == 1 else value
        except (TypeError, ValueError) as cause:
            raise self._refuse(
                f"attribute {name}", first_line(cause), "a number or a text", REWRITE
            ) from cause

    def _require_own(self, name: str) -> None:
        """Refuse a field that is a link: it may lead into another file, which is not of the recording and
        which no list of its inputs names.
        """
        if not isinstance(self.group.get(name, getlink=True, default=h5py.HardLink()), h5py.HardLink):
            raise self._refuse(name, "a link", "the field itself", "write its values into this file")

    def _require_budget(self, name: str, data: Any, value_bytes: int) -> None:
        """Refuse, before it is read, what would not fit into memory with all that was read before."""
        self._require_own_values(name, data)
        if self.prefix + name not in self.budget.counted:
            self.budget.counted.add(self.prefix + name)
            self.budget.used += data.size * max(value_bytes, data.dtype.itemsize)
        if self.budget.used > MOST_READ_BYTES:
            fault = f"shape {tuple(data.shape)}, {self.budget.used / 1e6:.0f} MB in all fields up to this one"
            raise self._refuse(name, fault, f"at most {MOST_READ_BYTES / 1e6:g} MB", "divide the recording")

    def _require_own_values(self, name: str, data: Any) -> None:
        """Refuse values that lie in other files, and chunks that are too large to unpack."""
        if data.external or data.is_virtual:
            fault = "values kept in another file"
            raise self._refuse(name, fault, "values in this file", "write them into the recording")
        if lacking := unknown_filter(data):
            fault = f"values packed by the filter {lacking}, which is not installed here"
            raise self._refuse(name, fault, "gzip, LZF or no packing", "write the field again with gzip")
        if (chunk := chunk_bytes(data)) > MOST_CHUNK_BYTES:
            fault = f"chunks of {chunk / 1e6:.0f} MB"
            raise self._refuse(name, fault, f"at most {MOST_CHUNK_BYTES / 1e6:g} MB", REWRITE)

    def _dataset(self, name: str) -> Any:
        """The dataset of this name, still unread. Raises TactileFailure where there is none."""
        self._require_own(name)
        try:
            data = self.group.get(name)
            present = hasattr(data, "dtype") and hasattr(data, "shape")
        except (TypeError, ValueError) as cause:
            raise self._refuse(name, first_line(cause), "numbers", REWRITE) from cause
        if not present:
            raise self._refuse(
                name, "nothing", "a dataset of this name", "add the missing field to the recording"
            )
        return data

    def _values(self, name: str, data: Any, *, axes: int) -> Any:
        """All values, in the order of dimensions that is expected; a single row or column as a vector."""
        most = 2 * data.nbytes + 4 * chunk_bytes(data) + SPARE_BYTES
        try:
            with limited_memory(most):
                values = data[()]
            values = values.T if self.reversed_dimensions else values
            return values.reshape(-1) if axes == 1 else values
        except (TypeError, ValueError) as cause:
            raise self._refuse(name, first_line(cause), "numbers", REWRITE) from cause
        except (OSError, MemoryError) as cause:
            if not lacks_memory(cause) and "filter returned failure" not in str(cause):
                raise
            fault = f"values that are damaged, or take more than {most / 1e6:.0f} MB to unpack"
            expected = f"{data.nbytes / 1e6:.1f} MB, as the shape {tuple(data.shape)} says"
            raise self._refuse(name, fault, expected, "copy the file again from the recorder") from cause

    def _require_shape(self, name: str, data: Any, shape: Shape) -> None:
        """Raises TactileFailure where a dataset has another shape; None stands for any length from 1."""
        if data.shape is None:  # HDF5's null dataspace: a type and no values, not even an empty array
            raise self._refuse(name, "an empty dataset", "values in it", "record the field or write it again")
        shape = tuple(n.total if isinstance(n, FramesRead) else n for n in shape)
        held = tuple(data.shape)
        have = held[::-1] if self.reversed_dimensions else held
        if len(shape) == 1 and len(have) == 2 and 1 in have:  # MATLAB has no vectors, but rows and columns
            have = (max(have),)
        if not fits(have, shape):
            advice = "frames and markers must agree with time_s and rest_mm"
            if fits(have[::-1], shape):
                advice = (
                    "the dimensions are reversed, as MATLAB writes them, but those of other fields are not: "
                    "permute this one"
                )
            raise self._refuse(name, f"shape {held}", shape_said(shape), advice)

    def _refuse(self, field: str, fault: str, expected: str, advice: str) -> TactileFailure:
        attribute = field.startswith("attribute ")
        inside = f" of /{self.prefix.rstrip('/')}" if self.prefix else ""
        where = field + inside if attribute else self.prefix + field
        return unreadable(self.path, where, fault, expected, advice)


def _chosen(values: np.ndarray, shape: Shape) -> np.ndarray:
    """The frames that are read, where the first length is theirs."""
    return values[shape[0].part] if shape and isinstance(shape[0], FramesRead) else values


def _not_finite(bad: Bool[np.ndarray, "..."], *, of_markers: bool) -> tuple[str, str, str]:
    """What was found, expected and is to be done where values are NaN or infinite: lost markers, or frames.

    `of_markers`: the last axis are x, y, z of a marker, and the one before it the markers.
    """
    where = tuple(int(i) for i in np.argwhere(bad)[0])
    count = f"{int(bad.sum())} value(s) NaN or infinite, the first at index {where}"
    if of_markers and bad.ndim > 1:
        lost = bad.any(axis=-1).reshape(-1, bad.shape[-2])  # frames (one, of places at rest), markers
        never, ever = int(lost.all(axis=0).sum()), int(lost.any(axis=0).sum())
        markers, frames = lost.shape[1], lost.shape[0]
        if never:
            within = "" if frames == 1 else " in any frame"
            fault = f"{never} of {markers} markers have no values{within} ({count})"
            advice = (
                "track those markers in the recorder, or take them out of rest_mm and of both fields alike"
            )
            return fault, "a finite number for each marker", advice
        spoilt = int(lost.any(axis=1).sum())
        if spoilt > MOST_DROPPED * frames:
            fault = f"{ever} of {markers} markers have no values in some of the frames ({count})"
            advice = f"track them throughout: {spoilt} of {frames} frames lack some, too many to drop them"
            return fault, "a finite number for each marker and frame", advice
    return count, "finite numbers", "repair or drop those frames in the recorder"


def fits(have: tuple[int, ...], wanted: Shape) -> bool:
    """Whether a shape is the one wanted; None stands for any length from 1."""
    return len(have) == len(wanted) and all(
        (length >= 1 if want is None else length == want) for length, want in zip(have, wanted, strict=True)
    )


def shape_said(wanted: Shape) -> str:
    """A shape as a sentence names it.

    >>> shape_said((None, 3))
    'shape (any, 3)'
    """
    return "shape (" + ", ".join("any" if length is None else str(length) for length in wanted) + ")"


def _step_of(kind: Any, value: float) -> float:
    """The distance from a value to the next one that a type of floating point holds; 0 of whole numbers."""
    return float(np.spacing(kind.type(abs(value)))) if kind.kind == "f" else 0.0


def _said(value: object) -> str:
    """A value as the user wrote it: numpy's scalars without their type."""
    if isinstance(value, h5py.Empty):
        return "an empty attribute"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return repr(value.item() if isinstance(value, np.generic) else value)
