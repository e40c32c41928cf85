"""Fruit on a cluster end as they do on one machine, whatever dies on the way.

Apart from the other tests (`pytest -n 0 -m cluster`): they start and kill a dozen processes on time limits of
seconds, which a machine that is busy with other tests does not keep.
"""

import io
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
from collections import Counter
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import dask
import psutil
import pytest
from cluster_work import graded_unless_it_dies, needs_of, patient, work
from dask.utils import parse_bytes
from distributed import Client, LocalCluster, Security
from rich.console import Console
from small_batches import batch_of_balls, wait_until

from pipeline.batch.records import read_record
from pipeline.problem import BatchRefused
from pipeline.run import grading
from pipeline.run.batch_run import GradeOptions
from pipeline.run.cluster import Cluster, _jobqueue, slurm_jobs
from pipeline.run.cluster_worker import OWN_MIB
from pipeline.run.scheduling import Died, Finished, Progressed, TimedOut, WorkPlace, run_on

pytestmark = [pytest.mark.slow, pytest.mark.cluster]
PATHS = os.pathsep.join(map(str, (Path(__file__).parents[2], Path(__file__).parent)))
"""What workers find: the drupe that is tested, and the work of these tests."""


@pytest.fixture(scope="module")
def address():
    """A scheduler with two workers of one thread, of which one fruit may take two along and not three.

    Of the 800 MiB of a worker 500 are its own, and 300 its fruit's.
    """
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 2}),
        LocalCluster(
            n_workers=2, threads_per_worker=1, memory_limit="800 MiB", dashboard_address=":0"
        ) as workers,
    ):
        yield workers.scheduler_address


def engine(address, folder, *, said=None, time_limit_s=60.0, **changed):
    return Cluster(
        address,
        needs=needs_of(folder, **changed),
        time_limit_s=time_limit_s,
        tell=print if said is None else said.append,
    )


@pytest.fixture(scope="module")
def ran(address, tmp_path_factory):
    """Events and endings of fruit that each end in another way, and what the run said."""
    folder, said = tmp_path_factory.mktemp("run"), []
    tasks = {
        "fine": "fine", "crash": "crash", "raise": "raise", "hang": "hang", "fill": "fill",
        "once": f"take-the-worker-along {folder / 'once'}",
        "always": f"take-every-worker-along {folder / 'always'}",
        "also fine": "also fine",
    }  # fmt: skip
    events = list(run_on(engine(address, folder, said=said, time_limit_s=20.0), work, tasks.items()))
    return events, {event.fruit_id: event for event in events if not isinstance(event, Progressed)}, said


def test_each_fruit_ends_in_its_own_way_and_once(ran):
    events, ended, _ = ran
    assert set(Counter(event.fruit_id for event in events if not isinstance(event, Progressed)).values()) == {
        1
    }
    assert ended["fine"].result[0] == "fine"
    assert ended["also fine"].result[::2] == ("also fine", "1")
    assert ended["crash"] == Died("crash", -11)
    assert ended["hang"] == TimedOut("hang")
    assert isinstance(ended["raise"].result, RuntimeError)
    assert Progressed("fine", "working") in events


def test_each_has_a_process_of_its_own(ran):
    assert ran[1]["fine"].result[1] != ran[1]["also fine"].result[1]


def test_one_that_takes_more_memory_than_its_worker_has_costs_that_fruit_alone(ran):
    assert isinstance(ran[1]["fill"].result, MemoryError)
    assert "more than the 300 MiB" in str(ran[1]["fill"].result)


def test_a_worker_killed_in_a_fruit_costs_nothing_but_time(ran):
    assert ran[1]["once"] == Finished("once", "at the second time")


def test_a_fruit_that_takes_every_worker_along_is_given_up(ran):
    ending = ran[1]["always"]
    assert isinstance(ending, Died)
    assert ending.how.startswith("3 workers died with it, the last tcp://")


def test_workers_and_dashboard_are_said(ran, address):
    assert ran[2][0].startswith(f"cluster at {address}: 2 workers; dashboard http://")


def test_leaving_early_ends_what_is_running(address, tmp_path):
    mark = tmp_path / "mark"
    with closing(run_on(engine(address, tmp_path), work, [("a", f"sleep {mark}")])) as events:
        assert next(events) == Progressed("a", "working")
        wait_until(lambda: mark.exists() and mark.read_text())
    process = int(mark.read_text())
    wait_until(lambda: not psutil.pid_exists(process))


