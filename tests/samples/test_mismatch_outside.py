"""Physics outside the catalogue leaves the mark that it should."""

import numpy as np
from mismatch_ball import drawn_ball, force_on_fruit, grasped_ball, motion, rough, total_N

from samples.mismatch.case_simulation import body_of
from samples.mismatch.injected import InjectedEffect
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.other_bodies import split_pit_stiffness
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import ElasticBody

WAY = motion([-0.05, 0.5, 1.0, 1.0, 1.0], pause_s=0.5)


def test_a_split_pit_is_softer_than_a_whole_one() -> None:
    grasp, stands = rough(drawn_ball(core_mm=14.0), WAY)
    whole = skin_compliance(stands.flesh.stiffness, stands.dofs)
    split = skin_compliance(split_pit_stiffness(stands.flesh), stands.dofs)
    lowest = np.linalg.eigvalsh(split.dense() - whole.dense())[0]
    assert lowest > -1e-6 * np.abs(whole.dense()).max()
    assert (
        total_N(grasped_ball(grasp, stands, ElasticBody(split)))[2]
        < total_N(grasped_ball(grasp, stands, ElasticBody(whole)))[2]
    )


def test_a_bond_lets_the_halves_part_by_its_share() -> None:
    _, stands = rough(drawn_ball(core_mm=14.0), WAY)
    whole = skin_compliance(stands.flesh.stiffness, stands.dofs).dense()
    free, bonded = (
        skin_compliance(split_pit_stiffness(stands.flesh, angle_deg=50.0, share=share), stands.dofs).dense()
        - whole
        for share in (1.0, 0.4)
    )
    assert np.abs(bonded - 0.4 * free).max() < 0.01 * np.abs(free).max()


def test_a_palm_takes_what_the_pads_do_not_balance() -> None:
    way = motion([-0.05, 0.5, 1.0, 1.0], shear_mm=[0, 0, 0, 1.0])
    grasp, stands = rough(drawn_ball(), way)
    palm = InjectedEffect(effect="palm", parameters={"N_per_mm": 8.0, "area_radius_mm": 6.0})
    on_palm = force_on_fruit(grasped_ball(grasp, stands, body_of(stands, (palm,))[0]))
    free = force_on_fruit(grasped_ball(grasp, stands, sound_body(stands)))
    assert np.abs(free[:, 2]).max() < 0.03
    assert np.abs(on_palm[:, 2]).max() > 2 * np.abs(free[:, 2]).max()


def test_a_softening_gel_is_pressed_deeper_while_it_is_held() -> None:
    grasp, stands = rough(drawn_ball(), WAY)
    softening = InjectedEffect(effect="gel_softening", parameters={"g": 0.3, "tau_s": 0.5})
    body, _ = body_of(stands, (softening,))
    depth = -grasped_ball(grasp, stands, body).pads[0].displacement_mm[..., 2].min(axis=1)
    assert depth[4] > depth[3] > depth[2]
