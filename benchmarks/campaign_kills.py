"""Runs of `drupe grade` are killed, starved of disk, doubled and given another time of day: what is left?

A batch of two ready fruit (one with a recording) is graded once undisturbed. Then, at moments drawn from
`--seed`, the command (SIGKILL, SIGTERM) or the process of a fruit (SIGKILL, SIGSEGV) is killed, the disk is
full (a small tmpfs where one may be mounted; the k-th write fails with ENOSPC in any case), two runs begin at
once, and the clock is set back or forward by a day in every process. After each: the inputs are byte for byte
what they were, no process and no temporary file is left; a killed process costs its own fruit and no other;
and the same command again gives the results of the undisturbed run: the same files, outcomes and ranking, E
within 1 % (the mesher does not repeat to the bit). A kill that met nobody is drawn again.

    python benchmarks/campaign_kills.py --kills 100 --folder /tmp/campaign [--quick]

`--quick` leaves out the fruit with a recording, double runs, clocks and the tmpfs.
"""

import errno
import hashlib
import os
import random
import shutil
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from signal import SIGKILL, SIGSEGV, SIGTERM, Signals

import numpy as np
import pandas as pd
import psutil
import trimesh
from script import run

from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.task import fruit_task
from pipeline.files import whole_file
from pipeline.fruit.stages import grade_fruit
from recon.surface.mesh_file import write_mesh
from samples.fruit import fruits_of_seed
from samples.sample_batch import write_scan

SHIPPED = Path(__file__).parents[1] / "samples" / "data" / "nectarines"
SHIPPED_SEED, SHIPPED_COUNT = 1, 4
SETTINGS = 'category = "nectarine"\npoisson_ratio = 0.45\n[mesh]\nedge_mm = 14.0\npad_edge_mm = 6.0\n'
MARK = "DRUPE_CAMPAIGN"
ENTRY = "from pipeline.start import main\nif __name__ == '__main__':\n    main()\n"
CLOCK = """
import os, time
real, began, after, by = time.time, time.monotonic(), float(os.environ["AFTER_S"]), float(os.environ["BY_S"])
time.time = lambda: real() + (by if time.monotonic() - began > after else 0.0)
"""
SAME_E = 0.01
KEYS = ["rank", "fruit_id", "outcome"]
AFTER_S = 2.0
"""A process that comes after the drawn moment is killed within this time."""
TRIES = 5
"""Runs until a kill hits: a process of a fruit is not there at every moment."""
PATIENCE_S = 20.0
"""A killed command's processes are gone at once on Linux; half a second later elsewhere."""
PRIVATE = {".written.json", ".written.lock", ".lock"}
"""Beside the results: drupe's own list of what it wrote, and the lock."""
Row = tuple[str, str, str]


class Fault(AssertionError):
    """Something that must hold does not."""


