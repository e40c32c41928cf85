"""Networks by ONNX: windows, a scene that is known, and files that are refused by name."""

import os
import resource
from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, point_map, ring
from refusals import refused
from scipy.spatial.transform import Rotation
from tiny_onnx import write_constant_model, write_external_model, write_large_model

from pipeline.batch.cache import stage_key
from recon.cameras.printed_mat import standard_mat
from recon.fruit_mesh import reconstruct_with_model
from recon.learned.fruit_model import AT_ONCE, SHIPPED, SIDE_PX, FruitModel, fruit_model, is_fruit_model
from recon.learned.geometry_model import point_maps
from recon.learned.onnx_file import model_files
from recon.learned.onnx_session import opened, ran
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.mask import Window
from recon.triangle_mesh import open_edges, volume_mm3

PICTURE = np.zeros((192, 192, 3), np.uint8)


@pytest.fixture
def folder(tmp_path):
    """A batch's folder, with what lies beside it."""
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    inside = tmp_path / "batch"
    (inside / "weights").mkdir(parents=True)
    (inside / "weights" / "far.bin").write_bytes(np.full(4, 2.5, np.float32).tobytes())
    (inside / "link.bin").symlink_to("../secret.bin")
    (inside / "linked").symlink_to("..")
    os.mkfifo(inside / "pipe.bin")
    return inside


@pytest.mark.parametrize(
    ("location", "why"),
    [
        ("../secret.bin", "is not in the folder of the model"),
        ("weights/../../secret.bin", "is not in the folder of the model"),
        ("/etc/passwd", "is not in the folder of the model"),
        ("", "is not in the folder of the model"),
        ("link.bin", "is a link"),
        ("linked/secret.bin", "is a link"),
        ("pipe.bin", "is a named pipe, not a file"),
        ("weights", "is a folder, not a file"),
        ("gone.bin", "does not exist"),
    ],
)
def test_numbers_are_read_from_plain_files_in_the_models_folder_alone(folder, location, why):
    path = folder / "model.onnx"
    write_external_model(path, location)
    with pytest.raises(
        ReconFailure, match=rf'model\.onnx keeps numbers in "{location}", which {why}; expected'
    ):
        fruit_model(path)
    assert model_files(path) == (path,)


def test_numbers_beside_the_model_are_read_and_are_part_of_the_key(folder):
    path, far = folder / "model.onnx", folder / "weights" / "far.bin"
    write_external_model(path, "weights/far.bin")
    assert model_files(path) == (path, far)

    def key():
        return stage_key("mesh", files=model_files(path), settings=None, rooms=("recon",))

    assert (
        fruit_model(path).session.run(None, {"images": np.zeros((1, 3, 192, 192), np.float32)})[0].max()
        == 2.5
    )
    before = key()
    far.write_bytes(np.full(4, 3.5, np.float32).tobytes())
    assert key() != before


@pytest.mark.parametrize("side", [40_000, 300_000])
def test_a_small_model_that_asks_for_much_memory_is_refused(tmp_path, side):
    """6.4 and 360 GB."""
    path = tmp_path / "large.onnx"
    write_large_model(path, side)
    assert path.stat().st_size < 1000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(
        ReconFailure, match=r"large\.onnx (is damaged, .*takes more than|failed while it ran)"
    ):
        fruit_model(path).log_odds([PICTURE], [Window(PICTURE, (0, 0), 1)])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2_500_000


