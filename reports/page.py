"""The report of a batch: one HTML file that shows all it holds, with no network.

Its one script sorts and searches the table of fruit and is named in the page's content policy by its hash;
without scripts the page shows the same.
"""

from __future__ import annotations

import base64
from datetime import UTC, datetime
from typing import NamedTuple
from urllib.parse import quote

from markupsafe import Markup

from reports.batch_overview import (
    MOST_LISTED,
    class_counts,
    class_words,
    decision_lists,
    failures,
    numbered,
    reason_words,
    share_words,
)
from reports.charts_batch import (
    control_chart,
    correlation_words,
    distribution_chart,
    ranking_chart,
    shore_chart,
)
from reports.charts_fruit import force_chart, frames_chart, grasps_chart
from reports.entries import OR, BatchEntry, FruitEntry, Picture, without_references
from reports.html_templates import own_script, page_environment
from reports.language import ENGLISH, say, spoken
from reports.language import decimals as with_comma
from reports.messages import in_language
from reports.palette import UNKNOWN, class_marks
from reports.svg import class_mark, element
from reports.words import UNKNOWN as UNKNOWN_WORD
from reports.words import (
    advice,
    duration,
    effect_name,
    number,
    p_words,
    remarks,
    verdict,
)

_EXIT_STATUS = {
    0: "all graded",
    1: "internal error",
    2: "usage or settings",
    3: "some fruit not graded",
    4: "all graded, some E in doubt",
}
"""Words for the exit statuses of `drupe grade` (docs/how-to/grade-a-batch.md)."""


_FILTERS = (
    *(advice, class_words, p_words, reason_words, remarks, share_words),
    *(control_chart, force_chart, frames_chart, grasps_chart),
)
"""Functions that the template calls by their names."""
MOST_ROWS = 40
"""Fruit up to which the ranking's chart has a row for each; beyond it the distribution is drawn."""


MOST_IN_FULL = 500
"""Fruit up to which the facts of each are a table; beyond it they are lines of text, which browsers lay out
in a tenth of the time, and the charts of E by grasp and by frame are left out."""


def report_html(batch: BatchEntry, *, provenance: bool = False, language: str = ENGLISH) -> str:
    """The whole report as one self-contained HTML page, the same text for the same records.

    All text of the batch is escaped; pictures are data URIs; a content security policy in the page
    forbids every outside source and every script but the page's own. `provenance`: whether the checksums of
    all inputs are listed; `language`: one of reports.language.LANGUAGES.
    """
    with spoken(language):
        return _page(in_language(batch), provenance=provenance)


def _page(batch: BatchEntry, *, provenance: bool) -> str:
    marks = class_marks(tuple(name for name, _ in batch.classes))
    environment = page_environment()
    environment.filters |= {
        "class_mark": lambda fruit: class_mark(*marks.get(fruit.maturity or "", UNKNOWN)),
        "image": _image,
        "base64": lambda data: base64.b64encode(data).decode("ascii"),
        "sort_key": lambda value: "" if value is None else f"{value:.6g}",
        "several": lambda mismatch: OR in mismatch,
        "facts": _facts,
        "first_large": lambda text: text[:1].upper() + text[1:],
        "inspect_words": lambda fruit: reason_words(fruit.decision_reason, fruit.suspicion),
        "screened": _screened,
        "utc": _utc,
    }
    environment.filters |= {words.__name__: words for words in _FILTERS}
    fruits = numbered(batch)
    alone = without_references(batch.fruits)
    script, script_hash = own_script("table.js")
    viewer, viewer_hash = own_script("scene.js")
    many = sum(fruit.E_MPa is not None for fruit in alone) > MOST_ROWS
    both = [fruit for fruit in alone if fruit.E_MPa is not None and fruit.shore_oo is not None]
    return environment.get_template("templates/page.html.j2").render(
        about=_about(batch),
        any_shore=any(fruit.shore_oo is not None for fruit in batch.fruits),
        batch=batch,
        brief=len(fruits) > MOST_IN_FULL,
        classes=_legend(batch, marks),
        counts=class_counts(batch, fruits),
        failed=failures(fruits),
        failed_count=sum(not fruit.ok for fruit in alone),
        lists=decision_lists(batch, fruits),
        many=many,
        most_listed=MOST_LISTED,
        script=script,
        script_hash=script_hash,
        viewer=viewer,
        viewer_hash=viewer_hash,
        turned=any(fruit.pictures.scene for fruit in batch.fruits),
        doubted=[(index, fruit) for index, fruit in fruits if fruit.ok and fruit.doubts],
        fruits=fruits,
        graded=any(fruit.E_MPa is not None for fruit in alone),
        limits_drawn=any(limit is not None for _, limit in batch.classes),
        provenance=_provenance(batch, inputs=provenance),
        ranking_narrow=(distribution_chart if many else ranking_chart)(batch, width_px=360),
        ranking_wide=(distribution_chart if many else ranking_chart)(batch, width_px=900),
        shore_chart=shore_chart(batch) if len(both) > 1 else None,
        shore_words=correlation_words(batch.shore) if batch.shore else "",
        status_words="" if batch.exit_status is None else _EXIT_STATUS.get(batch.exit_status, ""),
        took=duration((batch.finished_utc - batch.started_utc).total_seconds()),
        verdict=verdict(
            alone, waiting=batch.unfinished.total - batch.unfinished.done if batch.unfinished else 0
        ),
        version=dict(batch.versions).get("drupe", ""),
    )


