"""What an effect is to the finder: a name, its unknowns, and the words that go with it."""

from dataclasses import dataclass

from fem.indentation.unknowns import Unknown


@dataclass(frozen=True, kw_only=True)
class TraceEffect:
    """One missing physics, in one of its forms (the number of relaxing arms is a form, not an effect).

    `error`: share of the force by which its law is off once its parameters, E and the nuisances have taken up
    what they can, as finite elements tell: the least that a fit with it leaves unexplained.
    """

    name: str
    unknowns: tuple[Unknown, ...]
    arms: int = 0
    error: float = 4e-4
