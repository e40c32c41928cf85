"""First-order changes of a recording's response with pit, Poisson's ratio, surface and pads' places."""

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import SLIDE_MM, inner_forces
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse, nodal_loads, seen
from fem.solid.pad_link import slid

LEADING = 4
"""Force patterns whose change is computed: the others' response is hundredths of the first."""


def inner_changes(model: CaseModel, recording: GraspResponse) -> dict[str, Float[np.ndarray, "f n 3"]]:
    """dc/dp, mm MPa, for the causes in fem.estimation.sensitivity that move no pad: pit, surface, Poisson's
    ratio.
    """

    def compute() -> dict[str, Float[np.ndarray, "f n 3"]]:
        solid, chosen = recording.solid, recording.moved[:LEADING]
        causes, forces = inner_forces(solid, chosen, list(recording.links))
        moved = recording.at_markers(solid.displacement(forces.reshape(-1, *forces.shape[2:])))
        by_cause = moved.reshape(len(causes), len(chosen), *moved.shape[1:])
        return {cause: recording.over_time(change) for cause, change in zip(causes, by_cause, strict=True)}

    return model.memoised(("inner", recording.case.name), compute)


def slid_response(model: CaseModel, recording: GraspResponse, pad: int) -> Float[np.ndarray, "2 f n 3"]:
    """Change of c per mm of the pad's shift along its own x and y over the skin, mm MPa / mm.

    Central differences; all pads are solved together and memoised.
    """

    def compute() -> Float[np.ndarray, "p 2 f n 3"]:
        solid, links, loads = recording.solid, [], []
        for k, link in enumerate(recording.links):
            for way in recording.turn_of(k).T[:2]:
                for step in (SLIDE_MM, -SLIDE_MM):
                    moved = (*recording.links[:k], slid(link, solid, step * way), *recording.links[k + 1 :])
                    links.append(moved)
                    loads.append(nodal_loads(moved, solid, recording.patterns))
        on_skin = solid.displacement(np.concatenate(loads))[:, solid.contact_nodes]
        answers = np.split(on_skin, len(links))
        ends = [seen(moved, answer) for moved, answer in zip(links, answers, strict=True)]
        changes = [
            recording.over_time((ahead - back) / (2 * SLIDE_MM))
            for ahead, back in zip(ends[::2], ends[1::2], strict=True)
        ]
        return np.stack(changes).reshape(len(recording.links), 2, *changes[0].shape)

    return np.asarray(model.memoised(("slid", recording.case.name), compute)[pad])
