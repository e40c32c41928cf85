"""Work on a fruit that only waits or counts, for `many_fruit.py`: a file of its own,
so that a fruit's process imports little else.
"""

import os
import shutil
import time
from pathlib import Path

GRADED, WORK_S = "DRUPE_STUB_GRADED", "DRUPE_STUB_WORK_S"
"""Environment of the processes: results of the graded fruit, and seconds to wait."""
PICTURES = ("fruit.ply", "pit.ply", "mesh.png", "residual.png", "fruit.glb")
STAGES = ("mesh", "pit", "contact", "flesh", "modulus", "screen", "picture")


def stub(task, report):
    """Copies of the graded fruit's record and pictures, after as long as is asked for."""
    from pipeline.batch.records import read_record, write_record
    from pipeline.files.manifest import enter, writing_alone
    from pipeline.run.fruit_work import keep_pictures

    for stage in STAGES:
        report(stage)
        time.sleep(float(os.environ[WORK_S]) / len(STAGES))
    task.results.claim()
    task.results.forget()
    graded = Path(os.environ[GRADED])
    for name in PICTURES:
        if (graded / name).is_file():
            with writing_alone(task.results.root):
                enter(task.results.root / name, (graded / name).read_bytes())
                shutil.copyfile(graded / name, task.results.root / name)
    record = drawn(read_record(graded / "record.json"), task.fruit_id, task.key)
    write_record(task.results.record, record)
    keep_pictures(task, record)
    return record


def drawn(record, fruit_id, key):
    """The record under another name, with E by its number."""
    factor = 0.5 + (int(fruit_id[1:]) * 0.618034) % 1.0
    grasps = tuple(g.model_copy(update={"digest": f"{fruit_id}-{g.grasp}"}) for g in record.grasps)
    modulus = record.modulus.model_copy(
        update={"E_MPa": record.modulus.E_MPa * factor, "E_sd_MPa": record.modulus.E_sd_MPa * factor}
    )
    return record.model_copy(
        update={"fruit_id": fruit_id, "key": key, "modulus": modulus, "grasps": grasps, "strangers": {}}
    )


def burn(seconds, report):
    """Counts for so many seconds of processor time; what was used of it."""
    report("burning")
    began = time.process_time()
    while time.process_time() - began < seconds:
        sum(range(10_000))
    return time.process_time() - began


def idle(seconds, report):
    """Waits for so many seconds."""
    report("waiting")
    time.sleep(seconds)
    return seconds
