"""The page on which a device sends its token, before it sees that of `drupe watch`. It has no script."""

from __future__ import annotations

from reports.html_templates import page_environment
from reports.language import ENGLISH, say, spoken


def login_html(status: int, *, language: str = ENGLISH) -> str:
    """The form; `status` of HTTP: 200, or why the last try failed."""
    with spoken(language):
        faults = {
            401: say("This token is not known."),
            403: say("The form came from another page."),
        }
        template = page_environment().get_template("templates/login.html.j2")
        return template.render(fault=faults.get(status, ""))
