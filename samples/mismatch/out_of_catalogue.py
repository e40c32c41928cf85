"""Physics that the catalogue does not have; the right answer to each of these cases is "unknown".

palm             the fruit's bottom rests on the gripper's palm, a spring, in every grasp
gel_softening    both gels soften while they are held; the sensor goes on believing their nominal stiffness
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array

from samples.brick_flesh import BrickFlesh
from samples.gel_contact import Gel
from samples.mismatch.injected import plain_flesh
from samples.mismatch.meshed_fruit import MeshedFruit
from samples.mismatch.nonlinear_body import NonlinearBody, sound_body, whole_fruit
from samples.mismatch.true_recording import GrippedBody, SofteningGelBody, TrueRecording
from samples.sample_failure import SampleFailure

OUT_OF_CATALOGUE = ("palm", "gel_softening")


@dataclass(frozen=True, kw_only=True)
class OutOfCatalogue:
    """One of the physics above with what it takes."""

    name: str
    parameters: dict[str, Any]


def drawn_out_of_catalogue(name: str, rng: np.random.Generator) -> OutOfCatalogue:
    """At a level that is plain to be seen. Raises SampleFailure for a name that is not in the list."""
    if name not in OUT_OF_CATALOGUE:
        raise SampleFailure(
            f"There is no physics {name!r} outside the catalogue; there are: {', '.join(OUT_OF_CATALOGUE)}."
        )
    if name == "palm":
        parameters = {"N_per_mm": float(rng.uniform(15.0, 30.0)), "area_radius_mm": 6.0}
    else:
        parameters = {"g": float(rng.uniform(0.15, 0.3)), "tau_s": float(rng.uniform(0.8, 3.0))}
    return OutOfCatalogue(name=name, parameters=parameters)


def out_of_catalogue_body(stands: MeshedFruit, out_of_catalogue: OutOfCatalogue) -> GrippedBody:
    """The fruit of one mesh, with what is not in the catalogue."""
    flesh, p = stands.flesh, out_of_catalogue.parameters
    if out_of_catalogue.name == "palm":
        whole = whole_fruit(flesh, stands.dofs, support=on_a_palm(flesh, **p))
        return NonlinearBody(whole, plain_flesh(flesh))
    return SofteningGelBody(sound_body(stands), g=p["g"], tau_s=p["tau_s"])


def out_of_catalogue_recorded(truth: TrueRecording, out_of_catalogue: OutOfCatalogue) -> TrueRecording:
    """What the sensor makes of it."""
    if out_of_catalogue.name == "gel_softening":
        return believed(truth, truth.gel)
    return truth


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


def believed(truth: TrueRecording, gel: Gel) -> TrueRecording:
    """The force that a sensor computes from the markers' displacement with the gel's nominal stiffness."""
    stiffness = np.array([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    felt = truth.with_pads(
        lambda p: replace(p, force_N=-truth.marker_area_mm2 * stiffness * p.displacement_mm)
    )
    return replace(felt, gel=gel)
