"""The `drupe` command: its subcommands (pipeline/commands), and message and exit status of every error."""

import pipeline.safe_start  # noqa: F401 - first of all: the current folder may be a stranger's

# isort: split
import errno
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, TextIO, cast

import typer
from typer.core import TyperGroup

from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.scratch import PREFIX
from pipeline.commands.calibrate import calibrate
from pipeline.commands.check import check
from pipeline.commands.convert import convert
from pipeline.commands.device import device
from pipeline.commands.doctor import doctor
from pipeline.commands.explain import explain
from pipeline.commands.firmness import firmness
from pipeline.commands.grade import grade
from pipeline.commands.history import history
from pipeline.commands.judge import judge
from pipeline.commands.mat import mat
from pipeline.commands.new import new
from pipeline.commands.plan import plan
from pipeline.commands.report import report
from pipeline.commands.robot import robot
from pipeline.commands.sample import sample
from pipeline.commands.schema import schema
from pipeline.commands.sensor import sensor
from pipeline.commands.watch import watch
from pipeline.exit_status import INTERNAL, INTERRUPTED, USAGE
from pipeline.files.limited_memory import free_memory_MiB
from pipeline.files.plain_file import printable
from pipeline.files.whole_file import NotWritten
from pipeline.interruption import SAID, ended_like_ctrl_c
from pipeline.lack_of_memory import is_lack_of_memory, too_little_memory
from pipeline.problem import BatchRefused, plain_message
from reports.language import ENGLISH, of_environment, spoken
from reports.messages import message

CLOCK = re.compile(r"^\s*\[[\d:]+\] ")
"""The time since the start before a line of progress."""


