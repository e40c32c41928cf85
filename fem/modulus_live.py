"""The modulus from one frame, while a gripper closes: one product with C, and seven unknowns.

Every marker is compared with its own first touch (fem.modulus_fit says why),

    y_i - y_i(t_i) = s [c_i - c_i(t_i)] + [R q]_i + noise,        c = C f,

s = 1/E and q the fruit's rigid motion since then, where nothing holds it. What a whole recording allows
beyond that, scales of markers and noise in the forces among it, is left to fem.modulus.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.grasp_model import GraspModel
from fem.modulus_fit import rigid_motion

FEWEST = 6
"""Markers in contact below which a frame gives no modulus."""


@dataclass(frozen=True, kw_only=True)
class LiveModel:
    """A grasp's model made ready: C in single precision (its error is a millionth), the rigid motions."""

    compliance: Float[np.ndarray, "d d"]
    rigid: Float[np.ndarray, "d 6"]
    fruit_moves: bool

    @classmethod
    def of(cls, model: GraspModel) -> "LiveModel":
        """Takes some milliseconds, once per grasp."""
        return cls(
            compliance=model.compliance.astype(np.float32),
            rigid=rigid_motion(model.place_mm).reshape(-1, 6),
            fruit_moves=model.fruit_moves,
        )


@dataclass(frozen=True, kw_only=True)
class FirstTouch:
    """Where each marker was when it touched, and the model's response then; `touching` says which do."""

    position_mm: Float[np.ndarray, "n 3"]
    response: Float[np.ndarray, "n 3"]
    touching: Bool[np.ndarray, " n"]

    @classmethod
    def none(cls, markers: int) -> "FirstTouch":
        """Before the first frame."""
        return cls(
            position_mm=np.zeros((markers, 3)),
            response=np.zeros((markers, 3)),
            touching=np.zeros(markers, dtype=bool),
        )


@dataclass(frozen=True, kw_only=True)
class FrameEstimate:
    """E and its standard deviation from the markers' noise (NaN where too few touch, or nothing gives way).

    `residual_mm`: what the model leaves of each marker's motion since its first touch, NaN out of contact.
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

    `force_N`: what the gel puts on the fruit; `sd_mm`: noise of one component of a marker's place.
    """
    response = (model.compliance @ force_N.ravel().astype(np.float32)).astype(float).reshape(-1, 3)
    new = touching & ~before.touching
    since = FirstTouch(
        position_mm=np.where(new[:, None], position_mm, before.position_mm),
        response=np.where(new[:, None], response, before.response),
        touching=touching,
    )
    old = touching & before.touching
    residual = np.full(position_mm.shape, np.nan)
    nothing = FrameEstimate(E_MPa=np.nan, E_sd_MPa=np.nan, residual_mm=residual)
    if old.sum() < FEWEST:
        return nothing, since
    moved = (position_mm - since.position_mm)[old].ravel()
    columns = (response - since.response)[old].reshape(-1, 1)
    if model.fruit_moves:
        columns = np.hstack([columns, model.rigid.reshape(len(old), 3, 6)[old].reshape(-1, 6)])
    inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True)
    amounts = inverse @ (columns.T @ moved)
    residual[old] = (moved - columns @ amounts).reshape(-1, 3)
    if not amounts[0] > 0:
        return nothing, since
    spread = np.sqrt(2 * inverse[0, 0]) * sd_mm / amounts[0]  # two frames' noise in every difference
    modulus = 1 / float(amounts[0])
    return FrameEstimate(E_MPa=modulus, E_sd_MPa=float(spread) * modulus, residual_mm=residual), since
