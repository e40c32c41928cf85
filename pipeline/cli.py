"""The `drupe` command."""

from pipeline.safe_start import elsewhere, load  # first of all: the current folder may be a stranger's

# isort: split
import errno
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.outcome import Outcome, ending_of
from pipeline.paper import Paper
from pipeline.problem import BatchRefused, Problem
from pipeline.scratch import PREFIX
from pipeline.system_libraries import missing_libraries
from pipeline.whole_file import NotWritten
from recon.plain_file import printable

app = typer.Typer(
    name="drupe",
    help="How ripe stone fruit is, without cutting it: photos and a grasp per fruit become a ranking.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
BatchArgument = Annotated[
    Path, typer.Argument(metavar="BATCH", help="A folder with batch.toml and fruits.csv.")
]
USAGE, INTERNAL, UNUSABLE, DOUBTED, INTERRUPTED = 2, 1, 3, 4, 130
OF_A_PLACE = frozenset(
    {
        errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENAMETOOLONG,
        errno.EEXIST, errno.ENOTEMPTY, errno.ESTALE,
    }
)  # fmt: skip
"""Errors of the system that say what is wrong with a place that a user named."""
OF_THE_MACHINE = frozenset({errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN})
"""And that it has no more of: memory, open files, processes."""
MOST_EXPLAINING = 4
"""Jobs of `drupe explain` unless told otherwise: more than recordings are seldom of use, and cost memory."""
LOADED_LATE = ("open3d", "pymeshlab")
"""Libraries that rooms import when they need them, where the current folder may be a stranger's."""


class Indenter(StrEnum):
    """The tip of a bare press."""

    BALL = "ball"
    FLAT = "flat"
    PLATE = "plate"


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"drupe {metadata.version('drupe')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


@app.command()
def grade(
    batch: BatchArgument,
    out: Annotated[Path | None, typer.Option(help="Where results go.", show_default="BATCH/results")] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Fruit worked on at the same time.", show_default="one per core"),
    ] = None,
    time_limit: Annotated[
        float, typer.Option(min=1, help="Seconds that one fruit may take before it is given up.")
    ] = 1800,
    force: Annotated[
        bool,
        typer.Option("--force", help="Grade in spite of numbers that no fruit of the category has."),
    ] = False,
) -> None:
    """Grade a batch: photos and grasps of every fruit become ranking.csv and report.html.

    A second run does only what is missing or changed. Exit status: 0 all graded, 1 internal error, 2 usage or
    settings, 3 some fruit not graded, 4 all graded but some E in doubt (or the reference bodies or their
    chart call for somebody), 130 interrupted.
    """
    _require_libraries()
    with elsewhere():
        from pipeline.grade import grade as grade_batch
        from pipeline.summary import print_summary

    try:
        status, entry = grade_batch(
            batch,
            out,
            jobs=jobs or _cores(),
            time_limit_s=time_limit,
            console=Console(stderr=True),
            force=force,
        )
    except KeyboardInterrupt:
        typer.echo(
            "drupe: interrupted; finished fruit are kept, the same command goes on from here", err=True
        )
        raise typer.Exit(INTERRUPTED) from None
    print_summary(entry, out or batch / "results", console=Console())
    raise typer.Exit(status)


@app.command()
def check(batch: BatchArgument) -> None:
    """Say everything that is wrong with a batch, without computing.

    Problems stop the batch or a fruit of it; what leaves a fruit its E, with a wider error bar, is marked
    "E will be in doubt". Exit status: 0 nothing found, 2 problems found, 4 no problem but some E will be in
    doubt (as `drupe grade` ends then).
    """
    _require_libraries()
    with elsewhere():
        from pipeline.check import check as check_batch
    with _said_when_interrupted(""):
        found = check_batch(batch)
    for one in found:
        typer.echo(f"{one}")
    doubts = sum(one.doubtful for one in found)
    problems = len(found) - doubts
    more = f", and {_so_many(doubts, 'finding')} that will put E in doubt" if doubts else ""
    typer.echo(f"{_so_many(problems, 'problem')} found in {batch}{more}")
    raise typer.Exit(USAGE if problems else DOUBTED if doubts else 0)


