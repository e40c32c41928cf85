"""The plain response on a finer mesh than that of the effects.

Markers resolve more than the mesh on which all effects are solved. On it the skin of soft flesh moves too
little along the pads: by 2 to 3 um where it bulges by 50 um. The residual then resembles a share of large
deformation that is missing, soft jaws, a loose pit or a small one. So c is that of a finer mesh,

    c = C_fine f,        changes of c by effects and by large deformation: of the coarse mesh.

C_fine responds more to noise of short wavelength, too. So the draws of the forces' noise are solved on it.
"""

from dataclasses import replace

import numpy as np

from fem.mismatch.model.force_noise import drawn_noise
from fem.mismatch.model.plain_model import GraspResponse, PlainModel, nodal_loads, seen, solids_of
from fem.parallel_map import parallel_map
from fem.solid.pad_link import pad_link


def with_finer_mesh(base: PlainModel, *, workers: int = 1) -> PlainModel:
    """The same recordings with the response of the case's finer mesh, if it has one. Raises FemFailure."""
    mesh = base.case.finer_mesh
    if mesh is None:
        return base
    solids = solids_of(replace(base.case, mesh=mesh), {})

    def again(recording: GraspResponse) -> GraspResponse:
        solid = solids[recording.case.support]
        links = [pad_link(pad, solid) for pad in recording.case.history.pads]
        _, noise = drawn_noise(recording, base.case.budget)
        forces = np.concatenate([recording.patterns, noise.reshape(-1, *noise.shape[2:])])
        at_markers = seen(links, solid.contact_displacement(nodal_loads(links, solid, forces)))
        response, of_noise = np.split(at_markers, [len(recording.patterns)])
        tracks = replace(recording.tracks, unit_displacement=recording.whole(response))
        return replace(recording, tracks=tracks, finer_noise=of_noise.reshape(noise.shape))

    return replace(base, grasps=tuple(parallel_map(again, base.grasps, workers=workers)))
