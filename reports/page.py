"""The report of a batch: one HTML file that needs no network.

The page's content security policy allows its scripts by their hashes. They draw the charts and the visible
rows, and show one fruit at a time from JSON in the page. Without scripts the page has the summary and a table
of all fruit.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple
from urllib.parse import quote

from markupsafe import Markup

from reports.batch_overview import (
    MOST_LINKED,
    MOST_LISTED,
    Indexed,
    class_counts,
    class_words,
    correlation_words,
    decision_lists,
    failures,
    numbered,
    reason_words,
    share_words,
)
from reports.charts import script_json
from reports.charts_fruit import fruit_charts
from reports.entries import OR, BatchEntry, FruitEntry, Picture, without_references
from reports.html_templates import CHARTS, charted_page, template_of
from reports.kiosk_page import list_words
from reports.language import ENGLISH, language_in_force, say, spoken
from reports.language import decimals as with_comma
from reports.messages import in_language, message
from reports.palette import UNKNOWN, class_mark, class_marks, pad_marks
from reports.sheet_code import qr_png, sheet_code
from reports.skin_layer import FROM_SIDES
from reports.tables import ranking_csv
from reports.words import (
    NO_BREAK,
    advice,
    category_name,
    duration,
    effect_name,
    number,
    p_words,
    reading_title,
    remarks,
    verdict,
    with_sd,
)
from reports.words import UNKNOWN as UNKNOWN_WORD

_EXIT_STATUS = {
    0: "all graded",
    1: "internal error",
    2: "usage or settings",
    3: "some fruit not graded",
    4: "all graded, some E in doubt",
}
"""Words for the exit statuses of `drupe grade` (docs/how-to/grade-a-batch.md)."""


def report_html(batch: BatchEntry, *, language: str = ENGLISH) -> str:
    """The whole report as one self-contained HTML page; the same records give the same text.

    It escapes all text of the batch and holds pictures as data URIs. Its content security policy forbids
    every outside source and every script but the page's own. `language`: one of reports.language.LANGUAGES.
    """
    with spoken(language):
        return _page(in_language(batch))


def _page(batch: BatchEntry) -> str:
    marks = class_marks(tuple(name for name, _ in batch.classes))
    functions: dict[str, Any] = {
        "advice": advice,
        "class_words": class_words,
        "p_words": p_words,
        "reason_words": reason_words,
        "remarks": remarks,
        "share_words": share_words,
        "class_mark": lambda fruit: class_mark(*marks.get(fruit.maturity or "", UNKNOWN)),
        "image": _image,
        "as_given": _as_given,
        "base64": lambda data: base64.b64encode(data).decode("ascii"),
        "sort_key": lambda value: "" if value is None else f"{value:.6g}",
        "several": lambda mismatch: OR in mismatch,
        "facts": lambda fruit: _facts(fruit, batch),
        "first_large": _capitalised,
        "inspect_words": lambda fruit: reason_words(fruit.decision_reason, fruit.suspicion),
        "list_words": list_words,
        "mesh_key": _mesh_key,
        "qr": lambda fruit: _qr(batch, fruit.fruit_id),
        "screened": _screened,
        "sides": [say(name) for name, *_ in FROM_SIDES],
        "utc": _utc,
    }
    fruits = numbered(batch)
    alone = without_references(batch.fruits)
    turned = any(fruit.pictures.scene for fruit in batch.fruits)
    names = (*CHARTS, "dashboard.js", *(("scene.js",) if turned else ()))
    return charted_page(
        "page",
        **functions,
        scripts=names if fruits else (),
        about=_about(batch),
        any_at_pulp=any(fruit.E_at_pulp_MPa is not None for fruit in batch.fruits),
        any_shore=any(fruit.shore_oo is not None for fruit in batch.fruits),
        any_verdict=any(fruit.verdicts for fruit in batch.fruits),
        batch=batch,
        classes=_classes(batch, fruits),
        details=_json_lines(_details(functions, fruits)),
        doubted=[(index, fruit) for index, fruit in fruits if fruit.ok and fruit.doubts],
        failed=failures(fruits),
        failed_count=sum(not fruit.ok for fruit in alone),
        fruits=fruits,
        graded=sum(fruit.E_MPa is not None for fruit in alone),
        limits_drawn=any(limit is not None for _, limit in batch.classes),
        lists=decision_lists(batch, fruits),
        lot=_json_lines([_lot(batch, fruits)]),
        lot_code=_qr(batch),
        most_linked=MOST_LINKED,
        most_listed=MOST_LISTED,
        readings={name: _reading_words(batch, name) for name in reading_columns(batch)},
        provenance=[(say("Settings in force"), batch.settings), (say("Versions"), batch.versions)],
        shore_words=correlation_words(batch.shore) if batch.shore else "",
        status_words="" if batch.exit_status is None else _EXIT_STATUS.get(batch.exit_status, ""),
        took=duration((batch.finished_utc - batch.started_utc).total_seconds()),
        turned=turned,
        verdict=verdict(
            alone, waiting=batch.unfinished.total - batch.unfinished.done if batch.unfinished else 0
        ),
        version=dict(batch.versions).get("drupe", ""),
    )


def _lot(batch: BatchEntry, fruits: list[Indexed]) -> dict[str, object]:
    """Input of static/dashboard.js: figures of all fruit in the table's order, and words."""
    marks = class_marks(tuple(name for name, _ in batch.classes))
    header, *lines = ranking_csv(batch).splitlines()
    return {
        "name": batch.name,
        "language": language_in_force(),
        "classes": [
            {"name": name, "limit": limit, "colour": marks[name][0], "shape": marks[name][1]}
            for name, limit in batch.classes
        ],
        "unclassed": {"name": "", "key": say("no class"), "colour": UNKNOWN[0], "shape": UNKNOWN[1]},
        "header": header,
        "fruits": [
            {
                "id": fruit.fruit_id,
                "E": fruit.E_MPa,
                "sd": fruit.E_sd_MPa,
                "rank": fruit.rank,
                "shore": fruit.shore_oo,
                "csv": line,
            }
            for (_, fruit), line in zip(fruits, lines, strict=True)
        ],
        "words": {
            "one": say("1 fruit"),
            "all": say("{count} fruit", count="#"),
            "some": say("{count} of {total} fruit", count="#", total="##"),
            "sorts": say("a click on the name of a column sorts by it"),
            "histogram": say("Distribution of moduli"),
            "ranking": say("E by rank"),
            "shore": say("Modulus against Shore OO reading"),
            "E": say("E, modulus of the flesh (MPa)"),
            "rank": say("Rank"),
            "per": say("fruit per {width} MPa", width="#"),
            ".warning": say("and {count} more warnings in the report", count="#"),
            ".next": say("and {count} more notes in the report", count="#"),
            "tbody tr": say("and {count} more grasps in the report", count="#"),
            "mean": say("mean {mean} MPa, standard deviation {sd} MPa", mean="#", sd="##"),
        },
    }


