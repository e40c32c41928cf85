"""What an effect is to the finder: a name, its unknowns, and the words that go with it."""

from dataclasses import dataclass

from fem.mismatch.indenter.unknowns import Unknown


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One missing physics, in one of its forms (the number of relaxing arms is a form, not an effect)."""

    name: str
    unknowns: tuple[Unknown, ...]
    arms: int = 0
