"""All that is known of one trace: the answer, and the fits and predicted forces behind it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_law import suffix_of
from fem.indentation.fit import TraceFit
from fem.indentation.heldout import LawPrediction, predict_law
from fem.indentation.next_trace import next_press
from fem.indentation.no_contact import pooled_noise, require_force
from fem.indentation.posterior import CurvePosterior, modulus_of, posterior
from fem.indentation.rig_share import least_modulus, rig_share, rig_spread, unsure_E, widened
from fem.indentation.rupture import Rupture, before_rupture, find_rupture
from fem.indentation.search import candidate_fits
from fem.indentation.trace import IndenterTrace, joined
from fem.indentation.trace_baseline import linear_law
from fem.indentation.trace_catalogue import OF_THE_MACHINE
from fem.indentation.trace_checks import checks
from fem.indentation.trace_noise import NoContactNoise
from fem.mismatch.result import NONE, Explanation, HeldOut, Modulus, ModulusCell, Where

#: a phase with this share of the excess misfit is when the mismatch shows
MOST = 0.6
#: frames in the table of secant moduli
CELLS = 24
STRANGER_SD, STRANGE = 0.5, 100.0
"""Standard deviation of ln E of a recording of another specimen, and the odds from which it is named: a
recording in a hundred is one."""
#: recordings from which on it can be told which of them does not belong
FEWEST_PARTS = 3
#: E that is not given: not a number, which files write as null
WITHHELD = Modulus(value=float("nan"), sd=float("nan"))


@dataclass(frozen=True, kw_only=True)
class Account:
    """`linear`, `named`: fits of the plain law and of the likeliest; `before`, `after`: what they predict.
    `trace`: what was explained, cut before a rupture where there is one.
    """

    explanation: Explanation
    trace: IndenterTrace
    posterior: CurvePosterior
    linear: TraceFit
    named: TraceFit
    before: LawPrediction
    after: LawPrediction
    no_contact: NoContactNoise


def account_for(
    trace: IndenterTrace,
    *,
    thickness_mm: float | None,
    poisson_ratio: float,
    rng: np.random.Generator,
    rig_N_per_mm: float | None = None,
) -> Account:
    """The posterior over all laws, held-out frames and advice; see `explain_trace` for units and failures."""
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
    ruptured = [rupture.said for _, rupture in whole if rupture is not None]
    no_contact = pooled_noise(trace)
    law = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    fits = candidate_fits(law, trace, no_contact, rng=rng)
    answer = posterior(fits)
    chosen, verdict = answer.likeliest, answer.verdict
    names = verdict if isinstance(verdict, tuple) else (verdict,)
    rig_sd = rig_spread(chosen, trace, no_contact)
    before, after = (widened(one, rig_sd) for one in (modulus_of(fits[0]), answer.modulus))
    rig = rig_share(trace, rig_N_per_mm=rig_N_per_mm)
    withheld, ranking, bound = None, answer.ranking, rig.bound
    if bound is None and rig_sd > 0.0:
        bound = unsure_E(after, rig_sd)
    if bound is not None:
        least_MPa = least_modulus(
            trace, no_contact, after, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio
        )
        withheld = f"it is at least {least_MPa:.2g} MPa, and how much more is not known: {bound}"
        before, after = WITHHELD, WITHHELD
        ranking = tuple(replace(one, modulus=None) for one in ranking)
    notes = (*ruptured, *rig.notes, *_notes(trace, chosen), *strangers(trace, chosen))
    linear = predict_law(fits[0], trace, no_contact)
    try:
        predicted = predict_law(chosen, trace, no_contact)
    except FemFailure as failure:
        predicted = linear
        notes = (*notes, f"No prediction with {chosen.law.name}: {failure.detail}.")
    out = np.isfinite(linear.end_N)
    p_value = float(np.exp(-max(answer.log_odds, 0.0)))
    explanation = Explanation(
        detected=NONE not in names,
        p_value=p_value,
        statistics={"evidence": p_value},
        where=Where(region=_where(names)),
        when=_when(trace, fits[0]),
        component="normal",
        ranking=ranking,
        verdict=verdict,
        before=before,
        after=after,
        withheld=withheld,
        heldout=HeldOut(
            rms_before=linear.end_share,
            rms_after=predicted.end_share,
            noise_rms=no_contact.white_N / float(np.sqrt(np.mean(trace.force_N[out] ** 2))),
        ),
        next_grasp=next_press(
            [answer.best[name] for name in names if name in answer.best], trace.parts[0], no_contact
        ),
        cells=_cells(trace, fits[0], no_contact),
        checks=checks(trace, fits[0], chosen, rng=rng),
        notes=notes,
    )
    return Account(
        explanation=explanation,
        trace=trace,
        posterior=answer,
        linear=fits[0],
        named=chosen,
        before=linear,
        after=predicted,
        no_contact=no_contact,
    )


def _up_to_rupture(trace: IndenterTrace) -> tuple[IndenterTrace, Rupture | None]:
    """One recording, cut where its flesh breaks; raises FemFailure (no-load) where no force stands out."""
    no_contact = require_force(trace)
    found = find_rupture(trace, noise_N=no_contact.slow_N)
    return (trace if found is None else before_rupture(trace, found)), found


def _where(verdict: Sequence[str]) -> str:
    """The machine ("tip") where every name is the machine's, else the flesh."""
    names = {part for name in verdict for part in name.split("+")}
    return "tip" if names <= OF_THE_MACHINE else "flesh"


