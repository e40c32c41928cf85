"""The plain response on a finer mesh than that of the effects.

Markers resolve more than the mesh on which all effects are solved. On it the skin of soft flesh moves too
little along the pads: by 2 to 3 um where it bulges by 50 um. The residual then resembles a share of large
deformation that is missing, soft jaws, a loose pit or a small one. So c is that of a finer mesh,

    c = C_fine f,        changes of c by effects and by large deformation: of the coarse mesh.
"""

from dataclasses import replace

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
        moved = solid.contact_displacement(nodal_loads(links, solid, recording.patterns))
        tracks = replace(recording.tracks, unit_displacement=recording.whole(seen(links, moved)))
        return replace(recording, tracks=tracks)

    return replace(base, grasps=tuple(parallel_map(again, base.grasps, workers=workers)))
