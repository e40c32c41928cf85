"""`drupe history`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from pipeline.safe_start import elsewhere


def history(
    outs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[OUT]...", help="Folders of results, each of one `drupe grade`."),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            "--store", metavar="FILE", help="Keep batches here, and show those kept before (SQLite)."
        ),
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write the page for people here.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write a row per fruit and day here.")
    ] = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            "--fit",
            metavar="SCALE",
            help="Fit shore_oo or penetrometer_N against E, per cultivar, and keep it as a new version.",
        ),
    ] = None,
    convert: Annotated[
        list[str] | None,
        typer.Option(
            "--convert",
            metavar="SCALE[@N]",
            help="Predict these readings in the table by the last conversion kept, or by version N.",
        ),
    ] = None,
    forget: Annotated[
        list[str] | None,
        typer.Option(
            "--forget",
            metavar="BATCH_OR_LOT[/FRUIT]",
            help="Remove a batch (its name in the store or its folder), a lot, or one fruit from the store.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="With --forget: list what would be removed, and remove nothing.")
    ] = False,
) -> None:
    """Show how lots soften over days, when they reach a class, and whether the gripper drifts.

    Each day of a lot is a batch graded with the same lot and cultivar in batch.toml. An exponential is
    fitted to the days, with 90 % intervals of the rate and of the day on which the mean reaches each class.
    Example: drupe history monday/results thursday/results --store lots.sqlite --html history.html

    A batch that is graded again takes its own place: its latest results count, earlier ones are kept as
    revisions. --forget removes rows of the store and no other file.

    Exit status: 0 done, 1 internal error, 2 usage or results that cannot be read, 4 done, but reference
    bodies call for somebody.
    """
    with elsewhere():
        from pipeline.exit_status import DOUBTED
        from pipeline.history.history_summary import summary_lines
        from pipeline.history.keeping import HistoryWanted, forget_named, make_history

    wanted = HistoryWanted(
        store=store,
        html=html,
        csv=csv,
        fit=tuple(fit or ()),
        convert=tuple(convert or ()),
        forget=tuple(forget or ()),
    )
    if wanted.forget or dry_run:
        for line in forget_named(outs or [], wanted, dry_run=dry_run):
            typer.echo(line)
        return
    made = make_history(outs or [], wanted, now=datetime.now(UTC))
    for line in summary_lines(made, [path for path in (html, csv) if path is not None]):
        typer.echo(line)
    if made.entry.alarms:
        raise typer.Exit(DOUBTED)
