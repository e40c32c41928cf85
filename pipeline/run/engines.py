"""What a run's fruit are worked on by: this machine, or a cluster that is asked for."""

import importlib.util
import re
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field

from pipeline.problem import refused
from pipeline.run.batch_run import BatchRun
from pipeline.run.scheduling import Engine
from pipeline.safe_start import elsewhere

ADDRESS = re.compile(r"([a-z]+://)?[^/\s]+:[0-9]+/?")
"""A scheduler's: host and port, the protocol before them or not."""


@dataclass(frozen=True, kw_only=True)
class WorkPlace:
    """Where fruit are worked on: here, `scheduler` (an address of dask), or jobs of `slurm`.

    `jobs`: fruit at the same time at most, None: as many as there are workers; `mark` tells this run's folder
    from any other.
    """

    jobs: int | None = None
    scheduler: str | None = None
    slurm: bool = False
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)

    @property
    def here(self) -> bool:
        """Whether it is this machine."""
        return self.scheduler is None and not self.slurm

    def require_parts(self) -> None:
        """Raises BatchRefused where what is asked for contradicts itself, or is not installed."""
        option = "--slurm" if self.slurm else "--scheduler"
        if self.slurm and self.scheduler is not None:
            sentence = "conflicts with --scheduler; give only one of them."
            raise refused("--slurm", sentence)
        if self.slurm and self.jobs is None:
            raise refused("--slurm", "needs --jobs, the number of Slurm jobs.")
        if self.scheduler is not None and not ADDRESS.fullmatch(self.scheduler):
            sentence = (
                f'found "{self.scheduler}"; expected the address that `dask scheduler` prints, with its port.'
            )
            raise refused("--scheduler", sentence)
        wanted = (
            () if self.here else ("distributed", *(("dask_jobqueue", "cryptography") if self.slurm else ()))
        )
        for name in wanted:
            if importlib.util.find_spec(name) is None:
                sentence = f"needs the package {name}; install it with: pip install 'drupe[cluster]'."
                raise refused(option, sentence)


def cluster_of(
    place: WorkPlace,
    run: BatchRun,
    *,
    fruits: int,
    per_fruit_MiB: float,
    time_limit_s: float,
    tell: Callable[[str], None],
) -> Engine:
    """The cluster that `place` names, for so many fruit of the run."""
    with elsewhere():
        from pipeline.run.cluster import Cluster
        from pipeline.run.cluster_worker import RunNeeds, this_drupe

    needs = RunNeeds(
        drupe=this_drupe(),
        settings=run.batch.folder.settings.absolute(),
        run=run.results.run.absolute(),
        mark=place.mark,
        per_fruit_MiB=per_fruit_MiB,
    )
    return Cluster(
        place.scheduler,
        workers=min(place.jobs or 1, fruits) if place.slurm else 0,
        needs=needs,
        time_limit_s=time_limit_s,
        tell=tell,
        most=None if place.slurm else place.jobs,
    )
