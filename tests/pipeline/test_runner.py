"""One fruit per process: a crash, a hang or an exception costs that fruit only."""

import os
import signal
import time

from pipeline.runner import Died, Finished, Progressed, TimedOut, run_fruits


def work(task, report):
    report("working")
    if task == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if task == "hang":
        time.sleep(600)
    if task == "raise":
        raise RuntimeError("broken")
    return (task, os.getpid(), os.environ["OPENBLAS_NUM_THREADS"])


def endings(tasks, **options):
    found = list(run_fruits(work, [(t, t) for t in tasks], **options))
    return found, {e.fruit_id: e for e in found if not isinstance(e, Progressed)}


def test_each_fruit_ends_in_its_own_way():
    events, ended = endings(["fine", "crash", "hang", "raise", "also fine"], jobs=2, time_limit_s=15)
    assert isinstance(ended["fine"], Finished)
    assert isinstance(ended["also fine"], Finished)
    assert isinstance(ended["crash"], Died)
    assert ended["crash"].exit_code == -signal.SIGSEGV
    assert isinstance(ended["hang"], TimedOut)
    assert isinstance(ended["raise"].result, RuntimeError)
    assert Progressed("fine", "working") in events


def test_every_fruit_has_a_process_of_its_own_with_one_numerical_thread():
    _, ended = endings(["a", "b", "c"], jobs=1, time_limit_s=60)
    results = [event.result for event in ended.values()]
    assert len({pid for _, pid, _ in results}) == 3
    assert {threads for *_, threads in results} == {"1"}
