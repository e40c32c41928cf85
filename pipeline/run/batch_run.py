"""The batch, places and times of one run of `drupe grade`.

A folder of results belongs to a batch if at least one photo or recording is the same. If all were replaced,
the folder, the label and the id of a fruit must be the same. Ids alone do not identify a batch: many people
number their fruit from 1 every day.
"""

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import PurePosixPath
from typing import Any

from pipeline.batch.layout import Results
from pipeline.batch.opening import Batch
from pipeline.batch.provenance import read_provenance, utc_text, write_provenance
from pipeline.batch.write_guard import require_free
from pipeline.files.plain_file import listed, printable
from pipeline.problem import refused
from pipeline.ranking.batch_faults import BatchFault
from pipeline.ranking.reference_ratio import ReferenceFinding
from pipeline.run.scheduling import WorkPlace
from reports.language import ENGLISH

LABEL = ("lot", "harvest_date", "cultivar", "category")
"""Settings by which people distinguish batches."""
SHARED_KINDS = frozenset({".toml", ".json", ".csv", ".ply"})
"""Files that may be identical in different batches: descriptions of sensors, protocols of the gripper, the
mould of a cast body. Photos and recordings belong to one fruit."""
SHOWN = 3
"""Most ids in one sentence."""


def utc_now() -> datetime:
    """The time now, in UTC and aware of its zone."""
    return datetime.now(UTC)


@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """How drupe grades a batch: `jobs` fruit at once, each within `time_limit_s`, on the machines of `place`.
    `screen`: whether it screens fruit for missing physics. `force`: whether implausible numbers are only
    doubts. `language`: of the report.
    """

    jobs: int = 1
    time_limit_s: float = math.inf
    screen: bool = True
    force: bool = False
    language: str = ENGLISH
    place: WorkPlace = field(default_factory=WorkPlace)


@dataclass(frozen=True, kw_only=True)
class BatchRun:
    """One run: its batch, its results folder, the SHA-256 of its inputs, and its start."""

    batch: Batch
    results: Results
    inputs: Mapping[str, str]
    options: GradeOptions
    started: datetime
    since_s: float
    ended: datetime | None = None
    """End of a finished run: drupe writes only its report again."""

    def until_now(self) -> datetime:
        """The end of the run if it has ended, otherwise the time now by the monotonic clock."""
        return self.ended or self.started + timedelta(seconds=time.monotonic() - self.since_s)

    def require_ours(self, fruit: Collection[str] | None = None) -> None:
        """Raises BatchRefused if the results contain files of others, or belong to another batch. `fruit`:
        whose files it checks; None: all.
        """
        results = self.results
        names = self.batch.row_of if fruit is None else fruit
        of_fruit = (path for name in names for path in results.fruit(name).files)
        require_free((*results.files, results.run, *of_fruit), "--out")
        require_same_batch(results, self.batch, self.inputs)

    def write_provenance(
        self,
        outcomes: Mapping[str, str],
        status: int | None,
        finding: ReferenceFinding | None = None,
        faults: Sequence[BatchFault] = (),
    ) -> None:
        """Writes batch.json with the outcomes of the fruit so far; `status` is None before the end. Times are
        UTC in ISO 8601. Raises NotWritten.
        """
        content = {
            "batch": batch_folder(self.batch),
            "settings": self.batch.settings.model_dump(mode="json"),
            "inputs": self.inputs,
            "started_utc": utc_text(self.started),
            "finished_utc": None if status is None else utc_text(self.until_now()),
            "exit_status": status,
            "force": self.options.force,
            "screened": self.options.screen,
            "faults": [asdict(fault) for fault in faults],
            "outcomes": outcomes,
        }
        reference = {} if finding is None else {"reference": asdict(finding)}
        write_provenance(self.results.provenance, content | reference)


def batch_folder(batch: Batch) -> str:
    """The batch's folder as batch.json names it: absolute, without links."""
    return str(batch.folder.root.resolve())


def require_same_batch(results: Results, batch: Batch, inputs: Mapping[str, str]) -> None:
    """Raises BatchRefused if `results` belongs to another batch than this one. `inputs`: SHA-256 of this
    batch's files, by path inside the batch.
    """
    said = read_provenance(results) or {}
    former_inputs, settings, outcomes = (
        _table(said.get(name)) for name in ("inputs", "settings", "outcomes")
    )
    measured = _measured(former_inputs)
    if not measured or measured & _measured(inputs):
        return
    folder, now = str(said.get("batch", "")), batch.settings.model_dump(mode="json")
    same_label = all(str(settings.get(name)) == str(now.get(name)) for name in LABEL)
    if folder == batch_folder(batch) and same_label and outcomes.keys() & batch.row_of.keys():
        return
    fruit = printable(listed(sorted(outcomes), SHOWN))
    sentence = (
        f"holds the results of another batch in {printable(folder)} (fruit {fruit}), with other photos and "
        "recordings. They are not replaced; choose another folder with --out, or move this one away."
    )
    raise refused(results.root, sentence)


def _measured(inputs: Mapping[str, Any]) -> set[str]:
    """SHA-256 of the fruit's photos and recordings."""
    paths = ((PurePosixPath(name), str(digest)) for name, digest in inputs.items())
    return {
        digest
        for path, digest in paths
        if len(path.parts) > 2
        and path.parts[0] == "fruits"
        and path.suffix.lower() not in SHARED_KINDS
        and path.stem != "reference"
        and " " not in digest  # a file that could not be read
    }


def _table(value: object) -> Mapping[str, Any]:
    return {str(name): entry for name, entry in value.items()} if isinstance(value, dict) else {}
