"""Large deformation as a signature of stiffening: against Newton, and found where it is all there is."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU
from pinched_forward_model import forward_of

from fem.elements.assembly import unit_lame_constants
from fem.mismatch.effects import stiffening
from fem.mismatch.evidence.linear_evidence import GraspEquations
from fem.mismatch.model import stress_history
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import Parameter
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.screening import screened
from fem.mismatch.signature_variant import ONE_WAY, InMode
from fem.solid.finite_strain import FiniteStrainSolid

MU, LAME = unit_lame_constants(NU)


class BonetAndWood:
    """mu (F - F^-T) + lambda ln(J) F^-T for E = 1 MPa (Bonet and Wood 2008, eq. 6.28)."""

    poisson_ratio = NU

    def energy(self, F: np.ndarray) -> np.ndarray:
        log_J = np.log(np.linalg.det(F))
        return MU / 2 * ((F**2).sum(axis=(1, 2)) - 3 - 2 * log_J) + LAME / 2 * log_J**2

    def stress(self, F: np.ndarray) -> np.ndarray:
        back = np.linalg.inv(F).swapaxes(1, 2)
        return MU * (F - back) + LAME * np.log(np.linalg.det(F))[:, None, None] * back

    def tangent(self, F: np.ndarray) -> np.ndarray:
        back, eye = np.linalg.inv(F).swapaxes(1, 2), np.eye(3)
        rest = MU - LAME * np.log(np.linalg.det(F))
        return (
            MU * np.einsum("ik,jl->ijkl", eye, eye)
            + LAME * np.einsum("qij,qkl->qijkl", back, back)
            + rest[:, None, None, None, None] * np.einsum("qil,qkj->qijkl", back, back)
        )


def by_newton(forward: ForwardModel, *, share: float = 1.0) -> np.ndarray:
    """The markers' displacement, mm, of Bonet and Wood's flesh under this share of the loads, all frames."""
    recording = forward.base.grasps[0]
    solid = forward.base.solid_of(recording)
    force = np.tensordot(recording.shares, recording.patterns, axes=1)
    load = np.zeros((len(force), *solid.mesh.nodes_mm.shape))
    load[:, solid.contact_nodes] = share * forward.compliance * recording.nodal_of(force)
    newton = FiniteStrainSolid(solid=solid, law=BonetAndWood())
    moved = newton.displacement(load).require_equilibrium().displacement
    return recording.at_markers(moved[:, solid.contact_nodes])


def neo_hookean_signature(forward: ForwardModel) -> np.ndarray:
    found = next(
        one for one in stiffening.EFFECT.signatures(forward) if one.variant == InMode(mode="neo-hookean")
    )
    return found.columns[0].fields[0].markers


@pytest.mark.slow
def test_neo_hookean_signature_is_what_newtons_method_makes_of_the_law(monkeypatch):
    monkeypatch.setattr(stress_history, "CLOSE_MM", 2e-6)
    forward = forward_of()
    beyond = by_newton(forward) - 1e3 * by_newton(forward, share=1e-3)
    signature = neo_hookean_signature(forward)
    size = np.linalg.norm(signature), np.linalg.norm(beyond)
    assert (signature * beyond).sum() / np.prod(size) > 0.999
    assert size[0] / size[1] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_neo_hookean_flesh_is_found_to_be_that_and_to_stiffen_hardly():
    softer = replace(forward_of(), compliance=12.0)
    recording = softer.base.grasps[0]
    tracks = replace(recording.tracks, position_mm=recording.tracks.place_mm + by_newton(softer))
    injected = replace(softer, base=replace(softer.base, grasps=(replace(recording, tracks=tracks),)))
    recorded = [GraspEquations.of(injected, one) for one in injected.base.grasps]
    linear = screened(injected, recorded, [stiffening.EFFECT])
    shown = linear.best[0]
    assert shown.kind == "stiffening neo-hookean"
    assert shown.gain > 3
    assert shown.amounts[0] == pytest.approx(1.0, abs=0.1)
    again = refit(injected, linear, (shown,))
    assert again.parameters[0]["b"] < 0.5 < stiffening.HARDLY
    assert again.at_an_end == (False,)


def test_b_that_may_as_well_be_nothing_is_said_to_be_large_deformation():
    def remark(value: float, sd: float) -> str:
        return stiffening.EFFECT.remark({"b": Parameter(value=value, sd=sd, unit="1")})

    assert "b = 0.9 ± 0.8 may as well be nothing" in remark(0.9, 0.8)
    assert remark(2.0, 0.5) == remark(60.0, 3.0) == ""


@pytest.mark.parametrize("compliance", [28.0, 60.0])
def test_large_deformation_that_is_not_found_is_a_signature_that_says_why(compliance):
    """Rounds that have not settled, and rounds that ran away."""
    soft = replace(forward_of(), compliance=compliance)
    plain, large = stiffening.EFFECT.signatures(soft)
    assert (plain.variant, plain.untried) == (ONE_WAY, "")
    assert large.columns == ()
    assert "moves by this law" in large.untried
