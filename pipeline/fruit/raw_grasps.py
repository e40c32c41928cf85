"""Raw grasps of a batch (frames, log and descriptions) as recordings, converted once and kept."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import UInt8

from pipeline.batch.cache import cached, stage_key
from pipeline.batch.layout import raw_grasp_files
from pipeline.batch.stage_record import StageRecord
from pipeline.files.whole_file import put
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import write_recording


class KeptRecording(StageRecord):
    """The stage "frames of NAME": the bytes of the `.h5` made of a raw grasp, and notes on how."""

    recording: UInt8[np.ndarray, " b"]
    notes: tuple[str, ...]


def kept_recording(folder: Path, cache: Path, report: Callable[[str], None]) -> tuple[Path, tuple[str, ...]]:
    """The recording of the raw grasp in `folder`, and notes; made only where its files or the code changed.

    `report` is told each pad's progress. Raises TactileFailure that names the file and the field.
    """
    key = stage_key(
        "raw grasp", files=raw_grasp_files(folder), settings=None, rooms=("tactile", "pipeline/files")
    )

    def compute() -> KeptRecording:
        made = recording_of(read_raw_grasp(folder), progress=_in_quarters(folder.name, report))
        with TemporaryDirectory() as scratch:
            path = Path(scratch) / "grasp.h5"
            write_recording(path, made.recording)
            return KeptRecording(recording=np.frombuffer(path.read_bytes(), np.uint8), notes=made.notes)

    name = f"frames of {folder.name}"
    kept = cached(cache, name, key, compute, record=KeptRecording)
    path = cache / f"{name}.h5"
    put(path, kept.recording.tobytes())
    return path, kept.notes


def _in_quarters(grasp: str, report: Callable[[str], None]) -> Callable[[str, int, int], None]:
    def progress(pad: str, done: int, total: int) -> None:
        if done in (0, total) or done * 4 // total != (done - 1) * 4 // total:
            report(f"{grasp}: {pad}, frame {done} of {total}")

    return progress
