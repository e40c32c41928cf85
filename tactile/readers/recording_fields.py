"""Reads single fields of a recording, and checks each."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
from jaxtyping import Bool, Float

from pipeline.files.plain_file import printable
from tactile.readers.hdf5_file import first_line, is_elsewhere, unreadable
from tactile.tactile_failure import TactileFailure

Shape: TypeAlias = tuple[int | None, ...]
"""Lengths of an array; None: any from 1."""
RIGID_TOLERANCE = 1e-4
"""Largest entry of R'R - I that still counts as a rotation: poses stored in single precision pass."""
MOST_CHARACTERS = 200
"""Longest name in a recording. Set by hand."""
FARTHEST_MM = 1e5
"""Largest translation of a pose along an axis: no gripper is 100 m away."""
REWRITE = "write the field again as plain numbers or text: HDF5 holds more types than arrays do"


@dataclass(frozen=True)
class Limit:
    """Largest absolute value of a number, and its unit, with a question for a likely other unit. `least`:
    least value of a constant, which must be positive.
    """

    largest: float
    unit: str
    least: float = 0.0


ANY = Limit(1e12, "in any unit")
"""Limit of a field without a specific one: far beyond any value, with a finite square."""


@dataclass(frozen=True, kw_only=True)
class GroupReader:
    """One HDF5 group of a file; `prefix` names it in failures (empty for the root). Methods raise
    TactileFailure (unreadable-recording) for a field that is missing or wrong.
    """

    path: Path
    group: Any
    prefix: str = ""

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
        """A text attribute that must be one of `allowed`; `default` if it is missing."""
        if default is not None and name not in self.group.attrs:
            return default
        value = self.text(name)
        if value not in allowed:
            expected = " or ".join(sorted(allowed))
            raise self._refuse(f"attribute {name}", _said(value), expected, "is it a drupe recording?")
        return value

    def version(self, name: str, known: int) -> None:
        """Checks the format's version: a number of any type (1.0 is version 1) that must be `known`."""
        value = self._attribute(name)
        if not isinstance(value, int | np.integer | np.floating) or value != known:
            advice = "convert the file, or use a release of drupe that reads this version"
            raise self._refuse(f"attribute {name}", _said(value), f"version {known}", advice)

    def positive(self, name: str, *, limit: Limit) -> float:
        """A numeric attribute above zero, within its limit."""
        number, value = self._number(name)
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
        number, value = self._number(name)
        if not 0 <= number < 1:
            raise self._refuse(f"attribute {name}", _said(value), "a share, 0 to less than 1", "correct it")
        return number

    def optional_positive(self, name: str, *, limit: Limit) -> float | None:
        """A numeric attribute above zero, or None if it is missing."""
        return self.positive(name, limit=limit) if name in self.group.attrs else None

    def array(self, name: str, shape: Shape, *, limit: Limit = ANY) -> Float[np.ndarray, "..."]:
        """A dataset of numbers with `shape` (None: any length above zero), in double precision. All are
        finite and within the limit.
        """
        data = self._dataset(name)
        self._require_shape(name, data, shape)
        if data.dtype.kind not in "fiu":
            raise self._refuse(
                name, f"values of type {data.dtype}", "numbers", "write the field as floating point"
            )
        values = np.asarray(self._values(name, data, axes=len(shape)), dtype=np.float64)
        bad = ~np.isfinite(values)
        if bad.any():
            where = tuple(int(i) for i in np.argwhere(bad)[0])
            fault = f"NaN or infinite values: {int(bad.sum())}, the first at index {where}"
            if bad.ndim > 1 and shape[-1] == 3:
                lost = bad.any(axis=-1).reshape(-1, bad.shape[-2])
                fault = (
                    f"NaN or infinite values: {int(bad.sum())}, the first at index {where}, in "
                    f"{lost.any(axis=0).sum()} of {lost.shape[1]} markers"
                )
            advice = (
                "repair or drop those frames in the recorder, or take those markers out of rest_mm and of "
                "both fields alike"
            )
            raise self._refuse(name, fault, "finite numbers", advice)
        beyond = (values > limit.largest) | (values < -limit.largest)
        if beyond.any():
            where = tuple(int(i) for i in np.argwhere(beyond)[0])
            fault = f"{values[where]:g} at index {where}"
            expected = f"at most {limit.largest:g} {limit.unit}"
            raise self._refuse(name, fault, expected, "repair or drop those frames in the recorder")
        return values

    def refuse(self, name: str, wrong: tuple[str, str, str] | None) -> None:
        """Raises the failure of a field: what was found, expected, and advised; None: no fault."""
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
        """Raises the failure of a field with a value below 0."""
        if (values < 0).any():
            raise self._refuse(name, f"{values.min():g}", expected, advice)

    def time(self, name: str, *, limit: Limit = ANY) -> Float[np.ndarray, " t"]:
        """A strictly increasing dataset."""
        values = self.array(name, (None,), limit=limit)
        back = np.flatnonzero(np.diff(values) <= 0)
        if len(back):
            k = int(back[0]) + 1
            fault = f"{values[k]:.10g} s in frame {k} after {values[k - 1]:.10g} s"
            advice = "leave out the repeated frames, and write float64 or seconds from the first frame"
            raise self._refuse(name, fault, "strictly increasing times", advice)
        return values

    def poses(self, name: str, frames: int) -> Float[np.ndarray, "t 4 4"]:
        """Rigid transforms, one per frame."""
        values = self.array(name, (frames, 4, 4), limit=Limit(FARTHEST_MM, "millimetres"))
        if not (rigid := are_rigid(values)).all():
            fault = f"a matrix in frame {int(np.argmin(rigid))} that is not a rotation and a shift"
            advice = "write the 4x4 pad-to-fruit pose, lengths in mm, right-handed"
            raise self._refuse(name, fault, "rigid motions", advice)
        return values

    def _attribute(self, name: str) -> Any:
        """An attribute's value; an array of one element is that element, as MATLAB and Julia write it."""
        if name not in self.group.attrs:
            raise self._refuse(
                f"attribute {name}", "nothing", "the attribute to be present", "add it to the file"
            )
        try:
            value = self.group.attrs[name]
            return value.flat[0] if isinstance(value, np.ndarray) and value.size == 1 else value
        except (TypeError, ValueError) as cause:
            raise self._refuse(
                f"attribute {name}", first_line(cause), "a number or a text", REWRITE
            ) from cause

    def _number(self, name: str) -> tuple[float, Any]:
        """An attribute as a number, NaN if it is none, and as it was stored."""
        value = self._attribute(name)
        return float(value) if isinstance(value, int | float | np.number) else float("nan"), value

    def _require_own(self, name: str) -> None:
        """Refuses a field that is a link: it may lead into a file that no list of the inputs names."""
        if not isinstance(self.group.get(name, getlink=True, default=h5py.HardLink()), h5py.HardLink):
            raise self._refuse(name, "a link", "the field itself", "write its values into this file")

    def _dataset(self, name: str) -> Any:
        """The dataset, still unread. Raises TactileFailure if it is missing or stored in another file."""
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
        if is_elsewhere(data):
            fault = "values kept in another file"
            raise self._refuse(name, fault, "values in this file", "write them into the recording")
        return data

    def _values(self, name: str, data: Any, *, axes: int) -> Any:
        """All values; a single row or column becomes a vector if `axes` is 1."""
        try:
            values = data[()]
        except (TypeError, ValueError) as cause:
            raise self._refuse(name, first_line(cause), "numbers", REWRITE) from cause
        except OSError as cause:
            steps = data.id.get_create_plist()
            filters = [steps.get_filter(k)[0] for k in range(steps.get_nfilters())]
            lacking = [number for number in filters if not h5py.h5z.filter_avail(number)]
            fault = f"values that the HDF5 library does not read ({first_line(cause)})"
            if lacking:
                fault = f"values packed by the HDF5 filter {lacking[0]}, which is not installed"
            expected, advice = "gzip, LZF or no packing", "write the field again, or copy the file again"
            raise self._refuse(name, fault, expected, advice) from cause
        return values.reshape(-1) if axes == 1 else values

    def _require_shape(self, name: str, data: Any, shape: Shape) -> None:
        """Raises TactileFailure for a dataset with another shape; None allows any length from 1."""
        if data.shape is None:  # HDF5's null dataspace: a type and no values, not even an empty array
            raise self._refuse(name, "an empty dataset", "values in it", "record the field or write it again")
        held = have = tuple(data.shape)
        if len(shape) == 1 and len(have) == 2 and 1 in have:  # MATLAB writes vectors as rows or columns
            have = (max(have),)
        if not fits(have, shape):
            advice = "frames and markers must agree with time_s and rest_mm"
            if fits(have[::-1], shape):
                advice = "the dimensions are reversed, as MATLAB writes them: permute them before h5write"
            raise self._refuse(name, f"shape {held}", shape_said(shape), advice)

    def _refuse(self, field: str, fault: str, expected: str, advice: str) -> TactileFailure:
        attribute = field.startswith("attribute ")
        inside = f" of /{self.prefix.rstrip('/')}" if self.prefix else ""
        where = field + inside if attribute else self.prefix + field
        return unreadable(self.path, where, fault, expected, advice)


