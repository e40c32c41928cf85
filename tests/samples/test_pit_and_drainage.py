"""A split pit and draining flesh leave the marks that they should."""

import numpy as np
from mismatch_ball import drawn_ball, grasped_ball, motion, rough, total_N

from samples.mismatch.bodies import ElasticBody
from samples.mismatch.case_simulation import body_of
from samples.mismatch.injected import InjectedEffect
from samples.mismatch.pit_halves import split_pit_stiffness
from samples.mismatch.skin_compliance import skin_compliance

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


def test_draining_flesh_pushes_less_while_it_is_held() -> None:
    grasp, stands = rough(drawn_ball(), WAY)
    drainage = InjectedEffect(effect="drainage", parameters={"volume_share": 0.9, "tau_s": 0.5})
    body, _ = body_of(stands, (drainage,))
    force = total_N(grasped_ball(grasp, stands, body))
    assert force[2] > force[3] > force[4] > 0.5 * force[2]