def _screened(fruit: FruitEntry) -> str:
    """The cell of the ranking's table: none found, the first suspect, or that the fruit was not screened."""
    screen = fruit.screen
    if screen is None:
        return UNKNOWN_WORD
    if screen.why_not:
        return say("not screened")
    p = p_words(screen.p_value)
    first = [effect_name(one.name) for one in screen.suspects[:1]]
    return f"{first[0]}?{p}" if first else f"{say('none found')}{p}"


def _about(batch: BatchEntry) -> list[tuple[str, str]]:
    pulp_C = batch.pulp_temperature_C
    known = (
        (say("category"), batch.category),
        (say("cultivar"), batch.cultivar),
        (say("lot"), batch.lot),
        (say("harvested"), batch.harvest_date.isoformat() if batch.harvest_date else None),
        (say("pulp at"), None if pulp_C is None else with_comma(f"{pulp_C:.1f} °C")),
        (say("graded"), _utc(batch.finished_utc)),
    )
    return [(label, value) for label, value in known if value]


class _ClassLimits(NamedTuple):
    mark: Markup
    name: str
    limits: str


def _legend(batch: BatchEntry, marks: dict[str, tuple[str, str]]) -> list[_ClassLimits]:
    """Mark, name and limits of each class; those of the batch's own limits, softest first."""
    below: float | None = None
    items: list[_ClassLimits] = []
    for name, limit in batch.classes:
        words = ""
        if limit is not None:
            upper = with_comma(f"{limit:g}")
            if below is None:
                words = say("up to {limit} MPa", limit=upper)
            else:
                words = say("{lower} to {upper} MPa", lower=with_comma(f"{below:g}"), upper=upper)
        elif below is not None:
            words = say("above {limit} MPa", limit=with_comma(f"{below:g}"))
        items.append(_ClassLimits(mark=class_mark(*marks[name]), name=name, limits=words))
        below = limit
    return items


def _facts(fruit: FruitEntry) -> list[tuple[str, str]]:
    """(label, value) of a fruit's details, with times and memory."""
    facts: list[tuple[str, str]] = []
    if fruit.height_mm is not None:
        facts.append((say("Height"), f"{number(fruit.height_mm)} mm"))
    if fruit.volume_mm3 is not None:
        facts.append((say("Volume with pit"), f"{number(fruit.volume_mm3 / 1000.0)} cm³"))
    if fruit.shore_oo is not None:
        facts.append((say("Shore OO reading"), number(fruit.shore_oo)))
    facts.extend(fruit.facts)
    facts.extend((f"{say('Time')}, {stage}", duration(seconds)) for stage, seconds in fruit.seconds.items())
    if fruit.peak_memory_MiB is not None:
        facts.append((say("Peak memory"), f"{fruit.peak_memory_MiB:.0f} MiB"))
    return facts


def _provenance(batch: BatchEntry, *, inputs: bool) -> list[tuple[str, tuple[tuple[str, str], ...], bool]]:
    """(summary, rows, whether the cells are hashes) of each part that is not empty."""
    parts = (
        (say("Settings in force"), batch.settings, False),
        (say("Versions"), batch.versions, False),
        (
            say("Inputs: {count} files and their SHA-256", count=len(batch.inputs)),
            batch.inputs if inputs else (),
            True,
        ),
    )
    return [part for part in parts if part[1]]


def _image(picture: Picture, alt: str) -> Markup:
    """The picture inside the page, leading to its file at full size; where it has no bytes, words that do."""
    shown: Markup | str = alt
    if picture.webp:
        content = base64.b64encode(picture.webp).decode("ascii")
        shown = Markup('<img src="data:image/webp;base64,{}" alt="{}" loading="lazy">').format(content, alt)
    return element("a", shown, href=quote(picture.file)) if picture.file else Markup(shown)


def _utc(at: datetime) -> str:
    return at.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
