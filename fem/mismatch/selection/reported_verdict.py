"""What the held-out recordings leave of a verdict, and the E that is said with it.

A name that explains all recordings best must not predict those left out worse than the plain model does; a
property of the fruit must explain at least half of what they show beyond noise, or leave no more than sound
recordings do (a fault of a sensor shows in the balance of forces too, which this does not count). Else it
stands for something that the catalogue does not have. What E is said goes with the verdict: that of the plain
model where nothing is missing, its spread what effects that went undetected may do to it too; the mean over
all names that cannot be told apart, by their probabilities, its spread what they differ by too and what a
second effect beside them may do; and where something unknown is missing that of the plain model, as uncertain
as unknown physics has made it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from fem.mismatch.gel_fault import GelFault, faults_of_relation
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import NONE, UNKNOWN, Candidate, HeldOut, Modulus, mixture
from fem.mismatch.selection.detection import statistic_p
from fem.mismatch.selection.forward_selection import added_gains
from fem.mismatch.selection.model_selection import ModelSelection, NullCase
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.screening import LinearRound
from fem.mismatch.thresholds import (
    ABOVE_NOISE_SHARE,
    HELD_OUT_FLOOR,
    LARGE_MISFIT,
    LARGE_MISFIT_MODULUS_SD,
    MOST_LEFT,
    P_EXPONENT,
    TEMPERATURE,
    UNKNOWN_MODULUS_SD,
    WORSE_SHARE,
)

LEAST_P = 1e-6
"""Of an undetected effect p is above DETECTION_P; this only keeps a power finite."""


def fails_held_out(proof: HeldOut | None, *, of_fruit: bool) -> bool:
    """Whether recordings left out bear out no such name: `of_fruit`, of a property of the fruit, or not.

    Not to be said where the plain model leaves no more than noise, or of one recording alone.
    """
    if proof is None or proof.rms_before < (1 + ABOVE_NOISE_SHARE) * proof.noise_rms:
        return False
    if not proof.rms_after <= (1 + WORSE_SHARE) * proof.rms_before:
        return True
    if not of_fruit:
        return False
    noise = proof.noise_rms**2
    may_leave = max(MOST_LEFT * (proof.rms_before**2 - noise), HELD_OUT_FLOOR**2)
    return not proof.rms_after**2 - noise <= may_leave


def _of_fruit(again: Refit) -> bool:
    return any(effect.spec.family == "object" for effect in again.effects)


def borne_out(
    found: ModelSelection, proof_of: Callable[[Refit], HeldOut | None]
) -> tuple[ModelSelection, tuple[str, ...]]:
    """The selection with those names alone that recordings left out bear out, and the others.

    The names that stand come first in the ranking, the others last and without a probability; where none
    stands, the verdict is "unknown". `proof_of`: the held-out recordings by a refit.
    """
    if found.verdict in (NONE, UNKNOWN):
        return found, ()
    names = (found.verdict,) if isinstance(found.verdict, str) else found.verdict
    worse = tuple(
        one.name
        for one in found.ranking
        if one.name in names
        and one.refit is not None
        and fails_held_out(proof_of(one.refit), of_fruit=_of_fruit(one.refit))
    )
    left = tuple(name for name in names if name not in worse)
    if not worse:
        return found, ()
    if not left:
        return replace(found, verdict=UNKNOWN), worse
    stands = sum(one.probability for one in found.ranking if one.name not in worse)
    ranking = tuple(
        replace(one, probability=0.0 if one.name in worse else one.probability / stands)
        for one in sorted(found.ranking, key=lambda one: one.name in worse)
    )
    first = [one for one in ranking if one.name in left and one.refit is not None]
    if not first:
        return replace(found, verdict=UNKNOWN), worse
    ranking = (first[0], *(one for one in ranking if one is not first[0]))
    return replace(found, ranking=ranking, verdict=left[0] if len(left) == 1 else left), worse


def undetected_spread(found: ModelSelection, p_value: float) -> float:
    """Relative spread of E by effects that may be there though none was detected."""
    known = [one for one in found.ranking if one.linear_fits]
    return _spread_of_some([(one.gain, one.linear_fits[0].modulus_spread) for one in known], p_value)


def second_spread(linear: LinearRound, named: Refit, null_case: NullCase) -> float:
    """Relative spread of E by a second effect that may be there beside the named one, and is not named.

    p is that of sound recordings whose best effect adds as much.
    """
    best_of: dict[str, tuple[float, float]] = {}
    for gain, one in added_gains(linear, named):
        own = (null_case.excess_gain(one, gain), one.modulus_spread)
        best_of[one.name] = max(best_of.get(one.name, own), own)
    known = list(best_of.values())
    most = max((gain for gain, _ in known), default=0.0)
    return _spread_of_some(known, statistic_p("best single", most / null_case.compliance_ratio))


@dataclass(frozen=True, kw_only=True)
class HiddenGelFault:
    """A fault of the gel that is not named and that force against displacement does not exclude: its
    parameters as measured, its probability, and the relative change of E by it.
    """

    name: str
    values: Mapping[str, float]
    probability: float
    modulus_change: float

    @property
    def spread(self) -> float:
        """Relative spread of E, which is without it: root mean square."""
        return float(np.sqrt(self.probability) * abs(self.modulus_change))


def hidden_gel_faults(
    forward: ForwardModel, faults: Sequence[GelFault], named: Refit | None
) -> list[HiddenGelFault]:
    """Those of `faults` with which the flesh's equations fit better.

    At even odds beforehand one is there with probability 1 / (1 + exp(-ln evidence)). None beside a named one
    of the same relation: each shows in part as another.
    """
    if named is not None and faults_of_relation(named.effects):
        return []
    measured = [(fault, fault.measured(forward)) for fault in faults_of_relation(faults)]
    return [
        HiddenGelFault(
            name=fault.spec.name,
            values=known.values,
            probability=float(expit(known.evidence)),
            modulus_change=fault.modulus_change(forward),
        )
        for fault, known in measured
        if known is not None and fault.flesh_gain(forward) > 0
    ]


def _spread_of_some(known: Sequence[tuple[float, float]], p_value: float) -> float:
    """Relative spread of E by one of several effects, given the gain of each and the spread of E with it.

    On sound fruit p is uniform; with an effect its density is taken as x p^(x - 1), x = P_EXPONENT (Sellke,
    Bayarri and Berger 2001, The American Statistician 55, 62-71). At even odds beforehand that is the
    probability of some effect; which one, their gains say.
    """
    if not known:
        return 0.0
    density_ratio = P_EXPONENT * max(p_value, LEAST_P) ** (P_EXPONENT - 1)
    gain, spread = np.array(known).T
    weight = np.exp((gain - gain.max()) / TEMPERATURE)
    return float(np.sqrt(density_ratio / (1 + density_ratio) * (weight @ spread**2) / weight.sum()))


def reported_modulus(
    verdict: str | tuple[str, ...],
    ranking: Sequence[Candidate],
    plain: Modulus,
    *,
    undetected: float = 0.0,
    proof: HeldOut | None = None,
) -> Modulus:
    """E as the module's docstring says. `undetected`: of undetected_spread, or second_spread beside a name,
    and of hidden_gel_faults; `proof`: of the plain model.
    """
    if verdict == UNKNOWN:
        return _widened(plain, unknown_spread(proof))
    return _widened(plain if verdict == NONE else _of_names(verdict, ranking, plain), undetected)


def unknown_spread(proof: HeldOut | None) -> float:
    """Relative spread of E by physics that is not known."""
    large = proof is not None and proof.rms_before > LARGE_MISFIT * proof.noise_rms
    return LARGE_MISFIT_MODULUS_SD if large else UNKNOWN_MODULUS_SD


def _widened(modulus: Modulus, relative_sd: float) -> Modulus:
    return replace(modulus, sd=float(np.hypot(modulus.sd, relative_sd * modulus.value)))


def _of_names(verdict: str | tuple[str, ...], ranking: Sequence[Candidate], plain: Modulus) -> Modulus:
    """The mean over the names, by their probabilities; the plain model's E where none has one."""
    names = (verdict,) if isinstance(verdict, str) else verdict
    known = [(one.probability, one.modulus) for one in ranking if one.effect in names and one.modulus]
    shares = [share for share, _ in known]
    return mixture(shares, [modulus for _, modulus in known]) if sum(shares) > 0 else plain
