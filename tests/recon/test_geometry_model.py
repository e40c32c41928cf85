"""The ONNX door: a network that knows the scene gives the scene's mesh; wrong ones are refused by name."""

from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, point_map, ring
from refusals import refused
from scipy.spatial.transform import Rotation
from tiny_onnx import write_constant_model, write_large_model

from recon.cameras.printed_mat import standard_mat
from recon.fruit_mesh import reconstruct_with_model
from recon.learned.geometry_model import point_maps
from recon.learned.onnx_session import opened, ran
from recon.recon_failure import ReconProblem
from recon.triangle_mesh import open_edges, volume_mm3

EGG, CAMERAS = Egg(), ring(6)
ROWS, COLUMNS = 196, 266
OPEN = (1, "S", 3, "H", "W")
FIXED = (1, len(CAMERAS), 3, ROWS, COLUMNS)
TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()


@cache
def photos():
    return photographed(CAMERAS, egg=EGG, mat=standard_mat())


def points_of(egg):
    """What each cell sees, in a world turned, shifted and shrunk."""
    maps = np.stack([point_map(c, egg, ROWS, COLUMNS) for c in CAMERAS])
    return ((maps @ TURN.T) / 150 + [0.3, 0.1, 2.0])[None]


def written(tmp_path, outputs, input_shape=FIXED):
    path = tmp_path / "model.onnx"
    write_constant_model(path, outputs, input_shape=input_shape)
    return path


@pytest.mark.parametrize(("wrong", "within"), [(0.0, 0.02), (0.5, 0.03)], ids=["right", "some distrusted"])
def test_a_model_that_knows_the_scene_gives_its_mesh_on_the_mat(tmp_path, wrong, within):
    """Where trust is low the points are wrong, and do no harm."""
    points = points_of(EGG)
    trust = np.full(points.shape[:4], 2.0)
    points[:, :, ::7] += wrong
    trust[:, :, ::7] -= wrong
    path = written(tmp_path, {"world_points": points, "world_points_conf": trust})
    reconstruction = reconstruct_with_model(photos(), path, mat=standard_mat(), height_mm=None)
    vertices, faces = reconstruction.vertices, reconstruction.faces
    assert open_edges(faces) == 0
    assert volume_mm3(vertices, faces) == pytest.approx(EGG.volume_mm3, rel=within)
    assert wrong or np.sqrt(np.mean(EGG.misses_mm(vertices)[vertices[:, 2] > 8] ** 2)) < 0.4
    assert reconstruction.scale_sd < 0.01
    assert reconstruction.frame == "mat"


def test_points_without_a_mat_are_refused(tmp_path):
    path = written(tmp_path, {"world_points": points_of(EGG)})
    with refused(ReconProblem.NO_SCALE, "A geometry model needs the marker mat"):
        reconstruct_with_model(photos(), path, mat=None, height_mm=48.0)


@pytest.mark.parametrize(
    ("outputs", "input_shape", "words"),
    [
        ({"normals": np.zeros((1, 6, 4, 4, 3))}, OPEN, r'has no output "world_points" \(its .* normals\)'),
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
    ],
    ids=["no points", "nothing finite", "misshapen"],
)
def test_outputs_of_no_use_are_named(tmp_path, outputs, input_shape, words):
    path = written(tmp_path, outputs, input_shape=input_shape)
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, rf"model\.onnx {words}"):
        point_maps(photos(), path)


def test_a_bare_ground_shows_no_fruit(tmp_path):
    path = written(tmp_path, {"world_points": points_of(Egg(semi_mm=(1e-3, 1e-3, 1e-3)))})
    with refused(ReconProblem.NO_FRUIT, "lie above the ground"):
        reconstruct_with_model(photos(), path, mat=standard_mat(), height_mm=None)


def test_a_provider_that_does_not_start_leaves_the_model_to_the_next_one(tmp_path, monkeypatch):
    path, tried = tmp_path / "model.onnx", []
    write_large_model(path, 10)
    module = "recon.learned.onnx_session.onnxruntime"

    def session(*_, providers, **__):
        tried.append(providers)
        if providers[0] == "CUDAExecutionProvider":
            raise RuntimeError("no graphics processor")
        return "started"

    both = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(f"{module}.get_available_providers", lambda: both)
    monkeypatch.setattr(f"{module}.InferenceSession", session)
    assert opened(path, both) == "started"
    assert tried == [both, both[1:]]


def test_a_run_is_limited_to_a_share_of_the_free_memory(tmp_path, monkeypatch):
    """A control group (a container, a job) has less free memory than its machine."""
    path, images = tmp_path / "model.onnx", np.zeros((1, 3, 192, 192), np.float32)
    write_large_model(path, 20000)  # a matrix of 1.6 GB, more than earlier tests leave in the heap
    monkeypatch.setattr("recon.learned.onnx_session.free_memory_MiB", lambda: 100.0)
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, "failed while it ran"):
        ran(path, opened(path, ["CPUExecutionProvider"]), ["fruit_log_odds"], images, signature="")
    write_large_model(path, 6000)  # 144 MB
    monkeypatch.setattr("recon.learned.onnx_session.free_memory_MiB", lambda: 1000.0)
    ran(path, opened(path, ["CPUExecutionProvider"]), ["fruit_log_odds"], images, signature="")
