"""How much taller than the fruit its fitted hull is, by the elevation from which its top is seen.

    python benchmarks/unseen_top_error.py BANK [--sets 6]

Outlines of the true meshes of a bank's work half (benchmarks/photo_bank.py), standing as they were drawn,
with waves of half a pixel; 8 and 12 cameras all around at one elevation, 2 degrees up and down. Columns: the
lowest elevation (degrees), the excess found, what recon.surface.unseen_top expects and its standard
deviation. It also prints the root mean square of (found - expected) / sd.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from recon_score import read_truth
from scipy.ndimage import gaussian_filter1d

from recon.cameras.camera import Camera
from recon.silhouettes.hull import Silhouette, drawn, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import Outline, outline_of, silhouette_of_outline
from recon.silhouettes.tangent import fitted_to_outlines
from recon.surface.unseen_top import expected_excess

ELEVATIONS_DEG = (6.0, 13.0, 20.0, 30.0, 38.0)
FOCAL_PX, DISTANCE, NOISE_PX, FINER = 1100.0, 5.5, 0.5, 3


def cameras_around(
    count: int, elevation_deg: float, tall_mm: float, rng: np.random.Generator
) -> list[Camera]:
    """Cameras that see the fruit's top at about the elevation, 5.5 half heights off."""
    cameras = []
    for i in range(count):
        e, a = np.radians(elevation_deg + rng.uniform(-2, 2)), 2 * np.pi * i / count
        away = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        place = np.array([0.0, 0.0, tall_mm]) + DISTANCE * tall_mm / 2 * away
        ahead = np.array([0.0, 0.0, tall_mm / 2]) - place
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        pose[:3, 3] = -pose[:3, :3] @ place
        cameras.append(
            Camera(name=f"{i}", width_px=960, height_px=720, focal_px=FOCAL_PX, k1=0.0, cam_from_world=pose)
        )
    return cameras


def silhouette(
    camera: Camera, vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator
) -> Silhouette:
    """The mesh's outline, drawn three times as fine, with waves on it."""
    fine = replace(
        camera,
        focal_px=FINER * FOCAL_PX,
        width_px=FINER * camera.width_px,
        height_px=FINER * camera.height_px,
    )
    outline = outline_of(drawn(vertices, faces, window_of(fine.project(vertices)), fine))
    if outline is None:
        raise ValueError("the fruit has no outline; check the bank's mesh")
    corner = np.array(window_of(fine.project(vertices)).corner_px)
    points = (outline.points + corner - (FINER - 1) / 2) / FINER
    wave = gaussian_filter1d(rng.normal(size=len(points)), len(points) / 128, mode="wrap")
    points = points + NOISE_PX * (wave / wave.std())[:, None] * outline.normals
    window = window_of(points)
    return silhouette_of_outline(Outline(points - window.corner_px, outline.normals, 1.0), window, camera)


def window_of(pixels: np.ndarray) -> Window:
    """An empty window around pixels."""
    corner = np.floor(pixels.min(0)).astype(int) - 16
    columns, rows = np.ceil(pixels.max(0)).astype(int) + 16 - corner
    return Window(np.zeros((rows, columns, 3), np.uint8), (int(corner[0]), int(corner[1])), 1)


def main() -> int:
    """Prints a line a fruit and elevation."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bank", type=Path)
    parser.add_argument("--sets", type=int, default=6)
    options = parser.parse_args()
    folders = [
        p.parent
        for p in sorted(options.bank.glob("*/scene.json"))
        if json.loads(p.read_text())["half"] == "work"
    ]
    folders = folders[:: max(1, len(folders) // options.sets)]
    rng, off, count = np.random.default_rng(5), [], 8
    for folder in folders:
        truth = read_truth(folder)
        v = truth.vertices - [
            *(truth.vertices.max(0) + truth.vertices.min(0))[:2] / 2,
            truth.vertices[:, 2].min(),
        ]
        tall_mm = float(v[:, 2].max())
        for elevation_deg in ELEVATIONS_DEG:
            count = 20 - count
            cameras = cameras_around(count, elevation_deg, tall_mm, rng)
            seen = [silhouette(c, v, truth.faces, rng) for c in cameras]
            rough, faces = visual_hull(
                seen, centre_mm=np.array([0, 0, tall_mm / 2]), longest_mm=2 * tall_mm, floor_mm=0.0, level=5,
                outlier_share=0.03,
            )  # fmt: skip
            made = fitted_to_outlines(rough, faces, seen, floor_mm=0.0).vertices
            box = np.ptp(made, axis=0)
            away = np.array([c.place for c in cameras]) - [0, 0, box[2]]
            lowest = float(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1)).min())
            expected = expected_excess(cameras, box, lowest)
            found = box[2] / tall_mm - 1
            off.append((found - expected.value) / max(expected.sd, 0.002))
            print(
                f"{folder.name} {count:2} {np.degrees(lowest):5.1f} {100 * found:6.2f} %"
                f" {100 * expected.value:6.2f} % {100 * expected.sd:5.2f} %",
                flush=True,
            )
    print(f"{len(off)} meshes, (found - expected) / sd: RMS {np.sqrt(np.mean(np.square(off))):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
