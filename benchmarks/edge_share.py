"""Where a fruit's true outline lies on the step of colour across its rim: recon/silhouettes/outline.py's
STEP_SHARE.

    python benchmarks/edge_share.py FOLDER... [--every 2]

A FOLDER holds photos/, mat.json, fruit_truth.ply and cameras_truth.json. Cameras come from the mat, as in
grading. Along the normals of the true outline (the projected true surface, drawn SUBPIXELS times finer) the
share of fruit a = (c - B).(F - B) / |F - B|² is taken in linear light, with F and B the mean colours
STEP_BAND_PX inside and outside, as recon/silhouettes/outline.py takes them; printed is its median over all
samples with a clear step, by distance from the true edge, and where that median falls to one half. Half of
it lies inside the edge: at grazing angles a skin mirrors the ground behind it (Fresnel).
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from recon_score import read_truth

from recon.cameras.camera import Camera, straightened
from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import read_photos
from recon.cameras.printed_mat import parse_mat
from recon.checks.photo_check import checked_photos
from recon.silhouettes.hull import sampled
from recon.silhouettes.mask import window_around
from recon.silhouettes.outline import CLEAR_STEP, LINEAR_LIGHT, STEP_BAND_PX, outline_of

SUBPIXELS = 6
SHIFTS_PX = np.arange(-8, 8.1, 0.5)


def share_across_rim(
    image: np.ndarray, camera: Camera, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Shares (k, len(SHIFTS_PX)) along the normals of the true outline in one undistorted photo."""
    window = window_around(image, camera, vertices, margin=0.15, small_side_px=100_000)
    if window is None:
        return np.empty((0, len(SHIFTS_PX)))
    columns, rows = window.small_size_px
    corners = (window.into_small(camera.project(vertices)) + 0.5) * SUBPIXELS - 0.5
    triangles = np.rint(corners[faces] * 16).astype(np.int64)
    (ax, ay), (bx, by) = ((triangles[:, k] - triangles[:, 0]).T for k in (1, 2))
    fine = np.zeros((rows * SUBPIXELS, columns * SUBPIXELS), np.uint8)
    for triangle in triangles[ax * by - ay * bx < 0].astype(np.int32):
        cv2.fillConvexPoly(fine, triangle, 1, shift=4)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, 5) for m in (fine, 1 - fine))
    signed = np.where(fine > 0, inside - 0.5, 0.5 - outside) / SUBPIXELS
    distance = signed.reshape(rows, SUBPIXELS, columns, SUBPIXELS).mean((1, 3)).astype(np.float32)
    outline = outline_of(distance > 0)
    if outline is None:
        return np.empty((0, len(SHIFTS_PX)))
    away = sampled(distance, outline.points.astype(np.float32), outside=0.0)
    edge = outline.points + away[:, None] * outline.normals
    at = (edge[:, None] + SHIFTS_PX[None, :, None] * outline.normals[:, None]).astype(np.float32)
    light = cv2.remap(cv2.LUT(window.image, LINEAR_LIGHT), at, None, cv2.INTER_LINEAR)
    nearest, furthest = STEP_BAND_PX
    within_band = (np.abs(SHIFTS_PX) >= nearest) & (np.abs(SHIFTS_PX) <= furthest)
    fruit = light[:, within_band & (SHIFTS_PX < 0)].mean(1)
    ground = light[:, within_band & (SHIFTS_PX > 0)].mean(1)
    step = fruit - ground
    square = np.sum(step**2, axis=1)
    share = np.sum((light - ground[:, None]) * step[:, None], axis=2) / np.maximum(square, 1e-9)[:, None]
    return np.asarray(share[square > CLEAR_STEP**2])


def main() -> None:
    """Prints a row a folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=2)
    options = parser.parse_args()
    shown = (-6.0, -1.0, 0.0, 1.0)
    print(f"{'':20}" + "".join(f"{s:+8.0f} px" for s in shown) + "    half at, px")
    for folder in options.folders:
        mat = parse_mat(json.loads((folder / "mat.json").read_text()), source=str(folder / "mat.json"))
        photos = checked_photos(read_photos(folder / "photos"), mat).photos
        poses = cameras_from_mat(photos, mat)
        truth = read_truth(folder)
        shares = [
            share_across_rim(*straightened(photos[i], camera), truth.vertices, truth.faces)
            for i, camera in list(zip(poses.used.tolist(), poses.cameras, strict=True))[:: options.every]
        ]
        middle = np.median(np.concatenate(shares), axis=0)
        near = np.abs(SHIFTS_PX) <= 1
        half_px = np.interp(0.5, middle[near][::-1], SHIFTS_PX[near][::-1])
        columns = "".join(f"{middle[s == SHIFTS_PX][0]:11.2f}" for s in shown)
        print(f"{folder.name:20}{columns}{half_px:15.2f}", flush=True)


if __name__ == "__main__":
    main()
