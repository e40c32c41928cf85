"""Physics that the catalogue does not have; the right answer to each of these cases is "unknown".

palm             the fruit's bottom rests on the gripper's palm, a spring, in every grasp
gel_softening    both gels soften while they are held; the sensor goes on believing their nominal stiffness
"""

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array, csr_array

from samples.brick_flesh import BrickFlesh
from samples.mismatch.injected import InjectedEffect, plain_flesh
from samples.mismatch.meshed_fruit import MeshedFruit
from samples.mismatch.nonlinear_body import NonlinearBody, sound_body, whole_fruit
from samples.mismatch.true_recording import GrippedBody, SofteningGelBody, TrueRecording


def out_of_catalogue_body(stands: MeshedFruit, physics: InjectedEffect) -> GrippedBody:
    """The fruit of one mesh, with what is not in the catalogue."""
    if physics.effect == "palm":
        support = on_a_palm(stands.flesh, **physics.parameters)
        return NonlinearBody(
            whole_fruit(stands.flesh, stands.dofs, support=support), plain_flesh(stands.flesh)
        )
    return SofteningGelBody(sound_body(stands), **physics.parameters)


def on_a_palm(flesh: BrickFlesh, *, N_per_mm: float, area_radius_mm: float) -> csr_array:
    """Stiffness to add: springs along z under the lowest part of the skin."""
    bricks = flesh.bricks
    skin = np.unique(bricks.skin_cells)
    places = bricks.nodes_mm[skin]
    lowest = places[np.argmin(places[:, 2])]
    under = (np.linalg.norm(places[:, :2] - lowest[:2], axis=1) < area_radius_mm) & (places[:, 2] < 0)
    near = skin[under & np.isin(skin, flesh.free_nodes)]
    at = flesh.dofs_of(near)[:, 2]
    values = np.full(len(at), N_per_mm / len(at))
    return csr_array(coo_array((values, (at, at)), shape=(flesh.unknowns, flesh.unknowns)))


def believed(truth: TrueRecording) -> TrueRecording:
    """The force that a sensor computes from the markers' displacement with the gel's nominal stiffness."""
    gel = truth.gel
    stiffness = np.array([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    return truth.with_pads(
        lambda p: replace(p, force_N=-truth.marker_area_mm2 * stiffness * p.displacement_mm)
    )
