"""Render fruit of other kinds than the shipped sample, with what is true of them, for benchmarks/recon.py.

    python benchmarks/recon_fruits.py OUT KIND SEED [--views 36] [--mat big|small] [--reach 315] [--spp 8]
        [--over TILT TURN]

OUT gets photos/, mat.json, fruit_truth.ply (mm, in the mat's frame) and cameras_truth.json. KIND is one of
samples/kinds.py: cherry, black-cherry, plum, waxy-plum. With --over, photos-flipped/ alone is written: the
same fruit upside down, tilted and turned by so many degrees. Needs the extra `samples`.
"""

import argparse
import json
from pathlib import Path

from recon.cameras.printed_mat import mat_mapping, standard_mat
from recon.surface.mesh_file import write_mesh
from samples.fruit import skin_mesh
from samples.kinds import KINDS, fruit_of_kind
from samples.photo_set import PhotoOptions, write_photos


def main() -> None:
    """Writes one folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("kind", choices=sorted(KINDS))
    parser.add_argument("seed", type=int)
    parser.add_argument("--views", type=int, default=36)
    parser.add_argument("--mat", choices=("big", "small"), default="big")
    parser.add_argument("--reach", type=float, default=315.0, help="camera to fruit, mm (default 315)")
    parser.add_argument("--spp", type=int, default=8, help="light samples per pixel (default 8)")
    parser.add_argument("--over", type=float, nargs=2, metavar=("TILT", "TURN"))
    options = parser.parse_args()

    fruit = fruit_of_kind(options.kind, seed=options.seed)
    mat = standard_mat() if options.mat == "big" else standard_mat(tag_mm=9.0, gap_mm=2.5, margin_mm=8.5)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "mat.json").write_text(json.dumps(mat_mapping(mat)) + "\n")
    write_mesh(options.out / "fruit_truth.ply", *skin_mesh(fruit.skin, cells=72))
    views = write_photos(
        options.out / ("photos-flipped" if options.over else "photos"), fruit, mat, views=options.views,
        options=PhotoOptions(
            samples_per_pixel=options.spp, reach_mm=options.reach, skin_cells=200,
            look=KINDS[options.kind].look, over_deg=tuple(options.over) if options.over else None,
        ),
    )  # fmt: skip
    if options.over:
        return
    facts = {
        "f": views[0].focal_px, "width": views[0].width_px, "height": views[0].height_px,
        "views": [
            {
                "name": f"{k:03d}.jpg", "R": v.cam_from_world[:3, :3].tolist(),
                "t": v.cam_from_world[:3, 3].tolist(),
            }
            for k, v in enumerate(views)
        ],
    }  # fmt: skip
    (options.out / "cameras_truth.json").write_text(json.dumps(facts) + "\n")


if __name__ == "__main__":
    main()
