"""How well the self-check of a mesh made from photos tells right from wrong, on sets of known truth.

    python benchmarks/photo_evidence.py FOLDER... [--keep KEPT] [--kinds "made,shrunk 1 %"] --out CSV

Each folder has photos, mat.json, fruit_truth.ply and cameras_truth.json. A line is printed for the mesh that
`reconstruct` makes and for that mesh made wrong without a look at the truth: KINDS. A mesh is bad where it is
off by more than MISSED_RMS_MM (root mean square over the skin that two cameras see) or MISSED_VOLUME of
benchmarks/photo_bank_score.py, sound where by less than half of both; `said` where the self-check warns or
refuses. `within`: share of the skin seen where |error| < 2 sd. `left-right`: recon.checks.camera_shadow,
px. KEPT holds reconstructions for the next run.
"""

import argparse
import csv
import json
import pickle
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from photo_bank_score import MISSED_RMS_MM, MISSED_VOLUME
from recon_score import Truth, read_truth, signed_distance_mm

from recon.cameras.camera import Camera, straightened
from recon.cameras.photos import read_photos
from recon.cameras.printed_mat import parse_mat
from recon.checks.camera_shadow import left_right_px
from recon.checks.ground_check import rim_evidence
from recon.checks.photo_check import checked_photos
from recon.checks.surface_error import surface_error
from recon.checks.surface_verdict import surface_doubts, surface_offset
from recon.fruit_mesh import reconstruct
from recon.recon_failure import ReconFailure
from recon.stage_clock import one_thread
from recon.surface.coverage import SEEN_BY, seeing_views
from recon.triangle_mesh import face_areas, vertex_normals, volume_mm3

KINDS: dict[str, tuple[str, float, float]] = {
    "made": ("none", 0.0, 0.0),
    "shrunk 1 %": ("scale", -0.01, 0.0),
    "grown 1 %": ("scale", 0.01, 0.0),
    "moved 0.5 mm": ("shift", 0.5, 0.0),
    "dent 0.6 mm, 20 %": ("patch", -0.6, 0.2),
    "dent 1 mm, 15 %": ("patch", -1.0, 0.15),
    "dent 2 mm, 15 %": ("patch", -2.0, 0.15),
    "dent 3 mm, 10 %": ("patch", -3.0, 0.1),
    "bulge 1 mm, 15 %": ("patch", 1.0, 0.15),
    "bulge 2 mm, 15 %": ("patch", 2.0, 0.15),
    "bulge 3 mm, 10 %": ("patch", 3.0, 0.1),
}
"""What is done to the mesh made: by how much (relative, mm), over which share of the skin (a round patch on
the flank or the shoulder, deepest in its middle, as cos²)."""


