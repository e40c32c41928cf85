"""Which marker of the sensor's description each marker of the reference image is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactile.gel.gel_sides import GelOutline
from tactile.gel_camera import on_gel, project
from tactile.markers.marker_detection import spacing_of
from tactile.sensors import GelCamera
from tactile.tactile_failure import TactileFailure, TactileProblem

REACH = 0.4
"""A marker lies within this share of the spacing from where the description has it."""
ENOUGH = 0.8
"""Share of the markers that must lie so."""


@dataclass(frozen=True)
class Places:
    """The reference's markers that the description knows: `kept[n]` counts in the reference's order.

    `described[n]` counts in the description's; without one, in the reference's.
    """

    kept: Int[np.ndarray, " n"]
    described: Int[np.ndarray, " n"]
    rest_mm: Float[np.ndarray, "n 3"]


def places_of(
    camera: GelCamera,
    reference_px: Float[np.ndarray, "n 2"],
    rest_mm: Float[np.ndarray, "m 3"] | None,
    *,
    shape: tuple[int, int],
    source: str,
    outline: GelOutline | None = None,
) -> Places:
    """Each marker's rest place: the described one whose projection it lies on, else its ray's on the face
    (that of `outline`, a plane without).

    Raises TactileFailure (wrong-sensor) that says what does not agree: the image's size (height, width), or
    the markers' places.
    """
    width, height = camera.image_px
    if shape != (height, width):
        raise TactileFailure(
            TactileProblem.WRONG_SENSOR,
            f"{source}: found frames of {shape[1]} x {shape[0]} pixels, expected {width} x {height} "
            "as in the sensor's description; check that the description belongs to this sensor.",
        )
    if rest_mm is None:
        every = np.arange(len(reference_px))
        return Places(every, every, on_gel(camera, reference_px, outline))
    expected_px = project(camera, rest_mm)
    away, which = cKDTree(expected_px).query(reference_px)
    spacing = spacing_of(reference_px)
    near = np.asarray(away) < REACH * spacing
    kept = np.flatnonzero(near)
    single = len(np.unique(np.asarray(which)[kept])) == len(kept)
    spacing_differs = abs(spacing_of(expected_px) / spacing - 1.0) if spacing else np.inf
    if near.mean() < ENOUGH or not single or spacing_differs > REACH:
        raise TactileFailure(
            TactileProblem.WRONG_SENSOR,
            f"{source}: found {int(near.sum())} of {len(near)} markers at their places in the "
            f"sensor's description (spacing {spacing:.1f} px, described {spacing_of(expected_px):.1f} "
            f"px), expected at least {ENOUGH:.0%}. Check that the description belongs to this sensor "
            "and that the pads are not swapped.",
        )
    described = np.asarray(which)[kept]
    return Places(kept, described, rest_mm[described])
