"""Photos, shape, stem, suture and modulus of two scanned fruit shapes, beside drawn fruit in the same scenes.

    python benchmarks/real_fruit_shapes.py CHECKOUT WORK [--csv FILE] [--only TEXT] [--grasps 2]

CHECKOUT is a clone of github.com/kwonathan/ycb_urdfs: the scans of a peach and a plum of the YCB object set
(Calli et al. 2015, IEEE Robotics & Automation Magazine 22(3):36). Both objects are plastic toys: shape and
colours are those of fruit, the flesh is not. So the grasps are simulated: Neo-Hookean flesh of known
modulus round a rigid pit, which is the category's prior (recon/pit/priors) in the box of the true shape.

Each scan stands in three scenes in its own colours: on the mat and on a table (hand-held), and on a mat
that a turntable turns before a fixed camera, a table and a card. Scenes are the first of samples/scenes
from FIRST_SCENE on that draw the same kind of fruit without a flash and without a coin. A drawn fruit of
the kind stands in the same scenes for comparison. `drupe grade` gets photos and two grasps; on the table
also the height.

The scans are closed, and rays from their centre of volume meet them one time each: nothing is repaired.
Stem and suture of the truth were picked by eye on the texture (TOYS); they define the frame, so that the
errors of stem and suture are those of the record's `mesh.stance`. Columns `true_shape_...`: what the same
search finds in the true shape. WORK keeps photos, batches and rows; a run that was broken off goes on.
`--only` takes the sets with this text in their names (mat-drawn-plum). `--grasps 0` measures the shape alone.
Needs the extra `samples`.
"""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from photo_bank_modulus import graded, line, write_batch
from recon_score import onto_truth, read_truth, scored
from scipy.spatial.transform import Rotation
from script import run

from recon.pit.priors import load_prior
from recon.surface.mesh_file import read_mesh
from recon.surface.orientation import orientation_of
from samples.fruit import POISSON_RATIO, SampleFruit, SamplePit, box_mm, triple
from samples.sample_failure import NotInEquilibrium
from samples.scanned_skin import read_scan, skin_of_scan
from samples.scenes.draw import Scene, draw_scene
from samples.scenes.render import RenderOptions
from samples.scenes.write import complete, write_scene

FIRST_SCENE = 96
"""Scenes before it have been drawn for benchmarks/photo_bank.py."""
SCENES = {"mat": ("mat", 20), "table": ("phone", 12), "turntable": ("turntable", 12)}
"""Family of samples.scenes.draw and number of photos by scene."""


@dataclass(frozen=True, kw_only=True)
class Toy:
    """A scan of the checkout: folder; the middle of its stem and a point of its suture, read by eye off the
    texture (mm, axes of the scan, to about 0.5 mm); the modulus of its simulated flesh.
    """

    folder: str
    stem_mm: tuple[float, float, float]
    suture_mm: tuple[float, float, float]
    E_MPa: float


TOYS = {
    "peach": Toy(
        folder="015_peach", stem_mm=(-2.6, -2.9, 41.8), suture_mm=(0.0, -2.1, 8.0), E_MPa=0.35,
    ),
    "plum": Toy(
        folder="018_plum", stem_mm=(-9.0, 21.1, 1.6), suture_mm=(2.4, -1.7, 21.6), E_MPa=0.55,
    ),
}  # fmt: skip


def scanned_fruit(checkout: Path, kind: str) -> SampleFruit:
    """The toy in the fruit frame, with the pit that the category's prior puts into its box."""
    toy = TOYS[kind]
    folder = checkout / "ycb_assets" / toy.folder / "google_16k"
    scan = read_scan(folder / "textured.obj", folder / "texture_map.png", mm_per_unit=1000.0)
    skin = skin_of_scan(scan, stem_mm=np.array(toy.stem_mm), suture_mm=np.array(toy.suture_mm))
    prior = load_prior(kind)
    low, high = box_mm(skin)
    half = (high - low) / 2
    pit = SamplePit(
        centre_mm=triple((low + high) / 2 + np.array(prior.raised) * half),
        semi_axes_mm=triple(np.array(prior.axis_ratios) * half),
    )
    return SampleFruit(
        fruit_id=f"scanned-{kind}", seed=int(toy.folder[:3]), skin=skin, pit=pit, E_MPa=toy.E_MPa,
        poisson_ratio=POISSON_RATIO, ripeness=0.5,
    )  # fmt: skip


