"""`drupe report`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.language_option import LanguageOption, chosen_language
from pipeline.commands.table_options import ExcelOption, ParquetOption
from pipeline.exit_status import UNUSABLE
from pipeline.safe_start import elsewhere


def report(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Results of `drupe grade`.")],
    batch: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The batch, where it has moved since it was graded."),
    ] = None,
    provenance: Annotated[
        bool, typer.Option("--provenance", help="List the checksums of all inputs in the report.")
    ] = False,
    excel: ExcelOption = None,
    parquet: ParquetOption = False,
    lang: LanguageOption = None,
) -> None:
    """Make ranking.csv and report.html anew from what a run kept, for example after a change of classes.

    No fruit is computed. Of an interrupted run the page says how many fruit are done, and the exit status is
    3. Example: drupe report monday/results --provenance
    """
    with elsewhere():
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.batch_run import ReportOptions
        from pipeline.run.report_again import report_again
    language = chosen_language(lang)
    options = ReportOptions(checksums=provenance, excel=excel, parquet=parquet, language=language)
    entry = report_again(out, batch, options=options)
    if entry is None:
        typer.echo(f"{out}: not all fruit are done; `drupe grade` goes on. The page shows those that are.")
        raise typer.Exit(UNUSABLE)
    print_summary(entry, out, console=Console())
