"""The model of a fruit for one grasp: dense matrices among markers, without the mesh.

C maps forces at the markers to displacements at the markers for E = 1 MPa:

    C = L' K^-1 L        L: marker forces -> traction field -> nodes;  L': nodes -> markers
    (fem.solid.pad_link)

The factor of the fruit (fem.sparse.solver) gives K^-1 on the grasp's contact nodes; the other maps are
sparse. A frame then costs one product of a matrix and a vector.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.sensitivity import Sensitivity, sensitivities
from fem.grasp_history import GraspHistory
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import PadLink, PadPlaces, linked, pad_places


@dataclass(frozen=True, kw_only=True)
class GraspModel:
    """All pads' markers side by side on a fruit of E = 1 MPa.

    `place_mm`, `normal`: their places on the skin, outward normal. `compliance`: C, mm MPa / N, rows and
    columns marker by marker, x, y, z. `discretisation`: the share of the energy that the mesh misses under
    the leading force pattern (fem.solid.discretisation_error). `sensitivity`: derivatives of the response to
    the recording's own loaded frames by uncertain inputs. `fruit_moves`: no base holds it.
    `displacement_correction`: change of the response by large deformation, in every frame of the recording
    (fem.estimation.finite_response); None: small strain. `small_strain_alone`: why large deformation is left
    out, if it could not be solved for.
    """

    place_mm: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    compliance: Float[np.ndarray, "d d"]
    sensitivity: Sensitivity
    discretisation: float
    fruit_moves: bool
    displacement_correction: Float[np.ndarray, "t n 3"] | None = None
    small_strain_alone: str = ""

    def unit_displacement(self, force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Displacement of the markers times E, mm MPa, frame by frame."""
        flat = force_N.reshape(len(force_N), -1)
        return np.asarray(flat @ self.compliance.T).reshape(force_N.shape)


def grasp_model(
    history: GraspHistory, solid: UnitModulusSolid, *, places: Sequence[PadPlaces] | None = None
) -> GraspModel:
    """The model of one grasp on a solid whose contact nodes are (at least) this grasp's.

    `places`: its pads' places on the solid's mesh, if they are known. Raises FemFailure: off-surface,
    no-load.
    """
    if places is None:
        places = [pad_places(pad, solid.mesh) for pad in history.pads]
    links = [linked(at, solid) for at in places]
    sensitivity, withheld = sensitivities(history, solid, links, loaded_frames(history))
    return GraspModel(
        place_mm=np.vstack([link.place.point_mm for link in links]),
        normal=np.vstack([link.place.normal for link in links]),
        compliance=marker_compliance(links, solid.contact_compliance),
        sensitivity=sensitivity,
        discretisation=withheld,
        fruit_moves=solid.support == "free",
    )


def marker_compliance(
    links: Sequence[PadLink], contact: Float[np.ndarray, "c c"]
) -> Float[np.ndarray, "d d"]:
    """C = L' K^-1 L of all pads' markers, mm MPa / N; symmetric. `contact`: K^-1 on the contact nodes."""
    columns = []
    for link in links:
        moved = contact @ link.plain + (contact @ link.rigid) @ link.balance
        columns.append(np.vstack([to.plain.T @ moved + to.balance.T @ (to.rigid.T @ moved) for to in links]))
    return np.hstack(columns)