def test_a_run_whose_folder_the_workers_do_not_see_is_refused(address, tmp_path):
    with pytest.raises(BatchRefused) as refused:
        list(run_on(engine(address, tmp_path, mark="another run"), work, [("a", "fine")]))
    assert str(refused.value).startswith("worker tcp://")
    assert "results as this command does: OUT must lie on a file system" in str(refused.value)


def test_a_batch_begun_on_this_machine_ends_on_a_cluster(address, tmp_path, monkeypatch):
    """What is done is kept by its content; the fruit that died here is graded there."""
    batch_of_balls(tmp_path, "A", "B")
    monkeypatch.setattr(grading, "work_on", graded_unless_it_dies)
    monkeypatch.setattr(grading, "PER_FRUIT_MIB", {"mesh": 100.0})

    def outcomes(**options):
        said = io.StringIO()
        console = Console(file=said, width=200)
        how = GradeOptions(jobs=2, time_limit_s=60, **options)
        grading.grade(tmp_path, None, how, console=console)
        records = [read_record(tmp_path / "results" / "fruits" / name / "record.json") for name in ("A", "B")]
        return (
            [record.outcome for record in records],
            [record.peak_memory_MiB for record in records],
            said.getvalue(),
        )

    ended, (first, _), _ = outcomes()
    assert ended == ["graded", "crashed"]
    (tmp_path / "batch.toml").with_name("mended").touch()
    ended, (kept, _), said = outcomes(place=WorkPlace(scheduler=address))
    assert ended == ["graded", "graded"]
    assert kept == first  # the process that worked on it
    assert "1 of 2 fruit unchanged since the last run" in said
    assert f"cluster at {address}: 2 workers" in said


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@contextmanager
def started(folder, *arguments):
    """A part of dask's in a process of its own, killed with all that it started."""
    command = [sys.executable, "-m", *arguments]
    path = {"PYTHONPATH": PATHS}
    with subprocess.Popen(command, env=os.environ | path, stderr=subprocess.DEVNULL, cwd=folder) as process:
        try:
            yield process
        finally:
            kill(process)


def kill(process):
    if process.poll() is None:
        for member in [*psutil.Process(process.pid).children(recursive=True), process]:
            member.kill()
        process.wait()


def test_a_run_whose_scheduler_is_killed_ends_its_fruit_and_is_refused(tmp_path):
    port = free_port()
    place, here = f"tcp://127.0.0.1:{port}", ("--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    go, begun = tmp_path / "go", tmp_path / "begun"
    with (
        started(tmp_path, "distributed.cli.dask_scheduler", *here) as scheduler,
        started(tmp_path, "distributed.cli.dask_worker", place, "--nthreads", "1", "--no-dashboard"),
        closing(run_on(engine(place, tmp_path), patient, [("a", f"{begun} {go}")])) as events,
    ):
        assert next(events) == Progressed("a", "working")
        wait_until(lambda: begun.exists() and begun.read_text())
        kill(scheduler)
        with pytest.raises(BatchRefused, match="run the same command again"):
            list(events)
        wait_until(lambda: not psutil.pid_exists(int(begun.read_text())))


SBATCH = """#!/bin/sh
cp "$1" "{folder}/script"
setsid bash "{folder}/script" >"{folder}/job.log" 2>&1 &
echo $! >>"{folder}/jobs"
echo "Submitted batch job $!"
"""


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A folder on PATH with sbatch and scancel that start jobs here, in sessions of their own."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    (folder / "sbatch").write_text(SBATCH.format(folder=folder))
    (folder / "scancel").write_text('#!/bin/sh\nfor job; do kill -9 -- "-$job"; done\n')
    for name in ("sbatch", "scancel"):
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", PATHS)
    monkeypatch.chdir(tmp_path)
    _jobqueue()  # its import sets what is configured
    with dask.config.set({"jobqueue.slurm.scheduler-options": {"dashboard_address": ":0"}}):
        yield folder
    jobs = folder / "jobs"
    for job in jobs.read_text().split() if jobs.exists() else ():
        with suppress(ProcessLookupError):
            os.killpg(int(job), signal.SIGKILL)


def test_slurm_is_asked_for_jobs_of_one_worker_with_memory_for_one_fruit(slurm, tmp_path):
    needs = needs_of(tmp_path, per_fruit_MiB=300.0)
    engine = Cluster(None, workers=1, needs=needs, time_limit_s=60.0, tell=print)
    configured = {
        "jobqueue.slurm.job-script-prologue": ["module() { :; }", "module load python"],
        "jobqueue.slurm.worker-extra-args": ["--lifetime", "1h"],
    }
    with dask.config.set(configured):
        events = list(run_on(engine, work, [("a", "fine")]))
    (ended,) = (event for event in events if isinstance(event, Finished))
    assert ended.result[0] == "fine"
    script = (slurm / "script").read_text()
    key = Path(re.search(r"--tls-key (\S+)", script)[1])
    assert key.is_relative_to(tmp_path)
    assert not key.exists()
    assert "module load python\nexport PYTHONSAFEPATH=1" in script  # what is configured stays
    assert "--nanny --death-timeout 60 --lifetime 1h" in script
    assert "#SBATCH -J drupe" in script
    assert "#SBATCH --cpus-per-task=1" in script
    assert "--nthreads 1 --memory-limit" in script


def test_slurms_jobs_speak_tls_with_a_key_that_only_this_user_reads(slurm, tmp_path):
    with slurm_jobs(1, needs_of(tmp_path), print) as jobs:
        address = jobs.scheduler_address
        assert address.startswith("tls://")
        (folder,) = tmp_path.glob(".results.drupe-run-*")
        files = list(folder.iterdir())
        assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}
        assert sum("PRIVATE KEY" in file.read_text() for file in files) == 1
        with Client(address, security=jobs.security, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)
            assert client.submit(os.getpid).result(timeout=60) != os.getpid()
        for stranger in ("tcp" + address.removeprefix("tls"), address):
            other = None if stranger.startswith("tcp") else Security.temporary()
            with pytest.raises(OSError, match=r"."):
                Client(stranger, security=other, timeout=3, set_as_default=False)
    assert not folder.exists()


