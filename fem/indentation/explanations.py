"""Candidate laws of a curve, and their posterior by the decision rules of grasps (fem.mismatch.selection).

The evidence of a law replaces that of a signature; the mean over an effect's forms replaces that over
variants. A law's misfit is proportional to the square of the share of the force that it leaves unexplained.
The least share (fem.indentation.fit) corresponds to the usual MISFIT of grasps. The p-value of the misfit
uses the scatter of grasps, and the share is known on a grid only. This p is nominal, as P_NOMINAL states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from math import prod

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.contact_law import OWN, Law
from fem.indentation.effects.trace_damage import DAMAGE
from fem.indentation.effects.trace_machine import FAULT, GRIPPER_COMPLIANCE, drift_of_cell
from fem.indentation.effects.trace_plastic_set import PLASTIC_SET
from fem.indentation.effects.trace_stiffening import FUNG, RUBBER
from fem.indentation.effects.trace_viscoelastic import ARMS, viscoelastic
from fem.indentation.fit import TraceFit, fit, without_measured
from fem.indentation.no_contact import FEWEST, NoContactNoise, first_touch
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect
from fem.indentation.trace_noise import SHARE
from fem.mismatch.effects import sensor_drift
from fem.mismatch.result import NONE, UNKNOWN, Candidate, HeldOut, Modulus, Parameter, mixture
from fem.mismatch.selection.decision import (
    MISFIT,
    Detection,
    Weighed,
    misfit_p_value,
    probabilities,
    verdict_of,
)
from fem.mismatch.selection.reported_modulus import reported_modulus, unknown_spread

P_NOMINAL = (
    "nominal: it assumes that laws err as much in curves as models do in grasps, and is not calibrated"
)
DRAWS = 16
"""Number of starts drawn from the prior, and about each simpler fit."""
TEMPERATURE = 1.0
"""Divisor of log Bayes factors: 1, since the noise of a curve includes the error of its laws. With the
divisor of grasps 13 of 100 silicone cylinders were `stiffening` or `viscoelastic`, without it two
(benchmarks/silicone_cylinders.py at `fd51c8a1`; all ten mixtures)."""
LEAST_WEIGHT = 1e-4
"""Probability of a law below which the mean omits its force."""
SHAPES = frozenset({"stiffening", "plastic_set", "damage"})
"""Effects that bend the curve under monotonic loading. Flesh that yields or is damaged responds to it like
some nonlinear elastic flesh (deformation theory; Hencky 1924, Z. Angew. Math. Mech. 4, 323). The interval of
E excludes such pairs."""
NUISANCES = (*OWN[1:], "ends_held")
"""Unknowns of the plain law that are reported with every effect."""


def forms_of(trace: IndenterTrace) -> dict[str, tuple[TraceEffect, ...]]:
    """All effects tried on a curve, each in all of its forms, the simplest first."""
    cell = drift_of_cell(class_N_per_min=trace.drift_sd_N_per_min)
    each = (
        tuple(viscoelastic(arms) for arms in range(1, ARMS + 1)),
        (FUNG, *RUBBER) if isinstance(trace.geometry, Cylinder) else (FUNG,),
        (PLASTIC_SET,),
        (DAMAGE,),
        (GRIPPER_COMPLIANCE,),
        (cell,),
    )
    return {forms[0].name: forms for forms in each}


TIME_IS_TRAVEL = (
    "few frames are in the air or at rest, and speeds differ little. A drift then looks like another E. E's "
    f"error bar includes the load cell's usual drift. Record more than {FEWEST} frames in the air or at rest"
)


def shows_drift(trace: IndenterTrace) -> bool:
    """Whether a drift has a signature that no elastic law has: the force in the air, at rest or on the way
    back, or ramps so different in speed that a faulty cell drifts by more than the error of a law between
    them.
    """
    calm = max(first_touch(part) - 1 for part in trace.parts)
    if max(calm, sum(phase != "load" for phase in trace.phases)) >= FEWEST:
        return True
    s_per_mm = [np.ptp(part.time_s) / np.ptp(part.travel_mm) for part in trace.parts]
    apart_s = float(np.ptp(s_per_mm)) * min(float(np.ptp(part.travel_mm)) for part in trace.parts)
    drift_N = FAULT * trace.drift_sd_N_per_min * apart_s / 60
    return drift_N > SHARE * float(np.abs(trace.force_N).max())


def identifiable(law: Law, trace: IndenterTrace) -> Law:
    """The law without a test of drift if the recordings cannot show it."""
    if shows_drift(trace):
        return law
    hidden = {sensor_drift.SPEC.name: TIME_IS_TRAVEL}
    return replace(law, curve=replace(law.curve, without={**law.curve.without, **hidden}))


def candidate_fits(
    linear: Law,
    trace: IndenterTrace,
    no_contact: NoContactNoise,
    rng: np.random.Generator,
    effects: Mapping[str, Sequence[TraceEffect]],
) -> list[TraceFit]:
    """The plain fit, then every effect in every form, then pairs; each starts from simpler fits.

    Pairs: the best single effect with every other, each in its best form. If the best form has one relaxing
    arm, two arms are tried too, as the residual of the other effect may need them. If no recording unloads,
    two of SHAPES make no pair.
    """

    def fitted(effects: tuple[TraceEffect, ...], known: list[TraceFit]) -> TraceFit:
        law = Law(curve=linear.curve, baseline=linear.baseline, effects=effects)
        return fit(law, trace, no_contact, _starts(law, known, rng))

    plain = fitted((), [])
    singles: dict[str, list[TraceFit]] = {}
    for name, forms in effects.items():
        if name not in linear.curve.without:
            form_fits = singles.setdefault(name, [])
            for form in forms:
                form_fits.append(fitted((form,), [plain, *form_fits[-1:]]))
    best = best_forms(singles)
    top = max(best, key=lambda name: best[name].log_evidence)
    chosen = {name: [best[name]] for name in best}
    for name, form_fits in singles.items():
        if best[name] is form_fits[0] and best[name].law.effects[0].relaxation is not None:
            chosen[name].append(form_fits[1])
    pairs = [
        fitted(first.law.effects + second.law.effects, [first, second])
        for pair in combinations(best, 2)
        if top in pair and ("unload" in trace.phases or not SHAPES.issuperset(pair))
        for first, second in product(*(chosen[name] for name in pair))
    ]
    return [plain, *(trace_fit for form_fits in singles.values() for trace_fit in form_fits), *pairs]


def best_forms(fits: Mapping[str, Sequence[TraceFit]]) -> dict[str, TraceFit]:
    """The form with the largest score, for each effect."""
    return {name: max(forms, key=lambda trace_fit: trace_fit.log_score) for name, forms in fits.items()}


def _starts(law: Law, known: list[TraceFit], rng: np.random.Generator) -> Float[np.ndarray, "s k"]:
    """The prior's mean, draws from the prior, and draws that keep the values of simpler fits."""
    names = [u.name for u in law.unknowns]
    mean, sd = np.array([(u.mean, u.sd) for u in law.unknowns]).T
    rows = [np.vstack([mean, mean + 0.7 * sd * rng.standard_normal((DRAWS, len(mean)))])]
    for simpler_fit in known:
        kept = mean + 0.7 * sd * np.vstack([np.zeros(len(mean)), rng.standard_normal((DRAWS, len(mean)))])
        for u, value in zip(simpler_fit.law.unknowns, simpler_fit.scaled, strict=True):
            if u.name in names:
                kept[:, names.index(u.name)] = value
        rows.append(kept)
    return np.vstack(rows)


