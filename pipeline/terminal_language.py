"""Translates the lines of the terminal to the language of the locale (LC_ALL, LC_MESSAGES or LANG).

Commands write English; each whole line is looked up as a sentence (reports/messages.py) when it is written.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, TextIO, cast

from reports.language import ENGLISH, of_environment, spoken
from reports.messages import message


class _Translated:
    """A stream that translates each line written to it to `language`, if a catalogue has the line."""

    def __init__(self, stream: TextIO, language: str) -> None:
        self._stream, self._language = stream, language

    def write(self, text: str | bytes) -> int:
        """Writes the lines of the text, each translated. Raises TypeError for bytes, as the stream does."""
        if isinstance(text, bytes):
            raise TypeError("expected text")
        with spoken(self._language):
            lines = [_translated(line) for line in text.splitlines(keepends=True)]
        self._stream.write("".join(lines))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def in_language_of_locale() -> Iterator[None]:
    """Inside the block, standard output and standard error are in the locale's language."""
    if (language := of_environment()) == ENGLISH:
        yield
        return
    out, err = (cast("TextIO", _Translated(stream, language)) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        yield


def _translated(line: str) -> str:
    """The translated line; its indent and its end are not part of the sentence and stay."""
    text = line.strip()
    return line.replace(text, message(text), 1) if text else line
