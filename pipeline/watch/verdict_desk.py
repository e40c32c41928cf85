"""Verdicts on the page of `drupe watch`: shows the form, stores the verdict, and updates the page."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from threading import Lock

from pipeline.batch.layout import Results
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused
from pipeline.ranking.report_entries import verdict_entry
from pipeline.run.batch_run import utc_now
from pipeline.run.judging import judge_fruit
from reports.entries import FruitEntry, VerdictEntry
from reports.kiosk_page import KioskEntry, judge_html, kiosk_html, led_to
from reports.language import spoken


@dataclass(kw_only=True)
class VerdictDesk:
    """Passes the page to `show`, with verdicts that the last report lacks; calls `kept` after each new one.

    `logout`: whether devices can log out. Two threads use it: the grading thread and the page's.
    """

    results: Results
    language: str
    show: Callable[[str], None]
    kept: Callable[[], None]
    now: Callable[[], datetime] = utc_now
    logout: bool = False
    _entry: KioskEntry | None = None
    _new: dict[str, tuple[VerdictEntry, ...]] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    def show_entry(self, entry: KioskEntry) -> None:
        """Replaces the entry that the page shows."""
        with self._lock:
            self._entry = entry
            self._show()

    def form(self, fruit_id: str, *, fault: str = "", written: Mapping[str, str] | None = None) -> str | None:
        """The page with the form for a fruit; None if the entry does not contain it."""
        with self._lock:
            entry = self._judged()
        if entry is None or entry.batch is None:
            return None
        fruit = next((fruit for fruit in entry.batch.fruits if fruit.fruit_id == fruit_id), None)
        if fruit is None:
            return None
        names = [name for name, _ in entry.batch.classes]
        return judge_html(fruit, names, fault=fault, written=written, language=self.language)

    def scanned(self, text: str) -> tuple[str, str]:
        """The target of a scanned code, relative to the page; or "" and a page that states the fault."""
        with self._lock:
            entry = self._judged()
        if entry is None:
            return "./", ""
        with spoken(self.language):
            address, fault = led_to(entry, text)
        return address, "" if address else self._page(entry, fault)

    def judge(self, fruit_id: str, written: Mapping[str, str], device: str) -> str | None:
        """Stores a form's verdict and returns None; on failure returns the form with the reason."""
        texts = {name: written.get(name, "") for name in ("class", "by", "why")}
        try:
            verdict = judge_fruit(
                self.results,
                fruit_id,
                judged_class=texts["class"],
                by=texts["by"],
                why=texts["why"],
                now=self.now(),
                device=device,
            )
        except BatchRefused as refusal:
            faults = "; ".join(problem.sentence for problem in refusal.problems)
            return self.form(fruit_id, fault=faults, written=texts)
        except NotWritten as fault:
            return self.form(fruit_id, fault=str(fault), written=texts)
        with self._lock:
            self._new[fruit_id] = (*self._new.get(fruit_id, ()), verdict_entry(verdict, verdict.key))
            self._show()
        self.kept()
        return None

    def _show(self) -> None:
        if (entry := self._judged()) is not None:
            self.show(self._page(entry))

    def _page(self, entry: KioskEntry, fault: str = "") -> str:
        return kiosk_html(entry, fault=fault, logout=self.logout, language=self.language)

    def _judged(self) -> KioskEntry | None:
        if self._entry is None or self._entry.batch is None or not self._new:
            return self._entry
        fruits = tuple(map(self._with_new, self._entry.batch.fruits))
        return replace(self._entry, batch=replace(self._entry.batch, fruits=fruits))

    def _with_new(self, fruit: FruitEntry) -> FruitEntry:
        known = {verdict.at_utc for verdict in fruit.verdicts}
        new = [verdict for verdict in self._new.get(fruit.fruit_id, ()) if verdict.at_utc not in known]
        return replace(fruit, verdicts=(*fruit.verdicts, *new)) if new else fruit