@dataclass(frozen=True, kw_only=True)
class CurvePosterior:
    """`probability` by name (effects joined by "+", "none", "unknown"), the largest first; `best`: the
    likeliest fit of each name; `weights`: probabilities of all `fits`, without unknown physics.
    """

    fits: tuple[TraceFit, ...]
    weights: Float[np.ndarray, " f"]
    probability: dict[str, float]
    gain: dict[str, float]
    best: dict[str, TraceFit]
    detection: Detection

    @property
    def verdict(self) -> str | tuple[str, ...]:
        """One name, or several, by the rules of grasps."""
        names = verdict_of(self.probability, p_value=self.detection.p_value)
        return names[0] if len(names) == 1 else names

    @property
    def detected(self) -> bool:
        """Whether there is a mismatch; a verdict may list effects without a mismatch."""
        return self.detection.mismatch and self.verdict != NONE

    @property
    def likeliest(self) -> TraceFit:
        """The fit of the likeliest law, unknown physics excluded."""
        return self.best[next(name for name in self.probability if name != UNKNOWN)]

    def force_N(
        self, trace: IndenterTrace, *, unseen: Bool[np.ndarray, " t"] | None = None
    ) -> Float[np.ndarray, " t"]:
        """Mean force over the laws that the verdict names, weighted by their probabilities, N.

        In `unseen` frames no law uses the measured force: the law's own force moves a compliant machine.
        """
        verdict = (self.verdict,) if isinstance(self.verdict, str) else self.verdict
        names = {name for name in verdict if name in self.best} or {self.likeliest.law.name}
        named = np.array([trace_fit.law.name in names for trace_fit in self.fits])
        likely = np.flatnonzero(named & (self.weights > LEAST_WEIGHT))
        mask = np.zeros(len(trace.time_s), dtype=bool) if unseen is None else unseen
        forces = [without_measured(self.fits[k].law, self.fits[k].scaled, trace, mask) for k in likely]
        return np.asarray(self.weights[likely] @ np.array(forces) / self.weights[likely].sum())

    def candidate(self, name: str) -> Candidate:
        """One name as an answer's candidate; E is the mixture over its forms."""
        best = self.best.get(name)
        indices = [k for k, trace_fit in enumerate(self.fits) if trace_fit.law.name == name]
        weights = self.weights[indices]
        moduli = [self.fits[k].modulus for k in indices]
        return Candidate(
            effect=name,
            probability=self.probability[name],
            parameters={} if best is None else parameters_of(best),
            log_evidence=self.gain.get(name, 0.0),
            gain=0.0 if best is None else self.best[NONE].chi_square - best.chi_square,
            refitted=True,
            modulus=mixture(weights.tolist(), moduli) if weights.sum() > 0 else None,
        )

    def modulus(self, heldout: HeldOut) -> Modulus:
        """E over all explanations, by the rules of grasps."""
        plain = self.best[NONE]
        noise_rms = float(np.hypot(heldout.noise_rms, plain.usual_share))  # with the error of a law
        unknown = plain.modulus.widened(unknown_spread(replace(heldout, noise_rms=noise_rms)))
        known = {NONE: plain.modulus, UNKNOWN: unknown}
        weighed = [
            (probability, known.get(name) or self.candidate(name).modulus)
            for name, probability in self.probability.items()
        ]
        return reported_modulus(self.verdict, weighed, plain.modulus)


