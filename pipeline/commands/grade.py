"""`drupe grade`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.batch_argument import BatchArgument
from pipeline.commands.language_option import LanguageOption, chosen_language
from pipeline.commands.machine import cores, require_libraries
from pipeline.commands.output_options import LogOption, QuietOption, VerboseOption
from pipeline.commands.table_options import ExcelOption, ParquetOption
from pipeline.exit_status import INTERRUPTED
from pipeline.safe_start import elsewhere


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
    screen: Annotated[
        bool,
        typer.Option(help="Screen every fruit for physics that the model leaves out (about 10 s each)."),
    ] = True,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Grade on several machines: the address of the program that hands fruit out to them, a "
            "scheduler of dask (tcp://node1:8786). BATCH and OUT must lie on a file system that all share.",
        ),
    ] = None,
    slurm: Annotated[
        bool,
        typer.Option(
            "--slurm",
            help="Grade on a computing cluster whose machines Slurm gives out, in as many of its jobs as "
            "--jobs says, one fruit at a time each.",
        ),
    ] = False,
    tls: Annotated[
        bool,
        typer.Option(
            "--tls/--no-tls",
            help="Encrypt what jobs of --slurm and this command send each other, and let nobody else join.",
        ),
    ] = True,
    provenance: Annotated[
        bool,
        typer.Option("--provenance", help="List the checksums of all inputs in the report (for an annex)."),
    ] = False,
    excel: ExcelOption = None,
    parquet: ParquetOption = False,
    lang: LanguageOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    log: LogOption = None,
) -> None:
    """Grade a batch: photos and grasps of every fruit become ranking.csv and report.html.

    A second run does only what is missing or changed. Exit status: 0 all graded, 1 internal error, 2 usage or
    settings, 3 some fruit not graded, 4 all graded but some E in doubt (or the reference bodies or their
    chart call for somebody), 130 interrupted.
    """
    require_libraries()
    language = chosen_language(lang)
    with elsewhere():
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.batch_run import ReportOptions
        from pipeline.run.console import RunConsole
        from pipeline.run.engines import WorkPlace
        from pipeline.run.grading import grade as grade_batch

    try:
        status, entry = grade_batch(
            batch,
            out,
            jobs=jobs or cores(),
            time_limit_s=time_limit,
            console=RunConsole(quiet=quiet, verbose=verbose, log=log),
            force=force,
            screen=screen,
            place=WorkPlace(jobs=jobs, scheduler=scheduler, slurm=slurm, tls=tls),
            options=ReportOptions(checksums=provenance, excel=excel, parquet=parquet, language=language),
        )
    except KeyboardInterrupt:
        typer.echo(
            "drupe: interrupted; finished fruit are kept, the same command goes on from here", err=True
        )
        raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        print_summary(entry, out or batch / "results", console=Console())
    raise typer.Exit(status)
