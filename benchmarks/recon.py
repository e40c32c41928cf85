"""Photos to mesh against the true surface: one row per folder, route and number of photos.

    python benchmarks/recon.py FOLDER... [--route mat|flipped|height|colmap]... [--every 2]... [--views 12]...
        [--no-all] [--height MM] [--out benchmarks/results/recon.csv]

A FOLDER holds photos/, mat.json, fruit_truth.ply and cameras_truth.json. Each row is computed in a process
of its own, on one thread, so that seconds, CPU seconds and peak memory are its own. The mat routes are
compared in the mat's frame; the height route (which is given the true height to 0.1 mm) after a rigid
registration without scaling; `flipped` takes photos-flipped/ in too. `seen` is the true surface that some
camera of the row saw, without those of photos-flipped/ (benchmarks/recon_score.py).
"""

import argparse
import csv
import importlib
import json
import multiprocessing
import resource
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
if __name__ == "recon":  # a script in this folder asks for the room of this name: hand it over
    sys.path = [p for p in sys.path if Path(p).resolve() != HERE]
    del sys.modules["recon"]
    sys.modules["recon"] = importlib.import_module("recon")
    sys.path.append(str(HERE))

COLUMNS = (
    "fruit", "route", "photos", "used", "rms_seen_mm", "p95_seen_mm", "outward_seen_mm", "seen_share",
    "rms_all_mm", "p95_all_mm", "volume_error", "scale_error", "watertight", "faces", "seconds", "cpu_s",
    "peak_MiB", "poses_s", "outlines_s", "relief_s", "surface_s", "quality_s", "surface_sd_mm", "outcome",
)  # fmt: skip


def row(folder: Path, route: str, which: list[int] | None, height_mm: float | None) -> dict[str, Any]:
    """One reconstruction and its score; a failure is a row with its sentence."""
    from recon_colmap import colmap_mesh
    from recon_score import read_truth, rigidly_on_truth, scale_error, scored

    from recon.cameras.photos import read_photos
    from recon.cameras.printed_mat import parse_mat
    from recon.fruit_mesh import reconstruct
    from recon.recon_failure import ReconFailure
    from recon.stage_clock import one_thread
    from recon.underside import with_underside

    start, cpu = time.perf_counter(), time.process_time()
    photos = list(read_photos(folder / "photos"))
    photos = photos if which is None else [photos[i] for i in which if i < len(photos)]
    names = [p.name for p in photos]
    out: dict[str, Any] = {"fruit": folder.name, "route": route, "photos": len(photos), "outcome": "mesh"}
    mat = parse_mat(json.loads((folder / "mat.json").read_text()), source=str(folder / "mat.json"))
    truth = read_truth(folder)
    tall = height_mm or round(float(truth.vertices[:, 2].max() - truth.vertices[:, 2].min()), 1)
    try:
        if route == "colmap":
            with one_thread():
                vertices, faces, used, count = colmap_mesh(folder / "photos", photos, mat)
            out |= {"used": used, "outcome": f"mesh of {count} points"}
        else:
            made = reconstruct(
                photos,
                mat=None if route == "height" else mat,
                height_mm=tall if route == "height" else None,
            )
            if route == "flipped":
                same = partial(reconstruct, mat=mat, height_mm=None)
                over = partial(read_photos, folder / "photos-flipped")
                made = with_underside(made, over, same, mat=mat)
            vertices, faces = made.vertices, made.faces
            found = [c.name for c in made.cameras]
            places = np.array([c.place for c in made.cameras])
            out |= {"used": len(found), "scale_error": scale_error(truth, found, places)}
            out |= {f"{stage}_s": spent for stage, spent in made.seconds.items()}
            out |= {"surface_sd_mm": made.surface_sd_mm, "outcome": " ".join(("mesh", *made.warnings))}
    except (ReconFailure, ValueError) as failure:
        out["outcome"] = str(failure)
        return out
    out |= {
        "seconds": time.perf_counter() - start,
        "cpu_s": time.process_time() - cpu,
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "faces": len(faces),
    }
    if route == "height":
        vertices = rigidly_on_truth(truth, found, places, vertices, faces)
    return out | asdict(scored(truth, names, vertices, faces))


def main() -> int:
    """Prints the table and writes the file; exit status 1 where no mesh came out."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--route", choices=("mat", "flipped", "height", "colmap"), action="append")
    parser.add_argument("--every", type=int, action="append", default=[], help="every n-th photo too")
    parser.add_argument("--views", type=int, action="append", default=[], help="so many photos too, spread")
    parser.add_argument("--no-all", action="store_true", help="leave out the row of all photos")
    parser.add_argument("--height", type=float, help="height_mm (default: the truth's, to 0.1 mm)")
    parser.add_argument("--out", type=Path, help="CSV to append to or replace rows in")
    options = parser.parse_args()

    jobs = []
    for folder in options.folders:
        count = len(list((folder / "photos").iterdir()))
        subsets: list[list[int] | None] = [] if options.no_all else [None]
        subsets += [list(range(0, count, step)) for step in options.every]
        subsets += [[int((i + 0.5) * count / n) for i in range(n)] for n in options.views]
        jobs += [(folder, route, part) for route in options.route or ["mat"] for part in subsets]
    rows = []
    context = multiprocessing.get_context("spawn")
    for folder, route, part in jobs:
        child = context.Pool(1)
        rows.append(child.apply(row, (folder, route, part, options.height)))
        child.close()
        child.join()
        print(_line(rows[-1]), flush=True)
    if options.out:
        _write(options.out, rows)
    return int(any("rms_seen_mm" not in r for r in rows))


def _line(r: dict[str, Any]) -> str:
    head = f"{r['fruit']:18} {r['route']:6} {r['photos']:3}"
    if "rms_seen_mm" not in r:
        return f"{head}  {r['outcome']}"
    scale = f"{100 * r['scale_error']:+.3f}" if "scale_error" in r else "-"
    return (
        f"{head} {r['used']:3}  seen RMS {r['rms_seen_mm']:.3f} 95 % {r['p95_seen_mm']:.3f} "
        f"outward {r['outward_seen_mm']:+.3f}  all RMS {r['rms_all_mm']:.3f} 95 % {r['p95_all_mm']:.3f} mm  "
        f"volume {100 * r['volume_error']:+.2f} % scale {scale} %  "
        f"{'closed' if r['watertight'] else 'OPEN'}  {r['seconds']:.0f} s, {r['cpu_s']:.0f} CPU s, "
        f"{r['peak_MiB']:.0f} MiB  {r['outcome']}"
    )


def _write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Rows of the same fruit, route and number of photos are replaced, others stay."""
    old = list(csv.DictReader(path.open(newline=""))) if path.exists() else []
    made = {(r["fruit"], r["route"], str(r["photos"])) for r in rows}
    kept = [r for r in old if (r["fruit"], r["route"], r["photos"]) not in made]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(kept)
        for r in rows:
            writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in r.items()})


if __name__ == "__main__":
    sys.exit(main())
