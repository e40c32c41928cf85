"""What relief does to the outline surface, set by set: error before and after, in the cavity and around it.

    python benchmarks/recon_relief.py FOLDER... [--every N] [--set NAME=VALUE]...

A FOLDER holds photos/, mat.json, fruit_truth.ply and cameras_truth.json. Each is reconstructed up to the
outline surface once; `seen`, `cavity`, `sides`, `low` are root mean squares (mm) of the distance from the
true surface that some camera saw (benchmarks/recon_score.py), within 45 % of the fruit's radius of its axis
above 70 % of its height, above and below a quarter of its height. `measured` is the share of the vertices
that relief placed; each region it moved follows with what the held-out views say. `--every` uses every n-th
photo. `--set` gives a constant of recon/relief*.py or recon/surface/photo_consistency.py another value:
the tables from which those constants were chosen.
"""

import argparse
import ast
import importlib
import json
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def main() -> int:
    """Prints the table; exit status 1 where a set got worse by over 0.005 mm."""
    from recon_score import read_truth

    from recon.cameras.camera import straightened
    from recon.cameras.mat_poses import cameras_from_mat
    from recon.cameras.photos import read_photos
    from recon.cameras.printed_mat import parse_mat
    from recon.checks.photo_check import checked_photos
    from recon.silhouettes.all_views import find_fruit
    from recon.stage_clock import one_thread
    from recon.surface import photo_consistency, relief, relief_mesh, relief_search, relief_verdict

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="use every n-th photo (default 1)")
    parser.add_argument("--set", action="append", default=[], help="NAME=VALUE of a constant")
    options = parser.parse_args()
    modules = (relief, relief_mesh, relief_search, relief_verdict, photo_consistency)
    for each in options.set:
        name, value = each.split("=", 1)
        owners = [m for m in modules if hasattr(m, name)]
        if not owners:
            parser.error(
                f"--set {each}: neither recon/relief*.py nor recon/surface/photo_consistency.py has {name}"
            )
        for owner in owners:
            setattr(owner, name, ast.literal_eval(value))
    print(f"{'fruit':18}{'':8}{'seen':>8}{'cavity':>8}{'sides':>8}{'low':>8}{'cpu_s':>8}{'measured':>10}")
    worse = 0
    for folder in options.folders:
        source = str(folder / "mat.json")
        mat = parse_mat(json.loads((folder / "mat.json").read_text()), source=source)
        truth = read_truth(folder)
        with one_thread():
            photos = checked_photos(list(read_photos(folder / "photos"))[:: options.every], mat).photos
            poses = cameras_from_mat(photos, mat)
            pairs = [
                straightened(photos[i], c) for i, c in zip(poses.used.tolist(), poses.cameras, strict=True)
            ]
            images, cameras = [i for i, _ in pairs], [c for _, c in pairs]
            fruit = find_fruit(images, cameras, low_mm=poses.box[0], high_mm=poses.box[1], level=6)
            images, cameras = [images[i] for i in fruit.used], [cameras[i] for i in fruit.used]
            start = time.process_time()
            made = relief.relief(fruit.vertices, fruit.faces, images, cameras, support=fruit.support)
            spent = time.process_time() - start
        names = [c.name for c in cameras]
        before = parts(truth, names, fruit.vertices, fruit.faces)
        after = parts(truth, names, made.vertices, fruit.faces)
        worse += after["seen"] > before["seen"] + 0.005
        row = "".join(f"{before[k]:8.3f}" for k in ("seen", "cavity", "sides", "low"))
        print(f"{folder.name:18}{'before':8}{row}")
        row = "".join(f"{after[k]:8.3f}" for k in ("seen", "cavity", "sides", "low"))
        print(f"{'':18}{'after':8}{row}{spent:8.1f}{made.measured.mean():10.3f}")
        for r in made.regions:
            said = "kept" if r.accepted else "refused"
            print(
                f"{'':18}{said:8} {r.depth_mm:.2f} mm at ({', '.join(f'{x:.0f}' for x in r.centre_mm)}), "
                f"{r.confirmed} of {r.measured} measured vertices confirmed, gain {r.mean_gain:.2f}, "
                f"chance {r.chance:.1e}",
                flush=True,
            )
    return int(worse > 0)


def parts(truth, names: list[str], vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Root mean square distance (mm) of the seen skin to a mesh, by part of the fruit."""
    from recon_score import even_points, seen_points, signed_distance_mm

    points, normals = even_points(truth)
    seen = seen_points(truth, [truth.places[n] for n in names], points, normals)
    height = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    aside = np.hypot(*(points[:, :2] - points[:, :2].mean(0)).T)
    cavity, low = (height > 0.7) & (aside < 0.45 * aside.max()), height < 0.25
    away = signed_distance_mm(points, vertices, faces)
    where = {"seen": seen, "cavity": seen & cavity, "sides": seen & ~cavity & ~low, "low": seen & low}
    return {part: float(np.sqrt(np.mean(away[k] ** 2))) for part, k in where.items()}


if __name__ == "__main__":
    sys.path = [p for p in sys.path if Path(p).resolve() != HERE]
    importlib.import_module("recon")
    sys.path.append(str(HERE))
    sys.exit(main())
