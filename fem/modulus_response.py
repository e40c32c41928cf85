"""What the measured forces do to a fruit of unit modulus, at the markers: one solve per frame."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from fem.forward import UnitModulusSolid
from fem.modulus_fit import MarkerTracks
from fem.modulus_inputs import GraspHistory, PadHistory
from fem.modulus_thinning import spacing
from fem.modulus_traction import TractionField, marker_weights
from fem.surface import SurfacePoints, locate

OFF_SKIN_MM = 3.0
"""Markers farther than this from the skin of the mesh are a failure: registration has put them on the
surface."""
SMALLEST_SD_MM = 5e-4
"""Half a micrometre: what a recording without measurable noise is taken to carry, for the weights' sake."""


def marker_tracks(
    history: GraspHistory, solid: UnitModulusSolid, frames: Bool[np.ndarray, " t"]
) -> tuple[MarkerTracks, Float[np.ndarray, "f n 3"]]:
    """The chosen frames of all pads side by side, with the response of `solid` to them, and the forces.

    The forces of all pads act together in a frame. Between chosen frames that lie k apart noise correlates by
    r^k, r between neighbours. Raises FemFailure (off-surface) where markers are not on
    the mesh's skin.
    """
    places = [locate(solid.mesh, pad.surface_mm, within_mm=OFF_SKIN_MM) for pad in history.pads]
    loads = sum(
        (pad_load(pad, place, solid, frames) for pad, place in zip(history.pads, places, strict=True)),
        start=np.zeros(()),
    )
    displacement = solid.displacement(loads)
    tracks = MarkerTracks(
        place_mm=np.vstack([place.point_mm for place in places]),
        normal=np.vstack([place.normal for place in places]),
        position_mm=np.concatenate([pad.position_mm[frames] for pad in history.pads], axis=1),
        unit_displacement=np.concatenate([place.sample(displacement) for place in places], axis=1),
        gel_displacement_mm=np.concatenate([pad.gel_displacement_mm[frames] for pad in history.pads], axis=1),
        episode=np.concatenate([pad.episode[frames] for pad in history.pads], axis=1),
        sd_mm=_per_marker(history, lambda pad: max(pad.displacement_sd_mm, SMALLEST_SD_MM)),
        lag1=_per_marker(history, lambda pad: pad.lag1 ** spacing(frames)),
    )
    return tracks, np.concatenate([pad.force_N[frames] for pad in history.pads], axis=1)


def pad_load(
    pad: PadHistory, place: SurfacePoints, solid: UnitModulusSolid, frames: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, "f m 3"]:
    """Nodal forces of one pad's traction field; total force and moment are the markers' own."""
    between, weights = marker_weights(pad.rest_mm, place.point_mm)
    skin = locate(solid.mesh, between, within_mm=OFF_SKIN_MM)
    field = TractionField(points_mm=skin.point_mm, marker_mm=place.point_mm, weights=weights)
    return skin.point_load(field.forces(pad.force_N[frames]))


def _per_marker(history: GraspHistory, value: Callable[[PadHistory], float]) -> Float[np.ndarray, " n"]:
    return np.concatenate([np.full(len(pad.rest_mm), value(pad)) for pad in history.pads])