def _details(functions: Mapping[str, Any], fruits: list[Indexed]) -> Iterator[dict[str, object]]:
    """The details of each fruit, which the page shows on request: HTML and charts."""
    template = template_of("fruit")
    for _, fruit in fruits:
        yield {"html": template.render(fruit=fruit, **functions), "charts": fruit_charts(fruit)}


def _json_lines(objects: Iterable[object]) -> Markup:
    """One line of JSON per object, escaped for a script element."""
    return Markup("\n".join(map(script_json, objects)))


def _screened(fruit: FruitEntry) -> str:
    """Cell of the ranking: none found, the first suspect, not screened, or a dash without a screen."""
    screen = fruit.screen
    if screen is None:
        return UNKNOWN_WORD
    if screen.why_not:
        return say("not screened")
    p = p_words(screen.p_value, screen.p_nominal)
    first = [effect_name(suspect.name) for suspect in screen.suspects[:1]]
    return f"{first[0]}?{p}" if first else f"{say('none found')}{p}"


def _about(batch: BatchEntry) -> list[tuple[str, str]]:
    pulp_C = batch.pulp_temperature_C
    known = (
        (say("category"), category_name(batch.category)),
        (say("cultivar"), batch.cultivar),
        (say("lot"), batch.lot),
        (say("packer"), batch.packer),
        (say("harvested"), batch.harvest_date.isoformat() if batch.harvest_date else None),
        (say("measured"), batch.measured_on.isoformat() if batch.measured_on else None),
        (say("pulp at"), None if pulp_C is None else with_comma(f"{pulp_C:.1f} °C")),
        (say("graded"), _utc(batch.finished_utc)),
    )
    return [(label, value) for label, value in known if value]


class _ClassOfLot(NamedTuple):
    mark: Markup
    name: str
    limits: str
    share: str
    fruit: int
    unsure: int