def main() -> int:
    """Prints a line a mesh and the summary; writes the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    chosen = [kind for kind in KINDS if kind.split(",")[0] in options.kinds]
    rows = []
    for folder in options.folders:
        made = memoised(folder, options.keep)
        if "refused" in made:
            print(folder.name, "refused:", made["refused"], flush=True)
            continue
        truth = read_truth(folder)
        for kind in chosen:
            rows.append({"set": folder.name, "mesh": kind} | scored(made, truth, kind, folder.name))
            print(line(rows[-1]), flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["set"])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()})
    print(summary(rows))
    return 0


def memoised(folder: Path, keep: Path | None) -> dict[str, Any]:
    """Straightened photos, cameras and the mesh with the sd that only `reconstruct` knows; or the refusal."""
    path = keep / f"{folder.name}.pkl" if keep else None
    if path is not None and path.is_file():
        return dict(pickle.loads(path.read_bytes()))
    mat = parse_mat(json.loads((folder / "mat.json").read_text()), source="mat.json")
    photos = checked_photos(list(read_photos(folder / "photos")), mat).photos
    try:
        made = reconstruct(photos, mat=mat, height_mm=None)
    except ReconFailure as failure:
        out: dict[str, Any] = {"refused": failure.detail}
    else:
        by_name = {photo.name: photo for photo in photos}
        with one_thread():
            images = [straightened(by_name[c.name], replace(c, k1=made.quality.k1))[0] for c in made.cameras]
        other = [w for w in made.warnings if w.startswith("Outlines agree")]
        out = {
            "images": images, "cameras": list(made.cameras), "vertices": made.vertices, "faces": made.faces,
            "sd_mm": made.sd_mm, "other": other,
        }  # fmt: skip
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(out))
    return out


def made_wrong(
    vertices: np.ndarray, faces: np.ndarray, kind: tuple[str, float, float], rng: np.random.Generator
) -> np.ndarray:
    """The vertices after what KINDS says, in a direction drawn by `rng`."""
    what, size, share = kind
    middle = (vertices.min(0) + vertices.max(0)) / 2
    turn = rng.uniform(0, 2 * np.pi)
    if what == "scale":
        return np.asarray(middle + (vertices - middle) * (1 + size))
    if what == "shift":
        return np.asarray(vertices + size * np.array([np.cos(turn), np.sin(turn), 0]))
    if what == "patch":
        height = rng.uniform(-0.35, 0.6)
        flat = np.sqrt(1 - height**2)
        towards = np.array([np.cos(turn) * flat, np.sin(turn) * flat, height])
        way = (vertices - middle) / np.linalg.norm(vertices - middle, axis=1, keepdims=True)
        angle = np.arccos(np.clip(way @ towards, -1, 1)) / np.arccos(1 - 2 * share)
        bump = np.cos(np.pi / 2 * np.clip(angle, 0, 1)) ** 2
        moved = vertices + size * bump[:, None] * vertex_normals(vertices, faces)
        moved[:, 2] = np.maximum(moved[:, 2], 0.0)
        return np.asarray(moved)
    return vertices


def scored(made: dict[str, Any], truth: Truth, kind: str, name: str) -> dict[str, Any]:
    """True and stated errors of one mesh, and the verdict."""
    images, cameras, faces = made["images"], made["cameras"], made["faces"]
    places = np.array([c.place for c in cameras])
    rng = np.random.default_rng([int("".join(filter(str.isdigit, name)) or 0), list(KINDS).index(kind)])
    vertices = made_wrong(made["vertices"], faces, KINDS[kind], rng)
    hollow = made.get("hollow_mm2")
    if hollow is None:
        hollow = made["hollow_mm2"] = _added_by_hollows(made, images, cameras, places)
    start = time.process_time()
    with one_thread():
        views = seeing_views(vertices, faces, places)
        evidence = rim_evidence(images, cameras, vertices, faces)
        error = surface_error(evidence, vertices, faces, places, views)
    cpu_s = time.process_time() - start
    sd_mm = np.sqrt(error.sd_mm**2 + hollow)
    offset = surface_offset(error, vertices, faces, views)
    off = signed_distance_mm(vertices, truth.vertices, truth.faces)
    area = np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), len(vertices))
    area = area * (views >= SEEN_BY) / np.sum(area * (views >= SEEN_BY))
    try:
        words = [*made["other"], *surface_doubts(offset, error, evidence, vertices, faces, views)]
    except ReconFailure as failure:
        words = [f"refused: {failure.detail}"]
    rms_mm = float(np.sqrt(area @ off**2))
    volume = volume_mm3(vertices, faces) / volume_mm3(truth.vertices, truth.faces) - 1
    bad = rms_mm > MISSED_RMS_MM or abs(volume) > MISSED_VOLUME
    sound = rms_mm < MISSED_RMS_MM / 2 and abs(volume) < MISSED_VOLUME / 2
    return {
        "rms_mm": rms_mm, "volume_error": volume, "is": "bad" if bad else "sound" if sound else "between",
        "stated_mm": float(np.sqrt(area @ sd_mm**2)), "within": float(area @ (np.abs(off) < 2 * sd_mm)),
        "offset_rms_mm": offset.rms_mm, "offset_local_mm": offset.local_mm,
        "offset_volume": offset.volume_share, "left_right_px": float(np.abs(left_right_px(evidence)).max()),
        "known": float(evidence.known.mean()), "cpu_s": cpu_s, "said": " ".join(words),
    }  # fmt: skip


def _added_by_hollows(
    made: dict[str, Any], images: list[np.ndarray], cameras: list[Camera], places: np.ndarray
) -> np.ndarray:
    """What hollows under a bridge add to the variance at each vertex of the mesh made, mm²."""
    vertices, faces = made["vertices"], made["faces"]
    with one_thread():
        views = seeing_views(vertices, faces, places)
        plain = surface_error(
            rim_evidence(images, cameras, vertices, faces), vertices, faces, places, views
        ).sd_mm
    return np.maximum(made["sd_mm"] ** 2 - plain**2, 0.0)


def line(row: dict[str, Any]) -> str:
    """One mesh, in a line."""
    return (
        f"{row['set']:16} {row['mesh']:18} {row['is']:8} rms {row['rms_mm']:.3f} mm, volume"
        f" {100 * row['volume_error']:+.1f} %; stated {row['stated_mm']:.3f} mm, within 2 sd"
        f" {row['within']:.3f}; offsets {row['offset_rms_mm']:.3f} mm, local {row['offset_local_mm']:.2f} mm,"
        f" volume {100 * row['offset_volume']:+.1f} %; left-right {row['left_right_px']:.2f} px; "
        f"{row['said'] or 'passed'}"
    )


def summary(rows: list[dict[str, Any]]) -> str:
    """For each kind of mesh, as a table: how many, of how many bad ones nothing was said, false warnings."""
    lines = [
        "| mesh | meshes | bad | of these unsaid | sound | of these warned of | within 2 sd: mean, least |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for kind in (*dict.fromkeys(row["mesh"] for row in rows), "all"):
        these = [row for row in rows if kind in (row["mesh"], "all")]
        bad, sound = ([r for r in these if r["is"] == state] for state in ("bad", "sound"))
        within = [r["within"] for r in these]
        lines.append(
            f"| {kind} | {len(these)} | {len(bad)} | {sum(not r['said'] for r in bad)} | {len(sound)} |"
            f" {sum(bool(r['said']) for r in sound)} | {np.mean(within):.3f}, {min(within):.3f} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
