"""How much of a trace's travel is the rig's own: where most of it is, E is a lower bound and no more."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fem.indentation.fit import TraceFit, fit
from fem.indentation.no_contact import NoContactNoise, first_touch
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import NINETY

UNSURE = 0.3
"""Error of the object's own compliance over it, by the rig's spread, beyond which E is a lower bound. Set by
hand."""
MOST_SHARE = 0.3
"""Of the slope of the recorded travel that a rig of stated stiffness may give: E is then 1 / (1 - 0.3) = 1.43
times what the travel says, as far off as UNSURE. Set by hand."""
SAID_SHARE = 0.1
"""Of the same, from which it is said by how much E is too low. Set by hand."""
SOFT_RIG_N_PER_MM = 8.0
"""Stiffness that is taken for a rig's of which nothing is known: of a parallel gripper with soft pads, the
softest in ordinary use. Assumed: a golf ball between a gripper's gels takes 2 to 4 N/mm over its way to 25 N,
arms have some 10 to 50 N/mm, presses on a frame some hundreds. With MOST_SHARE
contacts above 2.4 N/mm are said: 44 kiwis have 0.2 to 2.0 (two are said), pieces of meat and silicone 0.1 to
0.7 (one of 37), mangoes 2.3 to 12 (half of 70), from the tenth to the
ninetieth percentile."""
OF_A_TRACE = "(drupe calibrate --rigid, drupe convert --rig), or give rig_N_per_mm in case.toml"
OF_A_BATCH = "(drupe calibrate --rigid) and name what it writes as `rig` in batch.toml"
"""How a rig is made known, beside squeezing a rigid object."""
UPPER = 0.5
"""Share of the peak force above which slopes are taken. Set by hand: E is ruled by the upper half."""


@dataclass(frozen=True, kw_only=True)
class RigShare:
    """Slopes over the upper half of the force, mm/N: of the travel as it was recorded, and of the rig in it.

    `bound`: a sentence's end that says why E is a lower bound, None where it is none; `notes`: sentences.
    """

    recorded_mm_per_N: float
    rig_mm_per_N: float
    rig_sd_mm_per_N: float = 0.0
    bound: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Of the recorded travel that the rig gives; all of it where the travel does not grow."""
        return min(self.rig_mm_per_N / max(self.recorded_mm_per_N, 1e-12), 1.0)


def rig_share(trace: IndenterTrace, *, rig_N_per_mm: float | None, made_known: str = OF_A_TRACE) -> RigShare:
    """What the rig does to E: by the curve that was taken off the travel, or by a stated stiffness, or, where
    nothing is known, by an ordinary one.

    Springs in series: 1/k = 1/k_o + 1/k_r, k the recorded slope, k_o the object's, k_r the rig's. Of a rig
    that was taken off, the error of 1/k_o is that of 1/k_r; of one that was not, its share k/k_r is what E is
    too low by. Of several recordings the one in which the rig gives the largest share. `made_known`: where
    the rig is to be stated, in the note for one of which nothing is known.
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
    """What is left to the object of the recorded slope, and whether it is clear of the rig's spread."""
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
    """ln E of the law refitted with the rig's give so many standard deviations less; its own where none was
    taken off.

    The rig's error is considered, not fitted (Schmidt, "Application of state-space methods to navigation
    problems", Adv. Control Syst. 3, 1966, 293-340): beside the contact's own curve, which it resembles, a fit
    would take it for whatever else the law leaves unexplained.
    """
    if trace.rig_sd_mm is None:
        return float(known.scaled[0])
    moved = replace(trace, travel_mm=trace.travel_mm + give_sd * trace.rig_sd_mm)
    return float(fit(known.law, moved, no_contact, known.scaled[None]).scaled[0])


def least_modulus(plain: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> float:
    """The modulus that E is above with 95 %, MPa: with the rig's give at the lower end of its spread.

    By linear elasticity, which holds where an effect is found as well: what relaxes or yields was stiffer.
    Any give that was not taken off leaves the object less travel.
    """
    ln_E = ln_E_with_other_rig(plain, trace, no_contact, give_sd=NINETY)
    return float(np.exp(ln_E - NINETY * plain.sd[0]))


def rig_spread(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> float:
    """Standard deviation of ln E that the rig's spread makes: half its change between the ends."""
    less, more = (ln_E_with_other_rig(known, trace, no_contact, give_sd=way) for way in (-1.0, 1.0))
    return 0.5 * abs(more - less)


def _upper_half(trace: IndenterTrace) -> Int[np.ndarray, " u"]:
    """Frames of the way in whose force is in the upper half, two at least; a reading of the travel that
    stands still while the force grows is none.
    """
    touch, peak = first_touch(trace), int(np.argmax(trace.force_N))
    new = np.r_[True, np.diff(trace.travel_mm) != 0.0]
    way_in = touch + np.flatnonzero(new[touch : peak + 1])
    level = float(np.median(trace.force_N[: max(touch - 1, 1)]))
    upper = trace.force_N[way_in] - level > UPPER * (trace.force_N[peak] - level)
    return np.asarray(way_in[-max(int(upper.sum()), 2) :])


def _slope(force: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"]) -> float:
    """Of the least-squares line, mm/N."""
    off = force - force.mean()
    return float(off @ travel / max(float(off @ off), 1e-30))
