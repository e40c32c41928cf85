"""Of a rigid object between gel pads: how far the gels themselves are pressed in, as their markers show."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from tactile.io.recording import GelPad

UNDER = 0.5
"""Of the deepest marker's indentation, above which a marker lies under the object. Set by hand."""
FEWEST = 4
"""Markers under a ball from which its lowest point is fitted: three unknowns, and one to spare."""


def gel_give_mm(pad: GelPad, *, shape: Literal["ball", "block"], size_mm: float) -> Float[np.ndarray, " t"]:
    """Indentation of the gel at the object's foremost point, mm, for each frame; 0 where nothing presses.

    Under a ball of radius R a marker that touches stands at depth d - r^2/2R, r its distance from the lowest
    point, so that depth + (x^2 + y^2)/2R = a + b x + c y over the markers that are pressed in at least half
    as deep as the deepest, and d = a + R (b^2 + c^2)/2 (the sphere's paraboloid: off by r^4/8R^3). Under a
    flat block it is the mean of these. With fewer than four of them it is the deepest one's own.
    """
    position = pad.rest_mm + pad.displacement_mm
    pressed = -pad.displacement_mm[:, :, 2]
    height = -position[:, :, 2]
    found = np.zeros(len(pressed))
    for t in np.flatnonzero(pressed.max(axis=1) > 0):
        under = pressed[t] > UNDER * pressed[t].max()
        if shape == "block":
            found[t] = float(height[t, under].mean())
        elif under.sum() < FEWEST:
            found[t] = float(height[t, under].max())
        else:
            found[t] = _apex_mm(position[t, under, :2], height[t, under], radius_mm=size_mm / 2)
    return found


def _apex_mm(places: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, " n"], *, radius_mm: float) -> float:
    """Depth of a ball's lowest point from markers that it has pressed in."""
    middle = places.mean(axis=0)
    around = places - middle
    rows = np.column_stack([np.ones(len(around)), around])
    raised = depth + (around**2).sum(axis=1) / (2 * radius_mm)
    a, b, c = np.linalg.lstsq(rows, raised, rcond=None)[0]
    return float(a + radius_mm * (b * b + c * c) / 2)
