"""Simulated grasps on disk: a fruit's noise-free truth, and cases with mesh, pit prior, settings, recordings.
Writing a case draws noise, scan errors and sensor effects.
"""

import fcntl
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.surface.mesh_file import write_mesh
from samples.cubed_sphere import even_sphere
from samples.fruit import scanned_skin
from samples.gel_contact import Gel
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.true_recording import PadTruth, TrueRecording, as_measured
from tactile.readers.recording import Recording, write_recording

FORMAT = 1
"""Format of the file; `stored_truths` refuses others."""


def store_truths(path: Path, truths: tuple[TrueRecording, ...]) -> None:
    """Write a fruit's grasps; an interrupted call leaves no file at `path`."""
    arrays: dict[str, np.ndarray] = {}
    words = []
    for k, truth in enumerate(truths):
        gel = {name: getattr(truth.gel, name) for name in Gel.__dataclass_fields__}
        words.append({"name": truth.name, "gel": gel})
        arrays[f"time_{k}"], arrays[f"aperture_{k}"] = truth.time_s, truth.aperture_mm
        arrays[f"rest_{k}"] = truth.rest_mm
        for side, pad in enumerate(truth.pads):
            arrays[f"pose_{k}_{side}"] = pad.pose
            arrays[f"displacement_{k}_{side}"] = pad.displacement_mm.astype(np.float32)
            arrays[f"force_{k}_{side}"] = pad.force_N.astype(np.float32)
    partial = path.with_suffix(".partial.npz")
    np.savez_compressed(partial, **arrays, words=np.array(json.dumps({"format": FORMAT, "grasps": words})))  # type: ignore[arg-type]
    partial.replace(path)


def stored_truths(path: Path) -> tuple[TrueRecording, ...]:
    """Read a fruit's grasps. Raises ValueError for another format."""
    with np.load(path, allow_pickle=False) as file:
        words = json.loads(str(file["words"]))
        if words["format"] != FORMAT:
            raise ValueError(f"{path} has another format; simulate the fruit anew")
        truths = []
        for k, grasp in enumerate(words["grasps"]):
            left, right = (
                PadTruth(
                    pose=file[f"pose_{k}_{side}"],
                    displacement_mm=file[f"displacement_{k}_{side}"].astype(float),
                    force_N=file[f"force_{k}_{side}"].astype(float),
                )
                for side in (0, 1)
            )
            truths.append(
                TrueRecording(
                    name=grasp["name"], time_s=file[f"time_{k}"], aperture_mm=file[f"aperture_{k}"],
                    rest_mm=file[f"rest_{k}"], gel=Gel(**grasp["gel"]), pads=(left, right),
                )
            )  # fmt: skip
    return tuple(truths)


MESH_CELLS = 33
"""Cells along each side of the cubed sphere's faces: triangles of 1.4 mm on a fruit of 30 mm radius."""

_SETTINGS = """\
category = "{category}"
poisson_ratio = {nu}   # assumed
offset_sd_mm = 0.5        # expected spread of the pit prior
size_sd = 0.03
mesh_sd_mm = 0.1
"""


def write_case_files(
    folder: Path,
    drawn: DrawnFruit,
    recordings: tuple[TrueRecording, ...],
    *,
    peaks_N: tuple[float, ...],
    rng: np.random.Generator,
) -> None:
    """Write the case's `folder`, which appears once it is complete. Noise and scan error come from `rng`.

    The case's frame has the prior's pit at its origin. `peaks_N`: true peak force of each recording.
    """
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    origin = np.array(drawn.prior.centre_mm)
    vertices, triangles = scanned_skin(
        drawn.fruit.skin, cells=MESH_CELLS, error_mm=drawn.mesh_error_mm, rng=rng
    )
    write_mesh(partial / "fruit.ply", vertices - origin, triangles)
    sphere = even_sphere(MESH_CELLS)
    write_mesh(partial / "pit.ply", drawn.prior.points_mm(sphere.directions) - origin, sphere.triangles())
    settings = _SETTINGS.format(category=drawn.category, nu=drawn.stated_poisson_ratio)
    (partial / "case.toml").write_text(settings, encoding="utf-8")
    for truth, peak in zip(recordings, peaks_N, strict=True):
        recording = sensed(truth, drawn, fruit_id=folder.name, origin_mm=origin, peak_N=peak, rng=rng)
        write_recording(partial / f"{truth.name}.h5", recording)
    shutil.rmtree(folder, ignore_errors=True)
    partial.rename(folder)


def sensed(
    truth: TrueRecording,
    drawn: DrawnFruit,
    *,
    fruit_id: str,
    origin_mm: Float[np.ndarray, " 3"],
    peak_N: float,
    rng: np.random.Generator,
) -> Recording:
    """The recording with sensor noise, in the frame whose origin is at `origin_mm`."""
    rounded = replace(truth, time_s=np.round(truth.time_s, 3), aperture_mm=np.round(truth.aperture_mm, 4))
    return as_measured(
        rounded, gels=(truth.gel, truth.gel), noise=drawn.sensor.noise(peak_N), rng=rng, fruit_id=fruit_id,
        category=drawn.category, sensor=drawn.sensor.name, origin_mm=origin_mm,
    )  # fmt: skip


def answer(drawn: DrawnFruit, label: dict[str, Any]) -> dict[str, Any]:
    """One entry of answers.json, in the case's frame; `label`: effect and parameters."""
    centre = np.array(drawn.fruit.pit.centre_mm) - np.array(drawn.prior.centre_mm)
    return {
        **label,
        "E_MPa": drawn.fruit.E_MPa,
        "nu": drawn.fruit.poisson_ratio,
        "pit_semi_axes_mm": list(drawn.fruit.pit.semi_axes_mm),
        "pit_centre_mm": centre.tolist(),
        "category": drawn.category,
    }


def write_answer(folder: Path, case_id: str, entry: dict[str, Any]) -> None:
    """Add one case's answer to answers.json; a lock permits several processes at once."""
    path = folder / "answers.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        known[case_id] = entry
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        partial.replace(path)


def is_written(folder: Path, case_id: str) -> bool:
    """Whether a case and its answer exist."""
    answers = folder / "answers.json"
    known = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    return case_id in known and (folder / case_id).exists()
