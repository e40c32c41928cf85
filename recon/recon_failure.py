"""How photos can fail to become a mesh: an exception whose problem is a word, its detail a sentence."""

from enum import StrEnum

from pipeline.files.plain_file import printable


class ReconProblem(StrEnum):
    """What went wrong, in a word that a record can carry."""

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

    `detail` is one sentence: what was found, what was expected, what to do next; it names the file and the
    field when a file is at fault; control characters, which names of files can hold, are taken out.
    `str(failure) == failure.detail`.
    """

    def __init__(self, problem: ReconProblem, detail: str) -> None:
        detail = printable(detail)
        super().__init__(detail)
        self.problem = problem
        self.detail = detail

    def __reduce__(self) -> tuple[type["ReconFailure"], tuple[ReconProblem, str]]:
        """Survive the way back from a worker process."""
        return type(self), (self.problem, self.detail)
