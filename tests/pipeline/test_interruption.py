"""What ends a command while libraries are loaded, and while it works."""

from unittest import mock

import pytest
from small_batches import python

from pipeline.exit_status import INTERRUPTED

LOADING = """
import os, signal
from pipeline.interruption import ended_like_ctrl_c, held_back
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
try:
    with ended_like_ctrl_c(), held_back():
        os.kill(os.getpid(), signal.{name})
        print("loaded", flush=True)
    print("works", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
WORKING = """
import os, signal
from pipeline.interruption import ended_like_ctrl_c
signal.signal(signal.SIGHUP, signal.SIG_DFL)
with ended_like_ctrl_c() as came:
    for _ in range(2):
        try:
            os.kill(os.getpid(), signal.{name})
            print("goes on", flush=True)
        except KeyboardInterrupt:
            print("interrupted", came == [signal.{name}], flush=True)
"""


def _ended(script: str) -> tuple[int, str, str]:
    done = python(script)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP", "SIGTERM"])
def test_an_interruption_while_libraries_load_waits_until_they_are_loaded(name):
    assert _ended(LOADING.format(name=name)) == (0, "loaded\ninterrupted\n", "")


@pytest.mark.parametrize(("name", "number"), [("SIGTERM", 15), ("SIGHUP", 1)])
def test_a_second_signal_ends_the_work_at_once(name, number):
    assert _ended(WORKING.format(name=name)) == (-number, "interrupted True\n", "")


WHEN = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
sys.argv = ["drupe", "new", "nowhere"]
import pipeline.start
pipeline.start.main()
"""


@pytest.mark.parametrize("module", ["gc", "pipeline.lack_of_memory", "typer", "pipeline.cli", "rich"])
def test_an_early_ctrl_c_ends_the_command_without_a_traceback(module):
    assert _ended(WHEN.format(module=module)) == (INTERRUPTED, "", "drupe: interrupted\n")


def test_a_command_at_work_says_that_it_was_interrupted(drupe):
    with mock.patch("pipeline.history.lot_quality.sampling_plan", side_effect=KeyboardInterrupt):
        ran = drupe("plan")
    assert (ran.status, ran.out, ran.err) == (INTERRUPTED, "", "drupe: interrupted\n")


def test_an_ignored_ctrl_c_stays_ignored():
    script = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
import pipeline.start
print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)
"""
    assert _ended(script) == (0, "True\n", "")
