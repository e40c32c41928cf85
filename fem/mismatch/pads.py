"""One pad among a recording's pads: its markers, its frame, the response to what it alone does."""

import numpy as np
from jaxtyping import Bool, Float

from fem.grasp_sensitivity import SLIDE_MM
from fem.mismatch.baseline import Seen
from fem.mismatch.ground import Ground
from fem.pad_link import slid


def pads_of(ground: Ground) -> list[str]:
    """Names of all pads of a case's recordings."""
    return list(dict.fromkeys(pad for seen in ground.base.grasps for pad in seen.pad_names))


def own_markers(seen: Seen, pad: int) -> Bool[np.ndarray, "1 n 1"]:
    """Which markers are this pad's, ready to mask fields."""
    return np.asarray(seen.pad_of_marker == pad)[None, :, None]


def turn_of(seen: Seen, pad: int) -> Float[np.ndarray, "3 3"]:
    """Pad axes in the fruit frame, as columns, at the greatest force."""
    return np.asarray(
        seen.pose[pad, int(np.argmax(np.linalg.norm(seen.force_N, axis=2).sum(axis=1))), :3, :3]
    )


def pad_force(seen: Seen, pad: int) -> Float[np.ndarray, "f 3"]:
    """Total force of one pad on the fruit, N."""
    return np.asarray(seen.force_N[:, seen.pad_of_marker == pad].sum(axis=1))


def response_to(
    ground: Ground, seen: Seen, force_N: Float[np.ndarray, "r n 3"]
) -> Float[np.ndarray, "r n 3"]:
    """Displacement (times E) of all markers under any forces on the markers."""
    solid = ground.base.solid_of(seen)
    loads = np.zeros((len(force_N), len(ground.base.mesh.nodes_mm), 3))
    loads[:, solid.contact_nodes] = seen.nodal_of(force_N)
    return ground.base.answer(seen, loads)


def slid_response(
    ground: Ground, seen: Seen, pad: int, way: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "f n 3"]:
    """Change of c per mm by which the pad is moved along the skin, mm MPa / mm, by a central difference."""
    solid = ground.base.solid_of(seen)
    split = np.cumsum([len(other.rest_mm) for other in seen.case.history.pads])[:-1]
    patterns = np.split(seen.patterns, split, axis=1)
    loads = np.zeros((2, len(seen.patterns), len(ground.base.mesh.nodes_mm), 3))
    moved_links = [slid(seen.links[pad], solid, step * way) for step in (SLIDE_MM, -SLIDE_MM)]
    others = sum(link.nodal_force(patterns[k]) for k, link in enumerate(seen.links) if k != pad)
    for end, link in enumerate(moved_links):
        loads[end][:, solid.contact_nodes] = others + link.nodal_force(patterns[pad])
    moved = solid.displacement(loads.reshape(-1, *loads.shape[2:]))[:, solid.contact_nodes]
    ends = []
    for end, own in enumerate(np.split(moved, 2)):
        links = [moved_links[end] if k == pad else link for k, link in enumerate(seen.links)]
        ends.append(np.concatenate([link.seen(own) for link in links], axis=1))
    return seen.over_time((ends[0] - ends[1]) / (2 * SLIDE_MM))
