"""Raw grasps of a batch (frames, log and descriptions) as recordings, converted once and kept.

The recording made of a raw grasp stays in the results' cache as an `.h5` that every reader of recordings
takes; its notes lie beside it. Both are named by the hash of all that they came from, and end in the SHA-256
of their content.
"""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.batch.cache import report_damage, stage_key
from pipeline.batch.layout import raw_grasp_files
from pipeline.files.checked_file import is_whole, put_checked, read_checked
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import write_recording


@dataclass(frozen=True, kw_only=True)
class KeptRecording:
    """The `.h5` made of a raw grasp, and what must be known of how it came about."""

    path: Path
    notes: tuple[str, ...]


def kept_recording(folder: Path, cache: Path, report: Callable[[str], None]) -> KeptRecording:
    """The recording of the raw grasp in `folder`; made only where its files or the code have changed, or the
    kept file is damaged.

    `report` is told each pad's progress. Raises TactileFailure that names the file and the field.
    """
    key = stage_key(
        "raw grasp", files=raw_grasp_files(folder), settings=None, rooms=("tactile", "pipeline/files")
    )[:16]
    path, notes = cache / f"{folder.name}-{key}.h5", cache / f"{folder.name}-{key}.json"
    said = read_checked(notes)
    whole = is_whole(path)
    if said is None or not whole:
        for damaged in [*([] if whole else [path]), *([] if said else [notes])]:
            if damaged.is_file():
                report_damage(damaged)
        made = recording_of(read_raw_grasp(folder), progress=_in_quarters(folder.name, report))
        for old in cache.iterdir() if cache.is_dir() else ():
            if re.fullmatch(re.escape(folder.name) + r"-[0-9a-f]{16}\.(h5|json|part)", old.name):
                old.unlink()
        with TemporaryDirectory() as scratch:
            unfinished = Path(scratch) / path.name
            write_recording(unfinished, made.recording)
            put_checked(path, unfinished.read_bytes())
        said = json.dumps(made.notes).encode()
        put_checked(notes, said)
    return KeptRecording(path=path, notes=tuple(json.loads(said)))


def _in_quarters(grasp: str, report: Callable[[str], None]) -> Callable[[str, int, int], None]:
    def progress(pad: str, done: int, total: int) -> None:
        if done in (0, total) or done * 4 // total != (done - 1) * 4 // total:
            report(f"{grasp}: {pad}, frame {done} of {total}")

    return progress
