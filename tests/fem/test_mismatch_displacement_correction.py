"""With an effect that is known in the model, the modulus of a recording that shows it is right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fem_shapes import ball
from injected_recording import BUDGET, CORE_MM, E_MPA, NU, RADIUS_MM, grasp, solid_of
from pinched_case_model import as_case, long_pinch, model_of

from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.mismatch import displacement_correction
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.displacement_correction import KnownEffect, displacement_corrections
from fem.mismatch.effect_spec import Entry
from fem.mismatch.effects import skin, viscoelastic
from fem.mismatch.mismatch_case import GraspCase, MismatchCase, PadMotion
from fem.mismatch.signature_variant import ONE_WAY

G, TAU_S = 0.35, 1.2
STEP_S, AIR = 0.4, 3
FINE = 400


@cache
def coarse_ball():
    poles = np.array([[0, 0, RADIUS_MM], [0, 0, -RADIUS_MM]])
    outer, core = ball(3000, semi_axes_mm=3 * (RADIUS_MM,)), ball(1000, semi_axes_mm=3 * (CORE_MM,))
    return tetrahedralise(
        *outer, *core, edge_mm=7.0, refine_at_mm=poles, refine_radius_mm=7.0, refine_edge_mm=2.5
    )


def relaxing(elastic: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Displacement e under the same forces of flesh with one arm that relaxes.

    c = (1 - G) e + G q, q' = e' - q / tau: the arm's own stress, marched in small steps.
    """
    e, q, creep = np.zeros_like(elastic[0]), np.zeros_like(elastic[0]), [elastic[0] * 0]
    for k in range(1, len(elastic)):
        h = (time_s[k] - time_s[k - 1]) / FINE
        for j in range(1, FINE + 1):
            c = elastic[k - 1] + (elastic[k] - elastic[k - 1]) * j / FINE
            fade = 1 / (1 + h / TAU_S)
            after = (c - G * fade * (q - e)) / (1 - G + G * fade)
            q, e = fade * (q + after - e), after
        creep.append(e)
    return np.array(creep)


@cache
def creeping_grasp() -> GraspHistory:
    """A grasp of the axisymmetric truth, after some frames in the air, on flesh that relaxes."""
    noisy, clean = grasp(moves=False), grasp(noise=0.0, moves=False, surface_mm=0.0)
    time_s = STEP_S * np.arange(AIR + len(noisy.time_s))
    rng = np.random.default_rng(7)
    pads = []
    for pad, quiet in zip(noisy.pads, clean.pads, strict=True):
        moved = quiet.position_mm - quiet.surface_mm
        still = np.zeros((AIR, *moved.shape[1:]))
        crept = relaxing(np.concatenate([still, moved]), time_s)[AIR:] - moved

        def after_air(values, sd, start, still=still):
            return np.concatenate([start + still + sd * rng.normal(size=still.shape), values])

        pads.append(
            replace(
                pad,
                position_mm=after_air(pad.position_mm + crept, 0.004, pad.position_mm[0]),
                gel_displacement_mm=after_air(pad.gel_displacement_mm, 0.004, 0.0),
                force_N=after_air(pad.force_N, 1e-4, 0.0),
                episode=np.vstack([np.full((AIR, len(pad.rest_mm)), -1), pad.episode]),
            )
        )
    return GraspHistory(time_s=time_s, phase=("air",) * AIR + noisy.phase, pads=tuple(pads))


def case_of(history: GraspHistory) -> MismatchCase:
    pads = tuple(
        PadMotion(
            name=pad.name,
            pose=np.repeat(np.diag([1.0, -side, -side, 1.0])[None], len(history.time_s), axis=0),
            normal_N=np.zeros(len(history.time_s)),
            markers=len(pad.rest_mm),
        )
        for pad, side in zip(history.pads, (1.0, -1.0), strict=True)
    )
    grasp_case = GraspCase(
        name="grasp-1",
        history=history,
        pads=pads,
        support="free",
    )
    return MismatchCase(mesh=coarse_ball(), grasps=(grasp_case,), poisson_ratio=NU, budget=BUDGET)


