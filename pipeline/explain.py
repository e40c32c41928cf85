"""`drupe explain`: what simulation leaves out of one fruit's recordings; terminal, JSON and page."""

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from fem.failure import FemFailure
from pipeline.alone import alone
from pipeline.answer import IN_ALL, answer, explain_entry
from pipeline.apply import applied
from pipeline.cache import file_hash
from pipeline.case import Case, open_case
from pipeline.diary import Diary
from pipeline.explain_notes import require_one_fruit
from pipeline.finding import finding
from pipeline.layout import Results, write_whole
from pipeline.outcome import FruitEnded
from pipeline.problem import BatchRefused, Problem
from pipeline.provenance import versions
from recon.failure import ReconFailure
from reports.explain_entries import ExplainEntry
from reports.explain_page import explain_html
from tactile.failure import TactileFailure

ANSWERED, NO_ANSWER = 0, 3


class NotExplained(Exception):
    """The fruit or its recordings could not be used; the text is the sentence staff read."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What the answer is written to; `work`: where stages are kept between runs of a case of its own."""

    json: Path | None = None
    html: Path | None = None
    work: Path | None = None
    out: Path | None = None
    apply: bool = False


def utc_now() -> datetime:
    """The present moment, aware."""
    return datetime.now(UTC)


def explain(
    path: Path,
    *,
    fruit_id: str | None,
    wanted: Wanted,
    report: Callable[[str], None],
    jobs: int = 1,
    now: Callable[[], datetime] = utc_now,
) -> ExplainEntry:
    """Explains the case or fruit at `path`, writes what is wanted, and gives what the page says.

    `jobs`: recordings and effects worked on at the same time.

    Raises BatchRefused (nothing can be begun) and NotExplained (begun, and no answer).
    """
    _require_writable(wanted)
    with _workspace(wanted.work) as work:
        case = open_case(path, fruit_id=fruit_id, work=work, out=wanted.out)
        if wanted.apply and case.batch is None:
            raise BatchRefused(
                [Problem(str(path), "is a case of its own; --apply writes into a batch's settings.")]
            )
        held = nullcontext() if case.batch is None else alone(Results(case.task.results.root.parents[1]))
        with held, _said_plainly():
            return _explained(case, wanted, report, jobs, now)


def _explained(
    case: Case, wanted: Wanted, report: Callable[[str], None], jobs: int, now: Callable[[], datetime]
) -> ExplainEntry:
    require_one_fruit(case)
    started = now()
    diary = Diary(report)
    found = finding(case, diary, jobs=jobs)
    explanation = found.explanation
    done = applied(case, explanation, now=started) if wanted.apply else ""
    made = now()
    seconds = {
        **diary.seconds,
        **{f"explanation, {stage}": round(took, 2) for stage, took in (explanation.seconds or {}).items()},
        IN_ALL: round((made - started).total_seconds(), 2),
    }
    inputs = {path.name: file_hash(path) for path in case.input_files()}
    said = answer(
        explanation,
        facts={
            "seconds": seconds,
            "case": case.name,
            "category": case.task.category,
            "grasps": found.grasps,
            "applied": done or None,
            "inputs": inputs,
            "versions": versions(),
            "made_utc": made.isoformat(timespec="seconds"),
        },
    )
    text = json.dumps(said, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    if wanted.json is not None:
        write_whole(wanted.json, text)
    if case.batch is not None:
        kept = json.dumps({**said, "key": case.task.key}, indent=1, allow_nan=False, ensure_ascii=False)
        write_whole(case.task.results.mismatch, kept + "\n")
    entry = explain_entry(
        explanation,
        name=case.name,
        category=case.task.category,
        grasps=found.grasps,
        contacts_mm=found.contacts_mm,
        made=made,
        facts=found.facts,
        inputs=tuple(inputs.items()),
        seconds=seconds,
        applied=done,
    )
    if wanted.html is not None:
        write_whole(wanted.html, explain_html(entry))
    return entry


@contextmanager
def _workspace(work: Path | None) -> Iterator[Path]:
    """Where stages are kept: the folder asked for, else one that is gone afterwards."""
    if work is not None:
        try:
            work.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BatchRefused(
                [Problem(str(work), f"cannot be made ({error.strerror}); choose another --work.")]
            ) from None
        yield work
        return
    with tempfile.TemporaryDirectory(prefix="drupe-explain-") as folder:
        yield Path(folder)


@contextmanager
def _said_plainly() -> Iterator[None]:
    """Every room's failure as one kind, with its sentence."""
    try:
        yield
    except (ReconFailure, TactileFailure, FemFailure, FruitEnded) as failure:
        raise NotExplained(" ".join(str(failure).split())) from failure
    except MemoryError as error:
        raise NotExplained(f"Ran out of memory ({error}); close other programs and run it again.") from error


def _require_writable(wanted: Wanted) -> None:
    """A slip in the name of an output is found before the work, not after it."""
    for option, target in (("--json", wanted.json), ("--html", wanted.html)):
        if target is None:
            continue
        if target.is_dir():
            raise BatchRefused([Problem(str(target), f"is a folder; {option} takes the name of a file.")])
        if not target.absolute().parent.is_dir():
            raise BatchRefused(
                [Problem(str(target.parent), f"there is no such folder; make it, or change {option}.")]
            )