def fits(have: tuple[int, ...], wanted: Shape) -> bool:
    """Whether a shape is the wanted one; None allows any length from 1."""
    return len(have) == len(wanted) and all(
        (length >= 1 if want is None else length == want) for length, want in zip(have, wanted, strict=True)
    )


def are_rigid(poses: Float[np.ndarray, "t 4 4"]) -> Bool[np.ndarray, " t"]:
    """Which matrices are a rotation and a translation of at most 100 m along each axis.

    >>> are_rigid(np.stack([np.eye(4), 2 * np.eye(4)])).tolist()
    [True, False]
    """
    turns = poses[:, :3, :3]
    skew = np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max(axis=(1, 2))
    last_row = np.abs(poses[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
    near = np.abs(poses[:, :3, 3]).max(axis=1) <= FARTHEST_MM
    right_handed = np.linalg.det(turns) > 0
    return np.asarray(near & right_handed & (np.maximum(skew, last_row) <= RIGID_TOLERANCE))


def shape_said(wanted: Shape) -> str:
    """A shape in words.

    >>> shape_said((None, 3))
    'shape (any, 3)'
    """
    return "shape (" + ", ".join("any" if length is None else str(length) for length in wanted) + ")"


def _said(value: object) -> str:
    """A value as the user wrote it: NumPy scalars without their type."""
    if isinstance(value, h5py.Empty):
        return "an empty attribute"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return repr(value.item() if isinstance(value, np.generic) else value)
