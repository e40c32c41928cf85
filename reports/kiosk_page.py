"""The pages of `drupe watch`: the last fruit large, with its class and what to do next; made anew after each.

It holds all it shows. Its one script asks the server, from which it comes, for the page anew when something
has changed; without scripts the browser loads the page again every few seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from reports.batch_overview import class_words, reason_words
from reports.entries import HOLD, INSPECT, SHIP, BatchEntry, FruitEntry
from reports.html_templates import own_script, template_of
from reports.language import ENGLISH, fruit_count, say, spoken
from reports.messages import in_language
from reports.palette import UNKNOWN, class_mark, class_marks
from reports.sheet_code import read_sheet_code
from reports.words import NOTHING, UNEXPLAINED, advice, effect_name, suspect_words

MOST_BEFORE = 8
"""Fruit before the last one that the page lists. Set by hand: what fits below it on a small screen."""
MOST_AT_WORK = 4
"""Fruit at work that are named; more are counted."""
MOST_WAITING = 6
"""Fruit still lacking files that are named; others are counted."""
WORDS = {SHIP: "Ship", HOLD: "Hold back", INSPECT: "Inspect"}
"""What to do with a fruit, by the list that it is on; each is in the words files."""
COUNTED = {SHIP: "to ship", HOLD: "to hold back", INSPECT: "to inspect"}
"""The lists beside the number of their fruit."""
MISSING = ("photos or fruit.ply", "a recording in grasps/")
"""What a fruit may lack (pipeline.watch.arrivals), with "and" between both."""


@dataclass(frozen=True, kw_only=True)
class KioskEntry:
    """What the page shows: the batch as far as it is graded (None: nothing is), fruit in the order in which
    they were graded, the last first, those at work, those that lack files (id, what), how many of the table
    have no files at all, and why nothing can be graded now.
    """

    name: str
    batch: BatchEntry | None = None
    recent: tuple[str, ...] = ()
    working: tuple[str, ...] = ()
    waiting: tuple[tuple[str, str], ...] = ()
    expected: int = 0
    problems: tuple[str, ...] = ()


def kiosk_html(entry: KioskEntry, *, fault: str = "", logout: bool = False, language: str = ENGLISH) -> str:
    """The whole page. All text of the batch is escaped; a content security policy in the page forbids every
    outside source and every script but the page's own. `fault`: why a scanned code opened nothing; `logout`:
    whether devices can log out; `language`: one of reports.language.LANGUAGES.
    """
    with spoken(language):
        return _page(entry, fault, logout)


def _page(entry: KioskEntry, fault: str, logout: bool) -> str:
    batch = None if entry.batch is None else in_language(entry.batch)
    marks = class_marks(tuple(name for name, _ in batch.classes)) if batch is not None else {}
    by_id = {} if batch is None else {fruit.fruit_id: fruit for fruit in batch.fruits}
    recent = [by_id[name] for name in entry.recent if name in by_id]
    alone = [fruit for fruit in by_id.values() if not fruit.reference]
    script, script_hash = own_script("kiosk.js")
    return template_of("kiosk").render(
        class_words=class_words,
        mark=lambda fruit: class_mark(*marks.get(fruit.maturity or "", UNKNOWN)),
        next_action=next_action,
        left_out=left_out,
        list_words=list_words,
        missing_words=lambda missing: say(" and ").join(say(part) for part in missing.split(" and ")),
        entry=entry,
        fault=fault,
        logout=logout,
        last=recent[0] if recent else None,
        before=recent[1 : 1 + MOST_BEFORE],
        graded=sum(fruit.ok for fruit in alone),
        of_rank=sum(fruit.rank is not None for fruit in alone),
        lists=[
            (say(words), sum(fruit.decision == name for fruit in alone)) for name, words in COUNTED.items()
        ],
        decides=any(fruit.decision in (SHIP, HOLD) for fruit in alone),
        at_work=", ".join(entry.working)
        if len(entry.working) <= MOST_AT_WORK
        else fruit_count(len(entry.working)),
        waiting=entry.waiting[:MOST_WAITING],
        more_waiting=max(len(entry.waiting) - MOST_WAITING, 0),
        script=script,
        script_hash=script_hash,
    )


def list_words(fruit: FruitEntry) -> str:
    """What to do with a fruit, in one word; empty if the batch makes no decision."""
    return say(WORDS[fruit.decision]) if fruit.decision in WORDS else ""


def led_to(entry: KioskEntry, text: str) -> tuple[str, str]:
    """Where the code of a sheet, or a fruit's name, leads from the page: an address beside it, and where
    there is none, a sentence that says why.
    """
    if entry.batch is None:
        return "./", ""
    lot, fruit_id = read_sheet_code(text)
    page_lot = entry.batch.lot or entry.batch.name
    if lot is not None and lot != page_lot:
        return "", say(
            "This code is of lot {lot}; the page shows lot {page_lot}.", lot=lot, page_lot=page_lot
        )
    if lot is not None and not fruit_id:
        return "report.html", ""
    if any(fruit.fruit_id == fruit_id for fruit in entry.batch.fruits):
        return f"judge?fruit={quote(fruit_id, safe='')}", ""
    return "", say("The page shows no fruit {fruit}.", fruit=fruit_id)


def next_action(fruit: FruitEntry) -> str:
    """What is to be done with a fruit, as a sentence; empty where nothing says so."""
    if not fruit.ok:
        return f"{fruit.reason} {advice(fruit)}".strip()
    if fruit.reference:
        return say("Reference body: go on with the fruit.")
    if fruit.doubts:
        return f"{say('E is in doubt')}: {fruit.doubts[0]}"
    if fruit.decision == INSPECT and fruit.decision_reason:
        why = reason_words(fruit.decision_reason, fruit.suspicion)
        return f"{why[0].upper()}{why[1:]}."
    return {SHIP: say("Ship it."), HOLD: say("Hold it.")}.get(fruit.decision, "")


def left_out(fruit: FruitEntry) -> str:
    """What the model leaves out of a fruit's E, as the screen or `drupe explain` say, as a sentence; empty
    where nothing is known to be left out. Of what nobody can name, and of what changes what to do,
    `next_action` says enough.
    """
    if (
        not fruit.ok
        or fruit.reference
        or fruit.suspicion is not None
        or fruit.mismatch in (NOTHING, UNEXPLAINED)
    ):
        return ""
    suspects = () if fruit.screen is None else fruit.screen.suspects
    if fruit.mismatch and not fruit.mismatch_taken:
        sentence = f"{say('Missing physics')}: {effect_name(fruit.mismatch)}."
    elif suspects and suspects[0].name != UNEXPLAINED:
        sentence = f"{say('Missing physics suspected')}: {suspect_words(suspects)}."
    else:
        return ""
    return f"{sentence} {say('Neither E nor the advice accounts for it.')}"


def judge_html(
    fruit: FruitEntry,
    classes: Sequence[str],
    *,
    fault: str = "",
    written: Mapping[str, str] | None = None,
    language: str = ENGLISH,
) -> str:
    """The page on which a person gives a verdict on a fruit, with its E and earlier verdicts; without script.

    `classes`: of the batch; without any the class is free text. `fault`: why the verdict was not kept, with
    what was `written`.
    """
    with spoken(language):
        return template_of("judge").render(fruit=fruit, classes=classes, fault=fault, written=written or {})


def login_html(status: int, *, language: str = ENGLISH) -> str:
    """The page on which a device sends its token, without script. `status` of HTTP: 200, or why the last try
    failed.
    """
    with spoken(language):
        faults = {
            401: say("This token is not known."),
            403: say("The form came from another page."),
        }
        return template_of("login").render(fault=faults.get(status, ""))
