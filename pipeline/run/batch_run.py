"""What one run of `drupe grade` knows of its batch and of its places."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta

from pipeline.batch.layout import Results
from pipeline.batch.opening import Batch
from pipeline.batch.provenance import write_provenance
from pipeline.batch.write_guard import require_free
from pipeline.ranking.batch_faults import BatchFault
from pipeline.ranking.reference_ratio import ReferenceFinding
from pipeline.run.former_results import batch_folder, require_same_batch
from reports.language import ENGLISH


def utc_now() -> datetime:
    """The time now, aware of its zone."""
    return datetime.now(UTC)


@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """How a batch is graded: `jobs` fruit at once, each within `time_limit_s`. `screen`: whether fruit are
    screened for missing physics; `force`: whether numbers that no fruit has are only doubts. `language`: of
    the report.
    """

    jobs: int
    time_limit_s: float
    screen: bool = True
    force: bool = False
    language: str = ENGLISH


@dataclass(frozen=True, kw_only=True)
class BatchRun:
    """One run: its batch, where results lie, the SHA-256 of what it reads, and when it began."""

    batch: Batch
    results: Results
    inputs: Mapping[str, str]
    force: bool
    screen: bool
    language: str
    started: datetime
    since_s: float

    def until_now(self) -> datetime:
        """The time now, by the monotonic clock."""
        return self.started + timedelta(seconds=time.monotonic() - self.since_s)

    def require_ours(self, fruit: Collection[str] | None = None) -> None:
        """Raises BatchRefused where the results hold files of others, or another batch's. `fruit`: those
        whose files are looked at; None: all.
        """
        results = self.results
        names = self.batch.row_of if fruit is None else fruit
        of_fruit = (path for name in names for path in results.fruit(name).files)
        require_free((*results.files, results.run, *of_fruit), "--out")
        require_same_batch(results, self.batch, self.inputs, "--out")

    def write_provenance(
        self,
        outcomes: Mapping[str, str],
        status: int | None,
        finding: ReferenceFinding | None = None,
        faults: Sequence[BatchFault] = (),
    ) -> None:
        """batch.json, with what fruit came to so far; `status` is None before the end. Raises NotWritten."""
        write_provenance(
            self.results.provenance,
            batch=batch_folder(self.batch),
            settings=self.batch.settings.model_dump(mode="json"),
            inputs=self.inputs,
            started=self.started,
            finished=None if status is None else self.until_now(),
            exit_status=status,
            outcomes=outcomes,
            reference=None if finding is None else asdict(finding),
            force=self.force,
            screened=self.screen,
            faults=[asdict(fault) for fault in faults],
        )