class _Translated:
    """A stream that translates each line written to it to `language`, if a catalogue has the line."""

    def __init__(self, stream: TextIO, language: str) -> None:
        self._stream, self._language = stream, language

    def write(self, text: str | bytes) -> int:
        """Writes the lines of the text, each translated. Raises TypeError for bytes, as the stream does."""
        if isinstance(text, bytes):
            raise TypeError("expected text")
        with spoken(self._language):
            lines = [_translated(line) for line in text.splitlines(keepends=True)]
        self._stream.write("".join(lines))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def in_language_of_locale() -> Iterator[None]:
    """Inside the block, standard output and standard error are in the locale's language."""
    if (language := of_environment()) == ENGLISH:
        yield
        return
    out, err = (cast("TextIO", _Translated(stream, language)) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        yield


def _translated(line: str) -> str:
    """The translated line; its indent, the time before it and its end are not part of the sentence and stay.

    >>> _translated("  [01:32] wrote a.csv\\n")
    '  [01:32] wrote a.csv\\n'
    """
    text = CLOCK.sub("", line).strip()
    return line.replace(text, message(text), 1) if text else line


class _Commands(TyperGroup):
    """The subcommands; messages on wrong options omit the prefix of the library that checks them."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the command. Raises typer.BadParameter for a wrong option."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:  # which typer would end without a word
            typer.echo(SAID, nl=False, err=True)
            raise typer.Exit(INTERRUPTED) from None
        except typer.BadParameter as error:
            error.message = plain_message(error.message)
            raise


app = typer.Typer(
    name="drupe",
    cls=_Commands,
    help="Rank stone fruit by ripeness without cutting them. drupe computes the modulus E of the "
    "flesh from photos and a tactile grasp of each fruit.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
OF_A_PLACE = frozenset(
    {
        errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENAMETOOLONG,
        errno.EEXIST, errno.ENOTEMPTY, errno.ESTALE,
    }
)  # fmt: skip
"""System error numbers that state what is wrong with a path from the user."""
OF_THE_MACHINE = frozenset({errno.EMFILE, errno.ENFILE, errno.EAGAIN})
"""System error numbers for a lack of open files or processes."""


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"drupe {metadata.version('drupe')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


COMMANDS: dict[Callable[..., None], str] = {
    new: "Create a batch from folders of photos.",
    grade: "Grade a batch: write the ranking and the report.",
    watch: "Grade fruit as their files arrive; show the latest one.",
    check: "Check a batch for problems without computing.",
    explain: "Find physics that the model misses in a fruit's recordings.",
    report: "Rebuild ranking and report from stored results.",
    judge: "Record a person's verdict on a fruit, next to its E.",
    history: "Show how lots soften over days and when they are ready.",
    firmness: "Simulate plates, FirmTech, a ball and S368.4 on each fruit.",
    plan: "Show how many fruit of a lot to inspect.",
    convert: "Convert gel frames, tables or other formats to a recording.",
    calibrate: "Calibrate a sensor, or measure a rig's compliance.",
    sensor: "Write the description of a commercial sensor.",
    robot: "Find where the marker mat lies in a robot's base.",
    mat: "Write the marker mat (PDF to print) and its mat.json.",
    sample: "Write a synthetic batch with known answers.",
    schema: "Print the JSON schema of batch.toml, for editors.",
    doctor: "Check whether this machine can grade.",
}
"""Subcommands, each with its line in the overview, which is 80 columns wide."""
for command, in_short in COMMANDS.items():
    app.command(short_help=in_short)(command)
app.add_typer(device, name="device", short_help="Manage devices that may open the page of drupe watch.")


def _not_ours(error: Exception) -> str:
    """A sentence on an error that the user can fix, empty for a fault of drupe. The user can fix a full disk,
    a lack of memory, files or processes, and a path outside drupe's installation and temporary files.
    """
    ending, said = ending_of(error)
    if ending is Outcome.NOT_WRITTEN:
        return said
    if is_lack_of_memory(error):
        return f"this machine: {too_little_memory(free_memory_MiB())}"
    if isinstance(error, OSError) and error.errno in OF_THE_MACHINE:
        return f"this machine: {os.strerror(error.errno)}; close other programs."
    if not (isinstance(error, OSError) and error.errno in OF_A_PLACE and error.filename):
        return ""
    place = Path(os.fsdecode(error.filename)).absolute()
    own_folders = (Path(__file__).parent, Path(sys.prefix), Path(sys.base_prefix, "lib"))
    if any(place.is_relative_to(folder) for folder in own_folders) or any(
        p.startswith(PREFIX) for p in place.parts
    ):
        return ""
    named = printable(os.fsdecode(error.filename))
    return f"{named}: {error.strerror}; correct the name, or ask for permission to read and write there."


def main() -> None:
    """Runs the command, and writes its output in the locale's language."""
    with in_language_of_locale():
        _run()


def _run() -> None:
    """Runs the command. An error that a user can fix becomes a line on standard error, no traceback."""
    came: list[int] = []
    try:
        with ended_like_ctrl_c() as came:
            app(prog_name="drupe")
    except KeyboardInterrupt:
        sys.stderr.write(SAID)
        sys.exit(INTERRUPTED)
    except NotWritten as fault:
        sys.stderr.write(f"drupe: {fault}\n")
        sys.exit(USAGE)
    except BatchRefused as refused:
        for problem in refused.problems:
            named = problem.file.startswith("drupe ")  # a command, such as drupe new
            sys.stderr.write(f"{'' if named else 'drupe: '}{problem}\n")
        sys.exit(USAGE)
    except Exception as error:  # noqa: BLE001 - the last door: a fault of ours is said as one
        if came:
            sys.stderr.write(SAID)
            sys.exit(INTERRUPTED)
        if said := _not_ours(error):
            sys.stderr.write(f"drupe: {said}\n")
            sys.exit(USAGE)
        if os.environ.get("DRUPE_DEBUG"):
            traceback.print_exc()
        sys.stderr.write(
            f"drupe: internal error: {type(error).__name__}: {error}; set DRUPE_DEBUG=1 to see the "
            "traceback, and please report it\n"
        )
        sys.exit(INTERNAL)
