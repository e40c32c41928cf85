"""What drupe says of a broken input: a clear error, or what it reads; nothing may hang, take all memory, or
show the inside of a library.

A case changes one file of a small sound batch, case or source (sound_inputs.py). `drupe check`, the reader of
`drupe explain` or `drupe convert` then reads it, in a process of its own with limits of time and memory:

- clear error: a sentence with the file's own name (or that of the folder that `convert` was given), with no
  traceback and no words of a library;
- same: accepted, and every number read is that of the sound input;
- other: accepted, and what is read differs: a valid file with other content, its numbers within all limits;
- FAILED: a hang, too much memory, an exception, an error that names no file or shows a library; and, for a
  case that states what it expects (`Broken.expects`), every other value or message, silence included.
"""

import hashlib
import json
import os
import re
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
from file_damage import Broken

from pipeline.batch.opening import survey
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.problem import BatchRefused
from pipeline.recordings.conversion import ConvertRequest, convert
from pipeline.run.checking import check
from recon.cameras.photos import Photo, photo_paths, read_photo
from recon.cameras.unused_photos import unused_photos
from recon.recon_failure import ReconFailure
from recon.surface.mesh_file import Mesh, read_mesh
from recon.triangle_mesh import volume_mm3
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import read_recording
from tactile.readers.trace_columns import TraceWords
from tactile.tactile_failure import TactileFailure

MOST_CPU_S, MOST_WALL_S = 20, 90
"""Of processor time: a sound batch takes 0.1 s. Of the clock: waiting for ever takes no processor time."""
MOST_MEMORY_MB = 1500
"""Beside what the process starts with: the largest photo that is decoded takes 180 MB."""
LIBRARY = re.compile(
    r"Traceback|Errno|pydantic|Input should|H5[A-Z]\w+|HDF5 error|numpy\.|<class|object at 0x|cv2\.|trimesh|"
    r"\[ONNXRuntimeError\]|codec can't decode|invalid literal|Expecting value"
)


def outcome(command: str, root: Path, path: str = "") -> tuple[list[str], str]:
    """What is said of the input, and a digest of all that was read where nothing is."""
    try:
        if command == "check":
            said = [str(p) for p in check(root / "batch", quick=True)]
            return said, "" if said else _digest_of_batch(root / "batch")
        if command == "photo":
            return [], _colours(read_photo(root / path))
        if command == "photos":
            place = (root / path).parent
            said, photos = unused_photos(place), [read_photo(photo_path) for photo_path in photo_paths(place)]
            return said, "" if said else _digest(
                [(photo.image.shape, photo.image.tobytes()) for photo in photos]
            )
        if command == "case":
            case = open_case(root / "case", fruit_id=None, work=root / "work", out=None)
            held = [*case.notes, repr(case.task.settings), repr(case.mesh_sd_mm), repr(case.stated)]
            return [], _digest(held)
        source = root / ("sources/tac3d" if "tac3d" in path else path)
        wanted = ConvertRequest(sensor=root / "sources" / "sensor.toml")
        if command == "press":
            wanted = ConvertRequest(indenter="ball", radius_mm=10.0, trace=_first_columns(source))
        done = convert(source, root / "out.h5", wanted, report=lambda _: None)
        said = [*done.refused, *done.doubts]
        return said, "" if said else _digest([read_recording(root / "out.h5")])
    except BatchRefused as refused:
        return [str(p) for p in refused.problems], ""
    except (ReconFailure, TactileFailure) as failure:
        return [failure.detail], ""


def _first_columns(source: Path) -> TraceWords:
    """A press's columns by their order: time, travel, force, semicolons between them."""
    names = source.read_text(encoding="utf-8").splitlines()[0].split(";")
    return TraceWords(columns=dict(zip(("time", "travel", "force"), names, strict=True)))


def _digest_of_batch(batch: Path) -> str:
    batch_survey = survey(batch)
    held: list[object] = [
        batch_survey.settings,
        batch_survey.rows,
        batch_survey.prior,
        batch_survey.mat and batch_survey.mat.corners_mm,
    ]
    first, second = batch_survey.folder.fruit("A"), batch_survey.folder.fruit("B")
    held += [_surface(read_mesh(path)) for path in (first.fruit_ply, first.pit_ply)]
    held += [replace(read_recording(path), notes=()) for path in first.grasp_files()]
    raw = read_raw_grasp(second.grasps / "raw")
    held += [(pad.sensor, pad.time_s, pad.pose, pad.view.reference) for pad in raw.pads]
    held += [raw.recording.aperture_mm, raw.recording.fruit_id, raw.recording.category, raw.recording.support]
    held += [read_photo(p).image for p in second.photo_files()]
    return _digest(held)


