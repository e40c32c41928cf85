"""What elements that are long beside a patch withhold of a recording's response.

One mesh carries the patches of all recordings, and its size is limited: on a fruit of 60 mm with eight
patches its edges are 3.3 mm, where the first markers to touch span 3 mm. It is then 3 % too stiff under the
lightest load and 0.2 % under half of the greatest, and a fruit whose resistance seems to grow with the load
stiffens, as the finder sees it (b 0.8, 5 to 13 nats). So under each pad the response to the recording's own
force patterns is solved for again in elements of EDGE of the patch's width (fem.solid.finer_elements); what
that adds is known, and of its amount little is in doubt.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from fem.mesh.contact_size import RADIUS_SHARE, SHORTEST_MM, contact_size
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.marker_equations import LEAST_NOISE_SHARE, noise_share
from fem.solid.finer_elements import FinerElements, finer_elements
from fem.solid.traction import TractionField

EDGE, REACH = 0.075, 0.5
"""Edges under a patch, and how far round it they are made shorter, as shares of its width. On that fruit
1.2 mm and 8 mm: what is left of the mesh's error is then 1.0 um of 4.3, beside edges of 1.1 mm in whole
fruits; 2.0 with edges of 1.7 mm within 5 mm (docs/validation.md)."""
WITHHELD = "withheld by the mesh"
"""Name of its column."""
WITHHELD_SD = 0.25
"""Standard deviation of its amount about one: the share of the error that is left."""


def withheld_response(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"] | None:
    """What it adds to c at the markers, mm MPa; None where the markers' own noise hides it, which is also in
    the forces that it would be computed from (LEAST_NOISE_SHARE of fem.mismatch.model.marker_equations), or
    where it is not asked for (`leave_withheld`).
    """

    def compute() -> Float[np.ndarray, "f n 3"] | None:
        if noise_share(recording.tracks, forward.compliance) >= LEAST_NOISE_SHARE:
            return None
        return recording.over_time(added_by_pattern(forward, recording, recording.patterns, recording.moved))

    return forward.memoised(_key(recording), compute)


def leave_withheld(forward: ForwardModel, recording: GraspResponse) -> None:
    """Takes a recording's response as the mesh gives it."""
    forward.memoised(_key(recording), lambda: None)


def _key(recording: GraspResponse) -> tuple[str, str]:
    return "withheld", recording.case.name


@dataclass(frozen=True)
class _UnderPad:
    """The finer elements under one pad: its markers, how its traction lies on them, values at its points."""

    own: Bool[np.ndarray, " n"]
    finer: FinerElements
    field: TractionField
    reading: csr_array


def added_by_pattern(
    forward: ForwardModel,
    recording: GraspResponse,
    force_N: Float[np.ndarray, "r n 3"],
    moved: Float[np.ndarray, "r m 3"],
) -> Float[np.ndarray, "r n 3"]:
    """What finer elements add at the markers, mm MPa, under any forces on them that move the flesh so.

    Pad by pad: one hardly feels how the other is meshed.
    """
    found = np.zeros_like(force_N)
    for pad in forward.memoised(("finer", recording.case.name), lambda: _under_pads(forward, recording)):
        loads = np.stack([pad.reading.T @ one for one in pad.field.forces(force_N[:, pad.own])])
        added = pad.finer.added(loads, moved)
        found[:, pad.own] = pad.field.at_markers(np.stack([pad.reading @ one for one in added]))
    return found


def _under_pads(forward: ForwardModel, recording: GraspResponse) -> list[_UnderPad]:
    solid = forward.base.solid_of(recording)
    found = []
    for pad, link in enumerate(recording.links):
        own = recording.pad_of_marker == pad
        touched = link.place.point_mm[(recording.tracks.episode[:, own] >= 0).any(axis=0)]
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
        field = TractionField(
            points_mm=link.skin.point_mm, marker_mm=link.place.point_mm, weights=link.weights
        )
        found.append(_UnderPad(own, finer, field, finer.reading(link.skin.point_mm)))
    return found
