"""`drupe explain`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.machine import cores, require_libraries
from pipeline.exit_status import DOUBTED, INTERRUPTED, UNUSABLE
from pipeline.safe_start import elsewhere, load

MOST_EXPLAINING = 4
"""Jobs unless told otherwise: there are seldom more recordings to work on at once, and each costs memory."""
LOADED_LATE = ("open3d", "pymeshlab")
"""Libraries that rooms import when they need them, where the current folder may be a stranger's."""


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
    batch's fruit, what belongs to it among the results (--out; BATCH/results without): mismatch.json, which a
    later `drupe grade` puts into its table, and shape and pictures, made anew where they are not there yet.

    Exit status: 0 an answer was given (whatever it says), 1 internal error, 2 usage or settings, 3 the fruit
    or its recordings could not be used, 4 an answer was given but its E is in doubt, 130 interrupted.
    """
    require_libraries()
    with elsewhere():
        load(*LOADED_LATE)
        from pipeline.diagnosis.explaining import ExplainOutputs, NotExplained
        from pipeline.diagnosis.explaining import explain as explain_case
        from pipeline.diagnosis.terminal_summary import print_explanation
        from pipeline.run.progress import StageLines

    console = Console(stderr=True)
    try:
        found = explain_case(
            case,
            fruit_id=fruit,
            wanted=ExplainOutputs(json=json, html=html, work=work, out=out, apply=apply),
            report=StageLines(console).stage,
            jobs=jobs or min(cores(), MOST_EXPLAINING),
        )
    except NotExplained as reason:
        typer.echo(f"drupe: {case}: {reason}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; no answer was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    print_explanation(found, [path for path in (json, html) if path], console=Console())
    if found.doubts:
        raise typer.Exit(DOUBTED)