def _colours(photo: Photo) -> str:
    """A photo's size, its mean colour, and the colours in the middle of its quarters, RGB to ten levels."""
    rows, columns = photo.image.shape[:2]
    quarters = [photo.image[i * rows // 4, k * columns // 4] for i in (1, 3) for k in (1, 3)]
    mean, *colours = (
        " ".join(str(10 * round(float(c) / 10)) for c in colour[::-1])
        for colour in (photo.image.mean(axis=(0, 1)), *quarters)
    )
    return f"{columns} x {rows} px, mean {mean}: {', '.join(colours)}"


def _surface(mesh: Mesh) -> tuple[object, ...]:
    """What tells a surface, whatever the order and the number type of its file: places to a thousandth of a
    millimetre, number of faces, volume.
    """
    vertices, faces = mesh
    places = np.round(vertices, 3) + 0.0
    return places[np.lexsort(places.T)], len(faces), f"{volume_mm3(vertices, faces):.6g}"


def _digest(held: list[object]) -> str:
    with np.printoptions(override_repr=_numbers):
        return hashlib.sha256(repr(held).encode()).hexdigest()


def _numbers(array: np.ndarray) -> str:
    """Number type, shape and a digest of the values; real numbers to eight digits.

    Numbers written out as text take twenty times as long.
    """
    values = array
    if array.dtype.kind == "f":
        # times pi: numbers with few digits lie then nowhere near a power of two or half a digit
        mantissa, exponent = np.frexp(np.pi * array.astype(float))
        values = np.stack([np.round(mantissa, 8), exponent])
    return f"{array.dtype}{array.shape}{hashlib.sha256(values.tobytes()).hexdigest()}"


def run(broken: Broken, sound: Path, digest: dict[str, str]) -> tuple[str, str, float, float]:
    """Verdict, what was said, processor time (s) and memory (MB) of one case."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "r"
        shutil.copytree(sound, root, copy_function=os.link)
        broken.change(root / broken.path, np.random.default_rng([broken.seed, len(broken.kind)]))
        said, cpu_s, memory_MB = _in_a_child(broken.command, root, broken.path)
    if isinstance(said, str):
        return "FAILED", said, cpu_s, memory_MB
    if memory_MB > MOST_MEMORY_MB:
        return "FAILED", f"{memory_MB:.0f} MB of memory", cpu_s, memory_MB
    lines, digest_read = said
    if broken.command == "photo" and not lines:
        verdict = "same" if re.match(broken.expects, digest_read) else "FAILED"
        return verdict, f"read as {digest_read}", cpu_s, memory_MB
    text = " | ".join(lines).replace(f"{root}/", "")
    if not lines and broken.expects in ("", "same"):
        kind = broken.command if broken.command != "convert" else broken.path.partition("/AD2")[0]
        verdict = "same" if digest_read == digest.get(kind) else "other"
        return ("FAILED" if verdict != (broken.expects or verdict) else verdict), "", cpu_s, memory_MB
    if broken.expects == "same":
        return "FAILED", f"expected the sound input's numbers, got {text!r}", cpu_s, memory_MB
    if broken.expects not in ("", "same") and not re.search(broken.expects, text):
        return "FAILED", f"expected {broken.expects!r}, got {text!r}", cpu_s, memory_MB
    # what is stated names the file; what is wrong with a source of several files names its folder
    path = Path(broken.path)
    names = {path.name, *(part for part in path.parts[1:2] if broken.command == "convert")}
    named = bool(broken.expects) or any(name in text for name in names)
    shown = LIBRARY.search(text) or not text.isprintable() or any(len(line) > 1200 for line in lines)
    if named and not shown:
        return "clear error", text, cpu_s, memory_MB
    return "FAILED", text, cpu_s, memory_MB


def _in_a_child(command: str, root: Path, path: str) -> tuple[tuple[list[str], str] | str, float, float]:
    """What `outcome` says in a forked process with limits; a sentence where it did not come back."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        quiet = os.open(os.devnull, os.O_RDWR)
        for handle in (0, 1, 2):
            os.dup2(quiet, handle)
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_S, MOST_CPU_S))
        held_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        most = held_bytes + 4 * MOST_MEMORY_MB * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        try:
            answer = json.dumps(outcome(command, root, path))
        except BaseException:  # noqa: BLE001 - whatever it is, it is this case's verdict
            answer = json.dumps("raised: " + traceback.format_exc()[-900:])
        with os.fdopen(writer, "w") as pipe:
            pipe.write(answer)
        os._exit(0)
    os.close(writer)
    data, end = b"", time.monotonic() + MOST_WALL_S
    while (left := end - time.monotonic()) > 0 and select.select([reader], [], [], left)[0]:
        block = os.read(reader, 65536)
        if not block:
            break
        data += block
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reader)
    _, status, used = os.wait4(child, 0)
    cpu_s, memory_MB = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024 - BASELINE_MB
    if status or not data:
        return f"did not come back (wait status {status})", cpu_s, memory_MB
    said = json.loads(data)
    return (said if isinstance(said, str) else (said[0], said[1])), cpu_s, memory_MB


BASELINE_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def sound_digests(sound: Path) -> dict[str, str]:
    """What is read of the sound inputs; raises RuntimeError where anything is said of them."""
    digest = {}
    for command in ("check", "case"):
        said, digest[command] = outcome(command, sound)
        if said:
            raise RuntimeError(said)
    _, digest["photos"] = outcome("photos", sound, "batch/fruits/B/photos/000.jpg")
    sources = dict.fromkeys(("sources/fields.csv", "sources/fields.npz", "sources/tac3d"), "convert")
    for path, command in {**sources, "sources/press.csv": "press"}.items():
        said, digest["press" if command == "press" else path] = outcome(command, sound, path)
        if said:
            raise RuntimeError(said)
    return digest
