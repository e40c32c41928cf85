"""Outcomes of a fruit, with the sentence that staff read.

The failures of recon, tactile and fem bring their own code and sentence; the outcomes here are the
pipeline's.
"""

import os
import re
import tempfile
from enum import Enum
from pathlib import Path

from pipeline.files.plain_file import printable
from pipeline.files.whole_file import MACHINE_FAULTS, NotWritten
from pipeline.lack_of_memory import is_lack_of_memory


class Outcome(Enum):
    """Code and sentence of an outcome; `{}` takes the particulars."""

    GRADED = ("graded", "")
    NO_GRASP = ("no-grasp", "grasps/ holds no tactile recording, so the fruit has a mesh but no modulus; {}")
    ALL_GRASPS_FAILED = ("grasps-failed", "No recording of this fruit is usable: {}")
    NO_SHAPE = ("no-shape", "{} holds neither photos nor fruit.ply; add one of them.")
    NO_SCALE = (
        "no-scale",
        "Without a mat, photos have no scale ({}). Fill height_mm in fruits.csv, or photograph on a "
        "marker mat and put mat.json beside batch.toml.",
    )
    IMPLAUSIBLE_INPUT = ("implausible-input", "{} Correct it; if it is right, run `drupe grade --force`.")
    IMPLAUSIBLE_PIT = (
        "implausible-pit",
        "{} Replace pit.ply by the fruit's own pit, in mm and in the fruit's frame.",
    )
    IMPLAUSIBLE_MODULUS = (
        "implausible-modulus",
        "E would be {}, outside the plausible range of this category. Check forces, displacements "
        "and meshes for wrong units or factors.",
    )
    WITHHELD_MODULUS = (
        "withheld-modulus",
        "drupe gives no E: {}. Run `drupe explain` to see what the recordings show.",
    )
    CRASHED = (
        "crashed",
        "The process for this fruit died ({}); other fruit are not affected. Run the same command "
        "again. If it dies again, report it with this fruit's inputs.",
    )
    TIMED_OUT = (
        "timed-out",
        "The fruit took longer than the limit of {} s; raise the limit with --time-limit.",
    )
    OUT_OF_MEMORY = (
        "out-of-memory",
        "drupe ran out of memory ({}); use fewer --jobs, or close other programs.",
    )
    NOT_WRITTEN = ("not-written", "drupe could not write a result: {} Then run the same command again.")
    INTERNAL = (
        "internal-error",
        "drupe has an internal error ({}); please report it with traceback.txt from this fruit's results.",
    )

    @property
    def code(self) -> str:
        """The short name in the ranking's outcome column."""
        return str(self.value[0])

    def sentence(self, particulars: str = "") -> str:
        """What happened and what to do next."""
        return printable(str(self.value[1]).format(particulars))


class FruitEnded(Exception):
    """Raised inside a stage if a fruit cannot be graded, for one of these reasons."""

    def __init__(self, outcome: Outcome, particulars: str = "") -> None:
        self.outcome = outcome
        super().__init__(outcome.sentence(particulars))


def ending_of(error: BaseException) -> tuple[Outcome, str]:
    """The outcome of an unexpected exception, and its particulars.

    A full disk and a lack of memory are faults of the machine, whichever library reports them; else INTERNAL.
    """
    if isinstance(error, NotWritten):
        return Outcome.NOT_WRITTEN, str(error)
    if is_lack_of_memory(error):
        return Outcome.OUT_OF_MEMORY, str(error)
    if isinstance(error, OSError) and (number := _number(error)) in MACHINE_FAULTS:
        where = Path(str(error.filename or tempfile.gettempdir()))
        return Outcome.NOT_WRITTEN, str(NotWritten(where, OSError(number, os.strerror(number))))
    return Outcome.INTERNAL, f"{type(error).__name__}: {error}"


def _number(error: OSError) -> int:
    """The error's number, which HDF5 states only in its text; 0 if it is unknown."""
    said = re.search(r"errno = (\d+)", str(error))
    return error.errno or (int(said[1]) if said else 0)
