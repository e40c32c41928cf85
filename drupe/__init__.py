"""The public functions of drupe, which measure the ripeness of stone fruit.

Names in `__all__` are public; all others may change without notice (docs/python.md, Compatibility). Units
are mm, N, MPa and s. Every function raises `DrupeError` for unusable input. Modules load at first use.
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
    """Imports the module of a public name and returns the name's value; `sys.path` does not change."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import sys

    path = sys.path[:]
    try:
        value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    finally:
        sys.path[:] = path  # pipeline.safe_start removes the current folder from the path
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
