"""A grasp of Neo-Hookean flesh, made on one mesh, has its modulus found again on another, coarser one."""

from dataclasses import dataclass

import numpy as np
import pytest
from fem_shapes import ball
from hookes_law import Linear

from fem.estimation.compliance_fit import MarkerTracks, fit_compliance
from fem.estimation.finite_strain_correction import (
    MarkerContact,
    _repeated,
    finite_modulus,
    finite_strain_correction,
)
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory
from fem.materials.neo_hookean import NeoHookean
from fem.mesh.flesh_mesh import tetrahedralise
from fem.mesh.surface_points import locate, skin_quadrature
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

NU, E_MPA = 0.45, 0.3
RADIUS_MM, CORE_MM = 25.0, 10.0
PATCH_MM = np.array([3.5, 4.5, 5.5, 6.5, 7.0, 5.0])
AXIS = np.arange(-8.0, 8.5)
MARKERS = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)


def traction_MPa(points_mm: np.ndarray, patch_mm: float) -> np.ndarray:
    """Two pads that press from above and below with up to 7 N, and drag a little."""
    r2 = (points_mm[:, :2] ** 2).sum(axis=1) / patch_mm**2
    pressure = E_MPA * patch_mm / RADIUS_MM * np.maximum(1 - r2, 0) * np.sign(points_mm[:, 2])
    return -pressure[:, None] * [0.1, 0.05, 1.0]


def solid(edge_mm: float, history: GraspHistory | None = None) -> UnitModulusSolid:
    mesh = tetrahedralise(
        *ball(6000, semi_axes_mm=3 * (RADIUS_MM,)),
        *ball(3000, semi_axes_mm=3 * (CORE_MM,)),
        edge_mm=5.0,
        refine_at_mm=np.array([[0, 0, RADIUS_MM], [0, 0, -RADIUS_MM]]),
        refine_radius_mm=7.0,
        refine_edge_mm=edge_mm,
    )
    nodes = contact_nodes(mesh, [history]) if history is not None else None
    return UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free", contact_nodes=nodes)


def recorded() -> GraspHistory:
    """What markers on the pads see of the true fruit."""
    truth = solid(1.9)
    points, area = skin_quadrature(truth.mesh)
    spread = [traction_MPa(points.point_mm, a) * area[:, None] for a in PATCH_MM]
    loads = points.point_load(np.stack(spread))
    finite = FiniteStrainSolid(solid=truth, law=NeoHookean(poisson_ratio=NU))
    moved_mm = finite.displacement(loads / E_MPA, tolerance=1e-5).require_equilibrium().displacement
    touching = np.linalg.norm(MARKERS, axis=1) < PATCH_MM[:, None]
    pads = []
    for name, side in (("left", 1.0), ("right", -1.0)):
        height = np.sqrt(RADIUS_MM**2 - (MARKERS**2).sum(axis=1))
        place = np.column_stack([MARKERS, side * height])
        cell_mm2 = RADIUS_MM / height
        seen = place + locate(truth.mesh, place).sample(moved_mm)
        pads.append(
            PadHistory(
                name=name,
                rest_mm=np.column_stack([MARKERS, np.zeros(len(place))]),
                surface_mm=place,
                position_mm=seen,
                gel_displacement_mm=np.zeros_like(seen),
                force_N=np.stack([traction_MPa(place, a) * cell_mm2[:, None] for a in PATCH_MM]),
                episode=np.where(touching, 0, -1),
                displacement_sd_mm=0.004,
                force_sd_N=1e-4,
                lag1=0.0,
            )
        )
    phase = ("load",) * 5 + ("unload",)
    return GraspHistory(time_s=np.arange(len(PATCH_MM)) * 0.1, phase=phase, pads=tuple(pads))


@dataclass
class Grasp:
    """The recording on the estimator's mesh, and the answers that several tests look at."""

    contact: MarkerContact
    finite: FiniteStrainSolid
    force_N: np.ndarray
    unit: np.ndarray
    tracks: MarkerTracks

    def refit(self, unit_displacement):
        tracks = MarkerTracks(**{**vars(self.tracks), "unit_displacement": unit_displacement})
        return fit_compliance(tracks, scale_sd=0.004, fruit_moves=True).compliance


