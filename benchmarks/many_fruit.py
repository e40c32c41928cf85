"""What a run itself costs with many fruit: its start, its memory, its time between fruit, its report.

    python benchmarks/many_fruit.py make GRADED BATCH --fruits 1000 [--bare]
    python benchmarks/many_fruit.py run GRADED BATCH [--work 0] [--jobs 2]
    python benchmarks/many_fruit.py simulate GRADED BATCH [--work 0.01] [--jobs 2] [--reports]

GRADED is a batch of one fruit, N01, with a ready mesh, and its `results` as `drupe grade` leaves them. `make`
copies the fruit: its mesh scaled by up to 10 % with noise of 0.01 mm, displacements of its recordings by as
much with noise of 0.001 mm; with `--bare` every fruit is a link to a ball and to an empty recording. `run` is
`drupe grade` of BATCH, but that a fruit's process waits for `--work` seconds and leaves copies of the graded
fruit's record and pictures, E drawn anew: processes, records, progress, ranking and report are the run's own.
`simulate` has no processes either: fruit end after `--work` seconds, `--jobs` at a time. With `--reports`
this process leaves the copies, which counts as work and not as the run's; without, no fruit has files, and
neither ranking nor report is made. A batch has at most 2000 fruit; for `simulate` that limit is lifted.
"""

import argparse
import heapq
import os
import pickle
import shutil
import time
from pathlib import Path

import psutil
from stub_fruit import GRADED, STAGES, WORK_S, drawn, stub

EVERY = 20
"""Lines of a table."""


def make(graded: Path, batch: Path, *, fruits: int, bare: bool) -> None:
    """The batch of copies."""
    import h5py
    import numpy as np

    from recon.silhouettes.hull import ball
    from recon.surface.mesh_file import read_mesh, write_mesh

    rng = np.random.default_rng(24)
    (batch / "fruits").mkdir(parents=True)
    shutil.copyfile(graded / "batch.toml", batch / "batch.toml")
    names = [f"F{k:05d}" for k in range(fruits)]
    (batch / "fruits.csv").write_text("fruit_id,height_mm\n" + "".join(f"{name},56\n" for name in names))
    own = graded / "fruits" / "N01"
    vertices, faces = read_mesh(own / "fruit.ply")
    if bare:
        directions, sides = ball(3)
        write_mesh(batch / "ball.ply", 28 * directions, sides)
        (batch / "empty.h5").write_bytes(b"")
    for name in names:
        folder = batch / "fruits" / name
        (folder / "grasps").mkdir(parents=True)
        if bare:
            os.link(batch / "ball.ply", folder / "fruit.ply")
            os.link(batch / "empty.h5", folder / "grasps" / "grasp-1.h5")
            continue
        scale = rng.uniform(0.9, 1.1)
        noisy = scale * vertices + rng.normal(scale=0.01, size=vertices.shape)
        write_mesh(folder / "fruit.ply", noisy, faces)
        for path in sorted((own / "grasps").glob("*.h5")):
            shutil.copyfile(path, folder / "grasps" / path.name)
            with h5py.File(folder / "grasps" / path.name, "r+") as file:
                file.attrs["fruit_id"] = name
                for pad in file["pads"].values():
                    moved = pad["displacement_mm"]
                    moved[...] = scale * moved[...] + rng.normal(scale=0.001, size=moved.shape)