@app.command()
def explain(
    case: Annotated[
        Path,
        typer.Argument(
            metavar="CASE",
            help="A case (case.toml, fruit.ply, pit.ply, *.h5), a fruit's folder in a batch, or a batch.",
        ),
    ],
    fruit: Annotated[
        str | None, typer.Option("--fruit", metavar="ID", help="Which fruit, where CASE is a batch.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the answer for programs here.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write the page for people here.")
    ] = None,
    apply: Annotated[
        bool,
        typer.Option(
            "--apply",
            help="Write the effect into the batch's batch.toml, for `drupe grade`, where it is one name and "
            "helps recordings that the fit did not see; else say why not.",
        ),
    ] = False,
    work: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Keep meshes here for a second run of a case.", show_default="nothing is kept"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where a batch's results are.", show_default="BATCH/results"),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Grasps and effects worked on at the same time; memory grows with each.",
            show_default=f"one per core, at most {MOST_EXPLAINING}",
        ),
    ] = None,
) -> None:
    """Say what physics the simulation leaves out of one fruit's recordings, where, when, and how surely.

    All recordings of the fruit are looked at together; four that differ in place, speed and hold, each with
    frames in the air before it, tell most effects apart. The verdict is "none", one effect, several that
    these recordings cannot tell apart, or "unknown". Nothing is written but the files asked for and, for a
    batch's fruit, mismatch.json among its results, which a later `drupe grade` puts into its table.

    Exit status: 0 an answer was given (whatever it says), 1 internal error, 2 usage or settings, 3 the fruit
    or its recordings could not be used, 130 interrupted.
    """
    _require_libraries()
    with elsewhere():
        load(*LOADED_LATE)
        from pipeline.explain import NO_ANSWER, NotExplained, Wanted
        from pipeline.explain import explain as explain_case
        from pipeline.explain_summary import print_explanation
        from pipeline.progress import StageLines

    console = Console(stderr=True)
    try:
        found = explain_case(
            case,
            fruit_id=fruit,
            wanted=Wanted(json=json, html=html, work=work, out=out, apply=apply),
            report=StageLines(console).stage,
            jobs=jobs or min(_cores(), MOST_EXPLAINING),
        )
    except NotExplained as reason:
        typer.echo(f"drupe: {case}: {reason}", err=True)
        raise typer.Exit(NO_ANSWER) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; no answer was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    print_explanation(found, [path for path in (json, html) if path], console=Console())


@app.command()
def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A raw grasp (folder with grasp.toml), Tac3D arrays, .h5 with images, .npz or .csv.",
        ),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.h5", help="The recording to write.")],
    sensor: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The sensor's description, for every pad.")
    ] = None,
    fruit: Annotated[
        str, typer.Option(metavar="ID", help="Whose recording, where SOURCE does not say.")
    ] = "unknown",
    category: Annotated[str, typer.Option(help="Kind of fruit, where SOURCE does not say.")] = "unknown",
    indenter: Annotated[Indenter | None, typer.Option(help="Of a bare load cell's trace.")] = None,
    radius_mm: Annotated[float | None, typer.Option(min=0.001, help="The indenter's radius.")] = None,
) -> None:
    """Turn frames, tables or another maker's files into a recording that grade and explain read.

    What was noticed on the way (lost frames, torn markers, clocks apart, ...) is said. OUT.h5 appears whole
    or not at all. Exit status: 0 written, 1 internal error, 2 usage, 3 SOURCE cannot be used, 130
    interrupted.
    """
    with elsewhere():
        from pipeline.convert import Wanted
        from pipeline.convert import convert as convert_source
        from pipeline.progress import StageLines
        from tactile.failure import TactileFailure

    wanted = Wanted(
        sensor=sensor,
        fruit_id=fruit,
        category=category,
        indenter=indenter.value if indenter else None,
        radius_mm=radius_mm,
    )
    try:
        notes = convert_source(source, out, wanted, report=StageLines(Console(stderr=True)).stage)
    except TactileFailure as reason:
        typer.echo(f"drupe: {_about(source, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for note in notes:
        typer.echo(f"note: {note}")
    typer.echo(f"wrote {out}")


@app.command()
def calibrate(
    sensor: Annotated[
        Path, typer.Argument(metavar="SENSOR.toml", help="The sensor's description as far as it is known.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.toml", help="The description to write.")],
    ball_mm: Annotated[float | None, typer.Option(min=0.001, help="Radius of the ball pressed in.")] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture of the untouched gel, for the ball.")
    ] = None,
    press: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="A picture of the ball in the gel (repeat).")
    ] = None,
    load_cell: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A raw press (grasp.toml, log.csv with fx_N to fz_N, frames)."),
    ] = None,
) -> None:
    """Complete a sensor's description from presses: slopes from a ball, stiffness from a load cell.

    A ball of known radius gives a photometric sensor's look-up of slopes (written beside OUT.toml), a press
    with the machine's load cell the gel's modulus. Exit status: 0 written, 1 internal error, 2 usage, 3 a
    press cannot be used, 130 interrupted.
    """
    with elsewhere():
        from pipeline.calibrate import Presses
        from pipeline.calibrate import calibrate as calibrate_sensor
        from pipeline.progress import StageLines
        from tactile.failure import TactileFailure

    presses = Presses(ball_mm=ball_mm, reference=reference, ball=tuple(press or ()), load_cell=load_cell)
    try:
        said = calibrate_sensor(sensor, out, presses, report=StageLines(Console(stderr=True)).stage)
    except TactileFailure as reason:
        typer.echo(f"drupe: {_about(sensor, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for line in said:
        typer.echo(line)
    typer.echo(f"wrote {out}")


@app.command()
def mat(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where mat.pdf and mat.json are written.")
    ] = Path(),
    paper: Annotated[Paper, typer.Option(help="The sheet it is printed on.")] = Paper.A4,
    cherry: Annotated[bool, typer.Option("--cherry", help="Half-size tags and blank, for cherries.")] = False,
) -> None:
    """Write the marker mat: mat.pdf to print at 100 %, and the mat.json that goes beside batch.toml."""
    with elsewhere():
        from pipeline.mat import write_mat
    with _said_when_interrupted(""):
        written = write_mat(folder, paper=paper, cherry=cherry)
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo("print the PDF at 100 %, measure its bar, and copy mat.json beside batch.toml")


