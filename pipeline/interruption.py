"""Being told to end: Ctrl-C, SIGTERM and a terminal that is closed are one interruption."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pipeline import early_end
from pipeline.early_end import SAID, end_at_once
from pipeline.exit_status import INTERRUPTED

_loading: list[str] = []
"""An entry for each block of `ends_at_once` that is open."""


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Inside the block native libraries are loaded and nothing is written: an interruption that
    `ended_like_ctrl_c` takes ends the process there and then, SIGTERM at the end of the block.

    An exception would not do: raised while a library sets itself up, it leaves half a library behind, and
    the interpreter's own end then crashes in it or takes its exit status (Open3D, pycolmap). pycolmap takes
    SIGTERM over for a moment; it is blocked for the threads that libraries begin as well.
    """
    _loading.append("libraries")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _loading.pop()


@contextmanager
def ended_like_ctrl_c() -> Iterator[list[int]]:
    """Inside the block SIGTERM and SIGHUP raise KeyboardInterrupt as Ctrl-C does; a second time they end the
    process. Handlers that somebody else set stay.

    Gives the list of the signals that came. A native library that is loaded later, outside `ends_at_once`,
    makes the interruption an error of its own ("ImportError: initialization failed"): the list tells them
    apart.
    """
    came: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        if _loading:
            os.write(early_end.terminal, SAID.encode())
            os._exit(INTERRUPTED)
        came.append(number)
        if number != signal.SIGINT:
            signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    usual: dict[signal.Signals, Any] = {
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
        signal.SIGINT: signal.default_int_handler,
    }
    before = {number: signal.getsignal(number) for number in usual}
    handled = [number for number, handler in usual.items() if before[number] in (handler, end_at_once)]
    for number in handled:
        signal.signal(number, interrupt)
    try:
        yield came
    finally:
        for number in handled:
            signal.signal(number, before[number])
