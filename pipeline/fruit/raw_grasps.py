"""Raw grasps of a batch (frames, log and descriptions) as recordings, converted once and cached."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.batch.cache import cached, file_hash, stage_key
from pipeline.batch.layout import raw_grasp_files
from pipeline.batch.stage_record import StageRecord
from pipeline.files.whole_file import put
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import write_recording


class KeptRecording(StageRecord):
    """The stage "frames of NAME": SHA-256 of the `.h5` beside it, made from a raw grasp, and notes on how."""

    sha256: str
    notes: tuple[str, ...]


def kept_recording(folder: Path, cache: Path, report: Callable[[str], None]) -> tuple[Path, tuple[str, ...]]:
    """The recording of the raw grasp in `folder`, and notes; made only if its files or the code changed.

    `report` gets each pad's progress. Raises TactileFailure that names the file and the field.
    """
    key = stage_key(
        "raw grasp", files=raw_grasp_files(folder), settings=None, rooms=("tactile", "pipeline/files")
    )

    name = f"frames of {folder.name}"
    path = cache / f"{name}.h5"

    def compute() -> KeptRecording:
        made = recording_of(read_raw_grasp(folder), progress=_in_quarters(folder.name, report))
        with TemporaryDirectory() as scratch:
            draft = Path(scratch) / "grasp.h5"
            write_recording(draft, made.recording)
            put(path, draft.read_bytes())
        return KeptRecording(sha256=file_hash(path), notes=made.notes)

    kept = cached(cache, name, key, compute, record=KeptRecording)
    if file_hash(path) != kept.sha256:  # removed or changed since
        kept = compute()
    return path, kept.notes


def _in_quarters(grasp: str, report: Callable[[str], None]) -> Callable[[str, int, int], None]:
    def progress(pad: str, done: int, total: int) -> None:
        if done in (0, total) or done * 4 // total != (done - 1) * 4 // total:
            report(f"{grasp}: {pad}, frame {done} of {total}")

    return progress
