"""How every page is made from its template: all text escaped, a name that is missing an error."""

from __future__ import annotations

import base64
import hashlib
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from reports.language import language_in_force, say, say_html


def page_environment() -> Environment:
    """Where templates are found by their path in this package, with filters to be added; in the language in
    force (reports.language).
    """
    environment = Environment(
        loader=PackageLoader("reports", package_path=""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"language": language_in_force(), "say": say, "say_html": say_html}
    return environment


def own_script(name: str) -> tuple[Markup, str]:
    """A script of this package (static/`name`) to be put into a page as it is, and the SHA-256 of it (base64)
    by which the page's content policy allows it.
    """
    script = resources.files("reports").joinpath(f"static/{name}").read_text(encoding="utf-8")
    return Markup(script), base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
