"""Which names of a trace may be given: those whose laws predict frames left out of their fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure
from fem.indentation.fit import TraceFit
from fem.indentation.heldout import LawPrediction, predict_law
from fem.indentation.no_contact import FEWEST
from fem.indentation.rank import APART, LEFT_OVER, close_to_best, explains, modulus_of
from fem.indentation.rig_share import widened
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import NoContactNoise
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Modulus, mixture

#: share of the force left out that the best explanation may miss in what it predicts (set by hand)
MISSED = 0.3
#: factor by which an explanation, or one of several, may move E (set by hand)
TENFOLD = 10.0
#: standard deviations that a drift must be apart from every smooth force over the travel (set by hand)
DISTINCT = 5.0
#: standard deviations of noise by which the force in the air may leave a straight line (set by hand)
STRAIGHT = 2.0
#: straight pieces over the travel that such a force is made of
PIECES = 12
#: share by which a pair must miss less of what it predicts than each of its effects alone (set by hand)
PAIR_GAIN = 0.1
DRIFT = "sensor_drift"
ONE_RAMP = (
    "The recording is one ramp, in which a drift of the load cell and a force of the flesh cannot be told "
    "apart: E is the mean over both, and its error bar holds their difference. For a smaller error bar leave "
    "the indenter in the air first, or hold it at the end."
)
#: share of the peak force, over the recording, of a drift that must be seen (as much as a law may leave)
DRIFT_SEEN = LEFT_OVER


@dataclass(frozen=True, kw_only=True)
class Naming:
    """`verdict` as in Explanation; `ranking` with drift's probability put right; `before`, `after`: E of
    linear elasticity and with the name, None where they are withheld for the reason `withheld`; `notes`: why
    no name, or why several.
    """

    verdict: str | tuple[str, ...]
    ranking: tuple[Candidate, ...]
    before: Modulus | None
    after: Modulus | None
    withheld: str | None = None
    notes: tuple[str, ...] = ()


def with_bound(naming: Naming, *, least_MPa: float, why: str) -> Naming:
    """The same names with no E but what it is above at 95 %, for the reason `why`."""
    return replace(
        naming,
        ranking=tuple(replace(one, modulus=None) for one in naming.ranking),
        before=None,
        after=None,
        withheld=f"it is at least {least_MPa:.2g} MPa, and how much more is not known: {why}",
    )


def with_rig_spread(naming: Naming, ln_sd: float) -> Naming:
    """Every E with what the rig's spread does to ln E."""
    ranking = tuple(
        one if one.modulus is None else replace(one, modulus=widened(one.modulus, ln_sd))
        for one in naming.ranking
    )
    after = None if naming.after is None else widened(naming.after, ln_sd)
    return replace(naming, ranking=ranking, after=after)


class Forecasts:
    """What each law predicts of the frames left out of its fit, worked out once."""

    def __init__(self, best: dict[str, TraceFit], trace: IndenterTrace, no_contact: NoContactNoise) -> None:
        self._best, self._trace, self._no_contact = best, trace, no_contact
        self._known: dict[str, LawPrediction | FemFailure] = {}

    def of(self, name: str) -> LawPrediction:
        """Raises FemFailure where the law's force cannot be worked out without the measured one."""
        if name not in self._known:
            try:
                self._known[name] = predict_law(self._best[name], self._trace, self._no_contact)
            except FemFailure as failure:
                self._known[name] = failure
        found = self._known[name]
        if isinstance(found, FemFailure):
            raise found
        return found


def named(
    verdict: str | tuple[str, ...],
    candidates: tuple[Candidate, ...],
    best: dict[str, TraceFit],
    forecasts: Forecasts,
    trace: IndenterTrace,
) -> Naming:
    """The names that evidence proposes, less those that predict nothing; E over what is left, or why not.

    A pair that predicts no better than one of its effects is that effect. In a single ramp any force over the
    travel may be a drift: drift is never the only name there, and E is the mean over what is likely, with a
    standard deviation that holds the difference. A name stays where what it predicts misses MISSED at most,
    and less than the linear law's prediction does, of the trace's end or of its blocks; and where E is moved
    by less than TENFOLD.
    """
    linear = modulus_of(best[NONE])
    hides = hides_drift([best[NONE], best[candidates[0].effect]], trace)
    if verdict == NONE:
        if not hides:
            return Naming(verdict=NONE, ranking=candidates, before=linear, after=linear)
        return _over_ramp(NONE, candidates, best, ())
    ranking, notes = candidates, []
    if verdict != UNKNOWN:
        names = (verdict,) if isinstance(verdict, str) else verdict
        one_ramp = hides and any(
            _drifts(one.effect)
            and one.probability > candidates[0].probability * np.exp(-APART)
            and explains(best[one.effect], best[NONE])
            and drift_apart(best[one.effect], trace) < DISTINCT
            for one in candidates
        )
        names = tuple(dict.fromkeys(_without_idle(name, best, forecasts) for name in names))
        if one_ramp:
            ranking = _drift_capped(ranking, best)
            names = tuple(_without_idle(name, best, forecasts) for name in close_to_best(ranking))
            names = tuple(dict.fromkeys(name for name in names if explains(best[name], best[NONE])))
        doubts = {name: _doubt(name, best, forecasts) for name in names}
        kept = tuple(name for name in names if not doubts[name])
        notes += list(dict.fromkeys(doubt for doubt in doubts.values() if doubt))
        if one_ramp:
            known = UNKNOWN if all(map(_drifts, kept)) else kept[0] if len(kept) == 1 else kept
            return _over_ramp(known, ranking, best, tuple(notes))
        if kept:
            return _with_modulus(kept, ranking, best, tuple(notes))
    return Naming(
        verdict=UNKNOWN,
        ranking=tuple(replace(one, modulus=None) for one in ranking),
        before=None,
        after=None,
        withheld="no explanation of this trace stands: its notes say why",
        notes=tuple(notes),
    )


