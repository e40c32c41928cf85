"""Something beside the pads bears the fruit: its force by conservation, its place, and the modulus with it.

The truth is solved on a mesh of its own, pads and third contact together in equilibrium.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse_fruit import FOOT_MM
from injected_mismatch import (
    E_MPA,
    GEL_N_PER_MM,
    NAMES,
    Altered,
    Recording,
    bare_pad,
    injected_case,
    linear_and_refitted,
    misplaced,
    on_pad,
    true_mesh,
    true_pads,
    true_solid,
)
from plain_model import case_model, screened_effects

from fem.grasp_history import GraspHistory
from fem.mesh.surface_points import locate
from fem.mismatch.effects import pose_error, sensor_gain, third_contact
from fem.mismatch.effects.third_contact import ForceBalance, best_contact
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.selection.modulus_with import modulus_of
from fem.solid.pad_link import contact_nodes, pad_link

PLACE_MM = np.array([0.0, 0.0, FOOT_MM])
UPWARDS = np.array([0.0, 0.0, 1.0])
PEAK_N = 0.3


def pushed_N(grasp: int, *, late: bool) -> np.ndarray:
    """The third contact's force: as the pads push, or only over half of their greatest."""
    normal = true_pads()[grasp][0].force_N @ true_pads()[grasp][0].axes[:, 2]
    share = normal.sum(axis=1) / normal.sum(axis=1).max()
    return PEAK_N * (2 * np.maximum(share - 0.5, 0.0) if late else share)


@cache
def third_contact_truth(
    late: bool, only: int | None
) -> dict[tuple[str, bytes], tuple[np.ndarray, np.ndarray]]:
    """By pad and its axes: what is added to its markers' forces, N, and to their displacement for E = 1 MPa.

    Both pads are drawn back by half of the third force each, evenly with their push.
    """
    mesh, by_pad = true_mesh(), {}
    for grasp, pads in enumerate(true_pads()):
        force = pushed_N(grasp, late=late) * (only in (None, grasp))
        bare = [bare_pad(grasp, side, name, mesh) for name, side in zip(NAMES, (-1.0, 1.0), strict=True)]
        history = GraspHistory(
            time_s=np.arange(len(force)) * 1.0, phase=("load",) * len(force), pads=tuple(bare)
        )
        solid = replace(true_solid(), contact_nodes=contact_nodes(mesh, [history]))
        links = [pad_link(pad, solid) for pad in bare]
        extra = []
        for pad in pads:
            push = pad.force_N @ pad.axes[:, 2]
            share = push / np.maximum(push.sum(axis=1, keepdims=True), 1e-12)
            extra.append(-0.5 * (force[:, None] * share)[..., None] * UPWARDS)
        loads = locate(mesh, PLACE_MM[None]).point_load(force[:, None, None] * UPWARDS)
        loads[:, solid.contact_nodes] += sum(
            link.nodal_force(force_N) for link, force_N in zip(links, extra, strict=True)
        )
        assert np.abs(loads.sum(axis=1)).max() < 1e-9
        moved = solid.displacement(loads)[:, solid.contact_nodes]
        for pad, link, force_N in zip(pads, links, extra, strict=True):
            by_pad[pad.name, pad.axes.tobytes()] = (force_N, link.at_markers(moved))
    return by_pad


@cache
def borne(*, late: bool = False, only: int | None = None) -> Altered:
    """Every pad as it is where something bears the fruit from below."""
    truth = third_contact_truth(late, only)

    def change(pad: Recording) -> Recording:
        force, unit = truth[pad.name, pad.axes.tobytes()]
        return replace(
            pad,
            force_N=pad.force_N + force,
            gel_mm=pad.gel_mm - (force @ pad.axes / GEL_N_PER_MM) @ pad.axes.T,
            position_mm=pad.position_mm + unit / E_MPA,
        )

    return change


@cache
def model_of(altered: Altered) -> CaseModel:
    return case_model(injected_case(altered))[0]


@pytest.fixture
def palm() -> CaseModel:
    return model_of(borne(late=False))


def normal_N(model: CaseModel) -> list[np.ndarray]:
    contact = best_contact(model)
    return [np.zeros(1) if force is None else force.force_N @ contact.seat.inward for force in contact.forces]


def test_a_palm_is_found_with_its_place_its_push_and_the_modulus():
    model, linear, again = linear_and_refitted(injected_case(borne()), third_contact.EFFECT)
    assert linear.best[0].gain > 100
    (parameters,) = again.parameters
    assert [parameters[name] for name in third_contact.CENTRE] == pytest.approx(PLACE_MM.tolist(), abs=1.0)
    assert parameters[third_contact.FORCE] == pytest.approx(PEAK_N, rel=0.05)
    assert again.converged
    assert modulus_of(model, again.response).value == pytest.approx(E_MPA, rel=0.03)
    assert again.fit.chi2 < linear.null.chi2


@pytest.mark.parametrize("late", [False, True], ids=["a palm", "a stop that is touched late"])
def test_the_force_is_what_the_pads_do_not_balance(late: bool):
    model = model_of(borne(late=late))
    for grasp, force in enumerate(normal_N(model)):
        true = pushed_N(grasp, late=late)[model.grasps[grasp].used]
        # but for what is common to all frames, which the fruit's own weight may be
        assert force - force.mean() == pytest.approx(true - true.mean(), abs=0.1 * PEAK_N)


@pytest.mark.proof
def test_a_contact_in_one_recording_alone_is_found_in_that_one():
    first, second = normal_N(model_of(borne(only=1)))
    assert np.abs(first).max() < 0.1 * PEAK_N
    assert second.max() == pytest.approx(PEAK_N, rel=0.07)


def test_the_balance_with_a_force_at_another_place_explains_less(palm: CaseModel):
    recording = palm.grasps[0]
    equations = palm.balance_equations(recording)
    assert equations is not None
    balance = ForceBalance.of(recording, equations)
    here = balance.force(PLACE_MM, UPWARDS)
    aside = np.array([0.0, 13.0, -13.0])
    elsewhere = balance.force(aside, -aside / np.linalg.norm(aside))
    assert here.evidence > (0.0 if elsewhere is None else elsewhere.evidence) + 100
    assert balance.force(-PLACE_MM, -UPWARDS) is None, "from above it would have to pull"
    under_pad = recording.tracks.place_mm[(recording.touching).any(axis=0)][0]
    assert balance.force(under_pad, UPWARDS) is None


@pytest.mark.parametrize(
    ("altered", "name"),
    [
        (lambda pad: pad, "sensor_gain"),
        pytest.param(
            on_pad("left", lambda pad: replace(pad, force_N=1.1 * pad.force_N)),
            "sensor_gain",
            marks=pytest.mark.proof,
        ),
        (on_pad("left", misplaced((2.0, -1.5), 4.0)), "pose_error"),
        (borne(), "third_contact"),
    ],
    ids=["null case", "a pad that reads 10 % too much", "a pad that is elsewhere and turned", "a palm"],
)
def test_what_bears_the_fruit_is_told_from_what_only_unbalances_it(altered: Altered, name: str):
    model = model_of(altered)
    effects = [third_contact.EFFECT, sensor_gain.EFFECT, pose_error.EFFECT]
    linear = screened_effects(model, effects)
    gains = {"third_contact": -20.0} | {fit.effect.spec.name: fit.gain for fit in linear.best}
    others = [gain for other, gain in gains.items() if other != name]
    assert gains[name] - 10 > (max(others) if name == "third_contact" else gains["third_contact"])
