"""Diagnosis of one fruit's recordings: is there a mismatch, where, which, and does modelling it help?"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from fem.estimation.compliance_fit import CompliantFit, fit_compliance
from fem.mismatch.catalogue import EFFECTS, SPECS
from fem.mismatch.evidence.beyond_small_strain import large_deformation
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.localisation.residual_places import located, modulus_cells
from fem.mismatch.localisation.spot_search import fruit_map
from fem.mismatch.mismatch_case import GradedCase, MismatchCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.finer_mesh import with_finer_mesh
from fem.mismatch.model.plain_model import Fields, PlainModel, plain_model
from fem.mismatch.model.touched_skin import with_touched_skin
from fem.mismatch.reported_values import candidates
from fem.mismatch.result import NONE, UNKNOWN, Explanation, Modulus, Where, in_words
from fem.mismatch.selection.cross_validation import cross_validated
from fem.mismatch.selection.decision import Detection, detection
from fem.mismatch.selection.grasp_explanations import Hypothesis
from fem.mismatch.selection.model_selection import select_model
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.reported_modulus import modulus_by, reported_modulus
from fem.mismatch.selection.screening import LinearRound, screened
from fem.solid.linear_solid import Support, UnitModulusSolid

TOUCH_SHARE = 0.5
"""Share of the frames in which large deformation is solved for the places that markers touch (path_share of
CaseModel). Set by hand: the places change by tens of micrometres, and need not be right to one."""


def explain(
    case: MismatchCase,
    *,
    graded: GradedCase | None,
    progress: Callable[[str], None] | None = None,
    workers: int = 1,
) -> Explanation:
    """The joint explanation of all recordings of a case, computed with `workers` threads.

    `graded`: E without an effect, as graded (fem.estimation.fruit_modulus), and the models that also infer E
    with an effect. It is the reported E if no effect is found. None: the mean of the recordings' own fits.

    Raises FemFailure if the plain model cannot be fitted.
    """
    seconds: dict[str, float] = {}

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress is not None:
            progress(name)
        started = time.perf_counter()
        yield
        seconds[name] = round(time.perf_counter() - started, 2)

    with stage("plain model"):
        model, fits = case_model(case, solids={} if graded is None else graded.solids, workers=workers)
        if graded is None:
            plain = modulus_of(model)
        else:
            model, plain = as_graded(replace(model, graded=graded.models), graded.modulus), graded.modulus
        recorded = model.each(lambda recording: GraspEquations.of(model, recording))
    with stage("all effects, linear"):
        linear = screened(model, recorded, EFFECTS)
        test = detected(linear)
    with stage("verdict, in full"):
        selection = select_model(model, linear, p_value=test.p_value)
    with stage("cross-validation"):
        named = next((h for h in selection.ranking if h.name in selection.names and h.refit), None)
        best = None if named is None else named.refit
        null = (linear.products, linear.nuisances)
        after = null if best is None else (best.near(), (*best.nuisances, *best.slopes))
        ranking = candidates(selection, linear, workers=workers)
        proof, traces = cross_validated(model, recorded, null, after)
    with stage("where and when"):
        residual = [linear.products.marker_residual(k, linear.null) for k in range(len(recorded))]
        region, when, component = located(model, residual)
        maps = fruit_map(model, model.adjoint_basis.observed(residual))
    untried = {**linear.without, **selection.without}
    notes = [f"{in_words(name)} could not be tried: {why}." for name, why in untried.items()]
    if best is not None and named is not None:
        notes += [] if best.converged else [NOT_CONVERGED_NOTE.format(name=in_words(best.name))]
        notes += _other_pads(named)
    return Explanation(
        detected=test.mismatch and selection.verdict != NONE,
        p_value=test.p_value,
        statistics=test.p_values,
        where=_where(region, best),
        when=when,
        component=component,
        ranking=ranking,
        verdict=selection.verdict,
        before=plain,
        after=reported_modulus(
            selection.verdict,
            [
                (hypothesis.probability, modulus_by(hypothesis, candidate.modulus, plain, proof))
                for hypothesis, candidate in zip(selection.ranking, ranking, strict=True)
            ],
            plain,
        ),
        heldout=proof,
        next_grasp=next_grasp(selection.verdict, grasps=len(recorded)),
        cells=modulus_cells(model, fits),
        traces=traces,
        maps=maps,
        notes=tuple(notes),
        seconds=seconds,
    )


NOT_CONVERGED_NOTE = (
    "the search for the parameters of {name} has not converged; they may lie beyond their error bars."
)


def _other_pads(first: Hypothesis) -> list[str]:
    """The named effect on another pad, if the recordings cannot separate the pads: sentences."""
    said = []
    for share, again in first.alternatives:
        words = [
            f"{in_words(effect.spec.name)} of the {variant.pad} pad ("
            + ", ".join(f"{name} {value:.3g}" for name, value in parameters.items())
            + ")"
            for effect, variant, parameters in zip(
                again.effects, again.variants, again.parameters, strict=True
            )
            if variant.pad
        ]
        if words:
            pads = " and ".join(words)
            said.append(f"{pads} explains the recordings about as well (probability {share:.2f}).")
    return said


def _where(region: str, best: Refit | None) -> Where:
    """Place of the named effect if it has one (a spot in the fruit, or one pad), otherwise `region`."""
    named = () if best is None else zip(best.effects, best.variants, best.parameters, strict=True)
    for effect, variant, parameters in named:
        place = effect.where(parameters)
        if place is not None:
            return place
        if variant.pad:
            return Where(region=f"pad {variant.pad}")
    return Where(region=region)


def case_model(
    case: MismatchCase,
    *,
    solids: Mapping[Support, UnitModulusSolid] | None = None,
    most_frames: int | None = None,
    beyond_small_strain: bool = True,
    workers: int = 1,
) -> tuple[CaseModel, list[CompliantFit]]:
    """The plain model at the median 1/E of the recordings, and its fits. `solids`: already factorised, by
    support. `most_frames`: of each recording (None: all). `beyond_small_strain`: as in CaseModel.
    """
    registered = plain_model(case, solids=solids, workers=workers)
    before = _median_compliance(plain_fits(registered))
    first = CaseModel(
        base=registered,
        compliance=before,
        path_share=TOUCH_SHARE,
        beyond_small_strain=beyond_small_strain,
        workers=workers,
    )
    touched = with_touched_skin(registered, _moved_mm(first), most_frames=most_frames, workers=workers)
    base = with_finer_mesh(touched, workers=workers)
    fits = plain_fits(base)
    compliance = _median_compliance(fits)
    scale = compliance / before if compliance > 0 and before > 0 else 1.0
    model = CaseModel(
        base=base,
        compliance=compliance,
        modulus_scale=scale,
        beyond_small_strain=beyond_small_strain,
        workers=workers,
    )
    return model, fits


def _moved_mm(model: CaseModel) -> Fields:
    """Displacement of every recording's markers by the plain model; without large deformation if the fitted
    1/E is not positive or its solve fails.
    """
    large = large_deformation(model) if model.beyond_small_strain and model.compliance > 0 else None
    unit = model.plain
    if isinstance(large, list):
        unit = [linear + more for linear, more in zip(unit, large, strict=True)]
    return [model.compliance * field for field in unit]


def as_graded(model: CaseModel, graded: Modulus) -> CaseModel:
    """The same model, with E of every explanation scaled so that the plain E is the graded one."""
    ratio = graded.value / modulus_of(model).value
    return replace(model, modulus_scale=model.modulus_scale * ratio)


def plain_fits(base: PlainModel) -> list[CompliantFit]:
    """Fit of 1/E by the plain model to each recording alone."""
    scale_sd = base.case.budget.gel_scale_sd
    return [
        fit_compliance(recording.tracks, scale_sd=scale_sd, fruit_moves=recording.case.support == "free")
        for recording in base.grasps
    ]


def _median_compliance(fits: Sequence[CompliantFit]) -> float:
    return float(np.median([fit.compliance for fit in fits]))


def detected(linear: LinearRound) -> Detection:
    """Tests whether the recordings contradict the plain model."""
    direct = [fit.direct for fit in linear.best if fit.effect.seen_directly]
    against: dict[str, list[float]] = {}
    for fit in linear.linear_fits:
        of_effect = against.setdefault(fit.name, [])
        if fit.columns:
            of_effect.append(min(fit.auxiliary_log_likelihood, 0.0))
    return detection(
        linear.equations,
        linear.null_draws,
        misfit=linear.null.chi2 / linear.numbers,
        direct=float(logsumexp(direct) - np.log(len(direct))) if direct else 0.0,
        against=against,
        rng=np.random.default_rng(0),
    )


TURNED = (
    "grasp the same spots once more with the fruit turned by 180 degrees between the jaws: what belongs "
    "to a sensor or jaw stays with it, what belongs to the fruit moves along"
)
TWICE = (
    "grasp one spot twice in a row and record the unloading too: what lasts shows in the unloading and in "
    "the second grasp"
)
SPEEDS = "grasp one spot at two speeds that differ tenfold, each with a hold of ten seconds"
ACROSS = "grasp across the last direction, and along the stem if the jaws allow it"


def next_grasp(verdict: str | tuple[str, ...], *, grasps: int) -> str | None:
    """Advice on the next recording, or None if no effects need to be separated. `grasps`: recordings so far.

    The first difference between the remaining effects decides: whether they stay with a jaw, whether they
    persist in the flesh, whether they depend on time.
    """
    if isinstance(verdict, str):
        if verdict == UNKNOWN:
            return f"nothing in the catalogue explains this; first {SPEEDS}; then {TURNED}"
        if verdict != NONE and grasps < 2:
            return f"one recording alone cannot be checked against another: {ACROSS}; then {TURNED}"
        return None
    specs = [SPECS[part] for name in verdict for part in name.split("+") if part in SPECS]
    if len({spec.of_the_jaws for spec in specs}) > 1:
        return TURNED
    if len({spec.remembers_grasps for spec in specs}) > 1:
        return TWICE
    return SPEEDS if any(spec.knows_time for spec in specs) else ACROSS
