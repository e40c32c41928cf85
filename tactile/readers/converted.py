"""What a reader of another format gives: a recording, and what must be known of how it came about."""

from dataclasses import dataclass

from tactile.readers.recording import Recording


@dataclass(frozen=True, kw_only=True)
class Converted:
    """A recording in the canonical form; `notes` are sentences for people."""

    recording: Recording
    notes: tuple[str, ...]
