"""Work on a fruit that ends, hangs or dies as its task says, and what a run on a cluster needs."""

import os
import signal
import time
from pathlib import Path

from pipeline.batch.layout import Results
from pipeline.batch.provenance import write_run
from pipeline.batch.records import FruitRecord, ModulusRecord, ScreenRecord, write_record
from pipeline.run.cluster_worker import RunNeeds, this_drupe


def work(task, report):
    report("working")
    kind, _, mark = task.partition(" ")
    if kind == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == "hang":
        time.sleep(600)
    if kind == "raise":
        raise RuntimeError("broken")
    if kind == "fill":
        held = bytearray(400 * 2**20)
        time.sleep(30)
        del held
    if kind in ("take-the-worker-along", "take-every-worker-along"):
        if kind == "take-the-worker-along" and Path(mark).exists():
            return "at the second time"
        Path(mark).touch()
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(600)
    if kind == "sleep":
        Path(mark).write_text(str(os.getpid()))
        time.sleep(600)
    return task, os.getpid(), os.environ["OPENBLAS_NUM_THREADS"]


def patient(task, report):
    """Ends when the file is there."""
    report("working")
    begun, go = map(Path, task.split(" "))
    begun.write_text(str(os.getpid()))
    while not go.exists():
        time.sleep(0.05)
    return task


def needs_of(folder, *, mark="this run", **changed):
    """What a run in `folder` needs of a worker."""
    settings, results = folder / "batch.toml", Results(folder / "results")
    settings.write_text('category = "nectarine"\n')
    results.root.mkdir(exist_ok=True)
    results.claim()
    write_run(results, mark="this run")
    known = {
        "drupe": this_drupe(),
        "settings": settings,
        "run": results.run,
        "mark": mark,
        "per_fruit_MiB": 100.0,
    }
    return RunNeeds(**{**known, **changed})


def graded_unless_it_dies(task, report):
    """A record that names the process; B dies until somebody has mended that."""
    report("modulus")
    if task.fruit_id == "B" and not (task.batch_root / "mended").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    task.results.claim()
    record = FruitRecord(
        fruit_id=task.fruit_id,
        outcome="graded",
        key=task.key,
        given=task.given,
        modulus=ModulusRecord(E_MPa=0.5, E_sd_MPa=0.02),
        screen=ScreenRecord(p_value=0.4),
        peak_memory_MiB=os.getpid(),
    )
    write_record(task.results.record, record)
    return record
