"""A gel pad against skin: an elastic layer with Coulomb friction.

The gel is a bed of springs on a rigid back: pressure p = kn depth, shear t = -kt (x - X), |t| <= friction p.
The anchor X is the gel point that the skin point x met at first touch. Skin at the limit slips and drags its
anchor along. In the pad frame z points out of the gel, so that a depth is a negative z.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, kw_only=True)
class Gel:
    """Normal and shear stiffness per area, and friction between gel and skin. `reach_mm`: how far adhering
    skin draws out the gel before it detaches (0: no adhesion).
    """

    kn_MPa_per_mm: float = 0.22
    kt_MPa_per_mm: float = 0.055
    friction: float = 0.8
    reach_mm: float = 0.0


DEFAULT_GEL = Gel()
"""Gel of the sample batch."""


def traction(
    gel: Gel,
    position_mm: Float[np.ndarray, "n 3"],
    anchor_mm: Float[np.ndarray, "n 2"],
    stuck: Bool[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Force per gel area on the skin (MPa, pad frame) and its derivative by the position (MPa/mm).

    Points that are `stuck` pull and keep their shear at any distance.
    """
    n = len(position_mm)
    pressed = position_mm[:, 2] < 0
    inside = pressed if stuck is None else pressed | stuck
    pressure = np.where(inside, -gel.kn_MPa_per_mm * position_mm[:, 2], 0.0)
    trial = -gel.kt_MPa_per_mm * (position_mm[:, :2] - anchor_mm)
    size, limit = np.linalg.norm(trial, axis=1), gel.friction * pressure
    slips = pressed & (size > limit)
    direction = trial / np.maximum(size, 1e-30)[:, None]
    shear = np.where(slips[:, None], limit[:, None] * direction, trial)
    force = np.zeros((n, 3))
    force[:, :2] = np.where(inside[:, None], shear, 0.0)
    force[:, 2] = pressure
    slope = np.zeros((n, 3, 3))
    slope[inside, 2, 2] = -gel.kn_MPa_per_mm
    stiff = np.where(slips, limit / np.maximum(size, 1e-30), 1.0)[:, None, None] * np.eye(2)
    ring = np.where(slips, limit / np.maximum(size, 1e-30), 0.0)[:, None, None]
    block = -gel.kt_MPa_per_mm * (stiff - ring * direction[:, :, None] * direction[:, None, :])
    slope[:, :2, :2] = np.where(inside[:, None, None], block, 0.0)
    drag = -gel.friction * gel.kn_MPa_per_mm * direction
    slope[:, :2, 2] = np.where(slips[:, None], drag, 0.0)
    return force, slope
