"""All that is known of one trace: the answer, and the fits and predicted forces behind it."""

from dataclasses import dataclass, replace

import numpy as np

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_law import OWN, suffix_of
from fem.indentation.fit import TraceFit, fit
from fem.indentation.heldout import Prediction, predictions
from fem.indentation.naming import Forecasts, named, with_bound, with_rig_spread
from fem.indentation.next_trace import next_press
from fem.indentation.no_contact import pooled_noise, require_force
from fem.indentation.rank import log_odds_of_any, modulus_of, ranking, verdict_of
from fem.indentation.rig_share import least_modulus, rig_share, rig_spread, unsure_E, widened
from fem.indentation.rupture import Rupture, before_rupture, find_rupture
from fem.indentation.search import candidate_fits
from fem.indentation.trace import IndenterTrace, joined
from fem.indentation.trace_baseline import linear_law
from fem.indentation.trace_catalogue import OF_THE_MACHINE
from fem.indentation.trace_checks import checks
from fem.indentation.trace_detection import Detection, detect
from fem.indentation.trace_noise import NoContactNoise
from fem.mismatch.result import NONE, UNKNOWN, Explanation, HeldOut, Modulus, ModulusCell, Where

#: a phase with this share of the excess misfit is when the mismatch shows
MOST = 0.6
#: frames in the table of secant moduli
CELLS = 24
#: standard deviation, over the travel, of an onset that is not fitted
FIXED = 1e-6
#: E that is not given: not a number, which files write as null
WITHHELD = Modulus(value=float("nan"), sd=float("nan"))


@dataclass(frozen=True, kw_only=True)
class Account:
    """`linear`, `named`: fits of the baseline and of the likeliest law; `end`, `blocks`: predicted forces.
    `trace`: what was explained, cut before a rupture where there is one.
    """

    explanation: Explanation
    trace: IndenterTrace
    linear: TraceFit
    named: TraceFit
    end: Prediction
    blocks: Prediction
    no_contact: NoContactNoise


