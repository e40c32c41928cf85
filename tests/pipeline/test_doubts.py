"""A given pit unlike its category's is said, with what it may do to E; named causes hide their signs."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.estimation.modulus import ModulusSign, ModulusWarning
from pipeline.fruit.input_doubts import (
    Doubt,
    causes_alone,
    of_a_given_pit,
    of_grasps,
    relative_sd,
    remarks_of_grasps,
    signs_explained,
)
from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from samples.fruit import fruit_of_seed, scanned_mesh
from tactile.consistency.finding import Finding, FindingKind


@pytest.fixture(scope="module")
def nectarine():
    vertices, faces = scanned_mesh(fruit_of_seed("N", seed=3, E_MPa=0.5), cells=20, error_mm=0.1)
    prior = load_prior("nectarine")
    return vertices, place_pit(vertices, faces, prior), prior


def about_middle(vertices, matrix):
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return middle + (vertices - middle) @ np.asarray(matrix, dtype=float).T


def test_the_categorys_own_pit_is_not_doubted(nectarine):
    skin, (pit, faces), prior = nectarine
    assert of_a_given_pit(skin, pit, faces, prior) == []
    assert of_a_given_pit(skin, pit + np.array([0.5, -0.5, 0.5]), faces, prior) == []
    assert of_a_given_pit(skin, about_middle(pit, 1.08 * np.eye(3)), faces, prior) == []


@pytest.mark.parametrize(("shift_mm", "refused"), [(4.0, False), (15.0, True)])
def test_a_pit_elsewhere_is_said_and_far_away_refused(nectarine, shift_mm, refused):
    skin, (pit, faces), prior = nectarine
    (doubt,) = of_a_given_pit(skin, pit + np.array([shift_mm, 0.0, 0.0]), faces, prior)
    assert f"pit.ply lies {shift_mm:.1f} mm" in doubt.sentence
    assert doubt.refused == refused
    assert doubt.relative_sd == pytest.approx(0.01 * shift_mm, rel=0.05)


def test_a_moved_pit_widens_the_error_bar_by_more_than_what_it_did_to_E_and_not_three_times_that(nectarine):
    """Over 6 mm E of three nectarines changed by 0.1 to 3.3 %."""
    skin, (pit, faces), prior = nectarine
    (doubt,) = of_a_given_pit(skin, pit + np.array([6.0, 0.0, 0.0]), faces, prior)
    assert 0.033 < doubt.relative_sd < 3 * 0.033


@pytest.mark.parametrize(("times", "refused"), [(1.3, False), (0.6, True), (1.7, True)])
def test_a_pit_of_another_size_is_said(nectarine, times, refused):
    skin, (pit, faces), prior = nectarine
    (doubt,) = of_a_given_pit(skin, about_middle(pit, times * np.eye(3)), faces, prior)
    assert f"{times:.2f} times the expected size" in doubt.sentence
    assert doubt.refused == refused


def test_a_turned_pit_is_said(nectarine):
    skin, (pit, faces), prior = nectarine
    (doubt,) = of_a_given_pit(skin, about_middle(pit, [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), faces, prior)
    assert "It is rotated" in doubt.sentence


def test_a_body_that_may_have_its_core_anywhere_is_not_judged(nectarine):
    skin, (pit, faces), _ = nectarine
    phantom = load_prior("phantom")
    assert of_a_given_pit(skin, pit + np.array([9.0, 0, 0]), faces, phantom) == []
    assert of_a_given_pit(skin, pit + np.array([9.0, 0, 0]), faces, None) == []


def grasp(number, *findings):
    return SimpleNamespace(name=f"grasp-{number}", findings=findings)


def gain(relative_sd=0.2, pads=("left", "right")):
    return Finding(
        kind=FindingKind.SCALE,
        says="forces are 1.3 times",
        pads=pads,
        relative_sd=relative_sd,
    )


def test_a_remark_is_said_puts_nothing_in_doubt_and_explains_no_sign():
    remark = Finding(kind=FindingKind.ENDS_PRESSED, says="it ends pressed", remark=True)
    remarked, two = grasp(1, remark), grasp(2, gain())
    assert remarks_of_grasps([remarked, two]) == ["grasp-1: it ends pressed."]
    (doubt,) = of_grasps([remarked, two])
    assert doubt.sentence == "grasp-2: both pads' forces are 1.3 times."
    assert doubt.relative_sd == 0.1
    assert signs_explained(remarked) == set()
    assert signs_explained(two)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_fault_that_all_recordings_have_is_not_made_less_by_more_of_them(count):
    everywhere = [grasp(k, gain()) for k in range(count)]
    assert relative_sd(of_grasps(everywhere)) == pytest.approx(0.2)
    in_one = [everywhere[0], *(grasp(k) for k in range(1, count))]
    assert relative_sd(of_grasps(in_one)) == pytest.approx(0.2 / count)


def test_unlike_faults_add_in_squares_also_where_they_are_of_one_kind():
    left, right = gain(0.3, ("left",)), gain(0.4, ("right",))
    assert relative_sd(of_grasps([grasp(1, left, right)])) == pytest.approx(0.5)
    clock = Finding(kind=FindingKind.CLOCKS_APART, says="late", relative_sd=0.4)
    assert relative_sd(of_grasps([grasp(1, gain(0.3), clock)])) == pytest.approx(0.5)
    assert relative_sd([]) == 0.0
    assert relative_sd([Doubt(sentence="a", relative_sd=0.3), Doubt(sentence="b", relative_sd=0.4)]) == 0.5


def test_only_the_signs_that_a_cause_explains_are_left_out():
    assert signs_explained(grasp(1, gain())) == {*ModulusSign} - {ModulusSign.NO_WORK}
    assert signs_explained(grasp(1)) == set()
    signs = [ModulusWarning(sign, "in whatever words") for sign in ModulusSign]
    assert [warning.sign for warning in causes_alone(grasp(1, gain()), signs)] == [ModulusSign.NO_WORK]
    assert causes_alone(grasp(1), signs) == signs


@pytest.mark.parametrize("kind", ["time-unit", "aperture-unit", "copied-frames", "ends-pressed"])
def test_what_E_does_not_depend_on_explains_no_sign_of_its_modulus(kind):
    harmless = Finding(kind=FindingKind(kind), says="harmless")
    assert signs_explained(grasp(1, harmless)) == set()
