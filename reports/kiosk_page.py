"""The pages of `drupe watch`: the last fruit in large type, with its class and the next action.

drupe renders the page again after each fruit, and the page needs no other file. Its only script reloads the
page from the server after a change; without scripts the browser reloads it every few seconds.
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
"""Most earlier fruit that the page lists. Set by hand: they fit below the last one on a small screen."""
MOST_AT_WORK = 4
"""Most fruit in progress that the page names; of more it shows only the number."""
MOST_WAITING = 6
"""Most fruit with missing files that the page names; it counts the others."""
WORDS = {SHIP: "Ship", HOLD: "Hold back", INSPECT: "Inspect"}
"""Action for the fruit of each list; the words files translate each."""
COUNTED = {SHIP: "to ship", HOLD: "to hold back", INSPECT: "to inspect"}
"""Words next to the number of fruit of each list."""
MISSING = ("photos or fruit.ply", "a recording in grasps/")
"""Inputs that a fruit may lack (pipeline.watch.arrivals); "and" joins both."""


@dataclass(frozen=True, kw_only=True)
class KioskEntry:
    """Content of the page. `batch`: the fruit graded so far (None: none yet); `recent`: graded fruit, latest
    first; `working`: fruit in progress; `waiting`: fruit that lack files (id, what). `expected`: number of
    fruit in the table without any files; `problems`: why drupe cannot grade now.
    """

    name: str
    batch: BatchEntry | None = None
    recent: tuple[str, ...] = ()
    working: tuple[str, ...] = ()
    waiting: tuple[tuple[str, str], ...] = ()
    expected: int = 0
    problems: tuple[str, ...] = ()


def kiosk_html(entry: KioskEntry, *, fault: str = "", logout: bool = False, language: str = ENGLISH) -> str:
    """The whole page. It escapes all text of the batch; its content security policy forbids every outside
    source and every script but the page's own. `fault`: why a scanned code opened nothing; `logout`: whether
    devices can log out; `language`: one of reports.language.LANGUAGES.
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
    """The action for a fruit in a word or two; empty if the batch makes no decision."""
    return say(WORDS[fruit.decision]) if fruit.decision in WORDS else ""


def led_to(entry: KioskEntry, text: str) -> tuple[str, str]:
    """Address, relative to the page, for a sheet's code or a fruit's name, and an empty text. Without such an
    address: an empty text and a sentence that says why.
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
    """The next action for a fruit, as a sentence; empty if there is none."""
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
    """The effect that a fruit's E ignores, by the screen or `drupe explain`, as a sentence; empty if none is
    known. It is also empty for an unknown effect and for one that changes the class: `next_action` covers
    both.
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

    `classes`: the batch's; without classes the page accepts free text. `fault`: why the server refused a
    verdict; `written`: the refused entries.
    """
    with spoken(language):
        return template_of("judge").render(fruit=fruit, classes=classes, fault=fault, written=written or {})


def login_html(status: int, *, language: str = ENGLISH) -> str:
    """The page on which a device sends its token, without script. `status`: HTTP 200, or why the last attempt
    failed.
    """
    with spoken(language):
        faults = {
            401: say("This token is not known."),
            403: say("The form came from another page."),
        }
        return template_of("login").render(fault=faults.get(status, ""))
