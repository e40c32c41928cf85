"""Few photos and no mat, over a bank of phone sets (benchmarks/photo_bank.py draw --family phone).

    python benchmarks/photo_phone.py BANK --photos 8 12 24 [--half work|scored] [--scale height|coin]
        [--only phone-004]... [--jobs 1] --out CSV

Of every set so many photos are taken as a person takes them who walks around the fruit: evenly in azimuth,
from the first photo on, whatever their height. Each subset is reconstructed in a process of its own as
`drupe grade` does it, to the scale of the fruit's height, or of the coin (sets without are left out). The
mesh is laid on the truth by a rigid motion (its own scale counts), and scored as in
benchmarks/recon_score.py. Further columns say where it went wrong: cameras after a similarity (poses), tilt
and height of the support plane at the fruit, scale, focal length. A set counts as missed where its mesh is
off by more than MISSED_RMS_MM or MISSED_VOLUME of benchmarks/photo_bank_score.py and nothing was said.
"""

import argparse
import json
import multiprocessing
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from photo_bank_score import verdict as of_bank
from photo_bank_score import write_rows

TARGET_RMS_MM = 0.2
"""What few photos without a mat are to reach on the seen surface, or be refused."""


def walked_around(azimuth_deg: np.ndarray, count: int) -> list[int]:
    """Which of the photos: the nearest left to each of `count` even azimuths from the first photo on."""
    left = set(range(len(azimuth_deg)))
    chosen = []
    for k in range(min(count, len(azimuth_deg))):
        wanted = azimuth_deg[0] + 360.0 * k / count
        best = min(sorted(left), key=lambda i: abs((azimuth_deg[i] - wanted + 180.0) % 360.0 - 180.0))
        left.remove(best)
        chosen.append(best)
    return sorted(chosen)


def subset(folder: Path, count: int) -> list[str]:
    """The names of `count` photos of a set."""
    views = json.loads((folder / "cameras_truth.json").read_text())["views"]
    places = np.array([-np.asarray(v["R"]).T @ np.asarray(v["t"]) for v in views])
    chosen = walked_around(np.degrees(np.arctan2(places[:, 1], places[:, 0])), count)
    return [views[i]["name"] for i in chosen]


def scored_subset(job: tuple[Path, int, str]) -> dict[str, Any]:
    """One reconstruction, its error, and what was said of it."""
    from recon_score import read_truth, rigidly_on_truth, scale_error, scored

    from recon.cameras.coin import coin_named
    from recon.cameras.photos import read_photos
    from recon.checks.photo_check import checked_photos
    from recon.checks.verdict import require_seen, shape_doubts
    from recon.fruit_mesh import ReconOptions, reconstruct
    from recon.recon_failure import ReconFailure

    folder, count, scale = job
    scene = json.loads((folder / "scene.json").read_text())
    out: dict[str, Any] = {
        "set": folder.name, "photos": count, "shape": scene["fruit"]["kind"],
        "gloss": scene["skin"]["gloss"], "ground": scene["ground"]["kind"],
        "coin": scene["coin"] is not None, "scale": scale,
    }  # fmt: skip
    names = subset(folder, count)
    photos = [p for p in read_photos(folder / "photos") if p.name in names]
    start = time.process_time()
    try:
        checked = checked_photos(photos, None)
        options = ReconOptions(coin=coin_named("1 euro") if scale == "coin" else None)
        made = reconstruct(checked.photos, mat=None, height_mm=scene["height_mm"], options=options)
        require_seen(made.quality, left_out=checked.warnings)
    except ReconFailure as refusal:
        return out | {
            "cpu_s": time.process_time() - start,
            "problem": refusal.problem.value,
            "refused": str(refusal),
        }
    out["cpu_s"] = time.process_time() - start
    truth = read_truth(folder)
    used = [c.name for c in made.cameras]
    places = np.array([c.place for c in made.cameras])
    placed = rigidly_on_truth(truth, used, places, made.vertices, made.faces)
    error = scored(truth, used, placed, made.faces)
    return out | {
        "used": made.quality.views_used,
        "rms_seen_mm": error.rms_seen_mm,
        "p95_seen_mm": error.p95_seen_mm,
        "outward_seen_mm": error.outward_seen_mm,
        "rms_all_mm": error.rms_all_mm,
        "volume_error": error.volume_error,
        "scale_error": scale_error(truth, used, places),
        "scale_sd": made.scale_sd,
        "surface_sd_mm": made.surface_sd_mm,
        "reprojection_px": made.quality.reprojection_px,
        "focal_error": made.quality.focal_px / scene["camera"]["focal_px"] - 1,
        **camera_errors(folder, used, places),
        "said": " ".join([*checked.warnings, *made.warnings, *shape_doubts(made.vertices, made.faces)]),
    }