def posterior(fits: list[TraceFit]) -> CurvePosterior:
    """The posterior of all fitted laws, by the decision rules of grasps.

    The forms of an effect are equally likely a priori, and so are the combinations of forms of a pair. Those
    that were not fitted have no evidence.
    """
    groups: dict[str, list[TraceFit]] = {}
    for trace_fit in fits:
        groups.setdefault(trace_fit.law.name, []).append(trace_fit)
    best = best_forms(groups)
    norms = {
        name: float(logsumexp([trace_fit.log_evidence for trace_fit in forms]))
        for name, forms in groups.items()
    }
    ways = {name: prod(len(groups[effect]) for effect in name.split("+")) for name in groups}
    plain = best[NONE].log_evidence
    gain = {name: norms[name] - float(np.log(ways[name])) - plain for name in groups}
    weighed = [
        Weighed(
            name=name,
            gain=gain[name],
            misfit=MISFIT * (trace_fit.share / trace_fit.usual_share) ** 2,
        )
        for name, trace_fit in best.items()
    ]
    misfit_p = misfit_p_value(next(law.misfit for law in weighed if law.name == NONE))
    shares, unknown = probabilities(weighed, temperature=TEMPERATURE)
    probability = {**dict(zip(best, shares.tolist(), strict=True)), UNKNOWN: unknown}
    singles = [gain[name] for name in gain if name != NONE and "+" not in name]
    bayes_factor = float(logsumexp(singles) - np.log(len(singles))) if singles else 0.0
    within = [np.exp(trace_fit.log_evidence - norms[trace_fit.law.name]) for trace_fit in fits]
    return CurvePosterior(
        fits=tuple(fits),
        weights=np.array([probability[trace_fit.law.name] for trace_fit in fits]) * within,
        probability=dict(sorted(probability.items(), key=lambda likely: -likely[1])),
        gain=gain,
        best=best,
        detection=Detection(p_values={"effects": float(np.exp(-max(bayes_factor, 0.0))), "misfit": misfit_p}),
    )


def parameters_of(trace_fit: TraceFit) -> dict[str, Parameter]:
    """The effects' parameters by their names in files, with the nuisances that are reported."""
    known: dict[str, Parameter] = {}
    scaled = list(zip(trace_fit.law.unknowns, trace_fit.scaled.tolist(), trace_fit.sd.tolist(), strict=True))
    at = len(trace_fit.law.baseline)
    for u, value, sd in scaled[:at]:
        if u.name.startswith(NUISANCES):
            known[u.name] = u.parameter(value, sd)
    for effect in trace_fit.law.effects:
        part = slice(at, at + len(effect.unknowns))
        if effect.parameters is not None:
            known |= effect.parameters(trace_fit.scaled[part], trace_fit.covariance[part, part])
        else:
            known |= {u.name: u.parameter(value, sd) for u, value, sd in scaled[part]}
        at = part.stop
    return known
