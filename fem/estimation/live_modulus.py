"""The modulus from one frame, while a gripper closes: one product with C, and seven unknowns.

Every marker is compared with its own first touch (see fem.estimation.compliance_fit),

    y_i - y_i(t_i) = s [c_i - c_i(t_i)] + [R q - R q(t_i)]_i + noise,        c = C f,

s = 1/E and q the fruit's rigid motion, if nothing holds it. In every frame q = u - s v, with u and v the
rigid motions fitted to the markers' motion and to the response. So q(t_i) needs no s from an early, lightly
loaded frame. Estimates that need a whole recording, such as marker scales and noise in the forces, are left
to fem.estimation.modulus.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.grasp_model import marker_compliance
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import PadLink

FEWEST = 6
"""Markers in contact below which a frame gives no modulus."""


@dataclass(frozen=True, kw_only=True)
class LiveModel:
    """A grasp's prepared model: C in single precision (its error is a millionth), the rigid motions."""

    compliance: Float[np.ndarray, "d d"]
    rigid: Float[np.ndarray, "d 6"]
    fruit_moves: bool

    @classmethod
    def of(cls, links: Sequence[PadLink], solid: UnitModulusSolid) -> "LiveModel":
        """The model of all pads' markers, side by side, on a solid that has their contact nodes."""
        place_mm = np.vstack([link.place.point_mm for link in links])
        return cls(
            compliance=marker_compliance(links, solid.contact_compliance).astype(np.float32),
            rigid=rigid_motion(place_mm).reshape(-1, 6),
            fruit_moves=solid.support == "free",
        )


@dataclass(frozen=True, kw_only=True)
class FirstTouch:
    """Each marker's position and model response at its first touch, less the fruit's motions u and v.

    `touching`: which markers touch; `motion`: u and v of the last frame.
    """

    position_mm: Float[np.ndarray, "n 3"]
    response: Float[np.ndarray, "n 3"]
    touching: Bool[np.ndarray, " n"]
    motion: Float[np.ndarray, "6 2"]

    @classmethod
    def none(cls, markers: int) -> "FirstTouch":
        """Before the first frame."""
        return cls(
            position_mm=np.zeros((markers, 3)),
            response=np.zeros((markers, 3)),
            touching=np.zeros(markers, dtype=bool),
            motion=np.zeros((6, 2)),
        )


@dataclass(frozen=True, kw_only=True)
class FrameEstimate:
    """E and its standard deviation from the markers' noise (NaN if too few touch, or without 1/E above zero).

    `residual_mm`: residual of each marker's motion since its first touch, NaN out of contact.
    """

    E_MPa: float
    E_sd_MPa: float
    residual_mm: Float[np.ndarray, "n 3"]


def frame_modulus(
    model: LiveModel,
    before: FirstTouch,
    *,
    position_mm: Float[np.ndarray, "n 3"],
    force_N: Float[np.ndarray, "n 3"],
    touching: Bool[np.ndarray, " n"],
    sd_mm: float,
) -> tuple[FrameEstimate, FirstTouch]:
    """One frame of all pads' markers side by side (fruit frame), and the first touches to hand to the next.

    `force_N`: the gel's forces on the fruit; `sd_mm`: noise of one component of a marker's position.
    """
    response = (model.compliance @ force_N.ravel().astype(np.float32)).astype(float).reshape(-1, 3)
    old, new = touching & before.touching, (touching & ~before.touching)[:, None]
    changes = np.stack([position_mm - before.position_mm, response - before.response], axis=2)
    since = changes[old].reshape(-1, 2)
    motion, modulus, spread = before.motion, np.nan, np.nan
    residual = np.full(position_mm.shape, np.nan)
    if old.sum() >= FEWEST:
        if model.fruit_moves:
            rigid = model.rigid.reshape(len(old), 3, 6)[old].reshape(-1, 6)
            motion = np.linalg.pinv(rigid.T @ rigid, rcond=1e-12, hermitian=True) @ (rigid.T @ since)
            since = since - rigid @ motion
        moved, unit = since.T
        signal = float(unit @ unit)
        compliance = float(unit @ moved) / signal if signal > 0 else 0.0
        residual[old] = (moved - compliance * unit).reshape(-1, 3)
        if compliance > 0:
            modulus = 1 / compliance
            spread = float(np.sqrt(2 / signal)) * sd_mm * modulus**2  # two frames' noise in every difference
    rigid_mm, rigid_response = (model.rigid @ motion).reshape(-1, 3, 2).transpose(2, 0, 1)
    return FrameEstimate(E_MPa=modulus, E_sd_MPa=spread, residual_mm=residual), FirstTouch(
        position_mm=np.where(new, position_mm - rigid_mm, before.position_mm),
        response=np.where(new, response - rigid_response, before.response),
        touching=touching,
        motion=motion,
    )
