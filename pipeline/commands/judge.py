"""`drupe judge`."""

from datetime import UTC, datetime
from typing import Annotated

import typer
from typer import Argument, Option

from pipeline.commands.shared_options import (
    LanguageOption,
    MovedBatchOption,
    ResultsArgument,
    chosen_language,
)
from pipeline.safe_start import elsewhere


def judge(
    out: ResultsArgument,
    fruit: Annotated[str, Argument(metavar="FRUIT", help="The fruit_id.")],
    judged_class: Annotated[
        str, Option("--class", metavar="CLASS", help="Your class for the fruit; one of the batch's.")
    ],
    by: Annotated[str, Option("--by", metavar="NAME", help="Your name.")],
    why: Annotated[str, Option("--why", metavar="TEXT", help="Your reason, in a sentence.")],
    batch: MovedBatchOption = None,
    lang: LanguageOption = None,
) -> None:
    """Record a person's verdict on a fruit. It is shown next to E and never replaces E.

    OUT/verdicts.jsonl keeps every verdict with name, time (UTC), reason, version of drupe, and E at that
    time. drupe only adds to this file. A later grading keeps the verdicts and marks them as earlier. drupe
    then writes ranking.csv and report.html again.

    Exit status: 0 kept; 1 internal error; 2 usage or unreadable results; 130 interrupted.

    Example: drupe judge monday/results N01 --class firm --by "A. Huber" --why "hard at the suture"
    """
    language = chosen_language(lang)
    with elsewhere():
        from pipeline.batch.layout import Results
        from pipeline.run.judging import judge_fruit, language_of
        from pipeline.run.reporting import with_report
        from reports.words import with_sd
    results = Results(out)
    verdict = judge_fruit(results, fruit, judged_class=judged_class, by=by, why=why, now=datetime.now(UTC))
    E = f"E stays {with_sd(verdict.E_MPa, verdict.E_sd_MPa)} MPa" if verdict.E_MPa else "there is no E"
    typer.echo(
        f"{verdict.fruit_id}: {verdict.judged_class}, by {verdict.by} ({E}); kept in {results.verdicts}"
    )
    language = language if lang else language_of(results.report, language)
    for line in with_report(out, batch, language=language):
        typer.echo(line, err=True)
