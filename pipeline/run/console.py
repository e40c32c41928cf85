"""Where a run says what it does: the terminal, and a log file that is asked for."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from pipeline.library_output import hand_over_native, tell_to
from pipeline.problem import refused

HEAD = "# log of drupe"
"""First line of a log: a file that begins otherwise is somebody else's, and nothing is added to it."""


def utc_now() -> datetime:
    """The time now, aware of its zone."""
    return datetime.now(UTC)


class RunConsole(Console):
    """Standard error, and a file that gets every line with its time in UTC.

    `quiet`: nothing is shown; `verbose`: a line for every stage of every fruit, on a terminal too; `log`: the
    file, which is made or added to. Raises BatchRefused where it cannot be, or is not a log of drupe.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        verbose: bool = False,
        log: Path | None = None,
        now: Callable[[], datetime] = utc_now,
    ) -> None:
        super().__init__(stderr=True, quiet=quiet)
        self.verbose = verbose
        self._log, self._now = log, now
        if log is not None:
            _require_log(log)
            self.note("begins")
        tell_to(self.of_library)

    def print(self, *objects: Any, **how: Any) -> None:
        """Shows it, and notes its text."""
        super().print(*objects, **how)
        self.note(" ".join(str(printed) for printed in objects))

    def of_library(self, text: str) -> None:
        """What a library said: for the log, and shown with `verbose`."""
        if self.verbose:
            super().print(text, style="dim", highlight=False, markup=False, soft_wrap=True)
        self._write(text)

    def note(self, text: str) -> None:
        """Writes to the log alone, after what native libraries have written meanwhile."""
        hand_over_native()
        self._write(text)

    def _write(self, text: str) -> None:
        """Writes to the log alone; a log that cannot be written any more costs the run nothing."""
        if self._log is None or not text.strip():
            return
        stamp = f"{self._now():%Y-%m-%dT%H:%M:%SZ}"
        lines = "".join(f"{stamp} {line}\n" for line in text.splitlines() if line.strip())
        try:
            with self._log.open("a", encoding="utf-8", errors="backslashreplace") as file:
                file.write(lines)
        except OSError as error:
            log, self._log = self._log, None
            super().print(
                f"{log}: drupe cannot write the log any more ({error.strerror})",
                highlight=False,
                markup=False,
            )


def _require_log(path: Path) -> None:
    """Makes the file, or finds that it is a log; raises BatchRefused."""
    try:
        with path.open("a+", encoding="utf-8", errors="replace") as file:
            file.seek(0)
            first = file.readline(len(HEAD) + 1)
            if not first:
                file.write(f"{HEAD}\n")
            elif first.rstrip("\n") != HEAD:
                sentence = f'is not a log of drupe (its first line is not "{HEAD}"); name another file.'
                raise refused(path, sentence)
    except OSError as error:
        sentence = f"cannot be written ({error.strerror}); name another file with --log."
        raise refused(path, sentence) from None
