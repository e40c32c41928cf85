"""How much faster fruit are done by 2 workers than by 1, on this machine's pool and on a cluster of dask's.

    python benchmarks/cluster_speed.py [--fruits 12] [--work 6] [--wait]

Every fruit counts for `--work` seconds of processor time, or waits as long with `--wait`, in a process of its
own. A pool of `drupe grade --jobs N` is held against a LocalCluster of N workers with one thread. `speed-up`
is against the pool of one; the last column is what the workers hold in memory beside the fruit's processes.
"""

import argparse
import os
import tempfile
import time
from importlib import metadata
from pathlib import Path

import psutil
from stub_fruit import burn, idle


def seconds_of(engine, work, *, fruits: int, work_s: float) -> float:
    """Until all are done, the engine being ready."""
    from pipeline.run.scheduling import Finished, run_on

    began = time.monotonic()
    tasks = ((f"F{k:05d}", work_s) for k in range(fruits))
    ended = [event for event in run_on(engine, work, tasks) if isinstance(event, Finished)]
    assert len(ended) == fruits
    assert all(isinstance(one.result, float) for one in ended)
    return time.monotonic() - began


def needs_of(folder: Path):
    """What a run in `folder` needs of a worker."""
    from pipeline.batch.batch_fruits import write_run
    from pipeline.batch.cache import ROOMS, code_version, file_hash
    from pipeline.batch.layout import Results
    from pipeline.run.cluster_worker import RunNeeds, python_version

    settings, results = folder / "batch.toml", Results(folder)
    settings.write_text('category = "nectarine"\n')
    results.claim()
    write_run(results, [], mark="m")
    return RunNeeds(
        drupe=metadata.version("drupe"),
        python=python_version(),
        code=code_version(ROOMS),
        settings=settings,
        settings_sha256=file_hash(settings),
        run=results.run,
        mark="m",
        per_fruit_MiB=100.0,
    )


def main() -> None:
    """Prints a table."""
    from distributed import LocalCluster

    from pipeline.run.cluster import Cluster, ClusterPlace
    from pipeline.run.runner import LocalPool

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fruits", type=int, default=12)
    parser.add_argument("--work", type=float, default=6.0)
    parser.add_argument("--wait", action="store_true")
    options = parser.parse_args()
    much = {"fruits": options.fruits, "work_s": options.work}
    work = idle if options.wait else burn
    print(f"load of the machine at the start: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print("engine      workers  seconds  speed-up  own_MiB", flush=True)
    alone = None
    for workers in (1, 2):
        took = seconds_of(LocalPool(jobs=workers, time_limit_s=600), work, **much)
        alone = alone or took
        print(f"pool        {workers:7d}  {took:7.1f}  {alone / took:8.2f}", flush=True)
    for workers in (1, 2):
        with (
            tempfile.TemporaryDirectory() as folder,
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0") as cluster,
        ):
            engine = Cluster(
                ClusterPlace(address=cluster.scheduler_address),
                needs=needs_of(Path(folder)),
                time_limit_s=600,
                tell=lambda _: None,
            )
            took = seconds_of(engine, work, **much)
            held = sum(one.memory_info().rss for one in psutil.Process().children()) / 2**20
        print(f"cluster     {workers:7d}  {took:7.1f}  {alone / took:8.2f}  {held:7.0f}", flush=True)


if __name__ == "__main__":
    main()
