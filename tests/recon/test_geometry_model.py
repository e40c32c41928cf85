"""The ONNX door: a network that knows the scene gives the scene's mesh; wrong ones are refused by name."""

from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, point_map, ring
from refusals import refused
from scipy.spatial.transform import Rotation
from tiny_onnx import write_constant_model

from recon.cameras.printed_mat import standard_mat
from recon.fruit_mesh import ReconOptions, reconstruct_with_model
from recon.learned.geometry_model import PointMaps, point_maps
from recon.point_route import fruit_points
from recon.recon_failure import ReconFailure, ReconProblem
from recon.triangle_mesh import open_edges, volume_mm3

EGG, CAMERAS = Egg(), ring(6)
ROWS, COLUMNS = 196, 266
OPEN = (1, "S", 3, "H", "W")
FIXED = (1, len(CAMERAS), 3, ROWS, COLUMNS)
TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()


@cache
def photos():
    return photographed(CAMERAS, egg=EGG, mat=standard_mat())


@cache
def scene_points():
    """What each cell sees, in a world turned, shifted and shrunk."""
    maps = np.stack([point_map(c, EGG, ROWS, COLUMNS) for c in CAMERAS])
    return (maps @ TURN.T) / 150 + [0.3, 0.1, 2.0]


def depth_mm(camera):
    """Of what each cell sees."""
    points = point_map(camera, EGG, ROWS, COLUMNS).reshape(-1, 3)
    return camera.into(points)[:, 2].reshape(ROWS, COLUMNS, 1)


def scene_poses():
    """pose_enc of the cameras in that world."""
    rows = []
    for camera in CAMERAS:
        turn = camera.cam_from_world[:3, :3] @ TURN.T
        shift = camera.cam_from_world[:3, 3] / 150 - turn @ [0.3, 0.1, 2.0]
        rows.append([*shift, *Rotation.from_matrix(turn).as_quat(), 0.5, 0.6])
    return np.array(rows)


def written(tmp_path, outputs, input_shape=FIXED):
    path = tmp_path / "model.onnx"
    write_constant_model(path, outputs, input_shape=input_shape)
    return path


@pytest.fixture
def knowing(tmp_path):
    points = scene_points()[None]
    return written(tmp_path, {"world_points": points, "world_points_conf": np.ones(points.shape[:4])})


def test_a_model_that_knows_the_scene_gives_its_mesh_on_the_mat(knowing):
    reconstruction = reconstruct_with_model(photos(), knowing, mat=standard_mat(), height_mm=None)
    assert open_edges(reconstruction.faces) == 0
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.02
    )
    assert (
        np.sqrt(np.mean(EGG.misses_mm(reconstruction.vertices)[reconstruction.vertices[:, 2] > 8] ** 2)) < 0.4
    )
    assert reconstruction.scale_sd < 0.01
    assert reconstruction.frame == "mat"


def test_height_gives_scale_without_a_mat(tmp_path):
    outputs = {"world_points": scene_points()[None], "pose_enc": scene_poses()[None]}
    reconstruction = reconstruct_with_model(
        photos(), written(tmp_path, outputs), mat=None, height_mm=2 * EGG.semi_mm[2]
    )
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.04
    )
    assert reconstruction.frame == "shape"


def test_without_a_mat_x_points_to_the_first_photo(tmp_path):
    """A long egg comes back turned about z by the first camera's azimuth, whatever the model's world."""
    egg = Egg(semi_mm=(34.0, 22.0, 24.0), x_mm=0.0, y_mm=0.0)
    maps = np.stack([point_map(c, egg, 98, 133) for c in CAMERAS])
    for first in (0, 2):
        order = np.roll(np.arange(len(CAMERAS)), -first)
        places = np.array([CAMERAS[i].place for i in order])
        world = PointMaps(
            (maps[order] @ TURN.T) / 150 + 0.5,
            np.ones(maps.shape[:3]),
            np.ones((len(CAMERAS), 2)),
            (places @ TURN.T) / 150 + 0.5,
        )
        points, _, _ = fruit_points(world, photos(), mat=None, height_mm=48.0)
        azimuth = np.arctan2(places[0, 1], places[0, 0])
        back = points @ Rotation.from_euler("z", azimuth).as_matrix().T
        assert np.ptp(back[:, 0]) / np.ptp(back[:, 1]) == pytest.approx(34 / 22, rel=0.03)


def test_points_alone_say_where_the_first_photo_was_taken(knowing):
    maps = point_maps(photos(), knowing)
    (place,) = maps.places
    true = CAMERAS[0].place @ TURN.T / 150 + [0.3, 0.1, 2.0]
    assert np.linalg.norm(place - true) * 150 < 0.02 * np.linalg.norm(CAMERAS[0].place)


