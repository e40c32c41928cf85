"""All that is known of one trace: the answer, and the fits and predicted forces behind it."""

from dataclasses import dataclass

import numpy as np

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.fit import TraceFit
from fem.indentation.heldout import Prediction, predict
from fem.indentation.next_trace import next_press
from fem.indentation.no_contact import first_touch, no_contact_noise
from fem.indentation.rank import log_odds_of_any, modulus_of, ranking, verdict_of
from fem.indentation.search import candidate_fits
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_baseline import linear_law
from fem.indentation.trace_catalogue import OF_THE_MACHINE
from fem.indentation.trace_checks import checks
from fem.indentation.trace_detection import Detection, detect
from fem.indentation.trace_noise import NoContactNoise
from fem.mismatch.result import NONE, Explanation, HeldOut, ModulusCell, Where

#: a phase with this share of the excess misfit is when the mismatch shows
MOST = 0.6
#: frames in the table of secant moduli
CELLS = 24
#: depth over radius from which small strain is far behind
DEEP = 0.5


@dataclass(frozen=True, kw_only=True)
class Account:
    """`linear`, `named`: fits of the baseline and of the likeliest law; `end`, `blocks`: predicted forces."""

    explanation: Explanation
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
    touch = first_touch(trace)
    no_contact = no_contact_noise(trace, touch)
    if trace.force_N.max() - np.median(trace.force_N[: max(touch, 1)]) < 10 * no_contact.slow_N:
        raise FemFailure(
            FemProblem.NO_LOAD,
            f"indenter trace: found a largest force of {trace.force_N.max():.3g} N in noise of "
            f"{no_contact.slow_N:.2g} N, expected ten times the noise: press deeper.",
        )
    law = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    fits = candidate_fits(law, trace, no_contact, rng=rng)
    candidates, best = ranking(fits)
    log_odds = log_odds_of_any(fits)
    found = detect(fits[0], trace, no_contact, log_odds=log_odds, rng=rng)
    verdict = verdict_of(candidates, best, p_value=found.p_value, log_odds=log_odds)
    named = fits[0] if verdict == NONE else best[candidates[0].effect]
    notes = _notes(trace, named, thickness_mm)
    try:
        end, blocks = predict(fits[0], named, trace, no_contact)
    except FemFailure as failure:
        end, blocks = predict(fits[0], fits[0], trace, no_contact)
        notes = (*notes, f"No prediction with {candidates[0].effect}: {failure.detail}.")
    rms = end.rms(trace.force_N)
    out = np.isfinite(end.before_N)
    noise = no_contact.white_N / float(np.sqrt(np.mean(trace.force_N[out] ** 2)))
    remaining = [best[name] for name in verdict] if isinstance(verdict, tuple) else []
    explanation = Explanation(
        detected=verdict != NONE,
        p_value=found.p_value,
        statistics=found.statistics,
        where=Where(region=_where(verdict)),
        when=_when(trace, found),
        component="normal",
        ranking=candidates,
        verdict=verdict,
        before=modulus_of(fits[0]),
        after=modulus_of(named),
        heldout=HeldOut(rms_before=rms[0], rms_after=rms[1], noise_rms=noise),
        next_grasp=next_press(remaining, trace, no_contact),
        cells=_cells(trace, fits[0], no_contact),
        checks=checks(trace, fits[0], named, rng=rng),
        notes=notes,
    )
    return Account(
        explanation=explanation,
        linear=fits[0],
        named=named,
        end=end,
        blocks=blocks,
        no_contact=no_contact,
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
    depth = trace.travel_mm - value["onset_mm"][0]
    per_MPa = linear.law.ball.force_N_per_MPa(depth) * (1 + np.maximum(depth, 0) / trace.radius_mm) ** float(
        value["bend"][0]
    )
    loaded = np.flatnonzero(per_MPa > 0.05 * per_MPa.max())
    phases = trace.phases
    return tuple(
        ModulusCell(
            grasp="press",
            pad="tip",
            time_s=float(trace.time_s[k]),
            phase=phases[k],
            E_MPa=float((trace.force_N[k] - value["zero_N"][0]) / per_MPa[k]),
            E_sd_MPa=float(no_contact.white_N / per_MPa[k]),
        )
        for k in loaded[np.linspace(0, len(loaded) - 1, min(CELLS, len(loaded))).astype(int)]
    )


def _notes(trace: IndenterTrace, named: TraceFit, thickness_mm: float | None) -> tuple[str, ...]:
    """What a reader must know of this trace."""
    onset = float(named.law.values(named.scaled[None])["onset_mm"][0])
    onset_sd = float(named.sd[1])
    depth = float(trace.travel_mm.max()) - onset
    notes = [
        f"The best law leaves {100 * named.share:.1f} % of the force unexplained; intervals allow for it.",
    ]
    if onset - trace.travel_mm[0] > 3 * onset_sd + 0.02 * depth:
        notes.append(f"Contact starts late: {onset - trace.travel_mm[0]:.2f} mm into the travel.")
    if onset - trace.travel_mm[0] < -3 * onset_sd - 0.02 * depth:
        notes.append(f"The ball was {trace.travel_mm[0] - onset:.2f} mm deep before the recording started.")
    if depth > DEEP * trace.radius_mm:
        notes.append(
            f"The ball went {depth / trace.radius_mm:.1f} of its radii deep, where small strain has ended: "
            "stiffening may be the geometry's in part."
        )
    if not named.converged:
        notes.append(f"The search for the parameters of {named.law.name} has not settled; do not trust them.")
    if thickness_mm is None:
        notes.append("No thickness was given: a half-space was assumed, and a thin specimen looks stiffer.")
    return tuple(notes)
