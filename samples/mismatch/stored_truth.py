"""A simulated fruit on disk before any sensor: noise, scan errors and sensor effects are drawn afterwards.

One .npz for a fruit with all its grasps; everything else follows from the seed of its plan
(samples.mismatch.case_simulation.planned). Displacement and force in single precision (1e-7 of their size).
"""

import json
from pathlib import Path

import numpy as np

from samples.gel_contact import Gel
from samples.mismatch.true_recording import PadTruth, TrueRecording

FORMAT = 1
"""Of the file; a reader refuses another."""


def store_truths(path: Path, truths: tuple[TrueRecording, ...]) -> None:
    """Write a fruit's grasps, whole or not at all."""
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
            raise ValueError(f"{path} is of another format: simulate the fruit anew")
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
