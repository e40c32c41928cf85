"""`drupe firmness`."""

from datetime import UTC, datetime
from typing import Annotated

import typer
from typer import Option

from pipeline.commands.shared_options import (
    LanguageOption,
    MovedBatchOption,
    ResultsArgument,
    chosen_language,
)
from pipeline.problem import refused
from pipeline.safe_start import elsewhere


def firmness(
    out: ResultsArgument,
    chord: Annotated[
        tuple[float, float],
        Option("--chord", metavar="LOW HIGH", help="The two forces of your FirmTech, in gf."),
    ] = (50.0, 350.0),
    ball_force: Annotated[
        float, Option("--ball-force", metavar="N", help="Force on the 5 mm ball, in N.")
    ] = 1.0,
    limit: Annotated[
        list[str] | None,
        Option(
            "--limit",
            metavar="TEST=VALUE",
            help="A limit in a test's unit: drupe states the E at which these fruit read it. Repeatable.",
        ),
    ] = None,
    lang: LanguageOption = None,
    batch: MovedBatchOption = None,
) -> None:
    """Simulate standard firmness tests on each graded fruit: plates, FirmTech, a 5 mm ball, ASAE S368.4.

    drupe presses the fruit's own mesh and pit with its E, and states each reading with its error. It writes
    OUT/firmness.csv and OUT/firmness.html after each fruit. At the end the readings become columns of the
    ranking and of the report, which drupe writes again with the batch's present settings. Without --lang the
    pages keep the report's language. It takes about 10 s of CPU per fruit.

    Exit status: 0 done; 1 internal error; 2 usage or unreadable results; 130 interrupted.

    Example: drupe firmness monday/results --limit plates_5pct_N=10
    """
    with elsewhere():
        from fem.firmness.trade_tests import trade_tests
        from pipeline.batch.layout import Results
        from pipeline.run.judging import language_of
        from pipeline.run.reporting import with_report
        from pipeline.run.trade_numbers import trade_numbers
    try:
        tests = trade_tests(chord_gf=chord, ball_N=ball_force)
    except ValueError as reason:
        raise refused("drupe firmness", f"--chord, --ball-force: {reason}.") from None
    language = chosen_language(lang)
    if lang is None:
        language = language_of(Results(out).report, language)
    for line in trade_numbers(out, tests, limit or [], now=datetime.now(UTC), language=language):
        typer.echo(line)
    for line in with_report(out, batch, language=language):
        typer.echo(line, err=True)
