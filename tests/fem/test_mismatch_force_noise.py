"""The noise of the forces is no effect: what it adds to the equations is known, and taken out of them."""

from functools import cache

import numpy as np
import pytest
from injected_mismatch import injected_case, only_grasp
from plain_model import case_model

from fem.mismatch.effects.sensor_gain import EFFECT as GAIN
from fem.mismatch.effects.skin import EFFECT as SKIN
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import (
    ALL,
    ForceNoise,
    OfFlesh,
    OfInnerChange,
    OfResponse,
    OfSomeForces,
    drawn_force_noise,
)
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor

SEEDS = range(6)


@cache
def noisy() -> tuple[CaseModel, ForceNoise]:
    model, _ = case_model(only_grasp(injected_case(), 0))
    return model, drawn(model, GraspEquations.of(model, model.grasps[0]))


def drawn(model: CaseModel, equations: GraspEquations) -> ForceNoise:
    """Of the model's only recording."""
    (noise,) = drawn_force_noise(model.base, [equations.weighed_markers], compliance=model.compliance)
    return noise


def directly(fields: np.ndarray, noise: ForceNoise) -> float:
    """The product of the module's docstring with fields that were solved for."""
    return float(
        np.mean([(field * weighed).sum() for field, weighed in zip(fields, noise.weighed, strict=True)])
    )


def linear_nuisances(model: CaseModel) -> list[Regressor]:
    """Those that follow from the forces linearly, as all but large deformation do."""
    return [column for column in common_nuisances(model) if column.name != LARGE_DEFORMATION]


def test_pit_and_poissons_ratio_follow_from_forces_like_their_own_fields() -> None:
    """Of noise that is the recording's own forces: the product is that of the nuisances' fields."""
    model, noise = noisy()
    recording = noise.recording
    count = noise.moved.shape[1]
    whole = ForceNoise(
        compliance=model.compliance,
        recording=recording,
        force_N=recording.patterns[None, :count],
        moved=recording.moved[None, :count],
        response=recording.response[None, :count],
        weighed=noise.weighed[:1],
        adjoint=noise.adjoint[:1, :count],
        adjoint_response=noise.adjoint_response[:1, :count],
    )
    for column in linear_nuisances(model):
        field = column.fields[0]
        assert isinstance(field, ObservationDelta)
        assert field.markers is not None
        product = column.of_forces.product(whole)
        expected = float((field.markers * noise.weighed[0]).sum())
        scale = float(np.abs(field.markers * noise.weighed[0]).sum())
        assert product == pytest.approx(expected, abs=0.02 * scale), column.name


def test_the_plain_models_product_is_negative() -> None:
    """Noise in a regressor attenuates it."""
    assert ALL.product(noisy()[1]) < 0


@pytest.mark.proof
def test_drawn_noise_of_the_response_is_as_large_as_the_real_one() -> None:
    """As the equations weigh it: between recordings of one grasp with their noise and nearly without.

    A common scale of all forces is left out: the gel's fitted stiffness is E, and no noise of single markers;
    and what is not in the patterns' courses over time, which the equations leave out too.
    """
    quiet, _ = case_model(only_grasp(injected_case(noise=0.02), 0))
    real, ours = [], []
    for seed in SEEDS:
        model, _ = case_model(only_grasp(injected_case(seed=seed), 0))
        equations = GraspEquations.of(model, model.grasps[0])
        recording, still = model.grasps[0], quiet.grasps[0]
        assert np.array_equal(recording.used, still.used)
        unit = recording.tracks.unit_displacement
        noise = drawn(model, equations)
        shares = recording.shares[:, : noise.response.shape[1]]
        course = np.linalg.qr(shares)[0]
        off = np.tensordot(course @ course.T, unit - still.tracks.unit_displacement, axes=1)
        real.append(energy(equations, off, unit))
        ours += [
            energy(equations, np.tensordot(shares, pattern_noise, axes=1), unit)
            for pattern_noise in noise.response
        ]
    assert np.mean(ours) == pytest.approx(np.mean(real), rel=0.25)


def energy(equations: GraspEquations, field: np.ndarray, without: np.ndarray) -> float:
    """phi . W phi, the field's share of another taken out."""
    heavy = equations.weighed_markers(without)
    other = field - without * float((field * heavy).sum() / (without * heavy).sum())
    return float((other * equations.weighed_markers(other)).sum())


def test_solved_fields_of_noise_have_the_products_that_adjoint_fields_say() -> None:
    model, noise = noisy()
    columns = [
        *SKIN.signatures(model)[0].columns,
        *GAIN.signatures(model)[0].columns,
        *linear_nuisances(model),
    ]
    kinds = set()
    for column in columns:
        kinds.add(type(column.of_forces))
        fields = column.of_forces.fields(noise)
        scale = float(np.abs(fields * noise.weighed).sum())
        product = column.of_forces.product(noise)
        assert product == pytest.approx(directly(fields, noise), abs=1e-6 * scale), column.name
    assert kinds == {OfFlesh, OfSomeForces, OfInnerChange, OfResponse}