class Campaign:
    """A batch, an undisturbed run of it, and a folder for the disturbed ones."""

    def __init__(self, folder: Path, seed: int, *, quick: bool) -> None:
        self.folder, self.draw = folder, random.Random(seed)
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "tmp").mkdir(parents=True)
        self.batch = make_batch(folder / "batch", quick=quick)
        (folder / "entry.py").write_text(ENTRY)
        self.inputs = hashes(self.batch)
        self.wait(self.start("first"))  # slower than all others: nothing is in the machine's memory yet
        began = time.monotonic()
        self.status = self.wait(self.start("undisturbed"))
        self.took_s = time.monotonic() - began
        self.expected = results(folder / "undisturbed")
        self.require(len(self.expected[0]) > 0, "the undisturbed run gave no results")

    def empty(self) -> Path:
        """A folder for the results of a disturbed run."""
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        return self.folder / "out"

    def start(self, out: str | Path, **more: str) -> subprocess.Popen[str]:
        """The command, in a process group of its own and with marked processes."""
        self.mark = uuid.uuid4().hex
        environment = {**os.environ, "TMPDIR": str(self.folder / "tmp"), MARK: self.mark, **more}
        command = [sys.executable, str(self.folder / "entry.py"), "grade", str(self.batch)]
        return subprocess.Popen(
            [*command, "--out", str(self.folder / out), "--jobs", "2"],
            env=environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def wait(self, run: subprocess.Popen[str]) -> int:
        """Until it ends; what it said is kept."""
        self.said = run.communicate(timeout=600)[1]
        return run.returncode

    def require(self, holds: bool, otherwise: str) -> None:
        """Raises Fault, with what the command said last."""
        if not holds:
            raise Fault(f"{otherwise}; {getattr(self, 'said', '')[-300:]}")

    def require_nothing_left(self) -> None:
        """No process, and the inputs as they were."""
        end = time.monotonic() + PATIENCE_S
        while (left := processes(self.mark)) and time.monotonic() < end:
            time.sleep(0.1)
        self.require(not left, f"processes left: {left}")
        self.require(hashes(self.batch) == self.inputs, "the inputs changed")

    def require_repaired(self, out: str | Path) -> None:
        """Nothing is left. The same command again gives what the undisturbed run gave, and no other file."""
        self.require_nothing_left()
        status = self.wait(self.start(out))
        self.require(status == self.status, f"the second run ended with {status}")
        self.require_nothing_left()
        files, rows = results(self.folder / out)
        self.require(files == self.expected[0], f"other files: {files ^ self.expected[0]}")
        self.require(same(rows, self.expected[1]), f"another ranking: {rows}")
        left = [p.name for p in (self.folder / "tmp").iterdir()]
        left += [p.name for p in (self.folder / out).rglob(f"*{whole_file.MARK}*")]
        self.require(not left, f"files left: {left}")


def make_batch(root: Path, *, quick: bool) -> Path:
    """A ball that nobody grasped and, unless quick, a shipped nectarine with its first recording."""
    (root / "fruits" / "ball" / "grasps").mkdir(parents=True)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=28.0)
    write_mesh(root / "fruits" / "ball" / "fruit.ply", ball.vertices, ball.faces)
    (root / "batch.toml").write_text(SETTINGS)
    names = ["ball"]
    if not quick:
        fruit = fruits_of_seed(SHIPPED_COUNT, seed=SHIPPED_SEED)[0]
        source = Path("fruits") / fruit.fruit_id / "grasps" / "grasp-1.h5"
        (root / source).parent.mkdir(parents=True)
        write_scan(root / "fruits" / fruit.fruit_id / "fruit.ply", fruit)
        shutil.copyfile(SHIPPED / source, root / source)
        names.append(fruit.fruit_id)
    (root / "fruits.csv").write_text("\n".join(["fruit_id", *names]) + "\n")
    return root


def hashes(root: Path) -> dict[str, str]:
    """SHA-256 of every file."""
    files = (p for p in sorted(root.rglob("*")) if p.is_file())
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def results(out: Path) -> tuple[set[str], pd.DataFrame]:
    """The files of a results folder, and its ranking."""
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and p.name not in PRIVATE}
    ranking = out / "ranking.csv"
    if ranking.is_file() and ranking.stat().st_size:
        return files, pd.read_csv(ranking)
    return files, pd.DataFrame(columns=[*KEYS, "E_MPa"])


def same(rows: pd.DataFrame, other: pd.DataFrame) -> bool:
    """The same fruit in the same order with the same endings, and E within 1 %."""
    close = {"rtol": SAME_E, "atol": 0.0, "equal_nan": True}
    return rows[KEYS].equals(other[KEYS]) and np.allclose(rows["E_MPa"], other["E_MPa"], **close)


def processes(mark: str) -> list[psutil.Process]:
    """Live processes that carry the mark in their environment."""
    marked = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.status() != psutil.STATUS_ZOMBIE and process.environ().get(MARK) == mark:
                marked.append(process)
    return marked