def _when(trace: IndenterTrace, linear: TraceFit) -> str:
    """The phase that holds most of what the plain law leaves of the force."""
    phases = np.array(trace.phases)
    left = (trace.force_N - linear.force_N) ** 2
    share = {p: float(left[phases == p].sum() / left.sum()) for p in ("load", "hold", "unload")}
    top = max(share, key=lambda p: share[p])
    return top if share[top] >= MOST else "all"


def strangers(trace: IndenterTrace, chosen: TraceFit) -> tuple[str, ...]:
    """Recordings that do not have the modulus of the others: the likeliest first, then the next given this
    one, while the evidence for a modulus of its own outweighs STRANGE against.
    """
    said: dict[int, str] = {}
    off = chosen.scaled - np.array([u.mean for u in chosen.law.unknowns])
    precision = np.array([u.sd**-2.0 for u in chosen.law.unknowns])
    slope = chosen.jacobian
    while len(said) < len(trace.parts) - FEWEST_PARTS + 1:
        factors: dict[int, tuple[float, float, np.ndarray]] = {}
        for k, frames in enumerate(trace.slices):
            column = np.zeros(len(trace.time_s))
            column[frames] = chosen.jacobian[frames, 0]
            if k not in said:
                factors[k] = (
                    *_own_modulus(np.column_stack([slope, column]), trace, chosen, precision, off),
                    column,
                )
        k = max(factors, key=lambda one: factors[one][0])
        log_factor, ln_ratio, column = factors[k]
        if log_factor < np.log(STRANGE):
            break
        said[k] = (
            f"Recording {k + 1} does not belong to the others: its modulus is {np.exp(ln_ratio):.2f} times "
            "theirs. Check that it is the same specimen."
        )
        slope, off = np.column_stack([slope, column]), np.append(off, 0.0)
        precision = np.append(precision, STRANGER_SD**-2.0)
    return tuple(said.values())


def _own_modulus(
    slope: Float[np.ndarray, "t k1"],
    trace: IndenterTrace,
    chosen: TraceFit,
    precision: Float[np.ndarray, " k"],
    off: Float[np.ndarray, " k"],
) -> tuple[float, float]:
    """Log Bayes factor for the last column's unknown against none (Savage and Dickey: prior over posterior
    density at nought), and its value.
    """
    weighted = chosen.noise.solve(np.column_stack([slope, trace.force_N - chosen.force_N]))
    prior = np.append(precision, STRANGER_SD**-2.0)
    matrix = slope.T @ weighted[:, :-1] + np.diag(prior)
    step = np.linalg.solve(matrix, slope.T @ weighted[:, -1] - prior * np.append(off, 0.0))
    variance = float(np.linalg.inv(matrix)[-1, -1])
    return float(0.5 * (step[-1] ** 2 / variance + np.log(variance / STRANGER_SD**2))), float(step[-1])


def _cells(trace: IndenterTrace, linear: TraceFit, no_contact: NoContactNoise) -> tuple[ModulusCell, ...]:
    """Secant moduli under the linear fit's onset and zero: they scatter about one number if it holds."""
    value = linear.law.values(linear.scaled[None])
    depth = linear.law.depth_mm(trace, linear.scaled)
    part_of = np.repeat(np.arange(len(trace.parts)), [len(part.time_s) for part in trace.parts])
    zero = np.array([value[f"zero_N{suffix_of(k)}"][0] for k in part_of.tolist()])
    curve = linear.law.curve
    bent = (1 + np.maximum(depth, 0) / curve.length_mm) ** float(value["bend"][0])
    held = curve.held_over_sliding(depth)
    per_MPa = curve.force_N_per_MPa(depth) * bent * (1.0 if held is None else held ** value["ends_held"][0])
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
    names, at, sd = [u.name for u in named.law.unknowns], named.scaled, named.sd
    notes: list[str] = []
    for k, part in enumerate(trace.parts):
        of = f"Recording {k + 1}: " if len(trace.parts) > 1 else ""
        onset, zero = (names.index(f"{name}{suffix_of(k)}") for name in ("onset_mm", "zero_N"))
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
    if "ends_held" in names:
        at_ends = names.index("ends_held")
        said = named.law.unknowns[at_ends].parameter(float(at[at_ends]), float(sd[at_ends]))
        low, high = said.interval or (0.0, 1.0)
        notes.append(
            f"The ends are not stated. From 0 (sliding) to 1 (held) the curve says {low:.2f} to {high:.2f}; "
            "E's error bar includes this uncertainty."
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
