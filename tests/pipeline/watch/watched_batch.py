"""Fruit as they come into a watched batch, the fake work that grades them, and what is left of them."""

from graded_results import written
from small_batches import write_ball

from pipeline.batch.outcome import Outcome
from pipeline.run import grading, reporting
from pipeline.run.fruit_queue import ended_record
from reports.grasp_record import GraspRecord

HEAD = 'category = "nectarine"\n[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.5\n'
QUIET = [lambda: None] * 8
"""Enough looks for a fruit to be at rest and graded."""


def put(batch, name, *, recording=True):
    """A fruit's files, as a gripper leaves them."""
    folder = batch / "fruits" / name
    (folder / "grasps").mkdir(parents=True, exist_ok=True)
    write_ball(folder / "fruit.ply")
    if recording:
        (folder / "grasps" / "grasp-1.h5").write_text(f"of {name}")


def of_another(batch, name, other):
    """A fruit with a recording that names another."""
    put(batch, name)
    (batch / "fruits" / name / "grasps" / "grasp-1.h5").write_text(f"of {other}")


def modulus_of(name):
    """E of the fake work (MPa): 0.1 of A, 0.2 of B, 0.3 of C; of a reference body 1.2 times its known 0.5."""
    return 0.6 if name.startswith("body") else 0.1 * (1 + (sum(name.encode()) - ord("A")) % 19)


def fake_record(fruit_id, task):
    """What the fake work makes of a fruit: its recording's content tells whether it is another's, too."""
    if fruit_id.startswith("crash"):
        return ended_record(task, Outcome.CRASHED, "signal 9")
    (path,) = task.folder.grasp_files()[:1]
    said = path.read_text()
    named = {said.removeprefix("of "): said.removeprefix("of ") in task.batch_fruits}
    strangers = {name: known for name, known in named.items() if name != fruit_id}
    grasp = GraspRecord(grasp="grasp-1", digest=said)
    doubts = [f"names {name}" for name, known in strangers.items() if known]
    changes = {"grasps": (grasp,), "strangers": strangers}
    return written(task, modulus_of(fruit_id), sd=0.01, doubts=doubts, changes=changes)


def one_by_one(batch, *names):
    """Each put there when the one before is graded."""
    return [step for name in names for step in (lambda name=name: put(batch, name), *QUIET)]


def reports_take(monkeypatch, watched, seconds):
    """Reports take so long by the watch's clock; how many fruit each was of."""
    made, report = [], grading.report

    def slow(run, records):
        made.append(len(run.batch.rows))
        watched.time_s[0] += seconds
        return report(run, records)

    for module in (grading, reporting):
        monkeypatch.setattr(module, "report", slow)
    return made


def shown_first(watched, name):
    """A fruit's entry as the page has it first."""
    for entry in watched.shown:
        for fruit in () if entry.batch is None else entry.batch.fruits:
            if fruit.fruit_id == name:
                return fruit
    raise AssertionError(name)


def interrupted():
    raise KeyboardInterrupt