def scene_of_kind(place: str, kind: str) -> Scene:
    """The first scene of the place that draws this kind of fruit, without a flash and without a coin."""
    family, photos = SCENES[place]
    numbers = range(FIRST_SCENE, FIRST_SCENE + 1000)
    drawn = (draw_scene(k, photos=photos, family=family) for k in numbers)
    return next(s for s in drawn if s.fruit_kind == kind and s.coin is None and "flash" not in s.light.kind)


def from_the_suture(scene: Scene) -> Scene:
    """The scene with its photographer walked about so that the first photo is taken from +x."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", scene.views[0].azimuth_deg, degrees=True).as_matrix()
    return replace(
        scene, views=tuple(replace(v, cam_from_world=v.cam_from_world @ turn) for v in scene.views)
    )


def row_of(place: str, kind: str, fruit: SampleFruit, work: Path, *, grasps: int) -> dict[str, Any]:
    """Photos, batch and grading of a fruit in a scene (what is there is kept), and the errors."""
    family, photos = SCENES[place]
    scene = draw_scene(scene_of_kind(place, kind).index, photos=photos, family=family, fruit=(kind, fruit))
    if place == "table":
        scene = from_the_suture(scene)
    where = work / fruit.fruit_id
    kept = where / f"{place}-{grasps}-grasps.json"
    if kept.is_file():
        return dict(json.loads(kept.read_text()))
    folder = where / scene.name
    if not complete(folder, photos=photos):
        write_scene(where, scene, options=RenderOptions(), progress=print)
    batch = where / f"batch-{place}"
    recordings = batch / "fruits" / fruit.fruit_id / "grasps"
    for other in sorted(where.glob("batch-*/fruits/*/grasps"))[:1]:
        if grasps and other != recordings:
            shutil.copytree(other, recordings, dirs_exist_ok=True)
    write_batch(batch, folder, fruit, kind=kind, grasps=grasps)
    result = graded(batch, json.loads((folder / "scene.json").read_text()))
    print(line(result), flush=True)
    row: dict[str, Any] = {
        "scene": place, "set": scene.name, "fruit": fruit.fruit_id, "light": scene.light.kind,
        "ground": scene.ground.kind, "photos": photos,
    }  # fmt: skip
    truth = read_truth(folder)
    shown = orientation_of(truth.vertices, truth.faces)
    row |= {"true_shape_stem_deg": shown.tilt_deg, "true_shape_suture_deg": abs(shown.turn_deg)}
    made = batch / "results" / "fruits" / fruit.fruit_id
    if (made / "fruit.ply").is_file():
        vertices, faces = read_mesh(made / "fruit.ply")
        if place == "table":
            vertices = onto_truth(truth, vertices, faces)
        score = scored(truth, list(truth.places), vertices, faces)
        mesh = json.loads((made / "record.json").read_text())["mesh"]
        row |= {
            "rms_seen_mm": score["rms_seen_mm"], "p95_seen_mm": score["p95_seen_mm"],
            "volume_error_percent": 100 * score["volume_error"], "surface_sd_mm": mesh["surface_sd_mm"],
            "stem_deg": mesh["stance"]["tilt_deg"], "stem_confidence": mesh["stance"]["stem_confidence"],
            "suture_deg": abs(mesh["stance"]["turn_deg"]),
            "suture_confidence": mesh["stance"]["suture_confidence"],
        }  # fmt: skip
    if result["E_MPa"] is not None:
        E_sd_percent = 100 * result["E_sd_MPa"] / result["E_MPa"]
        row |= {"E_error_percent": result["error_percent"], "E_sd_percent": E_sd_percent}
    row |= {"cpu_s": round(result["cpu_s"]), "warnings": result["warnings"]}
    kept.write_text(json.dumps(row))
    return row


def main(checkout: Path, work: Path, csv: Path | None = None, only: str = "", grasps: int = 2) -> None:
    """Prints a line a set, writes the rows."""
    rows = []
    for kind, toy in TOYS.items():
        drawn = replace(scene_of_kind("mat", kind).fruit, fruit_id=f"drawn-{kind}", E_MPa=toy.E_MPa)
        for fruit in (scanned_fruit(checkout, kind), drawn):
            for place in SCENES:
                if only not in f"{place}-{fruit.fruit_id}":
                    continue
                try:
                    rows.append(row_of(place, kind, fruit, work, grasps=grasps))
                except NotInEquilibrium as failure:
                    print(
                        f"{place} {fruit.fruit_id}: the grasp could not be simulated: {failure}", flush=True
                    )
    for row in rows:
        print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()})
    if csv is not None:
        pd.DataFrame(rows).to_csv(csv, index=False, float_format="%.4g")


if __name__ == "__main__":
    run(main)