def hides_drift(fits: Sequence[TraceFit], trace: IndenterTrace) -> bool:
    """Whether a drift of DRIFT_SEEN of the peak force may be a force over the travel, by each of the fits."""
    elapsed_s = float(trace.elapsed_s.max())
    newton_per_s = DRIFT_SEEN * float(np.ptp(trace.force_N)) / elapsed_s
    return all(_apart(one, trace, newton_per_s) < DISTINCT for one in fits)


def drift_apart(known: TraceFit, trace: IndenterTrace) -> float:
    """How far a fit's drift is from all that a smooth force over the travel can be, standard deviations."""
    return _apart(known, trace, float(known.law.values(known.scaled[None])["newton_per_s"][0]))


def _apart(known: TraceFit, trace: IndenterTrace, newton_per_s: float) -> float:
    """In standard deviations: of a drift's own force, what a force of PIECES over the depth does not take up,
    in the noise of the fit. Before the first touch, in a hold and on the way back time passes without such a
    force; in a single ramp it does not.
    """
    drift = newton_per_s * trace.elapsed_s
    depth = _depth_where_touched(known, trace)
    corners = np.unique(np.quantile(depth, np.linspace(0, 1, PIECES + 1)))
    basis = np.column_stack([np.interp(depth, corners, one) for one in np.eye(len(corners))])
    weighted = known.noise.solve(np.column_stack([drift, basis]))
    taken = np.linalg.lstsq(basis.T @ weighted[:, 1:], basis.T @ weighted[:, 0], rcond=1e-10)[0]
    gap = drift - basis @ taken
    return float(np.sqrt(max(gap @ known.noise.solve(gap), 0.0)))


def _depth_where_touched(known: TraceFit, trace: IndenterTrace) -> Float[np.ndarray, " t"]:
    """The depth by a fit, 0 in the air; the travel where the air is short, or its force no straight line over
    time: a specimen that is met little by little looks like a drift in the air.
    """
    depth: Float[np.ndarray, " t"] = np.maximum(known.law.depth_mm(trace, known.scaled), 0.0)
    for part in trace.slices:
        air = int(np.argmax(depth[part] > 0))
        time, force = trace.time_s[part][:air], trace.force_N[part][:air]
        if air < FEWEST or np.std(force - np.polynomial.Polynomial.fit(time, force, 1)(time)) > (
            STRAIGHT * known.noise.white_N
        ):
            depth[part] = trace.travel_mm[part] - trace.travel_mm[part].min()
    return depth


def _words(name: str) -> str:
    return name.replace("_", " ").replace("+", " with ")


def _drifts(name: str) -> bool:
    return DRIFT in name.split("+")


def _without_idle(name: str, best: dict[str, TraceFit], forecasts: Forecasts) -> str:
    """The effect of a pair that predicts and explains as well alone; the pair where neither does."""
    if "+" not in name:
        return name
    singles = [one for one in name.split("+") if one in best and explains(best[one], best[NONE])]
    try:
        both = forecasts.of(name)
        alone = {one: forecasts.of(one) for one in singles}
    except FemFailure:
        return name
    enough = [one for one in singles if not both.gains_on(alone[one], by=PAIR_GAIN)]
    return min(enough, key=lambda one: alone[one].product, default=name)


