"""`drupe history`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from pipeline.commands.shared_options import (
    Aql,
    Inspection,
    LanguageOption,
    Level,
    LotSizes,
    OcFile,
    Variables,
    chosen_language,
)
from pipeline.safe_start import elsewhere


def history(
    outs: Annotated[
        list[Path] | None,
        Argument(metavar="[OUT]...", help="Results folders of `drupe grade`, one per batch."),
    ] = None,
    store: Annotated[
        Path | None,
        Option(
            "--store",
            metavar="FILE",
            help="Store the batches in this SQLite file, and include the batches already in it.",
        ),
    ] = None,
    html: Annotated[
        Path | None, Option("--html", metavar="FILE", help="Write the history as an HTML page to this file.")
    ] = None,
    lang: LanguageOption = None,
    export: Annotated[
        Path | None,
        Option(
            "--export",
            "--csv",
            metavar="FILE",
            help="Write a table with one row per fruit and day, with lot, dates and gripper. The ending says "
            "the format: .csv, .xlsx, .parquet or .json.",
        ),
    ] = None,
    statistics: Annotated[
        Path | None,
        Option(
            "--statistics",
            metavar="FILE",
            help="Write a table with the statistics of each lot, day and class, in the same formats.",
        ),
    ] = None,
    precision: Annotated[
        float,
        Option(
            "--precision",
            metavar="PERCENT",
            help="State how many fruit the mean of a lot needs for this half-width of its 90 % interval.",
        ),
    ] = 5.0,
    gauge: Annotated[
        list[str] | None,
        Option(
            "--gauge",
            metavar="KIND",
            help="Add a gauge R&R study: gripper or sensor. Fruit with the same id, lot and day, grasped at "
            "least twice with each, must be the same fruit.",
        ),
    ] = None,
    accept: Annotated[
        str,
        Option(
            "--accept",
            metavar="CLASS",
            help="Decide on each lot by a sampling plan (see drupe plan). Fruit of its last day outside this "
            "class are nonconforming. Needs --lot-size.",
        ),
    ] = "",
    lot_size: LotSizes = None,
    aql: Aql = 4.0,
    level: Level = "II",
    inspection: Inspection = "normal",
    variables: Variables = False,
    oc: OcFile = None,
    oecd: Annotated[
        int,
        Option(
            "--oecd",
            min=0,
            max=2,
            metavar="CHEEKS",
            help="State which fruit and cheeks each lot lacks for the OECD test of firmness: ten fruit of "
            "each size, two cheeks each. CHEEKS: cheeks that one recording presses, 1 or 2.",
        ),
    ] = 0,
    size_column: Annotated[
        str, Option("--size-column", metavar="NAME", help="With --oecd: your column with sizes.")
    ] = "",
    firmness: Annotated[
        list[str] | None,
        Option(
            "--firmness",
            metavar="COLUMN=UNIT@PLUNGER",
            help="Fit readings of a penetrometer in your column to E, for each cultivar: unit N, kgf or lbf, "
            'plunger 8mm or 11.1mm. Repeat it for a second cheek. Example: "cheek 1=kgf@8mm".',
        ),
    ] = None,
    forget: Annotated[
        list[str] | None,
        Option(
            "--forget",
            metavar="BATCH_OR_LOT[/FRUIT]",
            help="Remove a batch (by name or folder), a lot, or one fruit from the store.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="With --forget: list what drupe would remove, and remove nothing.")
    ] = False,
) -> None:
    """Show how lots soften over days, when they reach a class, and whether the gripper drifts.

    Each day of a lot is one graded batch. All days have the same lot and cultivar in batch.toml. drupe fits
    an exponential decay to the days. It reports 90 % intervals of the rate and of the day on which the mean
    reaches each class. It compares lots of one cultivar, and grippers and sensors that measured the same
    lots.

    If you grade a batch again, its newest results count, and the store keeps earlier ones as revisions.
    --forget removes rows from the store and changes no other file.

    Exit status: 0 done; 1 internal error; 2 usage or unreadable results; 4 done but a reference body failed
    its check; 130 interrupted.

    Example: drupe history monday/results thursday/results --store lots.sqlite --html history.html
    """
    with elsewhere():
        from pipeline.exit_status import DOUBTED
        from pipeline.files.plain_file import composed
        from pipeline.history.keeping import HistoryWanted, forget_named, make_history, summary_lines
        from pipeline.history.lot_acceptance import PlanWanted
        from pipeline.history.lot_quality import QualityWanted

    wanted = HistoryWanted(
        store=store,
        html=html,
        language=chosen_language(lang),
        export=export,
        statistics=statistics,
        precision=precision / 100,
        gauge=tuple(gauge or ()),
        forget=tuple(map(composed, forget or ())),
        oc=oc,
        quality=QualityWanted(
            accept=composed(accept),
            plan=PlanWanted(
                lot_size=tuple(map(composed, lot_size or ())),
                aql=aql,
                level=level,
                inspection=inspection,
                variables=variables,
            ),
            oecd=oecd,
            size_column=composed(size_column),
            firmness=tuple(map(composed, firmness or ())),
        ),
    )
    if wanted.forget or dry_run:
        for line in forget_named(outs or [], wanted, dry_run=dry_run):
            typer.echo(line)
        return
    made = make_history(outs or [], wanted, now=datetime.now(UTC))
    for line in summary_lines(made, [path for path in (html, export, statistics, oc) if path is not None]):
        typer.echo(line)
    if made.entry.alarms:
        raise typer.Exit(DOUBTED)
