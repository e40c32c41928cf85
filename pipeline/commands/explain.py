"""`drupe explain`."""

from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from typer import Argument, Option

from pipeline.commands.endings import cores, exit_when_interrupted, require_libraries
from pipeline.commands.shared_options import LanguageOption, chosen_language
from pipeline.exit_status import DOUBTED, UNUSABLE
from pipeline.safe_start import elsewhere

MOST_EXPLAINING = 4
"""Default limit of jobs: a fruit seldom has more recordings, and each job needs memory."""
LOADED_LATE = ("open3d", "pymeshlab")
"""Libraries that other packages import late, when the current folder may hold a stranger's modules."""


def explain(
    case: Annotated[
        Path,
        Argument(
            metavar="BATCH",
            help="A batch (with --fruit), a fruit's folder in it, or a case (case.toml, fruit.ply, pit.ply, "
            "*.h5).",
        ),
    ],
    fruit: Annotated[
        str | None, Option("--fruit", metavar="ID", help="The fruit to explain, if BATCH is a batch.")
    ] = None,
    json: Annotated[
        Path | None, Option("--json", metavar="FILE", help="Write the answer as JSON to this file.")
    ] = None,
    html: Annotated[
        Path | None, Option("--html", metavar="FILE", help="Write the answer as an HTML page to this file.")
    ] = None,
    apply: Annotated[
        bool,
        Option(
            "--apply",
            help="Write the effect into batch.toml for `drupe grade`. This needs a single effect "
            "that improves the prediction of held-out recordings; otherwise drupe says why not.",
        ),
    ] = False,
    work: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Keep meshes in this folder, for a second run of the case.",
            show_default="no folder",
        ),
    ] = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="The batch's results folder.", show_default="BATCH/results")
    ] = None,
    jobs: Annotated[
        int | None,
        Option(
            min=1,
            help="Number of grasps and effects to compute in parallel. Each needs memory.",
            show_default=f"one per core, at most {MOST_EXPLAINING}",
        ),
    ] = None,
    lang: LanguageOption = None,
) -> None:
    """Find physics that the model misses in one fruit's recordings: what, where, when and how certain.

    drupe fits all recordings of the fruit together. Four recordings that differ in place, speed and hold
    distinguish most effects. Each should start with frames in the air. The verdict is "none", one effect,
    several indistinguishable effects, or "unknown".

    drupe writes the files that you name. For a fruit of a batch it also writes mismatch.json into the
    results, and missing shapes and pictures. `drupe report` and the next `drupe grade` show its verdict in
    their tables.

    Exit status: 0 answered; 1 internal error; 2 usage or settings; 3 unusable fruit or recordings; 4
    answered but E is in doubt; 130 interrupted.

    Example: drupe explain monday --fruit 7 --html fruit7.html
    """
    language = chosen_language(lang)
    require_libraries()
    with elsewhere():
        for library in LOADED_LATE:
            with suppress(ImportError):  # an optional library
                import_module(library)
        from pipeline.diagnosis.explaining import ExplainOutputs, NotExplained
        from pipeline.diagnosis.explaining import explain as explain_case
        from pipeline.diagnosis.terminal_summary import print_explanation
        from pipeline.run.progress import StageLines

    console = Console(stderr=True)
    try:
        with exit_when_interrupted("; drupe wrote no answer"):
            explanation = explain_case(
                case,
                fruit_id=fruit,
                wanted=ExplainOutputs(
                    json=json, html=html, work=work, out=out, apply=apply, language=language
                ),
                report=StageLines(console).stage,
                jobs=jobs or min(cores(), MOST_EXPLAINING),
            )
    except NotExplained as reason:
        typer.echo(f"drupe: {case}: {reason}", err=True)
        raise typer.Exit(UNUSABLE) from None
    written = [path for path in (json, html) if path]
    print_explanation(explanation, written, console=Console())
    if explanation.doubts:
        raise typer.Exit(DOUBTED)
