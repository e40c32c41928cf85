"""One pad among a recording's pads: its markers, its frame, the response to what it alone does."""

from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.sensitivity import SLIDE_MM
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.solid.pad_link import slid


def pads_of(forward: ForwardModel) -> list[str]:
    """Names of all pads of a case's recordings."""
    return list(dict.fromkeys(pad for recording in forward.base.grasps for pad in recording.pad_names))


def own_markers(recording: GraspResponse, pad: int | str) -> Bool[np.ndarray, "1 n 1"]:
    """Which markers are this pad's, by number or name, ready to mask fields; none of an absent pad."""
    names = np.array(recording.pad_names)[recording.pad_of_marker]
    mine = names == pad if isinstance(pad, str) else recording.pad_of_marker == pad
    return np.asarray(mine)[None, :, None]


def turn_of(recording: GraspResponse, pad: int) -> Float[np.ndarray, "3 3"]:
    """Pad axes in the fruit frame, as columns, at the greatest force."""
    return np.asarray(
        recording.pose[pad, int(np.argmax(np.linalg.norm(recording.force_N, axis=2).sum(axis=1))), :3, :3]
    )


def pad_force(recording: GraspResponse, pad: int) -> Float[np.ndarray, "f 3"]:
    """Total force of one pad on the fruit, N."""
    return np.asarray(recording.force_N[:, recording.pad_of_marker == pad].sum(axis=1))


def response_to(
    forward: ForwardModel, recording: GraspResponse, force_N: Float[np.ndarray, "r n 3"]
) -> Float[np.ndarray, "r n 3"]:
    """Displacement (times E) of all markers under any forces on the markers."""
    solid = forward.base.solid_of(recording)
    loads = np.zeros((len(force_N), len(forward.base.mesh.nodes_mm), 3))
    loads[:, solid.contact_nodes] = recording.nodal_of(force_N)
    return forward.base.marker_response(recording, loads)


def slid_response(forward: ForwardModel, recording: GraspResponse, pad: int) -> Float[np.ndarray, "2 f n 3"]:
    """Change of c per mm by which the pad is moved along its own x and y over the skin, mm MPa / mm.

    By central differences; of all pads at once, kept.
    """
    kept = forward.memoised(("slid", recording.case.name), partial(_slid_responses, forward, recording))
    return np.asarray(kept[pad])


def _slid_responses(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "p 2 f n 3"]:
    """Of every pad moved along its x and y by SLIDE_MM either way: central differences of c, per mm."""
    solid, pads = forward.base.solid_of(recording), range(len(recording.links))
    split = np.cumsum([len(other.rest_mm) for other in recording.case.history.pads])[:-1]
    patterns = np.split(recording.patterns, split, axis=1)
    unmoved = [
        link.nodal_force(pad_patterns) for link, pad_patterns in zip(recording.links, patterns, strict=True)
    ]
    links, loads = [], []
    for pad in pads:
        for way in turn_of(recording, pad).T[:2]:
            for step in (SLIDE_MM, -SLIDE_MM):
                link = slid(recording.links[pad], solid, step * way)
                nodal = [link.nodal_force(patterns[k]) if k == pad else unmoved[k] for k in pads]
                links.append([link if k == pad else recording.links[k] for k in pads])
                whole = np.zeros((len(recording.patterns), len(forward.base.mesh.nodes_mm), 3))
                whole[:, solid.contact_nodes] = sum(nodal)
                loads.append(whole)
    moved = solid.displacement(np.concatenate(loads))[:, solid.contact_nodes]
    ends = [
        np.concatenate([link.at_markers(displacement) for link in several], axis=1)
        for several, displacement in zip(links, np.split(moved, len(links)), strict=True)
    ]
    changes = [
        recording.over_time((ahead - back) / (2 * SLIDE_MM))
        for ahead, back in zip(ends[::2], ends[1::2], strict=True)
    ]
    return np.stack(changes).reshape(len(recording.links), 2, *changes[0].shape)
