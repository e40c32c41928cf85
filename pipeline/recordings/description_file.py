"""Descriptions of sensors, rigs and robots: TOML files whose first line identifies them as drupe's."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.scratch import scratch
from pipeline.batch.write_guard import require_file_apart, require_new_or_ours
from pipeline.files.plain_file import text_or_empty
from pipeline.files.toml_text import as_toml
from pipeline.files.whole_file import put

MOST_BYTES = 4_000_000
"""Largest description; the limit of its reader (tactile.readers.toml_table) is 1 MB."""


@dataclass(frozen=True)
class DescriptionKind:
    """The descriptions of one command: their first line, and their name in messages."""

    first_line: str
    called: str

    def is_ours(self, path: Path) -> bool:
        """Whether the command wrote the file at `path`."""
        return text_or_empty(path, most_bytes=MOST_BYTES).startswith(f"{self.first_line}\n")

    def require_place(self, out: Path, *, inputs: Iterable[Path], folders: Iterable[Path] = ()) -> None:
        """Raises BatchRefused if `out` is or lies in an input, or the command did not write it."""
        require_file_apart(out, inputs=inputs, folders=folders)
        require_new_or_ours(out, self.is_ours, self.called)

    def put(
        self, out: Path, table: dict[str, Any], read: Callable[[Path], object], *, remarks: Iterable[str] = ()
    ) -> None:
        """Writes first line, `remarks` and table if `read` accepts them. Raises as `read`, or NotWritten."""
        head = "\n".join([self.first_line, *(f"# {remark}" for remark in remarks)])
        with scratch() as folder:
            draft = folder / out.name
            draft.write_text(f"{head}\n{as_toml(table)}", encoding="utf-8")
            read(draft)
            put(out, draft.read_bytes())


def frame_progress(
    report: Callable[[str], None], *, every: int | None = None
) -> Callable[[str, int, int], None]:
    """A function that reports a pad's progress in a line: after each `every` frames, and after the last."""

    def report_pad(pad: str, done: int, of: int) -> None:
        if done == of or (every is not None and done % every == 0):
            report(f"{pad}: {done} of {of} frames")

    return report_pad
