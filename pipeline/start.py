"""Where the command `drupe` begins: an early Ctrl-C and too little memory to load it are one line each."""

import pipeline.interruption

pipeline.interruption.begin()

import sys  # noqa: E402

from pipeline.exit_status import USAGE  # noqa: E402

if sys.platform == "win32":
    sys.stderr.write(
        "drupe: this machine: Windows is not supported, because drupe uses file locks of Linux and macOS; "
        "install drupe in Linux, for example under WSL 2.\n"
    )
    sys.exit(USAGE)

import pipeline.safe_start  # noqa: E402 - before all others: the current folder may be a stranger's

# isort: split
from pipeline.lack_of_memory import is_lack_of_memory, too_little_memory  # noqa: E402
from pipeline.library_output import native_apart  # noqa: E402


def main() -> None:
    """Runs the command, whose terminal is its own: libraries write to its log."""
    try:
        from pipeline.cli import main as run
    except Exception as error:
        if not is_lack_of_memory(error):
            raise
        sys.stderr.write(f"drupe: this machine: {too_little_memory()}\n")
        sys.exit(USAGE)
    native_apart()
    run()