def of_fruit(mark: str) -> list[int]:
    """Processes that work on fruit: neither the command nor the tracker of its shared resources."""
    workers = []
    for process in processes(mark):
        with suppress(psutil.Error):
            if "spawn_main" in " ".join(process.cmdline()):
                workers.append(process.pid)
    return workers


def killed(campaign: Campaign, whom: str, number: Signals) -> str:
    """One kill at a moment of the run, drawn again where nobody was there to be killed; what it cost."""
    for _ in range(TRIES):
        out = campaign.empty()
        run = campaign.start(out)
        at = time.monotonic() + campaign.draw.uniform(0.02, 0.9) * campaign.took_s
        while time.monotonic() < at and run.poll() is None:
            time.sleep(0.02)
        if whom == "command":
            victims = [run.pid] if run.poll() is None else []
        else:
            while not (victims := of_fruit(campaign.mark)) and run.poll() is None:
                time.sleep(0.02)
            time.sleep(campaign.draw.uniform(0, AFTER_S))
        hit = bool(victims)
        if hit:
            try:
                os.kill(campaign.draw.choice(victims), number)
            except ProcessLookupError:
                hit = False
        status = campaign.wait(run)
        campaign.require_nothing_left()
        if hit:
            break
    else:
        raise Fault(f"nobody was there to be killed in {TRIES} runs")
    if whom == "command":
        ends = {SIGKILL: {-SIGKILL}, SIGTERM: {130, -SIGTERM}}[number]
        campaign.require(status in ends, f"ended with {status}")
        cost = f"{len(list(out.glob('fruits/*/record.json')))} of {len(campaign.expected[1])} fruit done"
    else:
        cost = cost_of_a_process(campaign, out, status)
    campaign.require_repaired(out)
    return cost


def cost_of_a_process(campaign: Campaign, out: Path, status: int) -> str:
    """Its fruit alone, as crashed, if it had one; every other ends as in the undisturbed run."""
    ended, expected = (
        dict(zip(rows["fruit_id"], rows["outcome"], strict=True))
        for rows in (results(out)[1], campaign.expected[1])
    )
    others = {name for name in expected if ended.get(name) != expected[name]}
    campaign.require(len(others) <= 1, f"several fruit ended otherwise: {ended}")
    campaign.require(all(ended.get(name) == "crashed" for name in others), f"ended as {ended}")
    campaign.require(status == (3 if others else campaign.status), f"ended with {status}")
    return "one fruit crashed" if others else "no fruit lost: its process had handed it over"


def doubled(campaign: Campaign) -> str:
    """Two runs at once into one place: one works, the other says so."""
    out = campaign.empty()
    first_run, mark = campaign.start(out), campaign.mark
    other = campaign.start(out)
    statuses = sorted((campaign.wait(first_run), campaign.wait(other)))
    campaign.require(statuses == sorted((2, campaign.status)), f"ended with {statuses}")
    campaign.require(not processes(mark), "processes left")
    campaign.require_repaired(out)
    return "one works, one is refused"


def another_time(campaign: Campaign, by_s: float) -> str:
    """The clock is set while the run is on."""
    out = campaign.empty()
    path = campaign.folder / "clock"
    path.mkdir(exist_ok=True)
    (path / "sitecustomize.py").write_text(CLOCK)
    after_s = campaign.draw.uniform(0, 0.5) * campaign.took_s
    run = campaign.start(out, PYTHONPATH=str(path), AFTER_S=str(after_s), BY_S=str(by_s))
    status = campaign.wait(run)
    campaign.require(status == campaign.status, f"ended with {status}")
    campaign.require_repaired(out)
    return "as undisturbed"


