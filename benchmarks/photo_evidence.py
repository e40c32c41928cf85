"""What the photos say against right and wrong meshes of fruits whose truth is known.

python benchmarks/photo_evidence.py FOLDER...: for each folder (photos, mat.json, fruit_truth.ply,
cameras_truth.json) a line for the true surface, for it shrunk by 2 %, moved by 0.5 mm and with a patch pushed
in by 1.5 mm, and for the mesh that `reconstruct` makes: the true error beside the stated one, and the share
of the skin seen where |error| < 2 sd.
"""

import json
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
from recon_score import Truth, read_truth, signed_distance_mm

from recon.camera import straightened
from recon.closed import face_areas, vertex_normals, volume_mm3
from recon.coverage import SEEN_BY, seeing_views
from recon.failure import ReconFailure
from recon.fruit_mesh import reconstruct
from recon.ground_check import rim_evidence
from recon.mat import parse_mat
from recon.photo_check import checked_photos
from recon.photos import read_photos
from recon.poses import cameras_from_mat
from recon.stage_clock import one_thread
from recon.surface_error import surface_error
from recon.surface_verdict import surface_doubts, surface_offset

FACES = 6000


def main(folders: list[str]) -> None:
    """Print a line a mesh."""
    for folder in map(Path, folders):
        mat = parse_mat(json.loads((folder / "mat.json").read_text()), source="mat.json")
        photos = checked_photos(list(read_photos(folder / "photos")), mat).photos
        truth = read_truth(folder)
        with one_thread():
            poses = cameras_from_mat(photos, mat)
            pairs = [straightened(photos[i], c) for i, c in zip(poses.used, poses.cameras, strict=True)]
            meshes = wrong_meshes(truth)
            try:
                made = reconstruct(photos, mat=mat, height_mm=None)
                meshes["made"] = made.vertices, made.faces
            except ReconFailure as failure:
                print(folder.name, "made: refused:", failure.detail)
            for kind, (vertices, faces) in meshes.items():
                print(folder.name, kind, told(pairs, truth, vertices, faces), flush=True)


def wrong_meshes(truth: Truth) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The true surface with fewer faces, and the same made wrong."""
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(truth.vertices), o3d.utility.Vector3iVector(truth.faces)
    ).simplify_quadric_decimation(FACES)
    v, f = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(int)
    middle = v.mean(0)
    out = (v - middle) / np.linalg.norm(v - middle, axis=1, keepdims=True)
    low = np.array([0.8, 0.3, -0.5]) / np.linalg.norm([0.8, 0.3, -0.5])
    patch = np.exp(-(((1 - out @ low) / 0.12) ** 2))[:, None] * vertex_normals(v, f)
    return {
        "true": (v, f),
        "shrunk": ((v - middle) * 0.98 + middle, f),
        "moved": (v + np.array([0.35, 0.35, 0.0]), f),
        "pushed": (v - 1.5 * patch, f),
    }


def told(pairs, truth: Truth, vertices: np.ndarray, faces: np.ndarray) -> str:
    """True and stated errors of one mesh, and the verdict."""
    images, cameras = [i for i, _ in pairs], [c for _, c in pairs]
    places = np.array([c.place for c in cameras])
    views = seeing_views(vertices, faces, places)
    evidence = rim_evidence(images, cameras, vertices, faces)
    error = surface_error(evidence, vertices, faces, places, views)
    offset = surface_offset(error, vertices, faces, views)
    off = signed_distance_mm(vertices, truth.vertices, truth.faces)
    area = np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), len(vertices))
    area = area * (views >= SEEN_BY) / np.sum(area * (views >= SEEN_BY))
    try:
        verdict = " ".join(surface_doubts(offset, error, evidence, vertices, faces, views)) or "passed"
    except ReconFailure as failure:
        verdict = f"refused: {failure.detail}"
    volume = volume_mm3(vertices, faces) / volume_mm3(truth.vertices, truth.faces) - 1
    within = area @ (np.abs(off) < 2 * error.sd_mm)
    return (
        f"true rms {np.sqrt(area @ off**2):.3f} mm, volume {100 * volume:+.1f} %; "
        f"stated {error.rms_mm:.3f} mm, within 2 sd {within:.3f}; "
        f"offsets {offset.rms_mm:.3f} mm, local {offset.local_mm:.2f} mm, "
        f"volume {100 * offset.volume_share:+.1f} %; known {evidence.known.mean():.2f}; {verdict}"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
