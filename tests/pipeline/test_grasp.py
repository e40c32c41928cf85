"""A whole recording with a known answer, and one placed by a simulated robot.

The data and their source: tests/data/nectarine-grasp/SOURCE.md.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mat_scene import ring
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from simulated_robot import BASE_FROM_MAT, FLANGE_FROM_CAMERA, noisy, pose
from small_batches import run, said_with

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.grasp_history import SMALLEST_SD_MM, SMALLEST_SHARE_OF_FORCE
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes
from pipeline.fruit.placed_grasp import Checked, grasp_record, history, place_grasp, refusal
from recon.cameras.camera import Camera
from recon.cameras.printed_mat import Mat, mat_mapping, standard_mat, tag_bits
from recon.surface.mesh_file import read_mesh
from tactile.consistency.finding import Finding, FindingKind
from tactile.readers.recording import read_recording, write_recording
from tactile.readers.robot_file import Robot, read_robot
from tactile.tactile_failure import TactileFailure

DATA = Path(__file__).parent.parent / "data" / "nectarine-grasp"
E_MPA, NU = 1.066393333897285, 0.45


@pytest.fixture(scope="module")
def graded():
    outer, pit = read_mesh(DATA / "fruit.ply"), read_mesh(DATA / "pit.ply")
    grasp = place_grasp(DATA / "grasp.h5", *outer)
    touched = np.vstack(list(grasp.touched_mm.values()))
    mesh = tetrahedralise(
        *outer, *pit, edge_mm=7.0, refine_at_mm=touched, refine_radius_mm=1.0, refine_edge_mm=2.5
    )
    pressed = history(grasp)
    solid = UnitModulusSolid.factorise(
        mesh, poisson_ratio=NU, support="free", contact_nodes=contact_nodes(mesh, [pressed])
    )
    return grasp, estimate_modulus(pressed, grasp_model(pressed, solid), budget=ErrorBudget())


def test_a_recording_without_poses_is_refused(tmp_path):
    recording = read_recording(DATA / "grasp.h5")
    nowhere = [replace(pad, pose=np.broadcast_to(np.eye(4), pad.pose.shape).copy()) for pad in recording.pads]
    write_recording(tmp_path / "grasp.h5", replace(recording, pads=tuple(nowhere)))
    with pytest.raises(TactileFailure, match="pads/left/pose: found no pose"):
        place_grasp(tmp_path / "grasp.h5", *read_mesh(DATA / "fruit.ply"))


def test_a_bent_force_reading_is_refused_by_grading_and_taken_to_be_explained(tmp_path):
    """f (1 - 0.45 |f| / M), M the largest: above half the peak force grows 0.47 times as fast as below."""
    recording = read_recording(DATA / "grasp.h5")
    pads = []
    for pad in recording.pads:
        size = np.linalg.norm(pad.force_N, axis=2, keepdims=True)
        pads.append(replace(pad, force_N=pad.force_N * (1 - 0.45 * size / size.max())))
    write_recording(tmp_path / "grasp.h5", replace(recording, pads=tuple(pads)))
    outer = read_mesh(DATA / "fruit.ply")
    with pytest.raises(TactileFailure, match=r"is nonlinear \(run drupe explain"):
        place_grasp(tmp_path / "grasp.h5", *outer, checked=Checked())
    placed = place_grasp(tmp_path / "grasp.h5", *outer, checked=Checked(explains=True))
    (finding,) = placed.findings
    assert FindingKind.SATURATION in {finding.kind, *finding.also}
    assert not any(finding.refused for finding in placed.findings)


def test_the_meshs_error_reaches_each_pad_from_the_skin_that_it_touches_alone():
    vertices, faces = read_mesh(DATA / "fruit.ply")
    plain = place_grasp(DATA / "grasp.h5", vertices, faces)
    assert all(pad.surface_sd_mm is None for pad in history(plain).pads)
    middle = {name: points.mean(axis=0) for name, points in plain.touched_mm.items()}
    (touched, at), (other, beyond) = middle.items()
    nearer = np.linalg.norm(vertices - at, axis=1) < np.linalg.norm(vertices - beyond, axis=1)
    known = place_grasp(DATA / "grasp.h5", vertices, faces, sd_mm=np.where(nearer, 0.3, 0.05))
    assert known.surface_sd_mm == pytest.approx({touched: 0.3, other: 0.05})
    pads = {pad.name: pad.surface_sd_mm for pad in history(known).pads}
    assert pads == pytest.approx({touched: 0.3, other: 0.05})


def test_a_recording_without_noise_counts_as_one_of_a_fine_sensor(graded):
    grasp, _ = graded
    silent = tuple(
        replace(
            pad,
            displacement_noise=replace(pad.displacement_noise, sd=0.0),
            force_noise=replace(pad.force_noise, sd=0.0),
        )
        for pad in grasp.contact.pads
    )
    for pad in history(replace(grasp, contact=replace(grasp.contact, pads=silent))).pads:
        assert pad.displacement_sd_mm == SMALLEST_SD_MM
        assert pad.force_sd_N == pytest.approx(SMALLEST_SHARE_OF_FORCE * np.abs(pad.force_N).max(), rel=0.01)


@pytest.fixture(scope="module")
def estimate(graded):
    return graded[1]


@pytest.mark.slow
def test_within_two_percent_of_the_answer_from_one_grasp(estimate):
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert estimate.energy.E_MPa == pytest.approx(E_MPA, rel=0.01)


def test_what_is_left_is_little_more_than_the_markers_noise(estimate):
    assert estimate.residual_rms_mm < 0.008
    assert estimate.warnings == ()


def test_the_error_bar_is_honest_and_small(estimate):
    assert 0.005 < estimate.E_sd_MPa / estimate.E_MPa < 0.02
    assert abs(estimate.E_MPa - E_MPA) < 2 * estimate.E_sd_MPa


def test_every_heavy_frame_agrees_through_load_hold_with_shear_and_unload(estimate):
    peak = max(frame.force_N for frame in estimate.frames)
    heavy = [frame for frame in estimate.frames if frame.pad == "all" and frame.force_N > 0.4 * peak]
    assert {frame.phase for frame in heavy} == {"load", "hold", "unload"}
    assert np.array([frame.E_MPa for frame in heavy]) == pytest.approx(E_MPA, rel=0.03)


def test_the_record_says_what_was_found_in_the_units_it_names(graded):
    grasp, estimate = graded
    record = grasp_record(grasp, estimate)
    assert record.failure is None
    assert (record.E_MPa, record.E_sd_MPa) == (estimate.E_MPa, estimate.E_sd_MPa)
    assert np.linalg.norm(list(record.parts_sd_MPa.values())) == pytest.approx(estimate.E_sd_MPa)
    assert record.residual_um == pytest.approx(1e3 * estimate.residual_rms_mm)
    assert record.frames_used == estimate.loaded.sum()
    assert record.peak_force_N == pytest.approx(max(f.force_N for f in estimate.frames), rel=0.1)
    assert set(record.contact_mm) == {pad.name for pad in grasp.pads}
    assert type(record).model_validate_json(record.model_dump_json()) == record


def test_a_refusal_names_the_corrections_that_were_made_before():
    finding = Finding(kind=FindingKind.SCALE, says="forces are 9.8 times too large", refused=True)
    assert refusal([finding], corrected_for=0) == "forces are 9.8 times too large"
    assert "[[mismatch]] in batch.toml" in refusal([finding], corrected_for=1)
    assert refusal([replace(finding, refused=False)], corrected_for=1) == ""


FLANGE_FROM_PAD = {"left": pose(0, -30, 150, 0, 0, 0), "right": pose(0, 30, 150, 180, 0, 0)}
"""At 60 mm, the pads' z towards each other along the flange's y."""
FLANGE_FROM_PAD["left"][:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
FLANGE_FROM_PAD["right"][:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def quaternion_row(flange: np.ndarray) -> str:
    return ",".join(f"{x:.6f}" for x in (*flange[:3, 3], *Rotation.from_matrix(flange[:3, :3]).as_quat()))


HEADER = "x_mm,y_mm,z_mm,qx,qy,qz,qw"


def write_gripper_and_mat(folder: Path) -> None:
    pads = "".join(f"[pads.{name}]\npose = {at.tolist()}\n" for name, at in FLANGE_FROM_PAD.items())
    (folder / "gripper.toml").write_text(f"pose_aperture_mm = 60.0\npose_sd_mm = 0.1\n{pads}")
    (folder / "mat.json").write_text(json.dumps(mat_mapping(standard_mat())))


def photo_of(mat: Mat, camera: Camera) -> np.ndarray:
    """The printed page through a pinhole, four times as fine before it is averaged."""
    page = np.full((4 * 200, 4 * 200), 225, np.uint8)
    for tag, corners in mat.corners_mm.items():
        left, top = (4 * (corners[0, :2] * [1, -1] + 100)).astype(int)
        side = int(4 * mat.tag_mm)
        bits = tag_bits(mat.dictionary, tag).astype(np.uint8) * 190 + 35
        page[top : top + side, left : left + side] = cv2.resize(bits, (side, side), interpolation=0)
    mm_from_page = np.array([[0.25, 0, 0.125 - 100], [0, -0.25, 100 - 0.125], [0, 0, 1]])
    finer = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1]])
    through = finer @ camera.intrinsics @ camera.cam_from_world[:3][:, [0, 1, 3]] @ mm_from_page
    size = 4 * camera.width_px, 4 * camera.height_px
    large = cv2.warpPerspective(page, through, size, flags=cv2.INTER_LINEAR, borderValue=90)
    return cv2.resize(large, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with twelve photos, the table of their flange poses, gripper and mat."""
    folder, rng = tmp_path_factory.mktemp("robot"), np.random.default_rng(4)
    rows = [f"photo,{HEADER}"]
    for camera in ring(12, width=800, height=600):
        cv2.imwrite(str(folder / camera.name), photo_of(standard_mat(), camera))
        flange = BASE_FROM_MAT @ np.linalg.inv(camera.cam_from_world) @ np.linalg.inv(FLANGE_FROM_CAMERA)
        rows.append(f"{camera.name},{quaternion_row(noisy(flange, rng))}")
    (folder / "poses.csv").write_text("\n".join(rows))
    write_gripper_and_mat(folder)
    return folder


