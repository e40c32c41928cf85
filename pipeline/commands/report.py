"""`drupe report`."""

import typer
from rich.console import Console

from pipeline.commands.shared_options import (
    ChecksumsOption,
    ExcelOption,
    LanguageOption,
    MovedBatchOption,
    ParquetOption,
    ResultsArgument,
    chosen_language,
)
from pipeline.exit_status import UNUSABLE
from pipeline.safe_start import elsewhere


def report(
    out: ResultsArgument,
    batch: MovedBatchOption = None,
    provenance: ChecksumsOption = False,
    excel: ExcelOption = None,
    parquet: ParquetOption = False,
    lang: LanguageOption = None,
) -> None:
    """Rebuild ranking.csv and report.html from stored results, for example after you change the classes.

    drupe computes no fruit. After an interrupted run the page shows the number of finished fruit, and the
    exit status is 3.

    Example: drupe report monday/results --provenance
    """
    with elsewhere():
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.batch_run import ReportOptions
        from pipeline.run.report_again import report_again
    language = chosen_language(lang)
    options = ReportOptions(checksums=provenance, excel=excel, parquet=parquet, language=language)
    entry = report_again(out, batch, options=options)
    if entry is None:
        typer.echo(
            f"{out}: some fruit are not graded yet; run `drupe grade` to continue. The page "
            "shows the finished fruit."
        )
        raise typer.Exit(UNUSABLE)
    print_summary(entry, out, console=Console())
