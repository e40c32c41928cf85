"""Diagnosis of the flesh beyond linear elasticity from a bare indenter's curves."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_curve import out_of_range
from fem.indentation.contact_law import linear_law, suffix_of
from fem.indentation.explanations import (
    P_NOMINAL,
    CurvePosterior,
    candidate_fits,
    forms_of,
    identifiable,
    posterior,
)
from fem.indentation.fit import TraceFit, from_prior, predicted_N, share_missed
from fem.indentation.no_contact import NoContactNoise, pooled_noise, require_force
from fem.indentation.rig_share import least_modulus, rig_share, rig_spread
from fem.indentation.strangers import own_moduli, scatter, strangers
from fem.indentation.trace import IndenterTrace, before_rupture, joined, without
from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import NONE, UNKNOWN, Explanation, HeldOut, Modulus, ModulusCell, Where, in_words

#: share of the misfit above which one phase is reported as the time of the mismatch
MOST = 0.6
#: frames in the table of secant moduli
CELLS = 24
#: a withheld E: not a number, which files write as null
WITHHELD = Modulus(value=float("nan"), sd=float("nan"))
UNEXPLAINED = (
    "other physics is likelier than any effect of the catalogue to explain this recording, and it can change "
    "E without limit"
)
IN_AIR = "leave the indenter in the air for a minute before the same press"
SLOWER = "the same press ten times slower, with a hold ten times as long"
BACK = "the same press, then draw the indenter back as fast as it went in and record two more minutes"


@dataclass(frozen=True, kw_only=True)
class Account:
    """Explanation of a curve; `trace`: the explained frames, up to any rupture."""

    explanation: Explanation
    trace: IndenterTrace
    posterior: CurvePosterior

    @property
    def linear(self) -> TraceFit:
        """The fit of the plain law."""
        return self.posterior.best[NONE]

    @property
    def named(self) -> TraceFit:
        """The fit of the likeliest law."""
        return self.posterior.likeliest


def linear_modulus(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Modulus:
    """E and its standard deviation (MPa) by linear elasticity alone; first touch, zero and the theory's own
    error are fitted too.

    The error bar includes the force that the law leaves unexplained, but not the rig's error. Raises
    FemFailure (bad-load) if the geometry has no law.
    """
    law = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    return from_prior(law, trace, pooled_noise(trace)).modulus


def explain_trace(
    trace: IndenterTrace,
    *,
    thickness_mm: float | None,
    poisson_ratio: float,
    rng: np.random.Generator,
    rig_N_per_mm: float | None = None,
) -> Account:
    """Explains the curve: effect, parameters, probability, and prediction of held-out frames.

    `thickness_mm`: of the slab under a ball or punch, bonded to a rigid base; None: a half-space. The
    baseline is linear elasticity with contact that may start late (or before the recording), the load
    cell's zero, and a bend for the theory's own error. Maps and traces stay empty: there are no markers.
    `rig_N_per_mm`: a stated stiffness of the rig, for which the travel was not corrected. If the rig's share
    of the travel is too large, E is withheld and a lower bound is given (fem.indentation.rig_share).
    Raises FemFailure: bad-poisson-ratio, bad-load (thickness), no-load (force lost in noise).
    """
    if not 0 <= poisson_ratio < 0.5:
        raise FemFailure(
            FemProblem.BAD_POISSON_RATIO,
            f"indenter trace: found Poisson's ratio {poisson_ratio:g}, expected 0 up to less than 0.5: "
            "flesh and rubber are at 0.45 to 0.49.",
        )
    if thickness_mm is not None and thickness_mm <= 0:
        raise out_of_range(
            f"thickness {thickness_mm:g} mm", "more than 0 or none at all: measure the specimen"
        )
    whole = [before_rupture(part, noise_N=require_force(part).slow_N) for part in trace.parts]
    trace, ruptured = joined([part for part, _ in whole]), [said for _, said in whole if said]

    def explained(trace: IndenterTrace) -> CurvePosterior:
        plain = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
        law = identifiable(plain, trace)
        return posterior(candidate_fits(law, trace, pooled_noise(trace), rng, forms_of(trace)))

    answer, no_contact = explained(trace), pooled_noise(trace)
    # the plain law and single effects: with a common modulus, a law adapts to a recording of another specimen
    moduli = {
        name: own_moduli(trace, fit, no_contact) for name, fit in answer.best.items() if "+" not in name
    }
    left_out = strangers(max(moduli.values(), key=lambda of_law: of_law.law_fit.log_score))
    if left_out:
        trace = without(trace, left_out)
        answer, no_contact, moduli = explained(trace), pooled_noise(trace), {}
    plain, chosen, verdict = answer.best[NONE], answer.likeliest, answer.verdict
    for fit in (plain, chosen):
        if fit.law.name not in moduli:
            moduli[fit.law.name] = own_moduli(trace, fit, no_contact)
    names = verdict if isinstance(verdict, tuple) else (verdict,)
    heldout = _held_out(plain, chosen, trace, no_contact)
    rig = rig_share(trace, rig_N_per_mm=rig_N_per_mm)
    rig_sd = rig_spread(chosen, trace, no_contact)
    between = [scatter(moduli[fit.law.name], fit.scaled[0]) for fit in (plain, chosen)]
    before, after = (
        E.widened(float(np.hypot(rig_sd, added_sd)))
        for E, (_, added_sd) in zip((plain.modulus, answer.modulus(heldout)), between, strict=True)
    )
    withheld = None
    if rig.bound is not None:
        least_MPa = least_modulus(plain, trace, no_contact)
        withheld = f"it is at least {least_MPa:.2g} MPa, and how much more is not known: {rig.bound}"
    elif names[0] == UNKNOWN:
        withheld = UNEXPLAINED
    ranking = tuple(answer.candidate(name) for name in answer.probability if name not in (NONE, UNKNOWN))
    if withheld is not None:
        before, after = WITHHELD, WITHHELD
        ranking = tuple(replace(candidate, modulus=None) for candidate in ranking)
    explanation = Explanation(
        detected=answer.detected,
        p_value=answer.detection.p_value,
        statistics=answer.detection.p_values,
        p_nominal=P_NOMINAL,
        left_out=tuple(left_out),
        where=Where(region=_where(names)),
        when=_when(trace, plain),
        component="normal",
        ranking=ranking,
        verdict=verdict,
        before=before,
        after=after,
        withheld=withheld,
        heldout=heldout,
        next_grasp=next_press(names),
        cells=_cells(trace, plain, no_contact),
        notes=(*left_out.values(), *ruptured, *rig.notes, *_notes(trace, chosen, between[1][0])),
    )
    return Account(explanation=explanation, trace=trace, posterior=answer)


def _held_out(plain: TraceFit, chosen: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> HeldOut:
    """Error of both laws' predictions of held-out frames."""
    linear, named = (predicted_N(trace_fit, trace, no_contact) for trace_fit in (plain, chosen))
    size = float(np.sqrt(np.mean(trace.force_N[np.isfinite(linear)] ** 2)))
    return HeldOut(
        rms_before=share_missed(linear, trace.force_N),
        rms_after=share_missed(named, trace.force_N),
        noise_rms=no_contact.sd_N / size,
    )