def _classes(batch: BatchEntry, fruits: list[Indexed]) -> list[_ClassOfLot]:
    """Mark, name, limits, share and number of fruit of each class of the batch, softest first."""
    marks = class_marks(tuple(name for name, _ in batch.classes))
    counts = {name: (count, unsure) for name, count, unsure in class_counts(batch, fruits)}
    graded = sum(fruit.E_MPa is not None for fruit in without_references(batch.fruits))
    below: float | None = None
    classes: list[_ClassOfLot] = []
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
        count, unsure = counts[name]
        share = f"{100 * count / graded:.0f}{NO_BREAK}%" if graded else UNKNOWN_WORD
        classes.append(_ClassOfLot(class_mark(*marks[name]), name, words, share, count, unsure))
        below = limit
    return classes


def _facts(fruit: FruitEntry, batch: BatchEntry) -> list[tuple[str, list[tuple[str, str]]]]:
    """(label, words) of a fruit's details by heading; "Error bar: pit size" has the heading "Error bar".

    Firmness readings and the user's own columns have separate headings. The user's columns keep the names
    of `fruits.csv`; other labels begin with a capital.
    """
    facts: list[tuple[str, str]] = []
    if fruit.height_mm is not None:
        facts.append((say("Height"), f"{number(fruit.height_mm)} mm"))
    if fruit.volume_mm3 is not None:
        facts.append((say("Volume with pit"), f"{number(fruit.volume_mm3 / 1000.0)} cm³"))
    if fruit.shore_oo is not None:
        facts.append((say("Shore OO reading"), number(fruit.shore_oo)))
    facts.extend(fruit.facts)
    facts.extend(
        (f"{say('Time')}: {message(stage)}", duration(seconds)) for stage, seconds in fruit.seconds.items()
    )
    if fruit.peak_memory_MiB is not None:
        facts.append((f"{say('Time')}: {say('Peak memory')}", f"{fruit.peak_memory_MiB:.0f} MiB"))
    parts: dict[str, list[tuple[str, str]]] = {}
    for label, words in facts:
        heading, _, rest = label.rpartition(": ")
        parts.setdefault(_capitalised(heading), []).append((_capitalised(rest), words))
    given = [
        (name, f"{_as_given(fruit.columns[name])} {unit}".strip())
        for name, unit in batch.columns
        if name in fruit.columns
    ]
    readings = [
        (_reading_words(batch, name), with_sd(fruit.readings[name], fruit.readings.get(f"{name}_sd")))
        for name in reading_columns(batch)
        if name in fruit.readings
    ]
    added = {say("Simulated firmness tests"): readings, say("Your own columns"): given}
    return [*parts.items(), *((heading, rows) for heading, rows in added.items() if rows)]


def reading_columns(batch: BatchEntry) -> list[str]:
    """Columns of simulated firmness tests, without those of their standard deviations."""
    return [name for name in batch.readings if f"{name}_sd" in batch.readings]


def _reading_words(batch: BatchEntry, name: str) -> str:
    """Title of a simulated firmness test with its unit; without a title, the name of its column."""
    title, unit = batch.reading_titles.get(name, (name, ""))
    return f"{reading_title(title)} ({unit})" if unit else title


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]


def _as_given(cell: float | str | None) -> str:
    """A cell of a user's own column; a number has up to 12 digits."""
    if cell is None:
        return UNKNOWN_WORD
    return cell if isinstance(cell, str) else with_comma(f"{cell:.12g}")


def _mesh_key(fruit: FruitEntry) -> list[tuple[Markup, str]]:
    """Marks and words of the colours in the picture of the mesh: the pads, and the pit."""
    marks = pad_marks(dict.fromkeys(pad for recording in fruit.recordings for pad in recording.contact_mm))
    return [*marks, *([(class_mark("pit", "circle"), message("pit"))] if fruit.has_pit else [])]


def _image(picture: Picture, alt: str) -> Markup:
    """The picture with a link to its file at full size; without bytes, the words `alt` with that link."""
    shown: Markup | str = alt
    if picture.content:
        content = base64.b64encode(picture.content).decode("ascii")
        kind = "webp" if picture.content[:4] == b"RIFF" else "jpeg"
        shown = Markup('<img src="data:image/{};base64,{}" alt="{}" loading="lazy">').format(
            kind, content, alt
        )
    if not picture.file:
        return Markup(shown)
    return Markup('<a href="{}">{}</a>').format(quote(picture.file), shown)


def _qr(batch: BatchEntry, fruit_id: str = "") -> str:
    """PNG of the sheet's code in base64; empty if the names are too long for a code."""
    code = sheet_code(batch.lot or batch.name, fruit_id)
    return base64.b64encode(qr_png(code)).decode("ascii") if code else ""


def _utc(at: datetime) -> str:
    return at.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
