"""Share of a curve's travel that is the rig's own; if it is too large, E is only a lower bound."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fem.indentation.fit import TraceFit, fit
from fem.indentation.no_contact import NoContactNoise, first_touch
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import NINETY

UNSURE = 0.3
"""Relative error of the object's compliance by the rig's standard deviation beyond which E is a lower bound.
Set by hand."""
MOST_SHARE = 0.3
"""Largest share of a rig of stated stiffness in the slope of the recorded travel: E is then
1 / (1 - 0.3) = 1.43 times its value from the travel, an error similar to UNSURE. Set by hand."""
SAID_SHARE = 0.1
"""The same share, above which a note states by how much E is too low. Set by hand."""
SOFT_RIG_N_PER_MM = 8.0
"""Assumed stiffness of an unknown rig: that of a parallel gripper with soft pads, the softest in ordinary
use. For comparison, a golf ball between a gripper's gels has 2 to 4 N/mm up to 25 N, arms have some 10 to
50 N/mm, presses on a frame some hundreds. With MOST_SHARE, contacts above 2.4 N/mm get a note: 44 kiwis have
0.2 to 2.0 (two get one), pieces of meat and silicone 0.1 to 0.7 (one of 37), mangoes 2.3 to 12 (half of 70),
from the tenth to the ninetieth percentile."""
OF_A_TRACE = "(drupe calibrate --rigid, drupe convert --rig), or give rig_N_per_mm in case.toml"
OF_A_BATCH = "(drupe calibrate --rigid) and name what it writes as `rig` in batch.toml"
"""How to state a rig after squeezing a rigid object."""
UPPER = 0.5
"""Share of the peak force above which slopes are fitted. Set by hand: the upper half determines E."""


@dataclass(frozen=True, kw_only=True)
class RigShare:
    """Slopes over the upper half of the force, mm/N: of the recorded travel, and of the rig's part of it.

    `bound`: end of a sentence on why E is a lower bound, or None if it is not; `notes`: sentences.
    """

    recorded_mm_per_N: float
    rig_mm_per_N: float
    rig_sd_mm_per_N: float = 0.0
    bound: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Share of the rig in the recorded travel; 1 if the travel does not grow."""
        return min(self.rig_mm_per_N / max(self.recorded_mm_per_N, 1e-12), 1.0)


def rig_share(trace: IndenterTrace, *, rig_N_per_mm: float | None, made_known: str = OF_A_TRACE) -> RigShare:
    """Influence of the rig on E: from the curve subtracted from the travel, from a stated stiffness, or for
    an unknown rig from an assumed stiffness.

    Springs in series: 1/k = 1/k_o + 1/k_r, k the recorded slope, k_o the object's, k_r the rig's. If the rig
    was subtracted, the error of 1/k_o is that of 1/k_r; otherwise E is too low by its share k/k_r. Of several
    recordings, the one with the rig's largest share counts. `made_known`: how to state the rig, for the note
    on an unknown one.
    """
    if len(trace.parts) > 1:
        each = [rig_share(part, rig_N_per_mm=rig_N_per_mm, made_known=made_known) for part in trace.parts]
        return max(each, key=lambda part_share: part_share.share)
    used = _upper_half(trace)
    force, slope = trace.force_N[used], _slope(trace.force_N[used], trace.travel_mm[used])
    if trace.rig_give_mm is not None and trace.rig_sd_mm is not None:
        give_mm, sd_mm = trace.rig_give_mm, trace.rig_sd_mm
        rig, peak = _slope(force, give_mm[used]), int(np.argmax(trace.force_N))
        of_size = float(sd_mm[peak] / max(float(give_mm[peak]), 1e-12)) * rig
        return _of_a_known_rig(slope + rig, rig, max(abs(_slope(force, sd_mm[used])), of_size))
    assumed = RigShare(recorded_mm_per_N=slope, rig_mm_per_N=1 / (rig_N_per_mm or SOFT_RIG_N_PER_MM))
    share, stiffness = assumed.share, 1 / max(slope, 1e-12)
    if not share > (MOST_SHARE if rig_N_per_mm is None else SAID_SHARE):
        return assumed
    if rig_N_per_mm is None:
        note = (
            f"The contact has {stiffness:.3g} N/mm at the upper half of its force, and nothing says how "
            f"stiff the rig is. E holds on a rig of {stiffness / SAID_SHARE:.2g} N/mm or more and is a "
            f"lower bound on a softer one: a gripper with soft pads, of {SOFT_RIG_N_PER_MM:g} N/mm, would "
            f"give {share:.0%} of that travel itself. Squeeze a rigid object {made_known}."
        )
        return replace(assumed, notes=(note,))
    if share > MOST_SHARE:
        bound = (
            f"of the travel at the upper half of the force {share:.0%} is the rig's own "
            f"({stiffness:.3g} N/mm were recorded on a rig of {rig_N_per_mm:g} N/mm)"
        )
        return replace(assumed, bound=bound)
    note = (
        f"A rig of {rig_N_per_mm:g} N/mm gives {share:.0%} of the travel at the upper half of the "
        "force: E is too low by about as much; drupe convert --rig takes it off."
    )
    return replace(assumed, notes=(note,))


