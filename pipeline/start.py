"""The entry point of `drupe`: an early Ctrl-C, or too little memory to load it, gives one line."""

import signal
import sys

from pipeline.exit_status import USAGE

if sys.platform == "win32":
    sys.stderr.write(
        "drupe: this machine: Windows is not supported, because drupe uses file locks of Linux and macOS; "
        "install drupe in Linux, for example under WSL 2.\n"
    )
    sys.exit(USAGE)

signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # until the command handles it

import pipeline.safe_start  # noqa: E402, F401 - before all others: the current folder may be a stranger's

# isort: split
from pipeline.lack_of_memory import is_lack_of_memory, too_little_memory  # noqa: E402
from pipeline.library_output import hide_libraries  # noqa: E402


def main() -> None:
    """Runs the command; hides what libraries write to the terminal."""
    try:
        from pipeline.cli import main as run
    except Exception as error:
        if not is_lack_of_memory(error):
            raise
        sys.stderr.write(f"drupe: this machine: {too_little_memory()}\n")
        sys.exit(USAGE)
    hide_libraries()
    run()