def calibrated(folder: Path, out: Path, *more: str) -> tuple[int, str]:
    files = "--gripper", folder / "gripper.toml", "--mat", folder / "mat.json"
    return run("robot", folder / "poses.csv", out, *files, *more)


def distance(robot: Robot) -> float:
    """Squared error of the mat's place in standard deviations."""
    error = np.linalg.inv(robot.base_from_mat) @ BASE_FROM_MAT
    motion = np.r_[Rotation.from_matrix(error[:3, :3]).as_rotvec(), error[:3, 3]]
    return float(motion @ np.linalg.solve(robot.covariance, motion))


def test_photos_then_a_grasp_give_pads_within_their_stated_error(photos: Path, tmp_path: Path) -> None:
    code, words = calibrated(photos, tmp_path / "robot.toml")
    assert code == 0, words
    assert "drupe grade includes it in E's error bar" in words
    assert distance(read_robot(tmp_path / "robot.toml")) < chi2.ppf(0.999, 6)
    write_recording_without_poses(tmp_path / "grasp.h5")
    flange = pose(3.0, -2.0, 190.0, 180.0, 0.0, 20.0)
    reported = noisy(BASE_FROM_MAT @ flange, np.random.default_rng(9))
    (tmp_path / "flange.csv").write_text(f"{HEADER}\n{quaternion_row(reported)}\n")
    options = "--robot", tmp_path / "robot.toml", "--flange", tmp_path / "flange.csv"
    code, words = run("convert", tmp_path / "grasp.h5", tmp_path / "placed.h5", *options)
    assert (tmp_path / "placed.h5").is_file(), words
    stated = [
        float(sd) for sd in re.findall(r"standard deviation of its place, per axis: ([\d.]+) mm", words)
    ]
    made = read_recording(tmp_path / "placed.h5")
    assert made.pose_frame == "mat"
    assert made.pose_sd_mm == pytest.approx(max(stated), rel=0.05)
    for pad, sd in zip(made.pads, stated, strict=True):
        truth = FLANGE_FROM_PAD[pad.name].copy()
        truth[:3, 3] += 0.5 * (60.0 - made.aperture_mm[0]) * truth[:3, 2]
        off = pad.pose[0, :3, 3] - (flange @ truth)[:3, 3]
        assert np.sum(off**2) / sd**2 < chi2.ppf(0.999, 3)
        assert sd < 0.4


