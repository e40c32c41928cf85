"""A second run does only what is missing or changed, whatever ended the first."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pandas as pd
import psutil
import pytest
from sample_batches import SHIPPED, drupe, first_fruit

pytestmark = pytest.mark.slow
OWN_STAGES = True
"""Its claims are about what a second run finds of the first (conftest)."""


def record_times(batch):
    return {p.parent.name: p.stat().st_mtime_ns for p in (batch / "results" / "fruits").glob("*/record.json")}


def grading(batch, **how):
    start = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell may ignore it
        "from pipeline.cli import main; main()"
    )
    command = [sys.executable, "-c", start, "grade", "--no-screen", batch, "--jobs", "1"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **{**pipes, **how})


def test_kill_in_the_middle_keeps_finished_fruit_and_the_second_run_does_the_rest(batch):
    with grading(batch, stderr=subprocess.DEVNULL, start_new_session=True) as run:
        end = time.monotonic() + 300
        while not record_times(batch):
            assert run.poll() is None
            assert time.monotonic() < end
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGKILL)
    finished = record_times(batch)
    assert len(finished) == 1
    assert not (batch / "results" / "ranking.csv").exists()

    again = drupe("grade", "--no-screen", batch, status=0)
    assert "1 of 2 fruit unchanged" in again.err
    after = record_times(batch)
    assert {name: after[name] for name in finished} == finished
    assert len(after) == 2

    first_ranking = pd.read_csv(batch / "results" / "ranking.csv", index_col="fruit_id")
    assert len(first_ranking) == 2
    assert first_ranking["E_MPa"].is_monotonic_increasing
    answers = json.loads((SHIPPED / "answers.json").read_text())["fruits"]
    true_MPa = [answers[name]["E_MPa"] for name in first_ranking.index]
    assert first_ranking["E_MPa"].to_numpy() == pytest.approx(true_MPa, rel=0.08)
    assert ": screen" not in again.err
    assert first_ranking[["screen", "mismatch"]].isna().all(axis=None)

    assert "2 of 2 fruit unchanged" in drupe("grade", "--no-screen", batch, status=0).err
    assert record_times(batch) == after

    (interrupted,) = first_ranking.index.difference(list(finished))
    shutil.rmtree(batch / "results" / "fruits" / interrupted / ".cache")
    grasp = batch / "fruits" / interrupted / "grasps" / "grasp-1.h5"
    grasp.rename(grasp.with_name("renamed.h5"))
    with (batch / "batch.toml").open("a") as file:
        file.write('[[grading.classes]]\nname = "all"\n')
    assert "1 of 2 fruit unchanged" in drupe("grade", "--no-screen", batch).err
    ranking = pd.read_csv(batch / "results" / "ranking.csv", index_col="fruit_id")
    assert set(ranking["maturity"]) == {"all"}
    assert ranking.loc[interrupted, "E_MPa"] == pytest.approx(
        first_ranking.loc[interrupted, "E_MPa"], rel=0.01
    )
    provenance = json.loads((batch / "results" / "batch.json").read_text())
    assert provenance["exit_status"] == 0
    assert "batch.toml" in provenance["inputs"]


@pytest.mark.parametrize(
    "send",
    [
        pytest.param(lambda run: os.killpg(run.pid, signal.SIGINT), id="Ctrl-C, to all processes"),
        pytest.param(lambda run: run.terminate(), id="terminate", marks=pytest.mark.proof),
    ],
)
def test_interrupting_ends_with_status_130_and_keeps_the_stages_that_are_done(batch, send):
    (batch / "fruits.csv").write_text(f"fruit_id\n{first_fruit(batch).name}\n")
    with grading(batch, start_new_session=True) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if line.rstrip().endswith(": modulus"):
                break
        time.sleep(0.3)
        workers = psutil.Process(run.pid).children(recursive=True)
        send(run)
        _, err = run.communicate(timeout=60)
    assert run.returncode == 130
    assert not psutil.wait_procs(workers, timeout=5)[1]
    assert "interrupted; drupe kept the finished fruit" in err
    assert "Traceback" not in err
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 130
    results = batch / "results" / "fruits" / first_fruit(batch).name
    assert not (results / "record.json").exists()  # nothing is said of work that was stopped
    assert not (results / "traceback.txt").exists()
    elements = results / ".cache" / "flesh.npz"
    kept = elements.stat().st_mtime_ns
    assert drupe("grade", "--no-screen", batch).status == 0
    assert elements.stat().st_mtime_ns == kept
