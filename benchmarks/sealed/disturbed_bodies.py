"""Bodies without mismatch from another simulator, exact and without noise, made into cases."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from fem.mismatch.result import NONE
from recon.surface.mesh_file import read_mesh, write_mesh
from samples.fruit import scan_error_mm
from samples.mismatch.bank import SEED, SETTINGS, is_written, write_answer
from samples.mismatch.drawn_fruit import MESH_ERRORS_MM, pit_error
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, measured, with_drawn_noise
from tactile.readers.recording import read_recording, write_recording


def disturbed(body: Path, cases: Path, *, record: int) -> str:
    """Write a case below `cases`, unless it exists, and return its name. `body`: `truth.json` (E, nu, pit and
    pit_centre in mm), `fruit.ply` and `grasp-K.h5`.

    The scan has an error, the pit deviates from its prior by the category's spread, and every recording has
    the noise of one drawn camera.
    """
    name = f"null-{body.name}-{record}"
    folder = cases / name
    if is_written(cases, name):
        return name
    truth = json.loads((body / "truth.json").read_text(encoding="utf-8"))
    rng = np.random.default_rng([SEED, 4, *name.encode()])
    partial = folder.with_name(f".{name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    vertices, faces = read_mesh(body / "fruit.ply")
    rays = vertices - vertices.mean(axis=0)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    error = scan_error_mm(rays, error_mm=float(rng.uniform(*MESH_ERRORS_MM)), rng=rng)
    write_mesh(partial / "fruit.ply", vertices + error, faces)
    shift, sizes = pit_error(rng)
    pit = trimesh.creation.icosphere(subdivisions=4)
    places = pit.vertices * (np.array(truth["pit"]) / sizes) + np.array(truth["pit_centre"]) - shift
    write_mesh(partial / "pit.ply", places, np.asarray(pit.faces))
    settings = SETTINGS.format(category=truth["category"], nu=truth["nu"])
    (partial / "case.toml").write_text(settings, encoding="utf-8")
    sensor = with_drawn_noise(DEFAULT_SENSOR, rng)
    for path in sorted(body.glob("grasp-*.h5")):
        recording = read_recording(path)
        peak_N = max(np.linalg.norm(pad.force_N.sum(axis=1), axis=1).max() for pad in recording.pads)
        noise = sensor.noise(float(peak_N))
        pads = []
        for pad in recording.pads:
            moved, force = measured(pad.displacement_mm, pad.force_N, noise, rng)
            pads.append(replace(pad, displacement_mm=moved, force_N=force))
        write_recording(partial / path.name, replace(recording, pads=tuple(pads)))
    shutil.rmtree(folder, ignore_errors=True)
    partial.rename(folder)
    entry = {"effect": NONE, "parameters": {}, "E_MPa": truth["E"], "drawn_from": {"fruit": body.name}}
    write_answer(cases, name, entry)
    return name