def write_recording_without_poses(path: Path) -> None:
    recording = read_recording(DATA / "grasp.h5")
    still = [replace(pad, pose=np.broadcast_to(np.eye(4), pad.pose.shape).copy()) for pad in recording.pads]
    write_recording(path, replace(recording, pads=tuple(still)))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (f"photo,{HEADER}\n../a.png,500,0,300,0,0,0,1", "without a path"),
        (f"photo,{HEADER}\na.png,500,0,300,0,0,0,1\na.png,510,0,300,0,0,0,1", '"a.png" twice'),
        (f"photo,{HEADER}\nb.png,500,0,300,0,0,0,1", "b.png"),
        (f"{HEADER}\n500,0,300,0,0,0,1", "found no photos"),
    ],
)
def test_a_table_that_names_no_photo_is_refused(table: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text(table)
    write_gripper_and_mat(tmp_path)
    code, said = calibrated(tmp_path, tmp_path / "robot.toml")
    assert code == 3
    assert words in said
    assert not (tmp_path / "robot.toml").exists()


def test_a_strangers_file_is_never_overwritten(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("mine")
    code, said = calibrated(photos, tmp_path / "robot.toml")
    assert code != 0
    assert "is not a robot that drupe robot wrote" in said
    assert (tmp_path / "robot.toml").read_text() == "mine"
    assert "is read by this command" in calibrated(photos, photos / "gripper.toml")[1]


def test_robot_and_flange_belong_together(tmp_path: Path) -> None:
    said = said_with(2, "convert", DATA / "grasp.h5", tmp_path / "out.h5", "--robot", tmp_path / "robot.toml")
    assert "give both or none" in said


def test_poses_on_the_mat_are_shifted_to_the_fruit_that_stands_there(tmp_path: Path) -> None:
    """Grading places the pads where it places those of the same recording in the fruit frame."""
    recording, outer = read_recording(DATA / "grasp.h5"), read_mesh(DATA / "fruit.ply")
    mat_from_fruit = pose(4.0, -7.0, 0.3)
    pads = tuple(replace(pad, pose=mat_from_fruit @ pad.pose) for pad in recording.pads)
    at, force = np.array([1.0, 2.0, 30.0]), np.array([3.0, -1.0, 2.0])  # in the fruit frame
    wrench = np.r_[force, np.cross(at + mat_from_fruit[:3, 3], force)]
    wrenches = np.tile(wrench, (len(recording.time_s), 1))
    on_mat = replace(recording, pads=pads, pose_frame="mat", pose_sd_mm=0.2, wrench_N=wrenches)
    write_recording(tmp_path / "grasp.h5", on_mat)
    plain = place_grasp(DATA / "grasp.h5", *outer)
    placed = place_grasp(tmp_path / "grasp.h5", *outer, mat_from_fruit=mat_from_fruit)
    for truth, pad in zip(plain.pads, placed.pads, strict=True):
        np.testing.assert_allclose(pad.surface_mm, truth.surface_mm, atol=1e-9)
    np.testing.assert_allclose(placed.recording.wrench_N[0], np.r_[force, np.cross(at, force)], atol=1e-9)
    assert placed.recording.pose_sd_mm == 0.2
    with pytest.raises(TactileFailure, match=r"Put its mat\.json beside"):
        place_grasp(tmp_path / "grasp.h5", *outer)