def camera_errors(folder: Path, used: list[str], places: np.ndarray) -> dict[str, float]:
    """Root mean square miss of the camera places after a similarity (mm), and where the support plane
    lies by it: height over the true one under the fruit (mm), and tilt (degrees).
    """
    from recon_score import read_truth

    from recon.cameras.similarity import fitted_similarity

    truth = read_truth(folder)
    T, away = fitted_similarity(places, np.array([truth.places[n] for n in used]))
    up = T[:3, 2] / np.linalg.norm(T[:3, 2])
    return {
        "cameras_mm": float(np.sqrt(np.mean(away**2))),
        "plane_mm": float(T[:3, 3] @ up / up[2]),
        "tilt_deg": float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))),
    }


def verdict(row: dict[str, Any]) -> str:
    """right, warned, refused, over target (unsaid, but not as far off as to be missed) or missed."""
    verdict = of_bank(row)
    return "over target" if verdict == "right" and float(row["rms_seen_mm"]) > TARGET_RMS_MM else verdict


def table(rows: list[dict[str, Any]]) -> str:
    """One line for each number of photos and scale."""
    lines = [
        "photos scale   sets meshes  RMS median  worst  within 0.2  refused warned over-target missed  CPU s"
    ]
    for count, scale in sorted({(r["photos"], r["scale"]) for r in rows}):
        these = [r for r in rows if (r["photos"], r["scale"]) == (count, scale)]
        rms = np.array([r["rms_seen_mm"] for r in these if "rms_seen_mm" in r])
        said = [verdict(r) for r in these]
        lines.append(
            f"{count:6} {scale:6} {len(these):5} {len(rms):6} {np.median(rms) if len(rms) else np.nan:11.3f}"
            f" {rms.max() if len(rms) else np.nan:6.3f} {int((rms <= TARGET_RMS_MM).sum()):11}"
            f" {said.count('refused'):8} {said.count('warned'):6} {said.count('over target'):11}"
            f" {said.count('missed'):6} {np.median([r['cpu_s'] for r in these]):6.0f}"
        )
    return "\n".join(lines)


def main() -> int:
    """Prints a line a subset and the table; writes the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bank", type=Path)
    parser.add_argument("--photos", type=int, nargs="+", default=[8, 12])
    parser.add_argument("--half", choices=("work", "scored"), default="work")
    parser.add_argument("--scale", choices=("height", "coin"), default="height")
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    jobs = []
    for path in sorted(options.bank.glob("*/scene.json")):
        scene, folder = json.loads(path.read_text()), path.parent
        if scene["half"] == options.half and (not options.only or folder.name in options.only):
            if options.scale == "coin" and scene["coin"] is None:
                continue
            jobs += [(folder, n, options.scale) for n in options.photos if n <= len(scene["photos"])]
    rows = []
    with multiprocessing.get_context("spawn").Pool(options.jobs, maxtasksperchild=1) as pool:
        for row in pool.imap(scored_subset, jobs, chunksize=1):
            rows.append(row)
            numbers = (
                f"RMS {row['rms_seen_mm']:.3f} mm, volume {100 * row['volume_error']:+.2f} %, scale"
                f" {100 * row['scale_error']:+.2f} %, cameras {row['cameras_mm']:.2f} mm, plane"
                f" {row['plane_mm']:+.2f} mm, {row['cpu_s']:.0f} CPU s"
                if "rms_seen_mm" in row
                else row["refused"]
            )
            print(
                f"{row['set']} {row['photos']:2} {verdict(row):13} {numbers}  {row.get('said', '')}",
                flush=True,
            )
    write_rows(options.out, rows)
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
