"""Failures of a reconstruction: an exception with a problem code and a detail for the user."""

from enum import StrEnum

from pipeline.files.plain_file import printable


class ReconProblem(StrEnum):
    """Code of a failure, as records store it."""

    TOO_FEW_VIEWS = "too-few-views"
    UNREADABLE_PHOTO = "unreadable-photo"
    UNREADABLE_MESH = "unreadable-mesh"
    BAD_MAT = "bad-mat"
    MAT_NOT_FOUND = "mat-not-found"
    NO_FRUIT = "no-fruit"
    FRUIT_CUT_OFF = "fruit-cut-off"
    NO_OVERLAP = "no-overlap"
    NO_SCALE = "no-scale"
    NO_SURFACE = "no-surface"
    NOT_WATERTIGHT = "not-watertight"
    SURFACE_CONTRADICTED = "surface-contradicted"
    NO_PRIOR = "no-prior"
    BAD_PRIOR = "bad-prior"
    PIT_OUTSIDE_FRUIT = "pit-outside-fruit"
    BAD_GEOMETRY_MODEL = "bad-geometry-model"
    MISSING_LIBRARY = "missing-library"

    def failure(self, detail: str) -> "ReconFailure":
        """The exception with this problem and one sentence."""
        return ReconFailure(self, detail)


class ReconFailure(Exception):
    """Raised for everything that a user's photos, files or settings can cause.

    `detail` states what was found, what was expected and what to do next. It names the file and the field at
    fault. Control characters, which file names can contain, are removed. `str(failure) == failure.detail`.
    """

    def __init__(self, problem: ReconProblem, detail: str) -> None:
        detail = printable(detail)
        super().__init__(detail)
        self.problem = problem
        self.detail = detail

    def __reduce__(self) -> tuple[type["ReconFailure"], tuple[ReconProblem, str]]:
        """Let a worker process return the failure."""
        return type(self), (self.problem, self.detail)
