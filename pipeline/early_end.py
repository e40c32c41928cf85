"""Ctrl-C before the command has begun: it ends the process there and then, without a traceback.

Only modules are imported until then and nothing is written.
"""

import _signal  # not `signal`: under -m a file of that name in the current folder, a stranger's, would be run
import os

STANDARD_ERROR = 2
"""Its file descriptor (POSIX, STDERR_FILENO)."""
terminal = STANDARD_ERROR
"""Where standard error leads to now: another descriptor where native libraries have that one."""
SAID = "drupe: interrupted\n"
STATUS = 130
"""Exit status of an interruption, as in pipeline.exit_status: 128 and the signal's number."""


def end_at_once(_number: int, _frame: object) -> None:
    """A handler of SIGINT: one line, exit status 130."""
    os.write(terminal, SAID.encode())
    os._exit(STATUS)


def begin() -> None:
    """Ctrl-C is `end_at_once` from now on, unless somebody else handles or ignores it."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, end_at_once)
