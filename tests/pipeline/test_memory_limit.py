"""The limit on a process's memory: blocks in several threads, and after a fork."""

import re
import resource
import sys
import threading

import pytest

from pipeline.files import limited_memory as module
from pipeline.files.limited_memory import _addresses_in_use, limited_memory
from tactile.readers.limited_process import tried

MIB, GIB = 2**20, 2**30
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is no limit")


def limit():
    return resource.getrlimit(resource.RLIMIT_AS)[0]


def limit_after(most):
    """The limit of a block that begins now, in a process without other blocks."""
    return _addresses_in_use() + most


@pytest.fixture(autouse=True)
def as_before():
    """A fault here must not limit the tests that follow in this process."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


class Block(threading.Thread):
    """A block in a thread of its own, which ends when it is told to."""

    def __init__(self, most):
        super().__init__()
        self._most = most
        self._open, self._may_end = threading.Event(), threading.Event()

    def begun(self):
        self.start()
        assert self._open.wait(10)
        return self

    def run(self):
        with limited_memory(self._most):
            self._open.set()
            self._may_end.wait(10)

    def end(self):
        self._may_end.set()
        self.join(10)


@pytest.mark.parametrize("sizes", [(GIB, 2 * GIB), (2 * GIB, GIB)])
def test_blocks_that_overlap_leave_no_limit(sizes):
    before = limit()
    block, other = Block(sizes[0]).begun(), Block(sizes[1]).begun()
    assert limit() != before
    block.end()
    other.end()
    assert limit() == before


@pytest.mark.parametrize("sizes", [(GIB, 2 * GIB), (2 * GIB, GIB)])
def test_of_two_open_blocks_the_tighter_limit_holds(sizes):
    tight, wide = 10 * MIB + limit_after(GIB), limit_after(2 * GIB)
    with limited_memory(sizes[0]), limited_memory(sizes[1]):
        assert limit() < tight < wide


@pytest.mark.parametrize("first", [0, 1])
def test_a_block_that_ends_leaves_the_limit_of_the_other(first):
    blocks = [Block(most).begun() for most in (GIB, 2 * GIB)]
    blocks[first].end()
    assert limit() == pytest.approx(limit_after((2 * GIB, GIB)[first]), abs=200 * MIB)
    blocks[1 - first].end()


def test_an_exception_lifts_the_limit_and_the_next_block_has_its_own():
    before = limit()
    for _ in range(2):
        with pytest.raises(MemoryError), limited_memory(100 * MIB):
            bytearray(GIB)
        assert limit() == before


def test_an_interrupt_while_the_limit_is_set_lifts_it(monkeypatch):
    before, set_tightest = limit(), module._set_tightest

    def interrupted():
        monkeypatch.undo()
        set_tightest()
        assert limit() != before
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "_set_tightest", interrupted)
    with pytest.raises(KeyboardInterrupt), limited_memory(GIB):
        pass
    assert limit() == before


def test_a_limit_of_the_user_is_not_widened():
    user_limit = 20 * GIB
    resource.setrlimit(resource.RLIMIT_AS, (user_limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    with limited_memory(40 * GIB):
        assert limit() == user_limit
    with limited_memory(60 * GIB), limited_memory(40 * GIB):
        assert limit() == user_limit
    assert limit() == user_limit


@pytest.mark.parametrize(
    ("of_block", "of_trial", "exceeded", "lines"),
    [(100 * MIB, 4 * GIB, "", (str(GIB),)), (4 * GIB, 100 * MIB, ".+of memory", ())],
)
def test_a_trial_has_its_own_limit_beside_a_tighter_or_wider_block(of_block, of_trial, exceeded, lines):
    """The block's thread is not in the process of the trial."""
    block = Block(of_block).begun()
    trial = tried(lambda tell: tell(str(len(bytearray(GIB)))), patience_s=10, most_bytes=of_trial)
    block.end()
    assert re.fullmatch(exceeded, trial.exceeded), trial.exceeded
    assert trial.lines == lines
