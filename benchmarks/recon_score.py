"""How far a mesh is from a fruit's true surface: where cameras saw it, on all of it, and in volume."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh
from scipy.spatial import cKDTree

from recon.triangle_mesh import volume_mm3

SAMPLES = 20000
FLATTEST_DEG = 80.0


@dataclass(frozen=True)
class Truth:
    """The true surface (mm) and the cameras: file name -> (R, t), world to camera."""

    vertices: np.ndarray
    faces: np.ndarray
    places: dict[str, np.ndarray]


def read_truth(folder: Path) -> Truth:
    """fruit_truth.ply and cameras_truth.json of a folder."""
    mesh = trimesh.load_mesh(folder / "fruit_truth.ply", process=False)
    views = json.loads((folder / "cameras_truth.json").read_text())["views"]
    places = {v["name"]: -np.asarray(v["R"]).T @ np.asarray(v["t"]) for v in views}
    return Truth(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, int), places)


def scored(truth: Truth, names: list[str], vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Errors of a mesh that lies in the truth's frame: distances from points of the true surface (mm).

    A point of the true surface counts as seen where at least one of the photos `names` was taken from a place
    with a free line of sight to it, less than 80 degrees off its normal (the fruit's bottom is not).
    """
    points, normals = even_points(truth)
    seen = seen_points(truth, [truth.places[n] for n in names], points, normals)
    away = signed_distance_mm(points, vertices, faces)
    return {
        "rms_seen_mm": float(np.sqrt(np.mean(away[seen] ** 2))),
        "p95_seen_mm": float(np.percentile(np.abs(away[seen]), 95)),
        "outward_seen_mm": float(-away[seen].mean()),
        "rms_all_mm": float(np.sqrt(np.mean(away**2))),
        "volume_error": volume_mm3(vertices, faces) / volume_mm3(truth.vertices, truth.faces) - 1,
    }


def even_points(truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over the true surface, and its normals there."""
    mesh = trimesh.Trimesh(truth.vertices, truth.faces, process=False)
    points, where = trimesh.sample.sample_surface(mesh, SAMPLES, seed=1)
    return np.asarray(points), np.asarray(mesh.face_normals)[where]


def seen_points(
    truth: Truth, places: list[np.ndarray], points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Which points have a free line of sight to a camera, not too flat."""
    scene = _scene(truth.vertices, truth.faces)
    seen = np.zeros(len(points), bool)
    for place in places:
        ray = place - points
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        facing = np.flatnonzero(np.sum(ray * normals, axis=1) > np.cos(np.radians(FLATTEST_DEG)))
        start = points[facing] + 1e-3 * normals[facing]
        rays = np.concatenate([start, ray[facing]], axis=1).astype(np.float32)
        hit = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        seen[facing[~np.isfinite(hit)]] = True
    return seen


def signed_distance_mm(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance to a mesh's surface, negative for points inside it."""
    tensor = o3d.core.Tensor(points.astype(np.float32))
    return np.asarray(_scene(vertices, faces).compute_signed_distance(tensor).numpy(), float)


def onto_truth(truth: Truth, placed: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices that lie about right, turned and shifted onto the true surface, point to plane."""
    target, normals = even_points(truth)
    tree = cKDTree(target)
    surface = trimesh.Trimesh(placed, faces, process=False)
    source, _ = trimesh.sample.sample_surface(surface, 6000, seed=1)
    source = np.asarray(source)
    for _ in range(60):
        away, nearest = tree.query(source)
        near = away < 3 * np.median(away)
        n, q, p = normals[nearest[near]], target[nearest[near]], source[near]
        middle = p.mean(0)
        A = np.concatenate([np.cross(p - middle, n), n], axis=1)
        step = np.linalg.lstsq(A, np.sum((q - p) * n, axis=1), rcond=None)[0]
        angle = float(np.linalg.norm(step[:3]))
        R = trimesh.transformations.rotation_matrix(angle, step[:3])[:3, :3] if angle > 0 else np.eye(3)
        source = (source - middle) @ R.T + middle + step[3:]
        placed = (placed - middle) @ R.T + middle + step[3:]
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(placed)


def _scene(vertices: np.ndarray, faces: np.ndarray) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    return scene
