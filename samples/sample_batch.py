"""A whole batch folder of sample fruit, in the form that users provide, and its answers.

`answers.json` holds the true values of each fruit; grading does not read it.
"""

import csv
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.cameras.printed_mat import mat_mapping, standard_mat
from recon.surface.mesh_file import write_mesh
from recon.triangle_mesh import volume_mm3
from samples.fruit import (
    MESH_ERROR_MM,
    SampleFruit,
    box_mm,
    fruits_of_seed,
    scanned_mesh,
    skin_mesh,
)
from samples.gel_contact import DEFAULT_GEL, Gel
from samples.grasp_plan import PlannedGrasp, planned_grasps
from samples.hexahedra import SHIPPED, Fineness
from samples.mismatch.grip import Instant
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, SensorNoise
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.true_recording import (
    TrueRecording,
    as_measured,
    grasped,
    grip_of,
)
from samples.sample_failure import NotInEquilibrium, SampleFailure
from samples.scenes.draw import sample_scene
from samples.scenes.render import RenderOptions
from samples.scenes.write import write_photos
from tactile.readers.recording import Recording, write_recording

WIDER_AT_UNLIKE_GELS = 1.0
"""`wider` (meshed_fruit) for two different gels: the softer pad may take the travel of both jaws."""


def simulate(
    fruit: SampleFruit,
    grasp: PlannedGrasp,
    *,
    rng: np.random.Generator,
    gel: Gel | tuple[Gel, Gel] = DEFAULT_GEL,
    fineness: Fineness = SHIPPED,
    progress: Callable[[str], None] | None = None,
) -> Recording:
    """The recording of one grasp at finite strain. Every frame is in equilibrium.

    `gel`: one for both jaws, or the left and the right one (a very stiff gel acts as a rigid jaw). Raises
    NotInEquilibrium if a step does not converge or the contact patch outgrows the pad.
    """
    truth = true_grasp(fruit, grasp, gel=gel, fineness=fineness, progress=progress)
    return as_measured(
        truth, gels=_of_each(gel), noise=SensorNoise(), rng=rng, fruit_id=fruit.fruit_id,
        category="nectarine", sensor=DEFAULT_SENSOR.name,
    )  # fmt: skip


def true_grasp(
    fruit: SampleFruit,
    grasp: PlannedGrasp,
    *,
    gel: Gel | tuple[Gel, Gel] = DEFAULT_GEL,
    fineness: Fineness = SHIPPED,
    progress: Callable[[str], None] | None = None,
) -> TrueRecording:
    """The recording of `simulate` before any noise. Raises NotInEquilibrium."""
    left, right = _of_each(gel)
    stands = meshed_fruit(
        fruit, grasp, sensor=replace(DEFAULT_SENSOR, gel=left), fineness=fineness,
        wider=0.0 if left == right else WIDER_AT_UNLIKE_GELS,
    )  # fmt: skip
    corners = len(grasp.motion.time_s)

    outermost = (
        np.abs(DEFAULT_SENSOR.rest_mm).max(axis=1) > DEFAULT_SENSOR.half_width_mm - DEFAULT_SENSOR.pitch_mm
    )

    def watch(corner: int, instant: Instant) -> None:
        if any(np.any(force_N[outermost]) for force_N in instant.marker_force_N):
            raise NotInEquilibrium("the contact patch grew past the pad: close less or move the pads")
        if progress is not None:
            progress(f"{fruit.fruit_id}: frame {corner + 1} of {corners}")

    return grasped(grasp, grip_of(stands, gel=(left, right)), sound_body(stands), watch=watch)


def _of_each(gel: Gel | tuple[Gel, Gel]) -> tuple[Gel, Gel]:
    return gel if isinstance(gel, tuple) else (gel, gel)


__all__ = ["SampleFailure", "write_answers", "write_batch", "write_grasps", "write_scan", "write_settings"]

Progress = Callable[[str], None]
PHOTOS = 24
"""Photos of each fruit: the number that drupe recommends."""

_SETTINGS = """\
# Nectarines that never grew: shapes, photos and grasps are simulated, the true moduli are in answers.json.
category = "nectarine"
cultivar = "simulated"
lot = "seed {seed}"
harvest_date = 2026-08-14
pulp_temperature_C = 20.0
poisson_ratio = 0.45

[sensor]
name = "20x20 marker gel (simulated)"

[gripper]
name = "parallel jaws (simulated)"

# Limits of this example only; yours depend on cultivar, season and customer.
[[grading.classes]]
name = "ready to eat"
E_max_MPa = 0.3

[[grading.classes]]
name = "ready to buy"
E_max_MPa = 0.9

[[grading.classes]]
name = "firm"
"""


