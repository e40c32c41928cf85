"""`drupe report`."""

import typer
from rich.console import Console

from pipeline.commands.shared_options import (
    LanguageOption,
    MovedBatchOption,
    ResultsArgument,
    chosen_language,
)
from pipeline.exit_status import UNUSABLE
from pipeline.safe_start import elsewhere


def report(out: ResultsArgument, batch: MovedBatchOption = None, lang: LanguageOption = None) -> None:
    """Rebuild ranking.csv and report.html from stored results, for example after you change the classes.

    drupe computes no fruit. After an interrupted run the page shows the number of finished fruit.

    Exit status: 0 written; 1 internal error; 2 usage or unreadable results; 3 some fruit not graded yet;
    130 interrupted.

    Example: drupe report monday/results --lang de
    """
    with elsewhere():
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.reporting import report_again
    entry = report_again(out, batch, language=chosen_language(lang))
    if entry is None:
        typer.echo(
            f"{out}: some fruit are not graded yet; run `drupe grade` to continue. The page "
            "shows the finished fruit."
        )
        raise typer.Exit(UNUSABLE)
    print_summary(entry, out, console=Console())
