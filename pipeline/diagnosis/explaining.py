"""`drupe explain`: physics that simulation misses in one fruit's recordings; terminal, JSON and page."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from fem.fem_failure import FemFailure
from fem.mismatch.catalogue import SPECS
from pipeline.batch.cache import file_hash
from pipeline.batch.layout import CaseFolder, FruitResults, Results, write_whole
from pipeline.batch.opening import Batch
from pipeline.batch.outcome import FruitEnded
from pipeline.batch.provenance import input_hashes, versions
from pipeline.batch.scratch import scratch, temporary_files_in
from pipeline.batch.write_guard import (
    LOCK,
    is_held,
    require_file_apart,
    require_free,
    require_made_by_drupe,
    require_new_or_ours,
    require_results_place,
    results_lock,
    same_place,
)
from pipeline.diagnosis.apply_to_settings import applied
from pipeline.diagnosis.diagnosed_case import Case, open_case
from pipeline.diagnosis.diagnosis import Diagnosis, finding
from pipeline.diagnosis.notes import require_one_fruit
from pipeline.diagnosis.terminal_summary import IN_ALL
from pipeline.files.manifest import LIST_LOCK, MANIFEST, MOST_BYTES, json_in
from pipeline.files.plain_file import text_or_empty
from pipeline.files.whole_file import put
from pipeline.fruit.stage_log import StageLog
from pipeline.problem import refused
from pipeline.run.batch_run import require_same_batch, utc_now
from pipeline.run.grading import read_files
from recon.recon_failure import ReconFailure
from reports.explain_entries import FORMAT, EffectEntry, ExplainEntry
from reports.explain_page import explain_html, page_title
from reports.language import ENGLISH, LANGUAGES
from tactile.tactile_failure import TactileFailure

OF_A_TRACE = {
    "onset_mm": "travel at first contact",
    "zero_N": "load cell reading before first contact",
    "toe_mm": "travel over which an end that is not parallel to its plate comes into contact",
    "ends_held": "ends of the specimen: 0 slide, 1 are held",
    "yeoh_second": "law of Yeoh: C2 / C1",
    "yeoh_third": "law of Yeoh: C3 / C1",
    "ogden_power": "law of Ogden: exponent of a term",
    "ogden_weight_2": "law of Ogden: share of the second term in the initial stiffness",
}
"""Parameters that only the curve of a bare indenter has; they belong to no effect."""


def explain_entry(
    diagnosis: Diagnosis,
    *,
    case: str,
    category: str,
    seconds: Mapping[str, float],
    inputs: Mapping[str, str],
    versions: Mapping[str, str],
    made: datetime,
    applied: str = "",
) -> ExplainEntry:
    """All output on one case. Fields of the explanation are copied by name (`seconds` excepted)."""
    answer = diagnosis.explanation
    verdict = (answer.verdict,) if isinstance(answer.verdict, str) else answer.verdict
    known = {field.name: getattr(answer, field.name) for field in fields(answer)}
    return ExplainEntry(
        **known
        | {
            "verdict": verdict,
            "left_out": tuple(diagnosis.grasps[k] for k in answer.left_out),
            "seconds": seconds,
            "case": case,
            "category": category,
            "grasps": diagnosis.grasps,
            "applied": applied or None,
            "inputs": inputs,
            "versions": versions,
            "made_utc": made,
            "effects": effect_entries([*verdict, *(candidate.effect for candidate in answer.ranking)]),
            "parameter_words": {
                candidate.effect: {
                    name: parameter_words(candidate.effect, name) for name in candidate.parameters
                }
                for candidate in answer.ranking
            },
            "contacts_mm": diagnosis.contacts_mm,
            "facts": diagnosis.facts,
            "doubts": diagnosis.doubts,
            "scale_sd": diagnosis.scale_sd,
        }
    )


def effect_entries(names: Iterable[str]) -> dict[str, EffectEntry]:
    """Words of all single effects in these names, those of pairs included, that the catalogue has."""
    single = dict.fromkeys(part for name in names for part in name.split("+"))
    return {name: EffectEntry(**vars(SPECS[name].words)) for name in single if name in SPECS}


def parameter_words(effect: str, name: str) -> str:
    """The meaning of a parameter of an effect or pair, where it may be named "effect.parameter".

    Further ones of a kind have the words of the first; unknown ones have their own name.

    >>> parameter_words("viscoelastic", "tau_2_s")
    'time over which it fades'
    """
    part, _, parameter_name = name.rpartition(".")
    specs = [
        SPECS[effect_name] for effect_name in ([part] if part else effect.split("+")) if effect_name in SPECS
    ]
    known = (spec.parameter(parameter_name) for spec in specs)
    words = next((parameter.words for parameter in known if parameter is not None), None)
    of_trace = next((said for prefix, said in OF_A_TRACE.items() if parameter_name.startswith(prefix)), None)
    return words or of_trace or name.replace("_", " ")


class NotExplained(Exception):
    """The fruit or its recordings could not be used; the text is the sentence staff read."""


@dataclass(frozen=True, kw_only=True)
class ExplainOutputs:
    """Where the answer is written, and the language of its page; `work`: where a case of its own keeps its
    stages between runs.
    """

    json: Path | None = None
    html: Path | None = None
    work: Path | None = None
    out: Path | None = None
    apply: bool = False
    language: str = ENGLISH


def explain(
    path: Path,
    *,
    fruit_id: str | None,
    wanted: ExplainOutputs,
    report: Callable[[str], None],
    jobs: int = 1,
) -> ExplainEntry:
    """Explains the case or fruit at `path`, writes the wanted outputs, and returns the page's content.

    `jobs`: recordings and effects processed at the same time.

    Raises BatchRefused (before the work begins) and NotExplained (begun, and no answer).
    """
    _require_writable(wanted)
    with scratch() as folder, temporary_files_in(folder):
        work = wanted.work or folder / "work"
        case = open_case(path, fruit_id=fruit_id, work=work, out=wanted.out)
        if wanted.apply and case.batch is None:
            sentence = "is a single case, but --apply writes into a batch's settings; remove --apply."
            raise refused(path, sentence)
        if case.batch is None:
            _require_apart(case, wanted)
            held, option = case.task.results.root, "--work"
        else:
            held, option = _require_apart_of_batch(case, case.batch, wanted), "--out"
            if wanted.out is not None and not Results(wanted.out).provenance.is_file():
                report(f"{wanted.out} holds no results of drupe grade: drupe computes all stages again")
        with results_lock(held, option=option), _said_plainly():
            Results(held).claim()
            case.task.results.claim()
            case.task.results.sweep()
            return _explained(case, wanted, report, jobs)


def _explained(case: Case, wanted: ExplainOutputs, report: Callable[[str], None], jobs: int) -> ExplainEntry:
    require_one_fruit(case)
    started, since_s = utc_now(), time.monotonic()
    log = StageLog(report)
    diagnosis = finding(case, log, jobs=jobs)
    explanation = diagnosis.explanation
    done = applied(case, explanation, now=started) if wanted.apply else ""
    made = utc_now()
    seconds = {
        **log.seconds,
        **{f"explanation, {stage}": round(took, 2) for stage, took in (explanation.seconds or {}).items()},
        IN_ALL: round(time.monotonic() - since_s, 2),
    }
    entry = explain_entry(
        diagnosis,
        case=case.name,
        category=case.task.category,
        seconds=seconds,
        inputs={path.name: file_hash(path) for path in case.input_files()},
        versions=versions(),
        made=made,
        applied=done,
    )
    if wanted.json is not None:
        put(wanted.json, (_json(entry.as_json()) + "\n").encode())
    if case.batch is not None:
        write_whole(case.task.results.mismatch, _json({**entry.as_json(), "key": case.task.key}) + "\n")
    if wanted.html is not None:
        put(wanted.html, explain_html(entry, language=wanted.language).encode())
    return entry


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False)


def _require_apart(case: Case, wanted: ExplainOutputs) -> None:
    """A case of its own: refuses outputs in its folder or over inputs."""
    folder, inputs = CaseFolder(case.task.folder.root), case.input_files()
    if wanted.work is not None:
        require_made_by_drupe(wanted.work, "--work", outside=[folder.root])
        require_free(FruitResults(wanted.work).files, "--work")
    for target in (wanted.json, wanted.html):
        if target is not None:
            require_file_apart(target, inputs=inputs, folders=[folder.root])


def _require_apart_of_batch(case: Case, batch: Batch, wanted: ExplainOutputs) -> Path:
    """For a batch's fruit: refuses results over inputs, and answers elsewhere in the batch; returns the
    results."""
    root = case.task.results.root.parents[1]
    results = Results(wanted.out or batch.folder.default_results)
    inputs, fruit = read_files(batch), results.fruit(case.name)
    require_results_place(results.root, batch.folder)
    if not is_held(root):
        require_free((*results.files, results.run, *fruit.files), "--out")
    if results.provenance.is_file():
        require_same_batch(results, batch, input_hashes(batch.folder.root, inputs))
    lists = (place / name for place in (results.root, fruit.root) for name in (MANIFEST, LIST_LOCK))
    result_files = (*results.files, results.root / LOCK, results.run, *fruit.files, *lists)
    for target in (wanted.json, wanted.html):
        if target is not None:
            require_file_apart(
                target, inputs=inputs, folders=[batch.folder.root, batch.folder.fruits], but_in=root
            )
            if any(same_place(target, path) for path in result_files):
                raise refused(target, "is a file of the results; give another name.")
    return root


@contextmanager
def _said_plainly() -> Iterator[None]:
    """Raises every package's failure as NotExplained, with its sentence."""
    try:
        yield
    except (ReconFailure, TactileFailure, FemFailure, FruitEnded) as failure:
        raise NotExplained(" ".join(str(failure).split())) from failure
    except MemoryError as error:
        raise NotExplained(
            f"drupe ran out of memory ({error}); close other programs and run the command again."
        ) from error


def _require_writable(wanted: ExplainOutputs) -> None:
    """Finds an error in the name of an output before the work, not after it."""
    for option, target in (("--json", wanted.json), ("--html", wanted.html)):
        if target is None:
            continue
        if target.is_dir():
            raise refused(target, f"is a folder; {option} needs a file name.")
        if not target.absolute().parent.is_dir():
            raise refused(target.parent, f"does not exist; create the folder, or change {option}.")
    if wanted.json is not None and wanted.html is not None and same_place(wanted.json, wanted.html):
        raise refused(wanted.html, "is the file of both --json and --html; give two names.")
    if wanted.json is not None:
        require_new_or_ours(wanted.json, _is_answer, "an answer of drupe explain")
    if wanted.html is not None:
        require_new_or_ours(wanted.html, _is_page, "a page of drupe explain")


def _is_answer(path: Path) -> bool:
    said = json_in(path)
    return isinstance(said, dict) and said.get("format") == FORMAT


def _is_page(path: Path) -> bool:
    page = text_or_empty(path, most_bytes=MOST_BYTES)
    return any(page_title(language) in page for language in LANGUAGES)
