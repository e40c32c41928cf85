"""Flesh whose resistance to losing volume fades, in the reduced space of another linear law.

With K_v = lambda K_lambda, what resists a loss of volume, and K0 = mu K_mu + K_v, both in the space V of
fem.mismatch.model.reduced_law, modes phi_k are those with

    K_v phi_k = b_k K0 phi_k,      phi_k' K0 phi_l = 1 where k = l, else 0,      0 <= b_k <= 1

b_k: the mode's volume share. In `sigma = 2 mu eps + lambda (tr eps - s m) 1, tau m' = tr eps - m` each mode's
amplitude z under its load F = phi_k' f then stands alone,

    z - s b_k m = F,      tau m' = z - m

which is flesh of one relaxing arm, g = s b_k (fem.materials.relaxing_arm). No step in time is needed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.relaxing_arm import lagging
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import over_all_frames
from fem.mismatch.model.reduced_law import ReducedLaw

LEAST_OWN = 1e-10
"""Directions of V whose share in K0 is smaller are rounding (V's fields are nearly parallel)."""


@dataclass(frozen=True, kw_only=True)
class FadingVolume:
    """One recording. `law`: its reduced law of parts K_mu and K_lambda. By mode: `volume_share` b, `load`
    phi' f of each leading pattern, `at_markers` as a law's.
    """

    law: ReducedLaw
    volume_share: Float[np.ndarray, " k"]
    load: Float[np.ndarray, "k r"]
    at_markers: Float[np.ndarray, "k n 3"]

    @classmethod
    def of(cls, law: ReducedLaw, *, mu: float, lame: float) -> "FadingVolume":
        """Solves for the modes."""
        volume = lame * law.parts[1]
        whole = mu * law.parts[0] + volume
        size = np.sqrt(np.diag(whole))
        stiffness, turn = np.linalg.eigh(whole / np.outer(size, size))
        stiff = stiffness > LEAST_OWN * stiffness[-1]
        even = turn[:, stiff] / np.sqrt(stiffness[stiff]) / size[:, None]
        share, turn = np.linalg.eigh(even.T @ volume @ even)
        modes = even @ turn
        return cls(
            law=law,
            volume_share=share.clip(0.0, 1.0),
            load=modes.T @ law.load,
            at_markers=np.tensordot(modes.T, law.recording, axes=1),
        )

    @property
    def typical_share(self) -> float:
        """Mean of b over the modes, each as it stores energy of volume."""
        weight = self.volume_share * (self.load**2).sum(axis=1)
        return float(weight @ self.volume_share / weight.sum())

    def response(self, recording: GraspResponse, *, share: float, tau_s: float) -> Float[np.ndarray, "f n 3"]:
        """c(t), mm MPa, where a `share` s of lambda fades by tau."""
        g = share * self.volume_share
        load = over_all_frames(recording, self.law.shares) @ self.load.T
        lag = lagging(load, recording.case.history.time_s, tau_s / (1 - g))
        amplitude = (load + g / (1 - g) * lag)[recording.used]
        return np.asarray(np.tensordot(amplitude, self.at_markers, axes=1) + self.law.unchanged)
