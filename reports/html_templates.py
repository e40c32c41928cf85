"""How every page is made from its template: all text escaped, a name that is missing an error."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources

from jinja2 import BytecodeCache, Environment, PackageLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup

from reports.charts import PlacedCharts
from reports.language import language_in_force, say, say_html
from reports.words import duration, effect_name, number, percent, verdict_words, with_sd


class _Compiled(BytecodeCache):
    """Templates that this process has compiled, so that each is compiled once."""

    def __init__(self) -> None:
        self._code: dict[str, bytes] = {}

    def load_bytecode(self, bucket: Bucket) -> None:
        """Hands over the code of this template, if there is any of this text."""
        if (code := self._code.get(bucket.key)) is not None:
            bucket.bytecode_from_string(code)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keeps the code."""
        self._code[bucket.key] = bucket.bytecode_to_string()


CHARTS = ("uplot.js", "charts.js")
"""Scripts of a page with charts: their library (uPlot, MIT, 51 kB), and what draws them."""
_compiled: dict[str, _Compiled] = {}
"""By language: filters of constants are applied while a template is compiled."""


def page_environment() -> Environment:
    """Templates by their path in this package, with filters, in the language in force (reports.language)."""
    environment = Environment(
        loader=PackageLoader("reports", package_path=""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_compiled.setdefault(language_in_force(), _Compiled()),
    )
    environment.filters |= {
        "duration": duration,
        "effect": effect_name,
        "number": number,
        "percent": percent,
        "verdict_words": verdict_words,
        "with_sd": with_sd,
    }
    environment.globals |= {"language": language_in_force(), "say": say, "say_html": say_html}
    return environment


def own_script(name: str) -> tuple[Markup, str]:
    """A script (static/`name`) for a page, and the SHA-256 (base64) by which its content policy allows it."""
    script = resources.files("reports").joinpath(f"static/{name}").read_text(encoding="utf-8")
    return Markup(script), base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def charted_page(
    name: str,
    filters: Mapping[str, Callable[..., object]],
    *,
    scripts: Sequence[str] = CHARTS,
    **content: object,
) -> str:
    """A page with charts: the filter "chart" puts one in its place, and `scripts` draw all of them.

    A content security policy in the page forbids every outside source and every script but these.
    """
    environment, placed = page_environment(), PlacedCharts()
    environment.filters |= {"chart": placed.place, **filters}
    template = environment.get_template(f"templates/{name}.html.j2")
    return template.render(placed=placed, scripts=[own_script(script) for script in scripts], **content)