@app.command()
def sample(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder that does not exist yet, or is empty.")
    ],
    name: Annotated[str, typer.Option(help="Which shipped batch.")] = "nectarines",
    seed: Annotated[
        int | None, typer.Option(min=0, help="Generate new fruit from this seed instead of the shipped ones.")
    ] = None,
    fruits: Annotated[
        int | None,
        typer.Option(min=1, max=500, help="How many fruit to generate.", show_default="4"),
    ] = None,
    photos: Annotated[
        bool, typer.Option(help="Render photos (needs the extra [samples]); without: ready meshes.")
    ] = True,
) -> None:
    """Write a synthetic batch with known answers (answers.json): a shipped one, or new from a seed."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BatchRefused([Problem(str(folder), "is not empty; give a folder that does not exist yet.")])
    if seed is None and (fruits is not None or not photos):
        raise BatchRefused(
            [Problem("sample", "--fruits and --no-photos are for new fruit; give a --seed too.")]
        )
    with elsewhere():
        from pipeline.sample import write_sample
    with _said_when_interrupted("; nothing was written"):
        write_sample(
            folder, name=name, seed=seed, fruits=fruits or 4, photos=photos, console=Console(stderr=True)
        )
    typer.echo(f"wrote {folder}; grade it with: drupe grade {folder}")


def _about(path: Path, reason: Exception) -> str:
    """The reason, with the path in front where it does not begin with it."""
    said = str(reason)
    named = [f"{name}{mark}" for name in (str(path), path.name) if name for mark in ":/ "]
    return said if said.startswith(tuple(named)) else f"{path}: {said}"


def _so_many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _said_when_interrupted(what_is_left: str) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"drupe: interrupted{what_is_left}", err=True)
        raise typer.Exit(INTERRUPTED) from None


@contextmanager
def _ended_like_ctrl_c() -> Iterator[None]:
    """Being told to end (SIGTERM, a terminal that is closed) is an interruption; a second time, the end."""

    def interrupt(number: int, _frame: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    told = [
        number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL
    ]
    for number in told:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in told:
            signal.signal(number, signal.SIG_DFL)


def _require_libraries() -> None:
    if missing := missing_libraries():
        raise BatchRefused([Problem("this machine", sentence) for sentence in missing])


def _not_ours(error: Exception) -> str:
    """What a user can mend, as a sentence: a full disk, too little memory, or a place that is neither of the
    installation nor of drupe's own temporary files; empty for anything else, which is a fault of drupe.
    """
    ending, said = ending_of(error)
    if ending is Outcome.NOT_WRITTEN:
        return said
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in OF_THE_MACHINE):
        return f"this machine: {os.strerror(getattr(error, 'errno', errno.ENOMEM))}; close other programs."
    if not (isinstance(error, OSError) and error.errno in OF_A_PLACE and error.filename):
        return ""
    place = Path(os.fsdecode(error.filename)).absolute()
    own = (Path(__file__).parent, Path(sys.prefix), Path(sys.base_prefix, "lib"))
    if any(place.is_relative_to(one) for one in own) or any(p.startswith(PREFIX) for p in place.parts):
        return ""
    named = printable(os.fsdecode(error.filename))
    return f"{named}: {error.strerror}; correct the name, or ask for the right to read and write there."


def main() -> None:
    """Runs the command; every error that a user can mend is one line on standard error, never a traceback."""
    try:
        with _ended_like_ctrl_c():
            app(prog_name="drupe")
    except KeyboardInterrupt:
        sys.stderr.write("drupe: interrupted\n")
        sys.exit(INTERRUPTED)
    except NotWritten as fault:
        sys.stderr.write(f"drupe: {fault}\n")
        sys.exit(USAGE)
    except BatchRefused as refused:
        for problem in refused.problems:
            sys.stderr.write(f"drupe: {problem}\n")
        sys.exit(USAGE)
    except Exception as error:  # noqa: BLE001 - the last door: a fault of ours is said as one
        if said := _not_ours(error):
            sys.stderr.write(f"drupe: {said}\n")
            sys.exit(USAGE)
        if os.environ.get("DRUPE_DEBUG"):
            traceback.print_exc()
        sys.stderr.write(
            f"drupe: internal error: {type(error).__name__}: {error}; "
            "set DRUPE_DEBUG=1 to see where, and please report it\n"
        )
        sys.exit(INTERNAL)
