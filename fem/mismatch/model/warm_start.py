"""Warm starts: a search starts from the solutions that the same search has found before.

A search of parameters (fem.mismatch.selection.refinement) solves the same model again and again for
parameters that differ little; the solutions of one belong to it alone. A call without a search's warm
starts begins from nothing, so that it gives the same answer whatever was asked before.
"""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class WarmStarts:
    """What one search has found, each under the key of the model that found it. Values are never changed."""

    solutions: dict[object, tuple[Any, ...]] = field(default_factory=dict)

    def copy(self) -> "WarmStarts":
        """A copy for another search that continues from here on its own."""
        return WarmStarts(dict(self.solutions))
