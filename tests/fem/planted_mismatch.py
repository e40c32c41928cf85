"""Former names of injected_mismatch."""

from injected_mismatch import injected_case as planted_case
from injected_mismatch import only_grasp

__all__ = ["only_grasp", "planted_case"]
