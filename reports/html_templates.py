"""Renders every page from its template; it escapes all text, and a missing name is an error."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from reports.charts import PlacedCharts
from reports.language import decimals, fruit_count, language_in_force, say, say_html
from reports.messages import message
from reports.words import (
    category_name,
    duration,
    effect_name,
    lot_words,
    number,
    percent,
    plunger_words,
    share,
    verdict_words,
    with_sd,
)

CHARTS = ("uplot.js", "charts.js")
"""Scripts of a page with charts: the library uPlot (MIT, 51 kB), and drupe's script that draws with it."""


def template_of(name: str) -> Template:
    """The template of a page, in the language in force (reports.language)."""
    return _environment(language_in_force()).get_template(f"templates/{name}.html.j2")


@cache
def _environment(language: str) -> Environment:
    environment = Environment(
        loader=PackageLoader("reports", package_path=""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "category": category_name,
        "decimals": decimals,
        "duration": duration,
        "effect": effect_name,
        "lot_words": lot_words,
        "number": number,
        "percent": percent,
        "plunger_words": plunger_words,
        "share": share,
        "verdict_words": verdict_words,
        "with_sd": with_sd,
    }
    environment.globals |= {
        "language": language,
        "message": message,
        "say": say,
        "say_html": say_html,
        "fruit_count": fruit_count,
    }
    return environment


def own_script(name: str) -> tuple[Markup, str]:
    """A script (static/`name`) for a page, and its SHA-256 (base64) for the page's content policy."""
    script = resources.files("reports").joinpath(f"static/{name}").read_text(encoding="utf-8")
    return Markup(script), base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def charted_page(name: str, *, scripts: Sequence[str] = CHARTS, **content: object) -> str:
    """A page with charts: its template calls `chart` to place each, and `scripts` draw all of them.

    A content security policy in the page forbids every outside source and every script but these.
    """
    placed = PlacedCharts()
    own_scripts = [own_script(script) for script in scripts]
    return template_of(name).render(placed=placed, chart=placed.place, scripts=own_scripts, **content)