def account_for(
    trace: IndenterTrace,
    *,
    thickness_mm: float | None,
    poisson_ratio: float,
    rng: np.random.Generator,
    rig_N_per_mm: float | None = None,
) -> Account:
    """Detection, selection, refit, held-out frames and advice; see `explain_trace` for units and failures."""
    if not 0 <= poisson_ratio < 0.5:
        raise FemFailure(
            FemProblem.BAD_POISSON_RATIO,
            f"indenter trace: found Poisson's ratio {poisson_ratio:g}, expected 0 up to less than 0.5: "
            "flesh and rubber are at 0.45 to 0.49.",
        )
    if thickness_mm is not None and thickness_mm <= 0:
        raise FemFailure(
            FemProblem.BAD_LOAD,
            f"indenter trace: found thickness {thickness_mm:g} mm, expected more than 0 or none at all: "
            "measure the specimen.",
        )
    whole = [_up_to_rupture(part) for part in trace.parts]
    trace = joined([part for part, _ in whole])
    ruptured = [found.said for _, found in whole if found is not None]
    no_contact = pooled_noise(trace)
    law = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    fits = candidate_fits(law, trace, no_contact, rng=rng)
    candidates, best = ranking(fits)
    log_odds = log_odds_of_any(fits)
    found = detect(fits[0], trace, no_contact, log_odds=log_odds, rng=rng)
    proposed = verdict_of(candidates, best, p_value=found.p_value, log_odds=log_odds)
    forecasts = Forecasts(best, trace, no_contact)
    naming = named(proposed, candidates, best, forecasts, trace)
    rig = rig_share(trace, rig_N_per_mm=rig_N_per_mm)
    rig_notes = rig.notes
    if rig.bound is not None and naming.after is None:
        rig_notes = (*rig_notes, f"E would be a lower bound at best: {rig.bound}.")
    if rig.bound is not None and naming.after is not None:
        least_MPa = least_modulus(
            trace, no_contact, naming.after, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio
        )
        naming = with_bound(naming, least_MPa=least_MPa, why=rig.bound)
    rig_sd = rig_spread(fits[0], trace, no_contact)
    if rig_sd > 0.0:
        own = naming.verdict if isinstance(naming.verdict, str) else naming.verdict[0]
        of_named = rig_sd if own not in best or own == NONE else rig_spread(best[own], trace, no_contact)
        naming = with_rig_spread(naming, of_named)
        if naming.after is not None and (why := unsure_E(naming.after, of_named)) is not None:
            least_MPa = least_modulus(
                trace, no_contact, naming.after, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio
            )
            naming = with_bound(naming, least_MPa=least_MPa, why=why)
    verdict = naming.verdict
    names = verdict if isinstance(verdict, tuple) else (verdict,)
    likeliest = naming.ranking[0].effect if verdict == UNKNOWN else names[0]
    chosen = best[likeliest]
    notes = (
        *ruptured,
        *rig_notes,
        *naming.notes,
        *_notes(trace, chosen),
        *(_with_onset_zero(trace, chosen, no_contact) if naming.after is not None else ()),
    )
    try:
        predicted = forecasts.of(likeliest)
    except FemFailure as failure:
        predicted = forecasts.of(NONE)
        notes = (*notes, f"No prediction with {likeliest}: {failure.detail}.")
    end, blocks = predictions(forecasts.of(NONE), predicted)
    out = np.isfinite(end.before_N)
    noise = no_contact.white_N / float(np.sqrt(np.mean(trace.force_N[out] ** 2)))
    explanation = Explanation(
        detected=verdict != NONE,
        p_value=found.p_value,
        statistics=found.statistics,
        where=Where(region=_where(verdict)),
        when=_when(trace, found),
        component="normal",
        ranking=naming.ranking,
        verdict=verdict,
        before=WITHHELD if naming.before is None else widened(naming.before, rig_sd),
        after=naming.after or WITHHELD,
        withheld=naming.withheld,
        heldout=HeldOut(
            rms_before=forecasts.of(NONE).end_share, rms_after=predicted.end_share, noise_rms=noise
        ),
        next_grasp=next_press([best[name] for name in names if name in best], trace.parts[0], no_contact),
        cells=_cells(trace, fits[0], no_contact),
        checks=checks(trace, fits[0], chosen, rng=rng),
        notes=notes,
    )
    return Account(
        explanation=explanation,
        trace=trace,
        linear=fits[0],
        named=chosen,
        end=end,
        blocks=blocks,
        no_contact=no_contact,
    )


def _up_to_rupture(trace: IndenterTrace) -> tuple[IndenterTrace, Rupture | None]:
    """One recording, cut where its flesh breaks; raises FemFailure (no-load) where no force stands out."""
    no_contact = require_force(trace)
    found = find_rupture(trace, noise_N=no_contact.slow_N)
    return (trace if found is None else before_rupture(trace, found)), found


def _with_onset_zero(trace: IndenterTrace, chosen: TraceFit, no_contact: NoContactNoise) -> tuple[str, ...]:
    """The same law with the first touch where the travel starts, where the fit has it before that."""
    start = float(trace.travel_mm[0])
    at = [u.name for u in chosen.law.unknowns].index("onset_mm")
    if len(trace.parts) > 1 or not chosen.scaled[at] < start:
        return ()
    fixed = tuple(
        replace(u, mean=start, sd=FIXED * float(np.ptp(trace.travel_mm))) if u.name == "onset_mm" else u
        for u in chosen.law.baseline
    )
    guess = chosen.scaled.copy()
    guess[at] = start
    again = fit(replace(chosen.law, baseline=fixed), trace, no_contact, guess[None], follow=1)
    modulus = modulus_of(again)
    return (
        f"The fitted onset lies {start - chosen.scaled[at]:.2f} mm before the travel starts. With onset 0 "
        f"E is {modulus.value:.3g} ± {modulus.sd:.2g} MPa, and {again.share:.1%} of the force is left "
        "unexplained.",
    )


def _where(verdict: str | tuple[str, ...]) -> str:
    """The machine ("tip") where every name is the machine's, else the flesh."""
    names = {
        part for name in ([verdict] if isinstance(verdict, str) else verdict) for part in name.split("+")
    }
    return "tip" if names <= OF_THE_MACHINE else "flesh"


