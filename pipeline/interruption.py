"""Being told to end: Ctrl-C, SIGTERM and a terminal that is closed are one interruption."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SAID = "drupe: interrupted\n"
HANDLERS: dict[signal.Signals, Any] = {
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
    signal.SIGINT: signal.default_int_handler,
}
"""Signals that interrupt, and their default handlers in Python."""


@contextmanager
def held_back() -> Iterator[None]:
    """Inside the block native libraries are loaded; an interruption waits for its end.

    An exception that is raised while a library sets itself up leaves half a library behind, and the
    interpreter's own end then crashes in it or takes its exit status (Open3D, pycolmap).
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HANDLERS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ended_like_ctrl_c() -> Iterator[list[int]]:
    """Inside the block SIGTERM and SIGHUP raise KeyboardInterrupt as Ctrl-C does; a second time they end the
    process. Handlers that somebody else set stay. A Ctrl-C that waited since the start comes now.

    Gives the list of the signals that came. A native library that is loaded later, outside `held_back`,
    makes the interruption an error of its own ("ImportError: initialization failed"): the list tells them
    apart.
    """
    came: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        came.append(number)
        if number != signal.SIGINT:
            signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    handled = [number for number, handler in HANDLERS.items() if signal.getsignal(number) == handler]
    for number in handled:
        signal.signal(number, interrupt)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        yield came
    finally:
        for number in handled:
            signal.signal(number, HANDLERS[number])