def write_batch(
    folder: Path,
    *,
    seed: int,
    fruits: int,
    photos: bool,
    grasps: int = 2,
    fineness: Fineness = SHIPPED,
    progress: Progress | None = None,
) -> None:
    """Write a batch of `fruits` nectarines into `folder`: the same seed gives the same batch.

    With `photos` a renderer draws each fruit on the printed mat (minutes per fruit, the extra `samples`).
    Otherwise each fruit has a scan, fruit.ply, with 0.1 mm RMS of error. Raises SampleFailure if the folder
    is not empty, a renderer is missing, or a simulation does not converge.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SampleFailure(f"{folder} exists and is not an empty folder; name a new one.")
    folder.mkdir(parents=True, exist_ok=True)
    made = fruits_of_seed(fruits, seed=seed)
    write_settings(folder, made, seed=seed)
    for fruit in made:
        where = folder / "fruits" / fruit.fruit_id
        if photos:
            scene = sample_scene(fruit, photos=PHOTOS)
            write_photos(where / "photos", scene, options=RenderOptions(), progress=progress)
        else:
            write_scan(where / "fruit.ply", fruit)
        write_grasps(where / "grasps", fruit, count=grasps, fineness=fineness, progress=progress)
    write_answers(folder, made, seed=seed)


def write_settings(folder: Path, fruits: tuple[SampleFruit, ...], *, seed: int) -> None:
    """Write batch.toml, fruits.csv and mat.json.

    Sizes, mass and Shore hardness have errors of 0.1 mm, 1 % and 2.5 points (standard deviations). Hardness
    is linear in ln E; this line serves the samples only and is no conversion rule.
    """
    (folder / "batch.toml").write_text(_SETTINGS.format(seed=seed), encoding="utf-8")
    (folder / "mat.json").write_text(json.dumps(mat_mapping(standard_mat())) + "\n", encoding="utf-8")
    with (folder / "fruits.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["fruit_id", "height_mm", "mass_g", "shore_oo", "diameter_mm", "notes"])
        for fruit in fruits:
            rng = np.random.default_rng([fruit.seed, 8])
            low, high = box_mm(fruit.skin)
            size = high - low + rng.normal(0.0, 0.1, 3)
            mass = _volume_mm3(fruit) * 1.03e-3 * rng.normal(1.0, 0.01)
            shore = np.clip(52.0 + 17.0 * np.log(fruit.E_MPa / 0.5) + rng.normal(0.0, 2.5), 5, 98)
            sizes = f"{size[2]:.1f}", f"{mass:.0f}", f"{shore:.0f}", f"{size[0]:.1f}"
            table.writerow([fruit.fruit_id, *sizes, "simulated"])


def write_scan(path: Path, fruit: SampleFruit) -> None:
    """Write fruit.ply with a scanner's smooth error of 0.1 mm RMS."""
    path.parent.mkdir(parents=True, exist_ok=True)
    vertices, triangles = scanned_mesh(fruit, cells=28, error_mm=MESH_ERROR_MM)
    write_mesh(path, vertices, triangles)


def write_grasps(
    folder: Path,
    fruit: SampleFruit,
    *,
    count: int,
    fineness: Fineness = SHIPPED,
    progress: Progress | None = None,
) -> None:
    """Write grasp-1.h5, grasp-2.h5, ..., one for each of `planned_grasps`. Raises NotInEquilibrium."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, plan in enumerate(planned_grasps(fruit, count=count)):
        recording = simulate(
            fruit,
            plan,
            rng=np.random.default_rng([fruit.seed, 7, k]),
            fineness=fineness,
            progress=progress and _named(progress, plan.name),
        )
        write_recording(folder / f"{plan.name}.h5", recording)


def write_answers(folder: Path, fruits: tuple[SampleFruit, ...], *, seed: int) -> None:
    """Write answers.json: the true values of every fruit, in the fruit frame."""
    answers = {
        "format": "drupe-sample-answers",
        "version": 1,
        "seed": seed,
        "fruits": {fruit.fruit_id: _answer(fruit) for fruit in fruits},
    }
    (folder / "answers.json").write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")


def _answer(fruit: SampleFruit) -> dict[str, Any]:
    """A fruit's entry in answers.json: its true modulus, shape and pit."""
    low, high = box_mm(fruit.skin)
    return {
        "E_MPa": fruit.E_MPa,
        "poisson_ratio": fruit.poisson_ratio,
        "law": "neo-hookean",
        "seed": fruit.seed,
        "size_mm": (high - low).tolist(),
        "volume_mm3": _volume_mm3(fruit),
        "pit": asdict(fruit.pit),
        "skin": fruit.skin.as_mapping(),
    }


def _volume_mm3(fruit: SampleFruit) -> float:
    return volume_mm3(*skin_mesh(fruit.skin, cells=160))


def _named(progress: Progress, grasp: str) -> Progress:
    return lambda line: progress(f"{grasp}, {line}")
