"""Prints the answer of `drupe explain` on the terminal, the verdict first."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fem.mismatch.selection.decision import DETECTION_P
from reports.effect_words import component_in_words, explain_verdict, when_in_words, where_in_words
from reports.explain_entries import ExplainEntry, Record
from reports.language import of_environment, spoken
from reports.messages import in_language, message
from reports.words import NO_BREAK, UNKNOWN, duration, effect_name, number, percent, with_sd

IN_ALL = "in all"
"""The name of the whole run's time among its stages' times."""
SHOWN = 5
"""Explanations on the terminal, set by hand to fit a screen; the JSON has all."""


def print_explanation(entry: ExplainEntry, written: list[Path], *, console: Console) -> None:
    """The verdict in a sentence, the ranking, E before and after, held-out grasps, what to record next.

    The entry's sentences are in the locale's language; pipeline.cli translates the lines around
    them.
    """
    with spoken(of_environment()):
        _print(in_language(entry), written, console=console)


def _print(entry: ExplainEntry, written: list[Path], *, console: Console) -> None:

    def line(text: str) -> None:
        console.print(text.replace(NO_BREAK, " "), highlight=False, markup=False, soft_wrap=True)

    line(f"{entry.case}: {explain_verdict(entry)}")
    if entry.ranking:
        console.print(_ranking(entry))
    for candidate in entry.ranking:
        if candidate.effect in entry.verdict and candidate.parameters:
            parameters = ", ".join(_in_short(*named) for named in candidate.parameters.items())
            line(f"{effect_name(candidate.effect)}: {parameters}")
    if entry.verdict != ("none",):
        line(f"where: {where_in_words(entry)}; when: {when_in_words(entry)}; {component_in_words(entry)}")
    before = with_sd(entry.before.value, entry.before.sd)
    after = with_sd(entry.after.value, entry.after.sd)
    if entry.withheld is not None:
        line(f"E: withheld, since {entry.withheld}")
    else:
        line(
            f"E: {after} MPa" if entry.verdict == ("none",) else f"E without: {before} MPa; with: {after} MPa"
        )
    for doubt in entry.doubts:
        line(f"doubt: {doubt}")
    line(
        f"probability of so large a difference without a mismatch: p {entry.p_value:.2g} (drupe "
        f"reports a mismatch below {DETECTION_P:g})" + (f"; {entry.p_nominal}" if entry.p_nominal else "")
    )
    if entry.heldout is None:
        line("held-out recordings: none, so nothing confirms the answer")
    else:
        fit = entry.heldout
        without, with_it, noise = map(number, (fit.rms_before, fit.rms_after, fit.noise_rms))
        model = without if entry.verdict == ("none",) else f"without {without}, with {with_it}"
        line(f"held-out recordings, residual as a share of the response: {model}, noise {noise}")
    if entry.next_grasp:
        line(f"record next: {entry.next_grasp}")
    for note in entry.notes:
        line(f"note: {note}")
    if entry.applied:
        line(entry.applied)
    for path in written:
        line(f"  {path}")
    if IN_ALL in entry.seconds:
        line(f"took {duration(entry.seconds[IN_ALL])}")


def _ranking(entry: ExplainEntry) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column(message("explanation"))
    table.add_column(message("probability"), justify="right")
    table.add_column("E (MPa)", justify="right")
    for candidate in entry.ranking[:SHOWN]:
        table.add_row(
            escape(effect_name(candidate.effect)),
            percent(candidate.probability).replace(NO_BREAK, " "),
            UNKNOWN if candidate.modulus is None else with_sd(candidate.modulus.value, candidate.modulus.sd),
        )
    return table


def _in_short(name: str, parameter: Record) -> str:
    value = parameter.value
    stem = name.removesuffix(f"_{parameter.unit.replace('/', '_per_')}")
    if isinstance(value, tuple):
        return f"{stem} ({', '.join(number(x) for x in value)}) {parameter.unit}"
    if isinstance(value, str):
        return f"{stem} {value}"
    sd = parameter.sd if isinstance(parameter.sd, int | float) else None
    unit = "" if parameter.unit in ("", "1") else f" {parameter.unit}"
    return f"{stem} {with_sd(value, sd)}{unit}"