def next_press(names: tuple[str, ...]) -> str | None:
    """A press that would separate the verdict's names; None for one name."""
    if len(names) < 2:
        return None
    effects = [SPECS[part] for name in names for part in name.split("+") if part in SPECS]
    if any(spec.name == "sensor_drift" for spec in effects):
        return IN_AIR
    return SLOWER if any(spec.knows_time for spec in effects) else BACK


def _where(names: tuple[str, ...]) -> str:
    """The machine ("tip") if every name belongs to the machine, otherwise the flesh."""
    parts = [part for name in names for part in name.split("+")]
    return "tip" if all(part in SPECS and SPECS[part].of_the_jaws for part in parts) else "flesh"


def _when(trace: IndenterTrace, plain: TraceFit) -> str:
    """The phase with most of the plain law's squared residual, otherwise "all"."""
    phases = np.array(trace.phases)
    left = (trace.force_N - plain.force_N) ** 2
    share = {p: float(left[phases == p].sum() / left.sum()) for p in ("load", "hold", "unload")}
    top = max(share, key=lambda p: share[p])
    return top if share[top] >= MOST else "all"


def _depth_mm(part: IndenterTrace, known: TraceFit, number: int) -> Float[np.ndarray, " t"]:
    """Travel of one recording beyond its first touch."""
    return np.asarray(part.travel_mm - known.scaled[known.law.index(f"onset_mm{suffix_of(number)}")])


