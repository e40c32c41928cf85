"""Laws of rubber between plates: stresses from the energies themselves, and curves drawn by them.

Nothing of fem draws a curve here: stress is the numerical derivative of an energy that is written down anew.
"""

import numpy as np
import pytest

from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.contact_law import linear_law
from fem.indentation.effects.trace_stiffening import ogden_share, yeoh_share
from fem.indentation.explain_trace import account_for
from fem.indentation.fit import from_prior
from fem.indentation.foundation import elastic_force, springs
from fem.indentation.no_contact import pooled_noise
from fem.indentation.strangers import strangers
from fem.indentation.trace import IndenterTrace, joined

NU = 0.495
DIAMETER_MM, HEIGHT_MM, E_MPA = 50.0, 30.0, 0.05
AREA_MM2 = np.pi * DIAMETER_MM**2 / 4


def stress(energy, stretch, step=1e-5):
    """Nominal stress of an incompressible solid, from its energy of one stretch."""
    return (energy(stretch + step) - energy(stretch - step)) / (2 * step)


def invariants(stretch):
    return stretch**2 + 2 / stretch - 3, 2 * stretch + stretch**-2 - 3


def neo_hookean(stretch):
    return invariants(stretch)[0] / 6


def yeoh(stretch, second=0.1, third=0.03):
    x = invariants(stretch)[0]
    return (x + second * x**2 + third * x**3) / 6


def ogden(stretch, power=5.0):
    return 2 / 3 / power**2 * (stretch**power + 2 * stretch ** (-power / 2) - 3)


def column(value):
    return np.array([[value]])


@pytest.mark.parametrize(
    ("energy", "share"),
    [
        (yeoh, lambda x: yeoh_share(column(0.1), column(0.03), x)),
        (ogden, lambda x: ogden_share(column(5.0), x)),
        (lambda x: ogden(x, -3.0), lambda x: ogden_share(column(-3.0), x)),
    ],
)
def test_each_law_is_the_derivative_of_its_energy_and_begins_as_neo_hooke(energy, share):
    stretch = np.array([[0.999, 0.9, 0.7, 0.5, 0.35]])
    expected = stress(energy, stretch) / stress(neo_hookean, stretch)
    assert share(stretch) == pytest.approx(expected, rel=1e-4)
    assert share(stretch)[0, 0] == pytest.approx(1.0, abs=0.01)


def test_ogdens_law_with_the_power_two_is_neo_hooke_and_has_a_limit_at_nought():
    stretch = np.linspace(0.3, 0.99, 9)[None]
    assert ogden_share(column(2.0), stretch) == pytest.approx(1.0)
    limit = 3 * np.log(stretch) / stretch / (stretch - stretch**-2)
    assert ogden_share(column(0.0), stretch) == pytest.approx(limit)


def test_a_toe_is_the_mean_over_first_touches():
    depth = np.linspace(-0.5, 2.0, 60)[None]
    level, stiffness = springs(lambda d: d**1.5, np.array([2.5]))
    touches = 0.8 * (np.arange(4000) + 0.5) / 4000 - 0.4
    mean = np.mean([elastic_force(depth - touch, None, level, stiffness) for touch in touches], axis=0)
    assert elastic_force(depth, None, level, stiffness, np.array([0.8])) == pytest.approx(mean, abs=1e-5)


def test_ends_that_are_not_stated_lie_between_sliding_and_held():
    depth = np.linspace(0.0, 9.0, 20)
    sliding, held, free = (
        Cylinder(diameter_mm=50.0, height_mm=30.0, ends=ends).curve(thickness_mm=None, poisson_ratio=NU)
        for ends in ("lubricated", "bonded", None)
    )
    ratio = free.held_over_sliding(depth)
    assert sliding.held_over_sliding(depth) is None
    assert free.force_N_per_MPa(depth) == pytest.approx(sliding.force_N_per_MPa(depth))
    assert free.force_N_per_MPa(depth) * ratio == pytest.approx(held.force_N_per_MPa(depth))


def pressed(energy, *, seed=0, E_MPa=E_MPA, onset_mm=0.6, toe_mm=0.5, strain=0.6, frames=150, **of_trace):
    """One ramp on sliding ends, 10 mm/min, its first touches spread over the toe; noise of 0.1 %."""
    travel = np.linspace(0.0, strain * HEIGHT_MM, frames)
    touches = onset_mm + toe_mm * (np.arange(200) + 0.5) / 200 - toe_mm / 2
    stretch = 1 - np.maximum(travel[:, None] - touches, 0.0) / HEIGHT_MM
    force = -E_MPa * AREA_MM2 * stress(energy, stretch).mean(axis=1)
    force = force + 1e-3 * force.max() * np.random.default_rng(seed).standard_normal(frames)
    geometry = Cylinder(diameter_mm=DIAMETER_MM, height_mm=HEIGHT_MM, ends="lubricated")
    return IndenterTrace(
        time_s=6 * travel + 0.01, force_N=force, travel_mm=travel, geometry=geometry, **of_trace
    )


def explained(trace):
    return account_for(trace, thickness_mm=None, poisson_ratio=NU, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("energy", "verdict"),
    [(neo_hookean, "none"), (yeoh, "stiffening"), pytest.param(ogden, "stiffening", marks=pytest.mark.proof)],
)
def test_a_cylinder_of_rubber_gives_its_initial_modulus_whatever_its_law(energy, verdict):
    account = explained(pressed(energy))
    said = account.explanation
    assert said.verdict == verdict
    assert abs(said.after.value - E_MPA) < 2 * said.after.sd
    assert said.after.sd < 0.1 * E_MPA
    names = [u.name for u in account.named.law.unknowns]
    onset = names.index("onset_mm")
    assert abs(account.named.scaled[onset] - 0.6) < 3 * account.named.sd[onset] + 0.05


def test_a_specimen_that_is_not_the_others_is_named():
    whole = joined(
        [pressed(neo_hookean, seed=k, E_MPa=E, strain=0.3) for k, E in enumerate((0.05, 0.05, 0.08))]
    )
    law = linear_law(whole, thickness_mm=None, poisson_ratio=NU)
    notes = strangers(whole, from_prior(law, whole, pooled_noise(whole)))
    assert len(notes) == 1
    assert notes[0].startswith("Recording 3 does not belong to the others")
    same = joined(whole.parts[:1] + whole.parts[:1] + whole.parts[:1])
    assert strangers(same, from_prior(law, same, pooled_noise(same))) == ()
