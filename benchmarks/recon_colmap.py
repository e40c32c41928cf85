"""What a user would try first: COLMAP's sparse points cropped to the fruit, Open3D's normals and Poisson."""

import tempfile
from pathlib import Path

import numpy as np
import open3d as o3d
import pycolmap

from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import moved, robust_similarity


def colmap_mesh(folder: Path, photos: list[Photo], mat: Mat) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Vertices (mm, the mat's frame), faces, photos registered and points on the fruit.

    Features, exhaustive matching and incremental mapping with COLMAP's defaults
    (one camera, one thread). The mat gives
    pose and scale (by the camera places), as generously as it can: the tag poses of `recon`. Points over
    the blank centre and more than a millimetre above the paper are the fruit's.
    """
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    pycolmap.set_random_seed(1)
    with tempfile.TemporaryDirectory() as scratch:
        database, pictures = Path(scratch) / "database.db", folder.resolve()
        names = [p.name for p in photos]
        extraction = pycolmap.FeatureExtractionOptions()
        matching = pycolmap.FeatureMatchingOptions()
        mapping = pycolmap.IncrementalPipelineOptions()
        extraction.num_threads = matching.num_threads = mapping.num_threads = 1
        extraction.use_gpu = matching.use_gpu = False
        pycolmap.extract_features(
            database, pictures, names, camera_mode=pycolmap.CameraMode.SINGLE,
            extraction_options=extraction, device=pycolmap.Device.cpu,
        )  # fmt: skip
        pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
        models = pycolmap.incremental_mapping(database, pictures, Path(scratch), options=mapping)
    if not models:
        raise ValueError("COLMAP found no model")
    model = max(models.values(), key=lambda m: m.num_reg_images())
    poses = cameras_from_mat(photos, mat)
    by_mat = {c.name: c.place for c in poses.cameras}
    by_motion = {i.name: i.projection_center() for i in model.images.values() if i.has_pose}
    both = sorted(by_mat.keys() & by_motion.keys())
    T, _ = robust_similarity(np.array([by_motion[n] for n in both]), np.array([by_mat[n] for n in both]))
    cloud = moved(np.array([p.xyz for p in model.points3D.values()]), T)
    low, high = poses.box
    fruit = cloud[np.all((cloud > low + np.array([0, 0, 1.0])) & (cloud < high), axis=1)]
    if len(fruit) < 30:
        raise ValueError(f"COLMAP found {len(fruit)} points on the fruit")
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(fruit))
    points, _ = points.remove_statistical_outlier(nb_neighbors=12, std_ratio=2.0)
    points.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(knn=16))
    points.orient_normals_towards_camera_location(np.median(fruit, axis=0))
    points.normals = o3d.utility.Vector3dVector(-np.asarray(points.normals))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(points, depth=8, n_threads=1)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles, int), len(by_motion), len(points.points)
