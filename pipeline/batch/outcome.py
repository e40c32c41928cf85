"""Every ending that a fruit can come to, and the sentence that staff read.

A room's failure (recon, tactile, fem) brings its own code and sentence; the endings here are the
pipeline's own.
"""

import os
import re
import tempfile
from enum import Enum
from pathlib import Path

from pipeline.address_space import is_lack_of_memory
from pipeline.files.plain_file import printable
from pipeline.files.whole_file import MACHINE_FAULTS, NotWritten


class Outcome(Enum):
    """Code and sentence of an ending that no room speaks for; `{}` takes the particulars."""

    GRADED = ("graded", "")
    NO_GRASP = ("no-grasp", "No tactile recording in grasps/, so there is a mesh but no modulus; {}")
    ALL_GRASPS_FAILED = ("grasps-failed", "None of its recordings could be used: {}")
    NO_SHAPE = ("no-shape", "Neither photos nor fruit.ply found in {}; add one of the two.")
    NO_SCALE = (
        "no-scale",
        "Photos without a mat need the fruit's height for scale: fill height_mm in fruits.csv, "
        "or photograph on a marker mat and put mat.json beside batch.toml ({}).",
    )
    IMPLAUSIBLE_INPUT = (
        "implausible-input",
        "{} Correct it; if it is right, `drupe grade --force` grades the fruit all the same.",
    )
    IMPLAUSIBLE_PIT = ("implausible-pit", "{} Put the fruit's own pit there, in the fruit's frame and mm.")
    IMPLAUSIBLE_MODULUS = (
        "implausible-modulus",
        "E would be {}, which no flesh of this category has: look for a unit or a factor in forces, "
        "displacements and meshes.",
    )
    WITHHELD_MODULUS = (
        "withheld-modulus",
        "E is not given: {}. `drupe explain` says what the recordings show.",
    )
    CRASHED = (
        "crashed",
        "The process working on this fruit died ({}); the other fruit are not touched. Run the same command "
        "again; if it dies again, take this fruit's inputs to the maintainers.",
    )
    TIMED_OUT = ("timed-out", "Took longer than the limit of {} s; raise it with --time-limit.")
    OUT_OF_MEMORY = (
        "out-of-memory",
        "Ran out of memory ({}); run with fewer --jobs, or close other programs.",
    )
    NOT_WRITTEN = ("not-written", "A result could not be written: {} Then run the same command again.")
    INTERNAL = (
        "internal-error",
        "A fault of drupe itself ({}); please report it with traceback.txt from this fruit's results.",
    )

    @property
    def code(self) -> str:
        """The short name in the ranking's outcome column."""
        return str(self.value[0])

    def sentence(self, particulars: str = "") -> str:
        """What happened and what to do next."""
        return printable(str(self.value[1]).format(particulars))


class FruitEnded(Exception):
    """Raised inside a stage when a fruit can go no further for a reason that is the pipeline's own."""

    def __init__(self, outcome: Outcome, particulars: str = "") -> None:
        self.outcome = outcome
        super().__init__(outcome.sentence(particulars))


def ending_of(error: BaseException) -> tuple[Outcome, str]:
    """The ending that an exception nobody expected comes to, and its particulars.

    A full disk and a lack of memory are the machine's, whichever library met them; the rest is drupe's own.
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
    """The error's number; HDF5 says it in its text alone."""
    said = re.search(r"errno = (\d+)", str(error))
    return error.errno or (int(said[1]) if said else 0)
