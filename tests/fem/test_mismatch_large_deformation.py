"""Large deformation as part of the plain model: against Newton, and found where it is all there is."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU
from pinched_case_model import model_of
from plain_model import screened_effects

from fem.fem_failure import FemFailure
from fem.materials.neo_hookean import NeoHookean
from fem.mismatch.effects import stiffening
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION, large_deformation
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.model import stress_history
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.screening import LinearRound
from fem.solid.finite_strain import FiniteStrainSolid


def by_newton(model: CaseModel, *, share: float = 1.0) -> np.ndarray:
    """The markers' displacement, mm, of Neo-Hookean flesh under this share of the loads, all frames."""
    recording = model.grasps[0]
    solid = recording.solid
    force = np.tensordot(recording.shares, recording.patterns, axes=1)
    load = share * model.compliance * recording.loads(force)
    newton = FiniteStrainSolid(solid=solid, law=NeoHookean(poisson_ratio=NU))
    moved = newton.displacement(load)
    return recording.at_markers(moved)


def large_deformation_column(model: CaseModel) -> Regressor:
    (column,) = (nuisance for nuisance in common_nuisances(model) if nuisance.name == LARGE_DEFORMATION)
    return column


@pytest.mark.slow
def test_its_column_is_what_newtons_method_makes_of_neo_hookean_flesh(monkeypatch):
    monkeypatch.setattr(stress_history, "CLOSE_MM", 2e-6)
    model = model_of()
    beyond = by_newton(model) - 1e3 * by_newton(model, share=1e-3)
    signature = large_deformation_column(model).fields[0].markers
    size = np.linalg.norm(signature), np.linalg.norm(beyond)
    assert (signature * beyond).sum() / np.prod(size) > 0.999
    assert size[0] / size[1] == pytest.approx(1.0, abs=0.03)


@pytest.fixture(scope="module")
def neo_hookean() -> tuple[CaseModel, LinearRound]:
    """Soft flesh that deforms largely and does nothing else, and its linear round."""
    softer = replace(model_of(), compliance=12.0)
    recording = softer.grasps[0]
    tracks = replace(recording.tracks, position_mm=recording.tracks.place_mm + by_newton(softer))
    injected = replace(softer, base=replace(softer.base, grasps=(replace(recording, tracks=tracks),)))
    return injected, screened_effects(injected, [stiffening.EFFECT])


@pytest.mark.slow
def test_neo_hookean_flesh_deforms_largely_and_does_not_stiffen(neo_hookean):
    """The amount is found by the data: its prior is a tenth wide."""
    _, linear = neo_hookean
    columns = [linear.products.columns[j] for j in linear.null.chosen]
    (place,) = (k for k, column in enumerate(columns) if column.name == LARGE_DEFORMATION)
    assert columns[place].mean + linear.null.amounts[place] == pytest.approx(1.0, abs=0.1)
    assert linear.null.sd[place] < 0.07
    assert linear.best[0].gain < 0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_large_deformation_grows_with_the_fitted_compliance(neo_hookean, share):
    """Its amount stays at its prior mean where the plain model starts from another 1/E, `share` of the
    true one.
    """
    injected, _ = neo_hookean
    other = replace(injected, compliance=share * injected.compliance)
    linear = screened_effects(other, [])
    columns = [linear.products.columns[j].name for j in linear.null.chosen]
    assert share * (1 + linear.null.amounts[0]) == pytest.approx(1.0, abs=0.01)
    assert linear.null.amounts[columns.index(LARGE_DEFORMATION)] == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
def test_stiffening_holds_large_deformation_itself(neo_hookean):
    """Its refit goes without the plain model's, and finds no more b than it starts from."""
    injected, linear = neo_hookean
    again = refit(injected, linear, (linear.best[0],))
    columns = [linear.products.columns[j].name for j in linear.nuisances]
    assert LARGE_DEFORMATION in columns
    assert LARGE_DEFORMATION not in [again.products.columns[j].name for j in again.fit.chosen]
    assert again.parameters[0]["b"] <= 1.0


def test_a_plain_model_that_holds_it_has_no_column_of_it():
    model = replace(model_of(), beyond_small_strain=False)
    assert LARGE_DEFORMATION not in [nuisance.name for nuisance in common_nuisances(model)]


@pytest.mark.parametrize("compliance", [28.0, 60.0])
def test_large_deformation_that_is_not_found_is_no_column_and_says_why(compliance):
    """Rounds that have not settled, and rounds that ran away."""
    soft = replace(model_of(), compliance=compliance)
    failure = large_deformation(soft)
    assert isinstance(failure, FemFailure)
    assert "moves by this law" in failure.detail
    assert LARGE_DEFORMATION not in [nuisance.name for nuisance in common_nuisances(soft)]