@pytest.mark.slow
def test_relaxing_flesh_is_too_soft_without_its_law_and_right_with_it():
    history = creeping_grasp()
    model = grasp_model(history, solid_of(coarse_ball(), history))
    known = KnownEffect(effect=viscoelastic.EFFECT, parameters=lambda E: {"g": G, "tau_s": TAU_S})
    (beyond,) = displacement_corrections(case_of(history), [known])
    without = estimate_modulus(history, model, budget=BUDGET).E_MPa
    informed = estimate_modulus(history, replace(model, displacement_correction=beyond), budget=BUDGET).E_MPa
    assert without < 0.93 * E_MPA
    assert informed == pytest.approx(E_MPA, rel=0.02)
    assert not beyond[:AIR].any()


def test_a_skin_of_so_many_newtons_per_millimetre_counts_in_the_modulus_that_comes_with_it():
    E_MPa, Et_N_per_mm = 0.3, 1.5
    recording = model_of().grasps[0]
    (stiff,) = skin.EFFECT.respond(model_of(), {"Et_over_E_mm": Et_N_per_mm / E_MPa}, ONE_WAY).unit
    history = long_pinch()
    ends = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    pads = tuple(
        replace(pad, position_mm=pad.surface_mm + displacement / E_MPa)
        for pad, displacement in zip(history.pads, np.split(stiff, ends, axis=1), strict=True)
    )
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": Et_N_per_mm / E})
    (beyond,) = displacement_corrections(as_case(replace(history, pads=pads)), [known])
    wanted = stiff - recording.tracks.unit_displacement
    assert np.abs(beyond - wanted).max() < 0.01 * np.abs(wanted).max()


def test_known_effects_whose_modulus_does_not_settle_say_so(monkeypatch):
    monkeypatch.setattr(displacement_correction, "STILL", -1.0)
    known = KnownEffect(effect=viscoelastic.EFFECT, parameters=lambda E: {"g": G, "tau_s": TAU_S})
    with pytest.raises(FemFailure, match="E with viscoelastic still changes") as failure:
        displacement_corrections(case_of(creeping_grasp()), [known])
    assert failure.value.problem is FemProblem.NOT_CONVERGED


def test_known_effects_of_a_fruit_that_does_not_move_have_no_modulus():
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": 1.5 / E})
    with pytest.raises(FemFailure, match="do not move the fruit") as failure:
        displacement_corrections(as_case(long_pinch()), [known])
    assert failure.value.problem is FemProblem.NO_MODULUS


VALUES = {"radius_mm": 5.0, "ratio": 0.5, "nu": 0.42, "scale": 0.95, "mu": 0.3, "gap_mm": 0.006}
"""Where a small share of the upper bound, as taken for the other parameters, is no effect that can be."""


@pytest.mark.parametrize(
    "effect",
    [effect for effect in EFFECTS if effect.spec.enters is Entry.RESPONSE],
    ids=lambda effect: effect.spec.name,
)
def test_every_effect_that_changes_the_response_has_a_correction(effect):
    """By its parameters alone: settings know no more of it."""
    model = model_of()
    values = {
        spec.name: VALUES.get(spec.name, 0.05 * spec.high if spec.low >= 0 else 0.01 * spec.high)
        for spec in effect.spec.searched
    }
    (correction,) = displacement_correction._corrections(
        model, [KnownEffect(effect=effect, parameters=lambda _: values)]
    )
    assert correction.shape == model.grasps[0].tracks.unit_displacement.shape
    assert np.isfinite(correction).all()
    if effect.spec.family == "object":  # a contact corrects what the recording shows of it, here nothing
        assert np.abs(correction).max() > 0
