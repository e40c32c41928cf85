"""A watched batch whose fruit take no time to be graded."""

import io

import pytest
from graded_results import work_at_once
from rich.console import Console
from watched_batch import HEAD, fake_record

from pipeline.run import grading
from pipeline.run.batch_run import GradeOptions
from pipeline.watch.watching import BatchWatch, WatchOptions


@pytest.fixture
def batch(tmp_path):
    """No row in fruits.csv, no fruit yet."""
    root = tmp_path / "monday"
    (root / "fruits").mkdir(parents=True)
    (root / "batch.toml").write_text(HEAD + '[[grading.classes]]\nname = "firm"\n')
    (root / "fruits.csv").write_text("fruit_id,height_mm\n")
    return root


@pytest.fixture
def worked(monkeypatch):
    """Fruit in the order in which they are worked on, which takes no time; "stop" is where Ctrl-C comes."""
    worked = []

    def record(fruit_id, task):
        worked.append(fruit_id)
        if fruit_id == "stop" and worked.count("stop") == 1:
            raise KeyboardInterrupt
        return fake_record(fruit_id, task)

    monkeypatch.setattr(grading, "_work", work_at_once(record))
    return worked


@pytest.fixture
def watched(batch, worked):
    """Watches with a clock that sleeping moves; `during` are done one at each sleep."""
    shown, time_s, said = [], [0.0], io.StringIO()

    def begun(*during, idle_s=30.0, settle_s=2.0, jobs=1):
        steps = list(during)

        def sleep(seconds):
            time_s[0] += seconds
            if steps:
                steps.pop(0)()

        options = WatchOptions(
            out=batch / "results",
            grading=GradeOptions(jobs=jobs, time_limit_s=60, screen=False),
            settle_s=settle_s,
            idle_s=idle_s,
        )
        watch = BatchWatch(
            root=batch,
            options=options,
            console=Console(file=said, width=200),
            show=shown.append,
            clock=lambda: time_s[0],
            sleep=sleep,
        )
        return watch, steps

    def until_ctrl_c(*during, **how):
        watch, _ = begun(*during, **how)
        with pytest.raises(KeyboardInterrupt):
            watch.run()
        return watch

    def run(*during, **how):
        watch, steps = begun(*during, **how)
        status = watch.run()
        assert not steps
        return status

    run.begun, run.until_ctrl_c, run.worked, run.shown = begun, until_ctrl_c, worked, shown
    run.said, run.time_s = said, time_s
    return run
