"""What a run itself costs with many fruit: its start, its memory, its time between fruit, its report.

    python benchmarks/many_fruit.py make GRADED BATCH --fruits 1000 [--bare]
    python benchmarks/many_fruit.py run GRADED BATCH [--work 0] [--jobs 2]
    python benchmarks/many_fruit.py simulate GRADED BATCH [--work 0.01] [--jobs 2] [--reports]
    python benchmarks/many_fruit.py watch GRADED BATCH [--there 0] [--every 5]

GRADED is a batch of one fruit, N01, with a ready mesh, and its `results` as `drupe grade` leaves them. `make`
copies the fruit: its mesh scaled by up to 10 % with noise of 0.01 mm, displacements of its recordings by as
much with noise of 0.001 mm; with `--bare` every fruit is a link to a ball and to an empty recording. `run` is
`drupe grade` of BATCH, but that a fruit's process waits for `--work` seconds and leaves copies of the graded
fruit's record and pictures, E drawn anew: processes, records, progress, ranking and report are the run's own.
`simulate` has no processes either: fruit end after `--work` seconds, `--jobs` at a time. With `--reports`
this process leaves the copies, which counts as work and not as the run's; without, no fruit has files, and
neither ranking nor report is made. A batch has at most 2000 fruit; for `simulate` that limit is lifted.
`watch` is `drupe watch` of BATCH with the same work, where `--there` fruit are graded already: the others lie
in `waiting` and come into `fruits` one every `--every` seconds, by a clock that waiting moves on at once and
computing as long as it takes.
"""

import argparse
import heapq
import os
import pickle
import shutil
import time
from dataclasses import replace
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


