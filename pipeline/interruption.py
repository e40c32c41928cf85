"""Interruptions: drupe treats Ctrl-C, SIGTERM and SIGHUP (a closed terminal) in the same way."""

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
    """Blocks interruptions until the end of the block, in which the caller loads native libraries.

    An exception during its initialisation leaves a library half loaded. The interpreter then crashes at exit,
    or the library replaces the exit status (Open3D, pycolmap).
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HANDLERS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ended_like_ctrl_c() -> Iterator[list[int]]:
    """Inside the block SIGTERM and SIGHUP raise KeyboardInterrupt as Ctrl-C does; a second one ends the
    process. It keeps handlers that other code has set. A Ctrl-C that was blocked since the start arrives now.

    Yields the list of received signals. A native library that is loaded outside `held_back` replaces the
    interruption with its own error ("ImportError: initialization failed"); the list identifies such an error.
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
