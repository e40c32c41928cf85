"""Why a tactile recording could not be used, as something a user can act on."""

from enum import StrEnum

from pipeline.files.plain_file import printable


class TactileProblem(StrEnum):
    """What can be wrong with a recording; the value is the code that tables and records carry."""

    UNREADABLE_RECORDING = "unreadable-recording"
    NEVER_TOUCHES = "never-touches"
    NO_MARKERS = "no-markers"
    PADS_OFF_FRUIT = "pads-off-fruit"
    UNREADABLE_SENSOR = "unreadable-sensor"
    UNREADABLE_FRAMES = "unreadable-frames"
    WRONG_SENSOR = "wrong-sensor"
    SATURATED = "gel-saturated"
    MARKERS_LOST = "markers-lost"
    IMPLAUSIBLE_RECORDING = "implausible-recording"
    FOREIGN_RECORDING = "foreign-recording"
    REPEATED_RECORDING = "repeated-recording"

    def failure(self, detail: str) -> "TactileFailure":
        """The exception with this problem and these words."""
        return TactileFailure(self, detail)


class TactileFailure(Exception):
    """The one exception of this package: `problem` for programs, `detail` (also `str`) for people."""

    def __init__(self, problem: TactileProblem, detail: str) -> None:
        detail = printable(detail)
        super().__init__(detail)
        self.problem = problem
        self.detail = detail
