"""Descriptions of sensors, rigs and robots: TOML files that drupe knows as its own by their first line."""

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
"""Of a description, as its reader has it (tactile.readers.toml_table)."""


@dataclass(frozen=True)
class DescriptionKind:
    """The descriptions that one command writes: their first line, and what sentences call them."""

    first_line: str
    called: str

    def is_ours(self, path: Path) -> bool:
        """Whether the command wrote the file at `path`."""
        return text_or_empty(path, most_bytes=MOST_BYTES).startswith(f"{self.first_line}\n")

    def require_place(self, out: Path, *, inputs: Iterable[Path], folders: Iterable[Path] = ()) -> None:
        """Raises BatchRefused where `out` is an input, or a file that the command did not write."""
        require_file_apart(out, inputs=inputs, folders=folders)
        require_new_or_ours(out, self.is_ours, self.called)

    def put(
        self, out: Path, table: dict[str, Any], read: Callable[[Path], object], *, remarks: Iterable[str] = ()
    ) -> None:
        """Writes the table below the first line and `remarks`, once its own reader `read` accepts it."""
        head = "\n".join([self.first_line, *(f"# {remark}" for remark in remarks)])
        with scratch() as folder:
            draft = folder / out.name
            draft.write_text(f"{head}\n{as_toml(table)}", encoding="utf-8")
            read(draft)
            put(out, draft.read_bytes())


def frame_progress(
    report: Callable[[str], None], *, every: int | None = None
) -> Callable[[str, int, int], None]:
    """A pad's progress as a line for `report`: after its last frame, and after `every` so many before."""

    def report_pad(pad: str, done: int, of: int) -> None:
        if done == of or (every is not None and done % every == 0):
            report(f"{pad}: {done} of {of} frames")

    return report_pad