def full_tmpfs(campaign: Campaign, KiB: int) -> str:
    """A disk of this size, which is made larger for the second run."""
    place = campaign.folder / "small"
    place.mkdir(exist_ok=True)
    mounted = ["mount", "-t", "tmpfs", "-o", f"size={KiB}k", "tmpfs", str(place)]
    if subprocess.run(mounted, capture_output=True, check=False).returncode:
        return "not run: a tmpfs cannot be mounted here"
    try:
        status = campaign.wait(campaign.start(place / "out"))
        campaign.require(status in {2, 3}, f"ended with {status}")
        campaign.require("No space left on device" in campaign.said, "does not say that the disk is full")
        campaign.require("internal" not in campaign.said, "takes the blame")
        campaign.require_nothing_left()
        subprocess.run(["mount", "-o", "remount,size=256m", str(place)], check=True)
        campaign.require_repaired(place / "out")
    finally:
        subprocess.run(["umount", str(place)], check=True)
    return f"exit {status}, said, repaired"


def full_at_every_write(campaign: Campaign) -> Iterator[Row]:
    """The k-th write of the ball meets a full disk, and so does every later one, until space is freed."""
    batch = open_batch(campaign.batch)
    real = whole_file.os.fsync
    expected, k = None, 0
    while True:
        out = campaign.empty()
        task = fruit_task(batch, "ball", Results(out))
        writes = 0

        def fsync(handle: int, k: int = k) -> None:
            nonlocal writes
            writes += 1
            if k and writes >= k:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(handle)

        whole_file.os.fsync = fsync
        try:
            outcome = grade_fruit(task, lambda _: None).outcome
        except whole_file.NotWritten:
            outcome = "not-written"
        finally:
            whole_file.os.fsync = real
        expected = outcome if expected is None else expected
        last = writes < k
        campaign.require(outcome == (expected if last or not k else "not-written"), f"write {k}: {outcome}")
        campaign.require(grade_fruit(task, lambda _: None).outcome == expected, f"write {k}: not repaired")
        campaign.require(not list(out.rglob(f"*{whole_file.MARK}*")), f"write {k}: files left")
        if last:
            return
        if k:
            yield ("disk full in-process", f"write {k}", "not-written, repaired")
        k += 1


def main(
    kills: int = 100,
    seed: int = 20261122,
    folder: Path = Path("/tmp/drupe-campaign"),
    quick: bool = False,
) -> int:
    """Prints a line per kind of disturbance; the exit status is 1 where anything did not hold."""
    campaign = Campaign(folder, seed, quick=quick)
    kinds = [("command", SIGKILL), ("process", SIGKILL), ("command", SIGTERM), ("process", SIGSEGV)]
    trials: list[tuple[str, Callable[[], str]]] = []
    for i in range(kills):
        whom, number = kinds[i % len(kinds)]
        trials.append((f"{number.name} to a {whom}", lambda w=whom, n=number: killed(campaign, w, n)))
    if not quick:
        trials.append(("two runs at once", lambda: doubled(campaign)))
        trials += [
            (f"clock set by {by_s / 3600:+.0f} h", lambda b=by_s: another_time(campaign, b))
            for by_s in (-86400.0, 86400.0)
        ]
        trials += [(f"tmpfs of {KiB} KiB", lambda s=KiB: full_tmpfs(campaign, s)) for KiB in (64, 512, 4096)]
    counted: Counter[Row] = Counter()
    faults = 0
    for what, trial in trials:
        try:
            counted[what, trial(), "holds"] += 1
        except Fault as fault:
            faults += 1
            counted[what, str(fault), "DOES NOT HOLD"] += 1
        print(f"{sum(counted.values())} of {len(trials)}: {what}", file=sys.stderr)
    try:
        counted.update((what, how, "holds") for what, _, how in full_at_every_write(campaign))
    except Fault as fault:
        faults += 1
        counted["disk full in-process", str(fault), "DOES NOT HOLD"] += 1
    print(
        f"undisturbed: {campaign.took_s:.1f} s, exit {campaign.status}; {len(trials)} trials, {faults} faults"
    )
    for (what, left, held), count in sorted(counted.items()):
        print(f"{count:4d}  {what:24s}  {held:14s}  {left}")
    shutil.rmtree(folder, ignore_errors=True)
    return 1 if faults else 0


if __name__ == "__main__":
    run(main)