def test_a_key_in_a_folder_with_a_blank_is_refused(slurm, tmp_path):
    (tmp_path / "with space").mkdir()
    with (
        pytest.raises(BatchRefused, match="choose another --out"),
        slurm_jobs(1, needs_of(tmp_path / "with space"), print),
    ):
        pass


@pytest.mark.parametrize("per_fruit_MiB", [600.0, 1000.0, 1500.0])
def test_a_job_of_slurm_has_memory_for_its_fruit_and_its_worker(slurm, tmp_path, per_fruit_MiB):
    """Neither Slurm's limit nor the worker's is below the sum."""
    with slurm_jobs(1, needs_of(tmp_path, per_fruit_MiB=per_fruit_MiB), print):
        script = (slurm / "script").read_text()
    number, unit = re.search(r"#SBATCH --mem=(\d+)([MG])", script).groups()
    limit_MiB = parse_bytes(re.search(r"--memory-limit (\S+)", script)[1]) / 2**20
    assert int(number) * {"M": 1, "G": 1024}[unit] >= limit_MiB >= per_fruit_MiB + OWN_MIB


REFUSES = """#!/bin/sh
echo "sbatch: error: invalid partition specified: normal" >&2
exit 1
"""


def test_a_run_whose_jobs_slurm_refuses_is_refused_with_its_words(slurm, tmp_path, capfd):
    (slurm / "sbatch").write_text(REFUSES)
    with (
        pytest.raises(
            BatchRefused, match=r"^--slurm: sbatch accepts no job \(sbatch: error: invalid partition"
        ),
        slurm_jobs(3, needs_of(tmp_path), print),
    ):
        pass
    assert "Traceback" not in capfd.readouterr().err


COMMAND = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from pipeline.cli import main
main()
"""


def test_ctrl_c_ends_a_run_on_slurm_as_any_other(slurm, tmp_path, monkeypatch):
    (slurm / "sbatch").write_text('#!/bin/sh\necho "Submitted batch job 1"\n')  # a job that waits for ever
    (slurm / "scancel").write_text("#!/bin/sh\n")
    monkeypatch.setenv("DASK_JOBQUEUE__SLURM__SCHEDULER_OPTIONS__DASHBOARD_ADDRESS", ":0")
    batch_of_balls(tmp_path, "A")
    command = [sys.executable, "-c", COMMAND, "grade", str(tmp_path), "--slurm", "--jobs", "1"]
    log = tmp_path / "log"
    with log.open("w") as said, subprocess.Popen(command, stdout=said, stderr=said) as run:
        wait_until(lambda: "waiting for workers" in log.read_text())
        run.send_signal(signal.SIGINT)
        assert run.wait(60) == 130
    assert "Traceback" not in log.read_text()
    assert json.loads((tmp_path / "results" / "batch.json").read_text())["exit_status"] == 130
