"""How ripe stone fruit is, from Python: the public functions of drupe.

Names in `__all__` are public; all else may change without notice (docs/python.md, Compatibility). Units are
mm, N, MPa and s. Every function raises `DrupeError` for input that it cannot use. Modules load at first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drupe.array_modulus import MarkerResidual, MeasuredModulus, modulus
    from drupe.batches import GradedBatch, grade, read
    from drupe.explained import ExplainedMismatch, explain, explain_fruit
    from drupe.live_frames import LiveModulus, live
    from drupe.recordings import jaw_poses, read_recording, recording, write_recording
    from drupe.refusal import DrupeError

__all__ = [
    "DrupeError",
    "ExplainedMismatch",
    "GradedBatch",
    "LiveModulus",
    "MarkerResidual",
    "MeasuredModulus",
    "explain",
    "explain_fruit",
    "grade",
    "jaw_poses",
    "live",
    "modulus",
    "read",
    "read_recording",
    "recording",
    "write_recording",
]

_MODULES = {
    "batches": ("GradedBatch", "grade", "read"),
    "explained": ("ExplainedMismatch", "explain", "explain_fruit"),
    "live_frames": ("LiveModulus", "live"),
    "array_modulus": ("MarkerResidual", "MeasuredModulus", "modulus"),
    "recordings": ("jaw_poses", "read_recording", "recording", "write_recording"),
    "refusal": ("DrupeError",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name, whose module is imported now; the caller's import path stays as it is."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import sys

    path = sys.path[:]
    try:
        value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    finally:
        sys.path[:] = path  # the command's start leaves the current folder off the path
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
