"""What `drupe explain` says on the terminal: the verdict first."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fem.mismatch.selection.decision import DETECTION_P
from reports.effect_words import (
    component_in_words,
    explain_verdict,
    when_in_words,
    where_in_words,
)
from reports.explain_entries import ExplainEntry, ParameterEntry
from reports.words import NO_BREAK, UNKNOWN, duration, effect_name, number, percent, with_sd

IN_ALL = "in all"
"""The name of the whole run's time among its stages'."""
SHOWN = 5
"""Explanations on the terminal, set by hand to fit a screen; all stand in the JSON."""


def print_explanation(found: ExplainEntry, written: list[Path], *, console: Console) -> None:
    """The verdict in a sentence, the ranking, E before and after, held-out grasps, what to record next."""

    def line(text: str) -> None:
        console.print(text.replace(NO_BREAK, " "), highlight=False, markup=False, soft_wrap=True)

    line(f"{found.case}: {explain_verdict(found)}")
    if found.ranking:
        console.print(_ranking(found))
    for one in found.ranking:
        if one.effect in found.verdict and one.parameters:
            parameters = ", ".join(_in_short(*named) for named in one.parameters.items())
            line(f"{effect_name(one.effect)}: {parameters}")
    if found.verdict != ("none",):
        line(f"where: {where_in_words(found)}; when: {when_in_words(found)}; {component_in_words(found)}")
    before = with_sd(found.E_MPa.before.value, found.E_MPa.before.sd)
    after = with_sd(found.E_MPa.after.value, found.E_MPa.after.sd)
    if found.E_withheld is not None:
        line(f"E: withheld, since {found.E_withheld}")
    else:
        line(
            f"E: {after} MPa" if found.verdict == ("none",) else f"E without: {before} MPa; with: {after} MPa"
        )
    for doubt in found.doubts:
        line(f"doubt: {doubt}")
    line(
        f"probability of so large a difference without a mismatch: p {found.p_value:.2g} (drupe "
        f"reports a mismatch below {DETECTION_P:g})"
    )
    if found.rms is None:
        line("held-out recordings: none, so nothing confirms the answer")
    else:
        without, with_it, noise = map(number, found.rms)
        model = without if found.verdict == ("none",) else f"without {without}, with {with_it}"
        line(f"held-out recordings, residual as a share of the response: {model}, noise {noise}")
    if found.next_grasp:
        line(f"record next: {found.next_grasp}")
    for note in found.notes:
        line(f"note: {note}")
    if found.applied:
        line(found.applied)
    for path in written:
        line(f"  {path}")
    if IN_ALL in found.seconds:
        line(f"took {duration(found.seconds[IN_ALL])}")


def _ranking(found: ExplainEntry) -> Table:
    """The first SHOWN explanations as a table."""
    table = Table(box=None, pad_edge=False)
    table.add_column("explanation")
    table.add_column("probability", justify="right")
    table.add_column("E (MPa)", justify="right")
    for one in found.ranking[:SHOWN]:
        table.add_row(
            escape(effect_name(one.effect)),
            percent(one.probability).replace(NO_BREAK, " "),
            UNKNOWN if one.E_MPa is None else with_sd(one.E_MPa.value, one.E_MPa.sd),
        )
    return table


def _in_short(name: str, parameter: ParameterEntry) -> str:
    value = parameter.value
    stem = name.removesuffix(f"_{parameter.unit.replace('/', '_per_')}")
    if isinstance(value, tuple):
        return f"{stem} ({', '.join(number(x) for x in value)}) {parameter.unit}"
    if isinstance(value, str):
        return f"{stem} {value}"
    sd = parameter.sd if isinstance(parameter.sd, int | float) else None
    unit = "" if parameter.unit in ("", "1") else f" {parameter.unit}"
    return f"{stem} {with_sd(value, sd)}{unit}"
