"""`drainage`: flesh under load loses juice: its bulk resistance fades, its shear resistance does not.

    sigma = 2 mu eps + lambda (tr eps - s m) 1,      tau m' = tr eps - m

s: share of lambda that fades; m: drained volumetric strain. This is poroelasticity (Biot 1941) with one
drainage time for all flesh, whatever the length of the juice's path; Christensen, "Theory of
Viscoelasticity", 1982, chapter 1, has it as a relaxing bulk modulus. E is the instantaneous modulus.

K_v = lambda K_lambda is the stiffness against loss of volume, and K0 = mu K_mu + K_v, both in the space of
fem.mismatch.model.reduced_law. The modes phi_k fulfil

    K_v phi_k = b_k K0 phi_k,      phi_k' K0 phi_l = 1 where k = l, else 0,      0 <= b_k <= 1

b_k: the mode's volume share. The modes' amplitudes z under their loads F = phi_k' f are uncoupled,

    z - s b_k m = F,      tau m' = z - m

which is flesh of one relaxing arm, g = s b_k (fem.materials.relaxing_arm). It needs no time stepping.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.fading_law import FadingLaw, lagged
from fem.mismatch.kinds.linear_law import matrix_operator
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.model.reduced_law import ReducedLaw, first_changes, reduced_laws

LEAST_OWN = 1e-10
"""Directions of the space with a smaller share in K0 are rounding errors (its fields are nearly parallel)."""

SPEC = EffectSpec(
    name="drainage",
    rank=15,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh loses juice while it is held: it gives up volume slowly",
        meaning="Under a steady squeeze the flesh's resistance to losing volume fades, as juice moves out of "
        "it, while its resistance to a change of shape stays.",
        advice="Compare fruit at the same speed and hold time, or apply the effect to the batch so that the "
        "modulus is the one at the first instant.",
    ),
    parameters=(
        EffectParameter(
            "volume_share",
            "1",
            "share of the resistance to losing volume (Lame's lambda) that fades",
            limits=(0.0, 1.0),
            low=0.01,
            high=0.98,
        ),
        EffectParameter(
            "tau_s",
            "s",
            "time over which it fades",
            limits=(1e-6, 1e6),
            low=0.05,
            high=200.0,
            log=True,
        ),
    ),
    knows_time=True,
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True, kw_only=True)
class FadingVolume:
    """Modes of one recording. `law`: its reduced law of parts K_mu and K_lambda. By mode: `volume_share` b,
    `load` phi' f of each leading pattern, `at_markers`: displacement of the markers.
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
        """Mean of b over the modes, weighted by their volumetric energy."""
        weight = self.volume_share * (self.load**2).sum(axis=1)
        return float(weight @ self.volume_share / weight.sum())

    def change(self, recording: GraspResponse, *, share: float, tau_s: float) -> Float[np.ndarray, "f n 3"]:
        """Change of c(t), mm MPa, if a `share` s of lambda fades with the time tau."""
        g = share * self.volume_share
        lag = lagged(recording, self.law.shares @ self.load.T, tau_s / (1 - g))
        return np.asarray(np.tensordot(g / (1 - g) * lag, self.at_markers, axes=1))


def _volume_forces(model: CaseModel, moved: Float[np.ndarray, "r m 3"]) -> Float[np.ndarray, "r m 3"]:
    """-lambda K_lambda U: minus the nodal forces by which the flesh resists loss of volume."""
    _, lame = unit_lame_constants(model.poisson_ratio)
    return np.asarray(-lame * matrix_operator(model.parts.k_lambda)(moved))


def _at_once(model: CaseModel) -> Fields:
    return first_changes(model, lambda moved: _volume_forces(model, moved))


def _fading_volumes(model: CaseModel) -> list[FadingVolume]:
    """The modes of every recording, solved for once."""

    def compute() -> list[FadingVolume]:
        mu, lame = unit_lame_constants(model.poisson_ratio)
        laws = reduced_laws(
            model,
            derivative=lambda moved: _volume_forces(model, moved),
            parts=(matrix_operator(model.parts.k_mu), matrix_operator(model.parts.k_lambda)),
        )
        return [FadingVolume.of(law, mu=mu, lame=lame) for law in laws]

    return model.memoised(SPEC.name, compute)


def _drained(model: CaseModel, share: float, tau_s: float) -> Fields:
    return [
        volume.change(recording, share=share, tau_s=tau_s)
        for volume, recording in zip(_fading_volumes(model), model.grasps, strict=True)
    ]


EFFECT: Effect = FadingLaw(
    spec=SPEC,
    at_once=_at_once,
    response=_drained,
    weight=lambda model: float(np.mean([volume.typical_share for volume in _fading_volumes(model)])),
)
