"""A whole recording with a known answer, on a scanned surface and a prior pit that are a little off.

The data and their source: tests/data/nectarine-grasp/SOURCE.md.
"""

from pathlib import Path

import numpy as np
import pytest

from fem.forward import UnitModulusSolid
from fem.mesh import tetrahedralise
from fem.modulus import estimate_modulus
from fem.modulus_budget import ErrorBudget
from pipeline.grasp import history, place_grasp
from recon.mesh_file import read_mesh

DATA = Path(__file__).parent.parent / "data" / "nectarine-grasp"
E_MPA, NU = 1.066393333897285, 0.45


@pytest.fixture(scope="module")
def found():
    outer, pit = read_mesh(DATA / "fruit.ply"), read_mesh(DATA / "pit.ply")
    grasp = place_grasp(DATA / "grasp.h5", *outer)
    touched = np.vstack(list(grasp.touched_mm.values()))
    mesh = tetrahedralise(
        *outer, *pit, edge_mm=7.0, refine_at_mm=touched, refine_radius_mm=1.0, refine_edge_mm=2.5
    )
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free")
    return estimate_modulus(history(grasp), solid, budget=ErrorBudget())


def test_within_two_percent_of_the_answer_from_one_grasp(found):
    assert found.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert found.energy.E_MPa == pytest.approx(E_MPA, rel=0.01)


def test_what_is_left_is_little_more_than_the_markers_noise(found):
    assert found.residual_rms_mm < 0.008
    assert found.warnings == ()


def test_the_error_bar_is_honest_and_small(found):
    assert 0.005 < found.E_sd_MPa / found.E_MPa < 0.02
    assert abs(found.E_MPa - E_MPA) < 2 * found.E_sd_MPa


def test_every_heavy_frame_agrees_through_load_hold_with_shear_and_unload(found):
    peak = max(frame.force_N for frame in found.frames)
    heavy = [frame for frame in found.frames if frame.pad == "all" and frame.force_N > 0.4 * peak]
    assert {frame.phase for frame in heavy} == {"load", "hold", "unload"}
    assert np.array([frame.E_MPa for frame in heavy]) == pytest.approx(E_MPA, rel=0.03)
