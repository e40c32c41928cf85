"""One thing that cannot be right in a recording: its cause as a sentence, and what it does to E."""

from dataclasses import dataclass
from enum import IntEnum


class Rank(IntEnum):
    """How near a finding is to the cause; of two that explain each other the lower stands first."""

    FIELD = 0
    """The field itself cannot hold measured values: dead, frozen, clipped, missing, out of order."""
    RELATION = 1
    """Two fields of one pad contradict each other: a unit, a sign, an axis, a delay."""
    MACHINE = 2
    """Jaws, poses and clock contradict each other, or the pads' movement."""
    FRUIT = 3
    """Recording and mesh do not belong together."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """`sentence` names the likely cause and has no full stop; `pad` is None where both are meant.

    `refused`: a modulus from this recording would mean nothing. Else E's relative standard deviation grows
    by `relative_sd`, which is 0 where E does not depend on what was found. `hides_touch`: the first touch
    cannot be seen for it, so that nothing can be said of where and when the pads met the fruit.
    """

    rank: Rank
    sentence: str
    pad: str | None = None
    refused: bool = False
    relative_sd: float = 0.0
    hides_touch: bool = False


def pads_said(names: tuple[str, ...]) -> str:
    """The pads as a sentence begins with them.

    >>> pads_said(("left",)), pads_said(("left", "right"))
    ("the left pad's", "both pads'")
    """
    return f"the {names[0]} pad's" if len(names) == 1 else "both pads'"