class Meter:
    """Seconds, processor seconds of this process and its memory, as fruit end."""

    def __init__(self, total: int) -> None:
        self.every, self.began_s, self.cpu_s = max(1, total // EVERY), time.monotonic(), time.process_time()
        self.first_s, self.done, self.before = None, 0, (self.began_s, self.cpu_s)
        self.work_s = 0.0
        print("fruit  elapsed_s  s/1000  own cpu s/1000  memory_MiB", flush=True)

    def began(self) -> None:
        """The first fruit's process has said something."""
        if self.first_s is None:
            self.first_s = time.monotonic() - self.began_s

    def not_ours(self, began: tuple[float, float]) -> None:
        """What has been spent since (monotonic, processor time) was a fruit's work, not the run's."""
        now = time.monotonic(), time.process_time()
        self.before = tuple(b + n - a for b, n, a in zip(self.before, now, began, strict=True))
        self.work_s += now[0] - began[0]

    def ended(self) -> None:
        """A fruit has ended."""
        self.done += 1
        if self.done % self.every == 0:
            now, cpu = time.monotonic(), time.process_time()
            per = 1000 / self.every
            wall, own = (now - self.before[0]) * per, (cpu - self.before[1]) * per
            self.before = now, cpu
            print(
                f"{self.done:5d}  {now - self.began_s:9.1f}  {wall:6.2f}  {own:14.2f}  {memory_MiB():10.1f}",
                flush=True,
            )


def memory_MiB() -> float:
    """Of this process."""
    return psutil.Process().memory_info().rss / 2**20


class Simulated:
    """An engine without processes: fruit end in their order, `jobs` at a time."""

    def __init__(self, ended, *, jobs: int, work_s: float) -> None:
        self.at_once, self._ended, self._work_s = jobs, ended, work_s
        self._going, self._free = [], [0.0] * jobs

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def room(self) -> int:
        """As many as two for each place."""
        return 2 * self.at_once - len(self._going)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Begins as soon as a place is free."""
        begins = max(time.monotonic(), heapq.heappop(self._free))
        heapq.heappush(self._free, begins + self._work_s)
        heapq.heappush(self._going, (begins + self._work_s, fruit_id, packed))

    def happened(self):
        """The next ending."""
        from pipeline.run.scheduling import Finished, Progressed

        ends, fruit_id, packed = heapq.heappop(self._going)
        time.sleep(max(0.0, ends - time.monotonic()))
        for stage in STAGES:
            yield Progressed(fruit_id, stage)
        yield Finished(fruit_id, self._ended(fruit_id, packed))


def run(graded: Path, batch: Path, *, jobs: int, work_s: float, simulated: bool, reports: bool) -> None:
    """`drupe grade` with such work, and what it cost."""
    from pipeline.batch import fruits_table
    from pipeline.batch.records import read_record
    from pipeline.run import grading
    from pipeline.run.console import RunConsole
    from pipeline.run.progress import BatchProgress
    from pipeline.run.reporting import ReportSoFar

    shutil.rmtree(batch / "results", ignore_errors=True)
    own = graded / "results" / "fruits" / "N01"
    os.environ |= {GRADED: str(own.absolute()), WORK_S: str(work_s)}
    with (batch / "fruits.csv").open() as table:
        meter = Meter(sum(1 for _ in table) - 1)

    class Measured(BatchProgress):
        def stage(self, fruit_id, stage):
            meter.began()
            super().stage(fruit_id, stage)

        def done(self, fruit_id, sentence, *, whole):
            super().done(fruit_id, sentence, whole=whole)
            meter.ended()

    so_far_s = 0.0
    whole_report, some_report = grading.report, ReportSoFar.write

    def timed_report(*arguments):
        began = time.monotonic()
        print(f"all ended after {began - meter.began_s:.1f} s, memory {memory_MiB():.1f} MiB")
        ended = whole_report(*arguments) if reports else (0, None)
        print(f"ranking and report at the end: {time.monotonic() - began:.2f} s")
        return ended

    def timed_write(self, **options):
        nonlocal so_far_s
        began = time.monotonic()
        some_report(self, **options)
        so_far_s += time.monotonic() - began

    grading.BatchProgress, grading.report, grading.work_on = Measured, timed_report, stub
    ReportSoFar.write = timed_write if reports else lambda _self, **_: None
    if simulated:
        fruits_table.MOST_FRUIT = 10**6
        record = read_record(own / "record.json")

        def ended(fruit_id, packed):
            if not reports:
                return drawn(record, fruit_id, "k")
            began = time.monotonic(), time.process_time()
            _, task = pickle.loads(packed)
            os.environ[WORK_S] = "0"
            done = stub(task, lambda _: None)
            meter.not_ours(began)
            return done

        grading.local_pool = lambda jobs, **_: Simulated(ended, jobs=jobs, work_s=work_s)
        grading._jobs = lambda _todo, jobs, _console: jobs
    status, _ = grading.grade(batch, None, jobs=jobs, time_limit_s=600, console=RunConsole(quiet=True))
    print(f"exit status {status}; start to the first fruit's first stage: {meter.first_s:.2f} s")
    print(f"reports while it went on: {so_far_s:.1f} s; memory at the end {memory_MiB():.1f} MiB")
    print(f"this process: {time.process_time() - meter.cpu_s:.1f} s of processor time, fruit's work included")


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("make", "run", "simulate"))
    parser.add_argument("graded", type=Path)
    parser.add_argument("batch", type=Path)
    parser.add_argument("--fruits", type=int, default=1000)
    parser.add_argument("--bare", action="store_true")
    parser.add_argument("--work", type=float, default=0.01)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--reports", action="store_true")
    options = parser.parse_args()
    if options.what == "make":
        make(options.graded, options.batch, fruits=options.fruits, bare=options.bare)
        return
    simulated = options.what == "simulate"
    run(
        options.graded,
        options.batch,
        jobs=options.jobs,
        work_s=options.work,
        simulated=simulated,
        reports=options.reports or not simulated,
    )


if __name__ == "__main__":
    main()