class RednessInCells:
    """Stands in for a session: every 2 x 2 pixels' mean of red, less a half."""

    def run(self, names, feeds):
        red = feeds["images"][:, :1]
        n, _, rows, columns = red.shape
        return [red.reshape(n, 1, rows // 2, 2, columns // 2, 2).mean((3, 5)) - 0.5]


@pytest.mark.parametrize(
    ("corner", "size", "shrink"),
    [((150, 90), (120, 100), 2), ((0, 0), (150, 160), 2), ((300, 100), (300, 400), 1)],
)
def test_odds_lie_where_the_window_has_what_they_speak_of(corner, size, shrink):
    """A red disc of known place: the odds' zero lies on its rim, to half a cell of the model."""
    y, x = np.mgrid[:520, :640]
    image = np.zeros((520, 640, 3), np.uint8)
    centre, radius = np.array([250.3, 180.6]), 70.0
    image[np.hypot(x - centre[0], y - centre[1]) < radius, 2] = 255
    rows, columns = (
        slice(first, first + shrink * n) for first, n in zip(corner[::-1], size[::-1], strict=True)
    )
    window = Window(image[rows, columns], corner, shrink)
    log_odds = FruitModel(SHIPPED, RednessInCells()).log_odds([image], [window])[0]
    assert log_odds.shape == size[::-1]
    row, column = np.nonzero(log_odds > 0)
    pixels = np.stack([column, row], 1) * shrink + np.array(corner) + (shrink - 1) / 2
    away = np.linalg.norm(pixels - centre, axis=1)
    cell = max(size) * shrink / (SIDE_PX / 2)
    inside = (x >= corner[0]) & (y >= corner[1])
    inside &= (x < corner[0] + size[0] * shrink) & (y < corner[1] + size[1] * shrink)
    true = inside & (np.hypot(x - centre[0], y - centre[1]) < radius)
    assert away.max() < radius + cell
    assert len(pixels) * shrink**2 == pytest.approx(true.sum(), rel=0.03)
    assert pixels.mean(0) == pytest.approx([x[true].mean(), y[true].mean()], abs=0.5 * cell)


def test_the_shipped_model_finds_an_egg_it_never_saw():
    egg, cameras = Egg(), ring(6)
    photos = photographed(cameras, egg=egg, mat=standard_mat())
    corners = [np.rint(camera.project(egg.centre[None])[0]).astype(int) - 70 for camera in cameras]
    blank = np.empty((140, 140, 0), np.uint8)
    windows = [Window(blank, tuple(corner.tolist()), 1) for corner in corners]
    predicted_log_odds = fruit_model().log_odds([p.image for p in photos], windows)
    overlaps = []
    for camera, corner, log_odds in zip(cameras, corners, predicted_log_odds, strict=True):
        rows, columns = np.mgrid[:140, :140]
        pixels = np.stack([columns + corner[0], rows + corner[1]], -1).reshape(-1, 2)
        true = egg.covers(camera, pixels).reshape(140, 140)
        overlaps.append((true & (log_odds > 0)).sum() / (true | (log_odds > 0)).sum())
    assert np.mean(overlaps) > 0.9, overlaps


def test_another_kind_of_model_is_told_by_its_outputs(tmp_path):
    path = tmp_path / "points.onnx"
    shape = (1, 4, 3, 14, 14)
    write_constant_model(path, {"world_points": np.zeros((1, 4, 14, 14, 3))}, input_shape=shape)
    assert not is_fruit_model(path)
    assert is_fruit_model(SHIPPED)


def test_a_damaged_model_prints_nothing(tmp_path, capfd):
    """onnxruntime would print words of its own and load the file a second time."""
    path = tmp_path / "model.onnx"
    write_constant_model(path, {"fruit_log_odds": np.zeros((1, 1, 2, 2))}, input_shape=("n", 3, 192, 192))
    path.write_bytes(path.read_bytes().replace(b"ReduceMean", b"ReduceM\xf3an"))
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, "is damaged"):
        fruit_model(path)
    assert capfd.readouterr() == ("", "")


def test_a_fruit_model_of_another_shape_is_refused_with_file_found_and_expected(tmp_path):
    path = tmp_path / "small.onnx"
    write_constant_model(path, {"fruit_log_odds": np.zeros((1, 1, 32, 32))}, input_shape=("n", 3, 64, 64))
    with refused(ReconProblem.BAD_GEOMETRY_MODEL, r"small\.onnx takes .*64.*expected .*\(n, 3, 192, 192\)"):
        fruit_model(path)


def test_a_fruit_model_of_the_users_own_is_asked_in_the_shipped_ones_place(tmp_path):
    """One that sees fruit nowhere outvotes the ground's colours: no fruit that fits the photos is found."""
    path = tmp_path / "blind.onnx"
    nowhere = np.full((AT_ONCE, 1, 96, 96), -50.0)
    write_constant_model(path, {"fruit_log_odds": nowhere}, input_shape=("n", 3, SIDE_PX, SIDE_PX))
    photos = photographed(ring(2 * AT_ONCE), egg=Egg(), mat=standard_mat())
    with pytest.raises(ReconFailure) as raised:
        reconstruct_with_model(photos, path, mat=standard_mat(), height_mm=None)
    assert raised.value.problem in (
        ReconProblem.NO_FRUIT,
        ReconProblem.FRUIT_CUT_OFF,
        ReconProblem.SURFACE_CONTRADICTED,
    )


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