def _drift_capped(ranking: tuple[Candidate, ...], best: dict[str, TraceFit]) -> tuple[Candidate, ...]:
    """Probabilities with all that drifts no likelier than the best explanation that does not."""
    others = [
        c.probability for c in ranking if not _drifts(c.effect) and explains(best[c.effect], best[NONE])
    ]
    if not others:
        return ranking
    drifting = max(c.probability for c in ranking if _drifts(c.effect))
    factor = min(1.0, max(others) / drifting)
    changed = [c.probability * (factor if _drifts(c.effect) else 1.0) for c in ranking]
    # what is neither (no effect at all) keeps its share, which beside an effect found is next to nothing
    whole = sum(changed) + max(1 - sum(c.probability for c in ranking), 0.0)
    put = (replace(c, probability=p / whole) for c, p in zip(ranking, changed, strict=True))
    return tuple(sorted(put, key=lambda c: -c.probability))


def _doubt(name: str, best: dict[str, TraceFit], forecasts: Forecasts) -> str:
    """Why a name may not be given; empty where it may."""
    try:
        found, linear = forecasts.of(name), forecasts.of(NONE)
    except FemFailure as failure:
        return f"{_words(name)} is not named: nothing can be predicted with it ({failure.detail})."
    if found.end_share > MISSED:
        return (
            f"{_words(name)} fits best but is not named: in frames left out of its fit it misses "
            f"{found.end_share:.0%} of the force, more than {MISSED:.0%}."
        )
    if not found.gains_on(linear):
        return (
            f"{_words(name)} is not named: it predicts frames left out of its fit no better than linear "
            "elasticity."
        )
    ratio = modulus_of(best[name]).value / modulus_of(best[NONE]).value
    if not 1 / TENFOLD < ratio < TENFOLD:
        return f"{_words(name)} is not named: it would move E by a factor of {max(ratio, 1 / ratio):.0f}."
    return ""


def _with_modulus(
    names: tuple[str, ...], ranking: tuple[Candidate, ...], best: dict[str, TraceFit], notes: tuple[str, ...]
) -> Naming:
    """E of the one name; of several the mean weighed by probability, their spread in its deviation."""
    verdict = names[0] if len(names) == 1 else names
    moduli = [modulus_of(best[name]) for name in names]
    chance = {c.effect: c.probability for c in ranking}
    if _tenfold_apart(moduli):
        return _too_far_apart(verdict, names, ranking, notes)
    modulus = mixture([max(chance.get(name, 0.0), 1e-12) for name in names], moduli)
    return Naming(verdict=verdict, ranking=ranking, before=modulus_of(best[NONE]), after=modulus, notes=notes)


def _over_ramp(
    verdict: str | tuple[str, ...],
    ranking: tuple[Candidate, ...],
    best: dict[str, TraceFit],
    notes: tuple[str, ...],
) -> Naming:
    """E of a single ramp: the mean over all that is about as likely. E of linear elasticity keeps its value;
    both have a deviation that holds the differences among these and to linear elasticity.

    Where something is found, the likeliest drift counts as much as its best rival: which of the two is
    likelier, a single ramp cannot show. The rival of a drift alone is linear elasticity.
    """
    chance = {c.effect: max(c.probability, 1e-12) for c in ranking}
    chance[NONE] = max(1.0 - sum(chance.values()), 1e-12)
    able = [name for name in chance if name == NONE or explains(best[name], best[NONE])]
    if verdict != NONE:
        rivals = [name for name in able if not _drifts(name) and name != NONE] or [NONE]
        level = max(chance[name] for name in able)
        for group in (rivals, list(filter(_drifts, able))):
            if group:
                chance[max(group, key=lambda name: chance[name])] = level
    likely = [name for name in able if chance[name] > max(chance[one] for one in able) * np.exp(-APART)]
    moduli = [modulus_of(best[name]) for name in likely]
    if _tenfold_apart(moduli):
        return _too_far_apart(verdict, likely, ranking, (*notes, ONE_RAMP))
    mean, linear = mixture([chance[name] for name in likely], moduli), modulus_of(best[NONE])
    sd = float(np.hypot(mean.sd, mean.value - linear.value))
    before, after = replace(linear, sd=sd), replace(mean, sd=sd)
    return Naming(verdict=verdict, ranking=ranking, before=before, after=after, notes=(*notes, ONE_RAMP))


def _tenfold_apart(moduli: Sequence[Modulus]) -> bool:
    values = [modulus.value for modulus in moduli]
    return max(values) > TENFOLD * min(values)


def _too_far_apart(
    verdict: str | tuple[str, ...],
    names: Sequence[str],
    ranking: tuple[Candidate, ...],
    notes: tuple[str, ...],
) -> Naming:
    return Naming(
        verdict=verdict,
        ranking=tuple(replace(one, modulus=None) for one in ranking),
        before=None,
        after=None,
        withheld=f"{' and '.join(map(_words, names))}, which cannot be told apart, put E tenfold apart",
        notes=notes,
    )