def test_points_and_height_are_enough_for_a_mesh(knowing):
    reconstruction = reconstruct_with_model(photos(), knowing, mat=None, height_mm=2 * EGG.semi_mm[2])
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.04
    )


def test_the_whole_signature_of_vggt_gives_the_scenes_mesh(tmp_path):
    """All five outputs; where trust is low the points are wrong, and do no harm."""
    depth = np.stack([depth_mm(camera) / 150 for camera in CAMERAS])
    points, trust = scene_points().copy(), np.full(depth.shape[:3], 2.0)
    points[:, ::7] += 0.5
    trust[:, ::7] = 1.0
    outputs = {
        "depth": depth[None], "depth_conf": trust[None], "world_points": points[None],
        "world_points_conf": trust[None], "pose_enc": scene_poses()[None],
    }  # fmt: skip
    reconstruction = reconstruct_with_model(
        photos(), written(tmp_path, outputs), mat=standard_mat(), height_mm=None
    )
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.03
    )


def test_a_provider_that_the_machine_lacks_is_named_with_those_it_has(knowing):
    with pytest.raises(ReconFailure, match=r"run on Abacus, .*expected one of .*CPUExecutionProvider"):
        point_maps(photos(), knowing, providers=("Abacus",))
    assert point_maps(photos(), knowing, providers=("Abacus", "CPUExecutionProvider")).points.shape[0] == 6


def test_depth_with_poses_is_enough(tmp_path):
    depth, poses = [], []
    for camera in CAMERAS:
        depth.append(depth_mm(camera))
        wide, tall = (2 * np.arctan(n / 2 / camera.focal_px) for n in (camera.width_px, camera.height_px))
        turn = Rotation.from_matrix(camera.cam_from_world[:3, :3]).as_quat()
        poses.append([*camera.cam_from_world[:3, 3], *turn, tall, wide])
    outputs = {"depth": np.stack(depth)[None], "pose_enc": np.array(poses)[None]}
    maps = point_maps(photos(), written(tmp_path, outputs))
    known = np.stack([point_map(c, EGG, ROWS, COLUMNS) for c in CAMERAS])
    near = np.linalg.norm(known, axis=-1) < 150
    assert np.abs(maps.points - known)[near].max() < 0.05


@pytest.mark.parametrize(
    ("outputs", "input_shape", "words"),
    [
        ({"depth": np.ones((1, 6, 14, 14, 1))}, OPEN, 'has no output "pose_enc" beside its "depth"'),
        ({"pose_enc": np.ones((1, 6, 9))}, OPEN, 'has no output "depth" beside'),
        (
            {"normals": np.zeros((1, 6, 4, 4, 3))},
            OPEN,
            r'has no output "world_points" \(its outputs are normals\)',
        ),
        (
            {"world_points": np.full((*FIXED[:2], ROWS, COLUMNS, 3), np.nan)},
            FIXED,
            "gives 0 finite points; expected at least 200",
        ),
        (
            {"world_points": np.zeros((1, 6, 14, 14, 3))},
            FIXED,
            r'gives "world_points" of shape \(1, 6, 14, 14, 3\); expected',
        ),
        (
            {"world_points": np.ones((*FIXED[:2], ROWS, COLUMNS, 3)), "pose_enc": np.zeros((1, 6, 9))},
            FIXED,
            'gives a "pose_enc" without a turn',
        ),
    ],
    ids=["depth alone", "poses alone", "no points", "nothing finite", "misshapen", "no turn"],
)
def test_outputs_of_no_use_are_named(tmp_path, outputs, input_shape, words):
    path = written(tmp_path, outputs, input_shape=input_shape)
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, rf"model\.onnx {words}"):
        point_maps(photos(), path)


def test_a_broken_and_a_missing_file_are_named(tmp_path):
    path = tmp_path / "flat.onnx"
    path.write_bytes(b"nonsense")
    with pytest.raises(ReconFailure, match="is no ONNX model, or was cut short"):
        point_maps(photos(), path)
    with pytest.raises(ReconFailure, match="does not exist"):
        point_maps(photos(), tmp_path / "none.onnx")


def test_points_of_a_bare_ground_show_neither_the_first_photos_place_nor_a_fruit(tmp_path):
    bare = Egg(semi_mm=(1e-3, 1e-3, 1e-3))
    ground = np.stack([point_map(c, bare, ROWS, COLUMNS) for c in CAMERAS])
    path = written(tmp_path, {"world_points": ground[None]})
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, r'Use the mat .* or a model with "pose_enc"'):
        reconstruct_with_model(photos(), path, mat=None, height_mm=48.0)
    with refused(ReconProblem.NO_FRUIT):
        reconstruct_with_model(photos(), path, mat=standard_mat(), height_mm=None, options=ReconOptions())