def _of_a_known_rig(slope: float, rig: float, sd: float) -> RigShare:
    """Share of a subtracted rig, with `bound` if its error is too large for the object's own slope."""
    known = RigShare(recorded_mm_per_N=slope, rig_mm_per_N=rig, rig_sd_mm_per_N=sd)
    bound = (
        None
        if slope - rig > sd / UNSURE
        else (
            f"of {slope:.3g} mm/N of travel at the upper half of the force the rig gives "
            f"{rig:.3g} ± {sd:.2g} mm/N, so that what is left to the object is not known"
        )
    )
    note = (
        f"Taken off as the rig's own: {known.share:.0%} of the travel at the upper half of the force "
        f"({rig:.3g} ± {sd:.2g} of {slope:.3g} mm/N); its spread is in E's."
    )
    return replace(known, bound=bound, notes=(note,))


def ln_E_with_other_rig(
    known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise, *, give_sd: float
) -> float:
    """ln E of the law refitted with the rig's displacement `give_sd` standard deviations smaller; the law's
    own ln E if no rig was subtracted.

    The rig's error is a consider parameter, not fitted (Schmidt, "Application of state-space methods to
    navigation problems", Adv. Control Syst. 3, 1966, 293-340): it resembles the contact's own curve, so that
    a fit would use it to absorb the law's other residuals.
    """
    if trace.rig_sd_mm is None:
        return float(known.scaled[0])
    moved = replace(trace, travel_mm=trace.travel_mm + give_sd * trace.rig_sd_mm)
    return float(fit(known.law, moved, no_contact, known.scaled[None]).scaled[0])


def least_modulus(plain: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> float:
    """Lower 95 % bound of E, MPa, with the rig's displacement at the lower end of its error.

    It uses linear elasticity, which is a bound with an effect too: flesh that relaxes or yields was stiffer.
    Any rig displacement that was not subtracted leaves the object less travel.
    """
    ln_E = ln_E_with_other_rig(plain, trace, no_contact, give_sd=NINETY)
    return float(np.exp(ln_E - NINETY * plain.sd[0]))


def rig_spread(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> float:
    """Standard deviation of ln E by the rig's error: half the change of ln E between -1 and +1 sd."""
    less, more = (ln_E_with_other_rig(known, trace, no_contact, give_sd=way) for way in (-1.0, 1.0))
    return 0.5 * abs(more - less)


def _upper_half(trace: IndenterTrace) -> Int[np.ndarray, " u"]:
    """Frames of loading with a force in the upper half, at least two; frames with an unchanged travel reading
    are excluded.
    """
    touch, peak = first_touch(trace), int(np.argmax(trace.force_N))
    new = np.r_[True, np.diff(trace.travel_mm) != 0.0]
    way_in = touch + np.flatnonzero(new[touch : peak + 1])
    level = float(np.median(trace.force_N[: max(touch - 1, 1)]))
    upper = trace.force_N[way_in] - level > UPPER * (trace.force_N[peak] - level)
    return np.asarray(way_in[-max(int(upper.sum()), 2) :])


def _slope(force: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"]) -> float:
    """Slope of the least-squares line, mm/N."""
    off = force - force.mean()
    return float(off @ travel / max(float(off @ off), 1e-30))
