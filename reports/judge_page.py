"""The page of `drupe watch` on which a person gives a verdict on a fruit. It has no script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.entries import FruitEntry
from reports.html_templates import page_environment
from reports.language import ENGLISH, spoken


def judge_html(
    fruit: FruitEntry,
    classes: Sequence[str],
    *,
    fault: str = "",
    written: Mapping[str, str] | None = None,
    language: str = ENGLISH,
) -> str:
    """The form for one fruit, with its E and earlier verdicts. `classes`: of the batch; without any the class
    is free text. `fault`: why the verdict was not kept, with what was `written`.
    """
    with spoken(language):
        template = page_environment().get_template("templates/judge.html.j2")
        return template.render(fruit=fruit, classes=classes, fault=fault, written=written or {})