@pytest.fixture(scope="module")
def grasp():
    history = recorded()
    coarse = solid(2.2, history)
    contact = MarkerContact.of(history, coarse)
    force = np.concatenate([pad.force_N for pad in history.pads], axis=1)
    unit = contact.at_markers(coarse.displacement(contact.nodal_force(force)))
    position = np.concatenate([pad.position_mm for pad in history.pads], axis=1)
    tracks = MarkerTracks(
        place_mm=np.vstack([link.place.point_mm for link in contact.links]),
        normal=np.vstack([link.place.normal for link in contact.links]),
        position_mm=position,
        unit_displacement=unit,
        gel_displacement_mm=np.zeros_like(position),
        episode=np.concatenate([pad.episode for pad in history.pads], axis=1),
        sd_mm=np.full(position.shape[1], 0.004),
        lag1=np.zeros(position.shape[1]),
    )
    law = NeoHookean(poisson_ratio=NU)
    return Grasp(contact, FiniteStrainSolid(solid=coarse, law=law), force, unit, tracks)


@pytest.fixture(scope="module")
def found(grasp):
    linear_MPa = 1 / grasp.refit(grasp.unit)
    modulus_MPa, correction = finite_modulus(
        grasp.finite, grasp.contact, grasp.force_N, grasp.unit, modulus_MPa=linear_MPa, refit=grasp.refit
    )
    return linear_MPa, modulus_MPa, correction


@pytest.mark.slow
def test_large_deformation_is_taken_out_of_the_modulus(found):
    linear_MPa, modulus_MPa, correction = found
    assert abs(linear_MPa / E_MPA - 1) > 0.008
    assert modulus_MPa == pytest.approx(E_MPA, rel=0.003)
    assert correction.modulus_MPa == pytest.approx(modulus_MPa, rel=0.01)


@pytest.mark.slow
def test_a_refit_that_does_not_settle_is_refused(grasp, found):
    _, modulus_MPa, correction = found
    guesses = iter(np.tile([1.0, 2.0], 100))
    with pytest.raises(FemFailure, match="still changes") as failure:
        _repeated(correction, grasp.unit, lambda _: float(next(guesses)) / modulus_MPa)
    assert failure.value.problem is FemProblem.NOT_CONVERGED


@pytest.mark.slow
def test_few_frames_are_computed_and_predict_the_others(grasp, found):
    _, modulus_MPa, correction = found
    assert len(correction.computed) < len(PATCH_MM)
    assert correction.unpredicted < 0.005
    others = np.setdiff1d(np.arange(len(PATCH_MM)), correction.computed)
    load = grasp.contact.nodal_force(grasp.force_N[others]) / correction.modulus_MPa
    moved = grasp.finite.displacement(load).displacement
    exact = correction.modulus_MPa * grasp.contact.at_markers(moved) - grasp.unit[others]
    off = np.abs(correction.displacement_correction[others] - exact).max()
    assert off < 0.02 * np.abs(correction.displacement_correction).max()
    complete = correction.displacement_correction.copy()
    complete[others] = exact
    all_frames = 1 / grasp.refit(grasp.unit + complete)
    assert all_frames == pytest.approx(modulus_MPa, rel=3e-4)


@pytest.mark.slow
def test_the_correction_leaves_less_unexplained(grasp, found):
    _, _, correction = found

    def residual(unit):
        tracks = MarkerTracks(**{**vars(grasp.tracks), "unit_displacement": unit})
        return fit_compliance(tracks, scale_sd=0.004, fruit_moves=True).residual_rms_mm

    assert residual(grasp.unit + correction.displacement_correction) < 0.25 * residual(grasp.unit)


def test_linear_flesh_departs_by_nothing_but_the_turn_of_the_pit(grasp):
    linear = FiniteStrainSolid(solid=grasp.contact.solid, law=Linear(poisson_ratio=NU))
    none = finite_strain_correction(linear, grasp.contact, grasp.force_N, grasp.unit, modulus_MPa=E_MPA)
    assert np.abs(none.displacement_correction).max() < 1e-3 * np.abs(grasp.unit).max()


@pytest.mark.slow
def test_forces_that_pull_are_refused(grasp, found):
    linear_MPa, _, _ = found
    with pytest.raises(FemFailure, match="above zero") as refused:
        finite_modulus(
            grasp.finite,
            grasp.contact,
            grasp.force_N[:1],
            grasp.unit[:1],
            modulus_MPa=linear_MPa,
            refit=lambda unit: -1.0,
        )
    assert refused.value.problem is FemProblem.NO_MODULUS