def _when(trace: IndenterTrace, found: Detection) -> str:
    """The phase that holds most of the misfit beyond noise."""
    phases = np.array(trace.phases)
    excess = np.maximum(found.whitened**2 - 1, 0)
    share = {
        p: float(excess[phases == p].sum() / max(excess.sum(), 1e-12)) for p in ("load", "hold", "unload")
    }
    top = max(share, key=lambda p: share[p])
    return top if share[top] >= MOST else "all"


def _cells(trace: IndenterTrace, linear: TraceFit, no_contact: NoContactNoise) -> tuple[ModulusCell, ...]:
    """Secant moduli under the linear fit's onset and zero: they scatter about one number if it holds."""
    value = linear.law.values(linear.scaled[None])
    depth = linear.law.depth_mm(trace, linear.scaled)
    part_of = np.repeat(np.arange(len(trace.parts)), [len(part.time_s) for part in trace.parts])
    zero = np.array([value[f"zero_N{suffix_of(k)}"][0] for k in part_of.tolist()])
    curve = linear.law.curve
    bent = (1 + np.maximum(depth, 0) / curve.length_mm) ** float(value["bend"][0])
    per_MPa = curve.force_N_per_MPa(depth) * bent
    loaded = np.flatnonzero(per_MPa > 0.05 * per_MPa.max())
    phases = trace.phases
    return tuple(
        ModulusCell(
            grasp=f"press{suffix_of(int(part_of[k]))}",
            pad="tip",
            time_s=float(trace.time_s[k]),
            phase=phases[k],
            E_MPa=float((trace.force_N[k] - zero[k]) / per_MPa[k]),
            E_sd_MPa=float(no_contact.white_N / per_MPa[k]),
        )
        for k in loaded[np.linspace(0, len(loaded) - 1, min(CELLS, len(loaded))).astype(int)]
    )


def _notes(trace: IndenterTrace, named: TraceFit) -> tuple[str, ...]:
    """What a reader must know of this trace."""
    names = [u.name for u in named.law.unknowns]
    notes: list[str] = []
    for k, part in enumerate(trace.parts):
        of = f"Recording {k + 1}: " if len(trace.parts) > 1 else ""
        onset, zero = (names.index(f"{one}{suffix_of(k)}") for one in OWN)
        at, sd = named.scaled, named.sd
        notes.append(
            f"{of}First touch {at[onset] - part.travel_mm[0]:.3g} ± {sd[onset]:.2g} mm into the travel, with "
            f"the load cell at {at[zero]:.3g} ± {sd[zero]:.2g} N before it."
        )
        notes += [of + one for one in _onset_notes(part, float(at[onset]), float(sd[onset]))]
    notes.append(f"The best law leaves {named.share:.1%} of the force unexplained; intervals allow for it.")
    if not named.converged:
        notes.append(f"The search for the parameters of {named.law.name} has not settled; do not trust them.")
    if len(trace.parts) > 1:
        notes.append(
            f"{len(trace.parts)} recordings have one law and one E; each was taken to begin with flesh that "
            "has come back from the one before, and with the damage and set of none."
        )
    curve = named.law.curve
    for name, why in curve.without.items():
        notes.append(f"{name.replace('_', ' ').capitalize()} was not looked for: {why}.")
    return (*notes, *curve.notes(float(named.law.depth_mm(trace, named.scaled).max())))


def _onset_notes(trace: IndenterTrace, onset: float, onset_sd: float) -> list[str]:
    """Contact that starts late, or before the recording."""
    depth, notes = float(trace.travel_mm.max()) - onset, []
    if onset - trace.travel_mm[0] > 3 * onset_sd + 0.02 * depth:
        notes.append(f"Contact starts late: {onset - trace.travel_mm[0]:.2f} mm into the travel.")
    if onset - trace.travel_mm[0] < -3 * onset_sd - 0.02 * depth:
        before = f"was {trace.travel_mm[0] - onset:.2f} mm deep before the recording started"
        notes.append(f"The {trace.geometry.tool} {before}.")
    return notes
