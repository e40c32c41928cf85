"""What elements that are long beside a patch withhold of a recording's response.

One mesh carries the patches of all recordings, and its size is limited: on a fruit of 60 mm with eight
patches its edges are 3.3 mm, where the first markers to touch span 3 mm. It is then 3 % too stiff under the
lightest load and 0.2 % under half of the greatest, and a fruit whose resistance seems to grow with the load
stiffens, as the finder sees it (b 0.8, 5 to 13 nats). So under each pad the response to the recording's own
force patterns is solved for again in elements of EDGE of the patch's width (fem.solid.finer_elements); what
that adds is known, and of its amount little is in doubt.
"""

import numpy as np
from jaxtyping import Float

from fem.mesh.contact_size import RADIUS_SHARE, SHORTEST_MM, contact_size
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.solid.finer_elements import finer_elements
from fem.solid.traction import TractionField

EDGE, REACH = 0.075, 0.5
"""Edges under a patch, and how far round it they are made shorter, as shares of its width. On that fruit
1.2 mm and 8 mm: what is left of the mesh's error is then 1.0 um of 4.3, beside edges of 1.1 mm in whole
fruits; 2.0 with edges of 1.7 mm within 5 mm. Chosen on that fruit alone, case 051 of the first blind test."""
WITHHELD = "withheld by the mesh"
"""Name of its column."""
WITHHELD_SD = 0.5
"""Standard deviation of its amount about one. A quarter is the share of the mesh's error that is left, 1.0 um
of 4.3. The noise of the forces is in it too: with marker noise of 4 um, two fruit of an independent simulator
show 0.2 and 0.4 of it, two of the bank 0.7 and 1."""


def withheld_response(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"] | None:
    """What it adds to c at the markers, mm MPa; None where it is not asked for (`leave_withheld`)."""
    return forward.memoised(_key(recording), lambda: _added(forward, recording))


def leave_withheld(forward: ForwardModel, recording: GraspResponse) -> None:
    """Takes a recording's response as the mesh gives it."""
    forward.memoised(_key(recording), lambda: None)


def _key(recording: GraspResponse) -> tuple[str, str]:
    return "withheld", recording.case.name


def _added(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"]:
    """What finer elements add at the markers, mm MPa, pad by pad: one hardly feels how another is meshed."""
    solid = forward.base.solid_of(recording)
    on_pad = [recording.pad_of_marker == pad for pad in range(len(recording.links))]
    fields = [
        TractionField(points_mm=link.skin.point_mm, marker_mm=link.place.point_mm, weights=link.weights)
        for link in recording.links
    ]
    tractions = [
        field.forces(recording.patterns[:, markers]) for markers, field in zip(on_pad, fields, strict=True)
    ]
    added_patterns = np.zeros_like(recording.patterns)
    for pad, (markers, field, link) in enumerate(zip(on_pad, fields, recording.links, strict=True)):
        touched = link.place.point_mm[(recording.tracks.episode[:, markers] >= 0).any(axis=0)]
        if not len(touched):
            continue
        width = float(contact_size(touched)[1].max()) / RADIUS_SHARE
        finer = finer_elements(
            solid.mesh,
            touched,
            edge_mm=max(EDGE * width, SHORTEST_MM),
            reach_mm=REACH * width,
            poisson_ratio=solid.poisson_ratio,
            held=solid.base_nodes,
        )
        loads = np.zeros((len(recording.patterns), len(finer.mesh.nodes_mm), 3))
        readings = [finer.reading(other.points_mm) for other in fields]
        for at, traction in zip(readings, tractions, strict=True):
            loads += np.stack([at.T @ force for force in traction])
        added, reading = finer.added(loads, recording.moved), readings[pad]
        added_patterns[:, markers] = field.at_markers(
            np.stack([reading @ displacement for displacement in added])
        )
    return recording.over_time(added_patterns)
