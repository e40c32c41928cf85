"""Whether a recording's datasets have their dimensions in the opposite order, as column-major programs write
them: MATLAB's h5write turns an array of T x N x 3 into a dataset of (3, N, T).
"""

from collections.abc import Iterator
from typing import Any

import h5py

from tactile.io.hdf5_texts import child_group, holds
from tactile.io.recording_fields import Shape

REVERSED = "the dimensions of all fields are reversed, as MATLAB writes them: (3, N, T) was read as (T, N, 3)"


def has_reversed_dimensions(file: Any) -> bool:
    """Whether every field of the pads, and the wrench, has the reverse of its shape, and one of them not the
    shape itself. T is the length of time_s, N that of each pad's rest_mm; links are not followed.
    """
    pairs = list(_shapes(file))
    return (
        bool(pairs)
        and all(_is(held[::-1], want) for held, want in pairs)
        and not all(_is(held, want) for held, want in pairs)
    )


def _is(held: tuple[int, ...], want: Shape) -> bool:
    """Whether it is this shape, None: any length, 0 too."""
    return len(held) == len(want) and all(n in (None, length) for length, n in zip(held, want, strict=True))


def _shapes(file: Any) -> Iterator[tuple[tuple[int, ...], Shape]]:
    """The shape of each field of two dimensions or more, and the one that it should have."""
    time, wrench = _dataset(file, "time_s"), _dataset(file, "wrench_N")
    frames = None if time is None else max(time, default=0)
    if wrench is not None:
        yield wrench, (frames, 6)
    pads = child_group(file, "pads")
    for name in pads or ():
        pad = child_group(pads, name)
        rest = None if pad is None else _dataset(pad, "rest_mm")
        markers = max(rest, default=0) if rest is not None and len(rest) == 2 else None
        wanted: dict[str, Shape] = {"pose": (frames, 4, 4), "rest_mm": (markers, 3)}
        wanted |= dict.fromkeys(("displacement_mm", "force_N"), (frames, markers, 3))
        for field, want in wanted.items() if pad is not None else ():
            if (held := _dataset(pad, field)) is not None:
                yield held, want


def _dataset(group: Any, name: str) -> tuple[int, ...] | None:
    """The shape of a dataset; None where there is none, or it holds no array."""
    return group[name].shape if holds(group, name, h5py.Dataset) else None