def _cells(trace: IndenterTrace, plain: TraceFit, no_contact: NoContactNoise) -> tuple[ModulusCell, ...]:
    """Secant moduli with the linear fit's onset and zero; they scatter about one number if it is valid."""
    value = plain.law.values(plain.scaled[None])
    part_of = np.repeat(trace.numbers, [len(part.time_s) for part in trace.parts])
    zero = np.array([value[f"zero_N{suffix_of(k)}"][0] for k in part_of.tolist()])
    depth = np.concatenate(
        [_depth_mm(part, plain, k) for k, part in zip(trace.numbers, trace.parts, strict=True)]
    )
    (per_MPa,) = plain.law.curve_N_per_MPa(value, np.maximum(depth, 0.0)[None])
    loaded, phases = np.flatnonzero(per_MPa > 0.05 * per_MPa.max()), trace.phases
    return tuple(
        ModulusCell(
            grasp=f"press{suffix_of(int(part_of[k]))}",
            pad="tip",
            time_s=float(trace.time_s[k]),
            phase=phases[k],
            E_MPa=float((trace.force_N[k] - zero[k]) / per_MPa[k]),
            E_sd_MPa=float(no_contact.sd_N / per_MPa[k]),
        )
        for k in loaded[np.linspace(0, len(loaded) - 1, min(CELLS, len(loaded))).astype(int)]
    )


def _notes(trace: IndenterTrace, named: TraceFit, scatter_sd: float) -> tuple[str, ...]:
    """Sentences a reader must know about this curve."""
    law, several, deepest_mm = named.law, len(trace.parts) > 1, 0.0
    notes: list[str] = []
    for k, part in zip(trace.numbers, trace.parts, strict=True):
        of = f"Recording {k + 1}: " if several else ""
        onset, zero = (law.index(f"{name}{suffix_of(k)}") for name in ("onset_mm", "zero_N"))
        late_mm, late_sd = named.scaled[onset] - part.travel_mm[0], named.sd[onset]
        notes.append(
            f"{of}First touch {late_mm:.3g} ± {late_sd:.2g} mm into the travel, with "
            f"the load cell at {named.scaled[zero]:.3g} ± {named.sd[zero]:.2g} N before it."
        )
        depth_mm = float(_depth_mm(part, named, k).max())
        clear, deepest_mm = 3 * late_sd + 0.02 * depth_mm, max(deepest_mm, depth_mm)
        if late_mm > clear:
            notes.append(f"{of}Contact starts late: {late_mm:.2f} mm into the travel.")
        if late_mm < -clear:
            deep = f"was {-late_mm:.2f} mm deep before the recording started"
            notes.append(f"{of}The {trace.geometry.tool} {deep}.")
    notes.append(f"The best law leaves {named.share:.1%} of the force unexplained; intervals allow for it.")
    if not named.converged:
        notes.append(
            f"The search for the parameters of {in_words(law.name)} has not settled; do not trust them."
        )
    if several:
        notes.append(
            f"{len(trace.parts)} recordings have one law and one E; each was taken to begin with flesh that "
            "has come back from the one before, and with the damage and set of none. Their own E scatters by "
            f"{scatter_sd:.1%} (standard deviation); the error bar of the common E includes this."
        )
    if law.curve.held_over_sliding is not None:
        ends = law.index("ends_held")
        said = law.unknowns[ends].parameter(float(named.scaled[ends]), float(named.sd[ends]))
        low, high = said.interval or (0.0, 1.0)
        notes.append(
            f"The ends are not stated. From 0 (sliding) to 1 (held) the curve says {low:.2f} to {high:.2f}; "
            "E's error bar includes this uncertainty."
        )
    for name, why in law.curve.without.items():
        notes.append(f"{in_words(name).capitalize()} was not looked for: {why}.")
    return (*notes, *law.curve.notes_of(deepest_mm))
