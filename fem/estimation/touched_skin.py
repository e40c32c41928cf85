"""Where on the undeformed skin the markers sit: the skin that they touched had been displaced before.

Registration takes the point of the scanned surface that lies straight behind a marker. A marker at the rim of
a patch meets skin that the middle of the patch has moved outward by then, by a tenth of a millimetre in soft
fruit:

    X = x_registered - (u - rigid part)_t,       u = s c halfway between the touch and the frame before

t: along the skin. The rigid part over each pad is the fruit's motion or the pad's place, both unknown anyway.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.estimation.compliance_fit import MarkerTracks, fit_compliance, rigid_motion
from fem.estimation.prepared_grasp import PreparedGrasp
from fem.estimation.sensitivity import mean_normal
from fem.estimation.unit_response import tracks_of
from fem.grasp_history import GraspHistory
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import pad_link

FEWEST = 8
"""A pad that fewer markers touch stays as registered."""


def on_touched_skin(prepared: PreparedGrasp, solid: UnitModulusSolid, *, gel_scale_sd: float) -> GraspHistory:
    """The prepared recording with its markers where they touched, by its own 1/E on a solid that was
    factorised for its contact nodes.

    Raises FemFailure (off-surface).
    """
    history = prepared.history
    links = [pad_link(pad, solid) for pad in history.pads]
    split = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    by_pad = np.split(prepared.patterns, split, axis=1)
    nodal = np.sum([link.nodal_force(own) for link, own in zip(links, by_pad, strict=True)], axis=0)
    moved = (nodal.reshape(len(nodal), -1) @ solid.contact_compliance).reshape(nodal.shape)
    response = np.concatenate([link.at_markers(moved) for link in links], axis=1)
    tracks = tracks_of(
        history,
        prepared.used,
        normal=np.vstack([link.place.normal for link in links]),
        unit_displacement=np.tensordot(prepared.shares, response, axes=1),
    )
    fit = fit_compliance(tracks, scale_sd=gel_scale_sd, fruit_moves=solid.support == "free")
    aside = np.split(
        pushed_aside(tracks, prepared.touched, history.pad_of_marker, compliance=max(fit.compliance, 0.0)),
        split,
    )
    pads = (
        replace(pad, surface_mm=pad.surface_mm - own) for pad, own in zip(history.pads, aside, strict=True)
    )
    return replace(history, pads=tuple(pads))


def pushed_aside(
    tracks: MarkerTracks,
    touched: Bool[np.ndarray, "f n"],
    pad_of_marker: Int[np.ndarray, " n"],
    *,
    compliance: float,
) -> Float[np.ndarray, "n 3"]:
    """The skin's motion along itself at each marker's first touch, mm, for 1/E = `compliance`; zero where it
    never touches.
    """
    moved = compliance * tracks.unit_displacement
    first, who = touched.argmax(axis=0), np.arange(touched.shape[1])
    before = np.where((first > 0)[:, None], moved[np.maximum(first - 1, 0), who], 0.0)
    there = (before + moved[first, who]) / 2
    aside = np.zeros_like(there)
    for pad in np.unique(pad_of_marker):
        mine = touched.any(axis=0) & (pad_of_marker == pad)
        if mine.sum() < FEWEST:
            continue
        modes = rigid_motion(tracks.place_mm[mine]).reshape(-1, 6)
        own = there[mine].ravel()
        own = (own - modes @ np.linalg.lstsq(modes, own, rcond=None)[0]).reshape(-1, 3)
        normal = mean_normal(tracks.normal[pad_of_marker == pad])
        aside[mine] = own - (own @ normal)[:, None] * normal
    return np.asarray(aside)
