"""A whole recording with a known answer, on a scanned surface and a prior pit that are a little off.

The data and their source: tests/data/nectarine-grasp/SOURCE.md.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes
from pipeline.fruit.placed_grasp import Checked, grasp_record, history, place_grasp, refusal
from recon.surface.mesh_file import read_mesh
from tactile.consistency.finding import Finding, FindingKind
from tactile.readers.recording import read_recording, write_recording
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
