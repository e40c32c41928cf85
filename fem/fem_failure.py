"""What can go wrong in the mechanics, and the one exception that says so."""

from enum import StrEnum


class FemProblem(StrEnum):
    """Every way in which a user's input can defeat the mechanics; the value goes into records and tables."""

    BAD_SURFACE = "bad-surface"
    NOT_WATERTIGHT = "not-watertight"
    PIT_OUTSIDE_FRUIT = "pit-outside-fruit"
    MESHING_FAILED = "meshing-failed"
    DISCONNECTED_FLESH = "disconnected-flesh"
    INVERTED_ELEMENTS = "inverted-elements"
    VOLUME_LOST = "volume-lost"
    BAD_POISSON_RATIO = "bad-poisson-ratio"
    BAD_LOAD = "bad-load"
    NO_BASE = "no-base"
    SINGULAR_STIFFNESS = "singular-stiffness"
    OFF_SURFACE = "off-surface"
    NO_LOAD = "no-load"
    TOO_FEW_MARKERS = "too-few-markers"
    NO_MODULUS = "no-modulus"
    NOT_CONVERGED = "not-converged"


class FemFailure(Exception):
    """A problem with a sentence: what was found, what was expected, what to do next."""

    def __init__(self, problem: FemProblem, detail: str) -> None:
        super().__init__(detail)
        self.problem = problem
        self.detail = detail
