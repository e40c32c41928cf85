"""What a run itself costs with many fruit: its memory, its processor time between fruit, its report.

    python benchmarks/many_fruit.py make GRADED BATCH [--fruits 1000]
    python benchmarks/many_fruit.py simulate GRADED BATCH [--work 0.01] [--jobs 2] [--reports]

GRADED is a batch of one fruit, N01, with a ready mesh, and its `results` as `drupe grade` leaves them. `make`
copies the fruit: its mesh scaled by up to 10 % with noise of 0.01 mm, displacements of its recordings by as
much with noise of 0.001 mm. `simulate` is `drupe grade` of BATCH without processes for its fruit: fruit end
after `--work` seconds, `--jobs` at a time. With `--reports` this process leaves copies of the graded fruit's
record and pictures, E drawn anew. That counts as the fruit's work, not as the run's. Without, no fruit has
files, and neither ranking nor report is made. A batch has at most 2000 fruit; here that limit is lifted.
"""

import heapq
import pickle
import shutil
import time
from pathlib import Path

import h5py
import numpy as np
import psutil
from script import run

from pipeline.batch import fruits_table
from pipeline.batch.records import read_record, write_record
from pipeline.files.manifest import enter, writing_alone
from pipeline.run import grading
from pipeline.run.batch_run import GradeOptions
from pipeline.run.progress import BatchProgress, RunConsole
from pipeline.run.scheduling import Finished
from recon.surface.mesh_file import read_mesh, write_mesh

LINES = 20
"""Of the table."""
PICTURES = ("fruit.ply", "pit.ply", "mesh.webp", "fruit.glb")
GOLDEN = 0.618034
"""Fractional parts of its multiples spread evenly: E of the copies."""


def make(graded: Path, batch: Path, fruits: int = 1000) -> None:
    """The batch of copies."""
    rng = np.random.default_rng(24)
    (batch / "fruits").mkdir(parents=True)
    shutil.copyfile(graded / "batch.toml", batch / "batch.toml")
    names = [f"F{k:05d}" for k in range(fruits)]
    (batch / "fruits.csv").write_text("fruit_id,height_mm\n" + "".join(f"{name},56\n" for name in names))
    original = graded / "fruits" / "N01"
    vertices, faces = read_mesh(original / "fruit.ply")
    for name in names:
        folder = batch / "fruits" / name
        (folder / "grasps").mkdir(parents=True)
        scale = rng.uniform(0.9, 1.1)
        noisy = scale * vertices + rng.normal(scale=0.01, size=vertices.shape)
        write_mesh(folder / "fruit.ply", noisy, faces)
        for path in sorted((original / "grasps").glob("*.h5")):
            shutil.copyfile(path, folder / "grasps" / path.name)
            with h5py.File(folder / "grasps" / path.name, "r+") as file:
                file.attrs["fruit_id"] = name
                for pad in file["pads"].values():
                    moved = pad["displacement_mm"]
                    moved[...] = scale * moved[...] + rng.normal(scale=0.001, size=moved.shape)


def copied(record, fruit_id, key):
    """The record under another name, with E by its number."""
    factor = 0.5 + (int(fruit_id[1:]) * GOLDEN) % 1.0
    grasps = tuple(g.model_copy(update={"digest": f"{fruit_id}-{g.grasp}"}) for g in record.grasps)
    modulus = record.modulus.model_copy(
        update={"E_MPa": record.modulus.E_MPa * factor, "E_sd_MPa": record.modulus.E_sd_MPa * factor}
    )
    return record.model_copy(
        update={"fruit_id": fruit_id, "key": key, "modulus": modulus, "grasps": grasps, "strangers": {}}
    )


def leave_results(graded: Path, task):
    """Copies of the graded fruit's record and pictures, as a fruit's process leaves them."""
    task.results.claim()
    task.results.forget()
    for name in PICTURES:
        if (graded / name).is_file():
            with writing_alone(task.results.root):
                enter(task.results.root / name, (graded / name).read_bytes())
                shutil.copyfile(graded / name, task.results.root / name)
    record = copied(read_record(graded / "record.json"), task.fruit_id, task.key)
    write_record(task.results.record, record)
    return record


class Meter:
    """Seconds, processor seconds of this process and its memory, as fruit end."""

    def __init__(self, total: int) -> None:
        self.every, self.began_s, self.cpu_s = max(1, total // LINES), time.monotonic(), time.process_time()
        self.done, self.before = 0, (self.began_s, self.cpu_s)
        print("fruit  elapsed_s  s/1000  own cpu s/1000  memory_MiB", flush=True)

    def not_ours(self, began: tuple[float, float]) -> None:
        """What has been spent since (monotonic, processor time) was a fruit's work, not the run's."""
        now = time.monotonic(), time.process_time()
        self.before = tuple(b + n - a for b, n, a in zip(self.before, now, began, strict=True))

    def ended(self) -> None:
        """A fruit has ended."""
        self.done += 1
        if self.done % self.every == 0:
            now, cpu = time.monotonic(), time.process_time()
            wall, mine = (1000 / self.every * x for x in (now - self.before[0], cpu - self.before[1]))
            self.before = now, cpu
            print(
                f"{self.done:5d}  {now - self.began_s:9.1f}  {wall:6.2f}  {mine:14.2f}  {memory_MiB():10.1f}",
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
        ends, fruit_id, packed = heapq.heappop(self._going)
        time.sleep(max(0.0, ends - time.monotonic()))
        yield Finished(fruit_id, self._ended(fruit_id, packed))


def simulate(graded: Path, batch: Path, jobs: int = 2, work: float = 0.01, reports: bool = False) -> None:
    """`drupe grade` with such work, and what it cost."""
    shutil.rmtree(batch / "results", ignore_errors=True)
    original = graded / "results" / "fruits" / "N01"
    record = read_record(original / "record.json")
    meter = Meter(len((batch / "fruits.csv").read_text().splitlines()) - 1)
    whole_report = grading.report

    class Measured(BatchProgress):
        def done(self, fruit_id, sentence):
            super().done(fruit_id, sentence)
            meter.ended()

    def timed_report(*arguments):
        began = time.monotonic()
        print(f"all ended after {began - meter.began_s:.1f} s, memory {memory_MiB():.1f} MiB")
        ended = whole_report(*arguments) if reports else (0, None)
        print(f"ranking and report at the end: {time.monotonic() - began:.2f} s")
        return ended

    def ended(fruit_id, packed):
        if not reports:
            return copied(record, fruit_id, "k")
        began = time.monotonic(), time.process_time()
        _, task = pickle.loads(packed)
        result = leave_results(original, task)
        meter.not_ours(began)
        return result

    grading.BatchProgress, grading.report, fruits_table.MOST_FRUIT = Measured, timed_report, 10**6
    if not reports:
        grading.report_so_far = lambda *_, **_how: None
    grading._engine = lambda *_: Simulated(ended, jobs=jobs, work_s=work)
    how = GradeOptions(jobs=jobs, time_limit_s=600)
    status, _ = grading.grade(batch, None, how, console=RunConsole(quiet=True))
    spent_s = time.process_time() - meter.cpu_s
    print(f"exit status {status}; memory at the end {memory_MiB():.1f} MiB")
    print(f"this process: {spent_s:.1f} s of processor time, fruit's work included")


if __name__ == "__main__":
    run(make, simulate)
