"""Problems of a batch, in sentences by which staff can correct them."""

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pipeline.files.plain_file import listed, printable

T = TypeVar("T")
MOST_KNOWN = 12
"""Most names in one sentence, so that it fits on a line of a terminal."""


@dataclass(frozen=True)
class Problem:
    """One fault of the input: the file, and a sentence with the finding, the expectation and the remedy.

    `implausible`: readable, but outside the category's plausible range; `drupe grade --force` accepts it.
    `doubtful`: grading goes on, but E is in doubt. `remark`: grading goes on and E is not in doubt, but staff
    may have meant something else.
    """

    file: str
    sentence: str
    fruit_id: str | None = None
    implausible: bool = False
    doubtful: bool = False
    remark: bool = False

    def __str__(self) -> str:
        """One line, which names the file once and first, without control characters from file names."""
        sentence = " ".join(self.sentence.split()).removeprefix(f"{Path(self.file).name}: ")
        return printable(f"{self.file}: {sentence}")


class BatchRefused(Exception):
    """Raised if a batch as a whole cannot be graded; holds every problem, not only the first."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))


def refused(place: Path | str, sentence: str) -> BatchRefused:
    """A BatchRefused with one problem, of a file or an option."""
    return BatchRefused([Problem(str(place), sentence)])


def gathered(problems: list[Problem], read: Callable[[], T]) -> T | None:
    """The result of `read`. If it raises BatchRefused: None, and `problems` gets its problems."""
    try:
        return read()
    except BatchRefused as refusal:
        problems.extend(refusal.problems)
        return None


def plain_message(message: str) -> str:
    """The message of pydantic without its prefix for the ValueError of a check.

    >>> plain_message("Value error, class names must differ")
    'class names must differ'
    """
    return message.removeprefix("Value error, ")


def nearest(written: str, known: Iterable[str], otherwise: str, *, cutoff: float = 0.6) -> str:
    """A question with the known name that is most similar; `otherwise` if none is similar enough."""
    near = difflib.get_close_matches(written, list(known), n=1, cutoff=cutoff)
    return f'did you mean "{near[0]}"?' if near else otherwise


def known_names(written: str, known: Sequence[str], what: str, plural: str) -> str:
    """The likely name and all known names; above MOST_KNOWN the nearest, and the number of the others.

    >>> known_names("frim", ["firm", "ripe"], "class", "classes")
    'did you mean "firm"? known classes: firm, ripe.'
    >>> known_names("zzz", ["firm", "ripe"], "class", "classes")
    'choose a known class: firm, ripe.'
    >>> known_names("A", [], "fruit", "fruit")
    'there are none yet.'
    """
    if not known:
        return "there are none yet."
    ranked = known
    if len(known) > MOST_KNOWN:
        ranked = difflib.get_close_matches(written, known, n=len(known), cutoff=0.0)
    likely = nearest(written, known, "")
    lead = f"{likely} known {plural}" if likely else f"choose a known {what}"
    return printable(f"{lead}: {listed(ranked, MOST_KNOWN)}.")