class DayMeter:
    """What a fruit costs while a batch is watched: seconds, processor seconds, and the delay of its page."""

    def __init__(self, total: int) -> None:
        self.every, self.done = max(1, total // EVERY), 0
        self.spent = dict.fromkeys(("all", "looks", "reports", "work"), (0.0, 0.0))
        self.begin()
        self.written_s, self.delays_s = {}, []
        print("                    own cpu (ms a fruit)           record to page (ms)")
        print("fruit  ms a fruit  all   looks  reports  rest      mean   most  memory_MiB", flush=True)

    def begin(self):
        """The first newcomer arrives."""
        self.spent = dict.fromkeys(self.spent, (0.0, 0.0))
        self.before, self.began = dict(self.spent), (time.monotonic(), time.process_time())

    def timed(self, part, function):
        """The function, whose time counts as that part's."""

        def timed(*arguments, **options):
            began = time.monotonic(), time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                now = time.monotonic(), time.process_time()
                self.spent[part] = tuple(
                    s + n - b for s, n, b in zip(self.spent[part], now, began, strict=True)
                )

        return timed

    def shown(self, fruit_id):
        """The page has it."""
        if fruit_id in self.written_s:
            self.delays_s.append(time.monotonic() - self.written_s.pop(fruit_id))
            self.done += 1
            if self.done % self.every == 0:
                self._print()

    def _print(self):
        now = time.monotonic(), time.process_time()
        self.spent["all"] = tuple(n - b for n, b in zip(now, self.began, strict=True))
        ms = {
            part: tuple(1000 * (s - b) / self.every for s, b in zip(spent, self.before[part], strict=True))
            for part, spent in self.spent.items()
        }
        self.before = dict(self.spent)
        wall, own = (a - w for a, w in zip(ms["all"], ms["work"], strict=True))
        looks, reports = ms["looks"][1], ms["reports"][1]
        mean, most = 1000 * sum(self.delays_s) / len(self.delays_s), 1000 * max(self.delays_s)
        self.delays_s = []
        print(
            f"{self.done:5d}  {wall:10.0f}  {own:4.0f}  {looks:5.0f}  {reports:7.0f}  "
            f"{own - looks - reports:4.0f}  {mean:8.0f}  {most:5.0f}  {memory_MiB():10.0f}",
            flush=True,
        )


def watch(graded: Path, batch: Path, *, there: int, every_s: float) -> None:
    """`drupe watch` with such work, and what it cost."""
    from pipeline.batch.opening import open_batch
    from pipeline.run import grading, reporting
    from pipeline.run.console import RunConsole
    from pipeline.watch.watching import BatchWatch, WatchOptions
    from reports.kiosk_page import kiosk_html

    shutil.rmtree(batch / "results", ignore_errors=True)
    os.environ |= {GRADED: str((graded / "results" / "fruits" / "N01").absolute()), WORK_S: "0"}
    waiting = batch / "waiting"
    waiting.mkdir(exist_ok=True)
    for path in waiting.iterdir():
        path.rename(batch / "fruits" / path.name)
    names = sorted(path.name for path in (batch / "fruits").iterdir())[there:]
    for name in names:
        (batch / "fruits" / name).rename(waiting / name)
    names.reverse()
    coming, moved_s, next_s = len(names), 0.0, 0.0

    def clock():
        return time.monotonic() + moved_s

    def sleep(seconds):
        nonlocal moved_s, next_s
        moved_s += seconds
        while names and clock() >= next_s:
            if len(names) == coming:
                meter.begin()
            name = names.pop()
            (waiting / name).rename(batch / "fruits" / name)
            next_s = max(next_s + every_s, clock())

    def show(entry):
        kiosk_html(entry)
        if entry.recent:
            meter.shown(entry.recent[0])

    def ended(fruit_id, packed):
        _, task = pickle.loads(packed)
        record = stub(task, lambda _: None)
        if meter is not None:
            meter.written_s[fruit_id] = time.monotonic()
        return record

    meter = None
    engine = lambda jobs, **_: Simulated(ended, jobs=jobs, work_s=0)  # noqa: E731
    grading.local_pool, grading.work_on = engine, stub
    grading._jobs = lambda _todo, jobs, _console: jobs
    console = RunConsole(quiet=True)
    if there:
        opened = open_batch(batch)
        opened = replace(opened, rows=opened.rows[:there])
        grading.grade(batch, None, jobs=1, time_limit_s=600, console=console, opened=opened)
    meter = DayMeter(len(names))
    ended = meter.timed("work", ended)
    grading.report = reporting.report = meter.timed("reports", grading.report)
    BatchWatch._opened = meter.timed("looks", BatchWatch._opened)
    options = WatchOptions(
        out=batch / "results", jobs=1, time_limit_s=600, screen=True, settle_s=2, idle_s=60 + every_s
    )
    status = BatchWatch(
        root=batch, options=options, console=console, show=show, clock=clock, sleep=sleep
    ).run()
    total = time.process_time() - meter.began[1] - meter.spent["work"][1]
    looks, reports = meter.spent["looks"][1], meter.spent["reports"][1]
    print(f"exit status {status}; {total:.0f} s of processor time: looks {looks:.0f}, reports {reports:.0f}")
    print(f"{clock() - meter.began[0]:.0f} s by the clock that waiting moves; memory {memory_MiB():.0f} MiB")


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
    parser.add_argument("what", choices=("make", "run", "simulate", "watch"))
    parser.add_argument("graded", type=Path)
    parser.add_argument("batch", type=Path)
    parser.add_argument("--fruits", type=int, default=1000)
    parser.add_argument("--bare", action="store_true")
    parser.add_argument("--work", type=float, default=0.01)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--reports", action="store_true")
    parser.add_argument("--there", type=int, default=0)
    parser.add_argument("--every", type=float, default=5.0)
    options = parser.parse_args()
    if options.what == "make":
        make(options.graded, options.batch, fruits=options.fruits, bare=options.bare)
        return
    if options.what == "watch":
        watch(options.graded, options.batch, there=options.there, every_s=options.every)
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
