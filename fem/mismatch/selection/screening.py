"""Screening: every effect's best signature, and every pair of them, by linear Gaussian evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from fem.fem_failure import FemFailure
from fem.mismatch.effect import AuxiliaryLikelihood, Effect, SeenDirectly, Signature
from fem.mismatch.evidence.force_noise import DRAWS, drawn_force_noise
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.large_deformation import (
    CLEAR,
    LARGE_DEFORMATION,
    LARGELY,
    LITTLE,
    large_deformation,
)
from fem.mismatch.evidence.linear_evidence import Fit, GramMatrix
from fem.mismatch.evidence.model_error import model_error_columns
from fem.mismatch.evidence.nuisances import common_nuisances, stand_ins
from fem.mismatch.gel_fault import GelFault, faults_of_relation
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import Regressor
from fem.parallel_map import parallel_map

Auxiliary: TypeAlias = Callable[[Effect, Signature, Float[np.ndarray, " k"]], tuple[float, float]]
"""ln likelihood of what else is known of a signature at given amounts, and of its direct marks."""


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """One signature of one effect among the columns of a case, fitted with the nuisances.

    `gain`: ln evidence over that of the nuisances, `auxiliary_log_likelihood` (fem.mismatch.effect) included,
    of which `direct` counts whatever the motion says. `modulus_change`: E with the effect over E without, and
    the relative standard deviation that it adds.
    """

    effect: Effect
    signature: Signature
    columns: tuple[int, ...]
    amounts: Float[np.ndarray, " k"]
    gain: float
    auxiliary_log_likelihood: float
    chi2_drop: float
    modulus_change: tuple[float, float]
    direct: float = 0.0

    @property
    def name(self) -> str:
        """The name of its effect."""
        return self.effect.spec.name


@dataclass(frozen=True, kw_only=True)
class LinearRound:
    """All products of a case; `null`: the fit of the nuisances; `best`: each effect's best, best first.

    `pairs`: gains of pairs of best signatures, greatest first. `without`: effects, one way of theirs to show,
    or large deformation, that could not be computed, and why. `largely`: ln evidence of flesh that deforms
    largely over flesh that moves little, the best effect of each beside it; the round is of the likelier,
    `other` of the other. `gel_faults`: all those of the catalogue. `numbers`: how
    many numbers all recordings have.
    """

    products: GramMatrix
    nuisances: tuple[int, ...]
    null: Fit
    linear_fits: tuple[LinearFit, ...]
    best: tuple[LinearFit, ...]
    pairs: tuple[tuple[float, LinearFit, LinearFit], ...]
    without: dict[str, str]
    largely: float = 0.0
    other: "LinearRound | None" = None
    gel_faults: tuple[GelFault, ...] = ()
    numbers: int = 0

    @property
    def deforms_largely(self) -> bool:
        """Whether that is clear, the best effect beside."""
        return self.largely > CLEAR

    @property
    def large_deformation(self) -> tuple[float, float] | None:
        """Its share and standard deviation in the plain model, where that is clearly likelier with it than
        without, no effect beside either.
        """
        if self.other is None:
            return None
        large, little = (self, self.other) if self.largely > 0 else (self.other, self)
        if large.null.log_evidence - little.null.log_evidence < CLEAR:
            return None
        return large.products.amount_of(LARGE_DEFORMATION, large.null)

    @property
    def evidence(self) -> float:
        """ln evidence of the plain model, or of the best effect beside it."""
        return self.null.log_evidence + max([0.0, *(one.gain for one in self.best)])


def screened(
    forward: ForwardModel,
    recorded: Sequence[GraspEquations],
    effects: Sequence[Effect],
    *,
    noise_draws: int = DRAWS,
) -> LinearRound:
    """Signatures of all effects, their products, and the evidence of each alone and of all pairs.

    `noise_draws`: of the noise of forces (fem.mismatch.evidence.force_noise).
    """
    recording: list[tuple[Effect, Signature]] = []
    without: dict[str, str] = {}
    answers = parallel_map(lambda effect: _signatures(forward, effect), effects, workers=forward.workers)
    for effect, answer in zip(effects, answers, strict=True):
        if isinstance(answer, FemFailure):
            without[effect.spec.name] = answer.detail
        else:
            recording += [(effect, signature) for signature in answer if not signature.untried]
            without |= {f"{effect.spec.name} ({s.label})": s.untried for s in answer if s.untried}
    large = large_deformation(forward)
    if isinstance(large, FemFailure):
        without[LARGE_DEFORMATION] = large.detail
    known = common_nuisances(forward)
    columns: list[Regressor] = [*known, *stand_ins(forward)]
    found: list[tuple[Effect, Signature, tuple[int, ...]]] = []
    for effect, signature in recording:
        first = len(columns) + 1
        columns += signature.columns
        found.append((effect, signature, tuple(range(first, len(columns) + 1))))
    errors = model_error_columns(found, compliance_ratio=forward.compliance_ratio)
    of_errors = range(len(columns) + 1, len(columns) + len(errors) + 1)
    nuisances = (*range(1, len(known) + 1), *of_errors)
    columns += errors
    noise = drawn_force_noise(forward, recorded, draws=noise_draws)
    products = GramMatrix(forward, recorded, columns, noise=noise)

    def round_of(products: GramMatrix) -> LinearRound:
        of_products = linear_round(
            products,
            nuisances,
            found,
            auxiliary=lambda *one: _auxiliary(forward, *one),
            without=without,
        )
        faults = tuple(effect for effect in effects if isinstance(effect, GelFault))
        numbers = sum(equations.own.shape[1] for equations in recorded)
        return replace(of_products, gel_faults=faults, numbers=numbers)

    if not isinstance(large, list):
        return round_of(products)
    little, largely = (
        round_of(products.with_prior(LARGE_DEFORMATION, *prior)) for prior in (LITTLE, LARGELY)
    )
    more = largely.evidence - little.evidence
    likelier, other = (largely, little) if more > 0 else (little, largely)
    return replace(likelier, largely=more, other=other)


def linear_round(
    products: GramMatrix,
    own: tuple[int, ...],
    found: Sequence[tuple[Effect, Signature, tuple[int, ...]]],
    *,
    auxiliary: Auxiliary,
    without: dict[str, str],
) -> LinearRound:
    """The evidence of each signature and of all pairs of effects, from products alone.

    `own`: columns of the plain model; `found`: each signature with its columns; `auxiliary`: what else is
    known of it at the amounts found.
    """
    null = products.fit(own)
    linear_fits = tuple(_linear_fit(products, own, null, auxiliary, *one) for one in found)
    best: dict[str, LinearFit] = {}
    for one in sorted(linear_fits, key=lambda s: -s.gain):
        best.setdefault(one.effect.spec.name, one)
    pairs = []
    for a, b in combinations(best.values(), 2):
        both = (*a.columns, *b.columns)
        fit = products.fit([*own, *both])
        if not violates_sign_constraint(products, both, fit.amounts[-len(both) :]):
            gain = fit.log_evidence - null.log_evidence + _auxiliary_of_pair(a, b)
            pairs.append((gain, a, b))
    return LinearRound(
        products=products,
        nuisances=own,
        null=null,
        linear_fits=linear_fits,
        best=tuple(best.values()),
        pairs=tuple(sorted(pairs, key=lambda pair: -pair[0])),
        without=without,
    )


def _signatures(forward: ForwardModel, effect: Effect) -> Sequence[Signature] | FemFailure:
    try:
        return effect.signatures(forward)
    except FemFailure as failure:
        return failure


def _auxiliary(
    forward: ForwardModel, effect: Effect, signature: Signature, amounts: Float[np.ndarray, " k"]
) -> tuple[float, float]:
    """ln likelihood of what else is known of a signature at these amounts, and of its direct marks."""
    said = 0.0
    if isinstance(effect, AuxiliaryLikelihood):
        said = effect.auxiliary_log_likelihood(
            forward, effect.start(forward, signature, amounts), signature.variant
        )
    return said, effect.direct_evidence(forward) if isinstance(effect, SeenDirectly) else 0.0


def _auxiliary_of_pair(a: LinearFit, b: LinearFit) -> float:
    """What else is known of both. Of two faults in one relation the greater direct evidence counts: one alone
    shows in part as another. What a second one adds is known once the first is refitted
    (fem.mismatch.selection.forward_selection.direct_evidence).
    """
    both = a.auxiliary_log_likelihood + b.auxiliary_log_likelihood
    of_one_relation = len(faults_of_relation([a.effect, b.effect])) == 2
    return both - min(a.direct, b.direct) if of_one_relation else both


def _linear_fit(
    products: GramMatrix,
    own: tuple[int, ...],
    null: Fit,
    auxiliary: Auxiliary,
    effect: Effect,
    signature: Signature,
    columns: tuple[int, ...],
) -> LinearFit:
    """One signature fitted beside the nuisances; it gains nothing with an amount that has no meaning."""
    fit = products.fit([*own, *columns])
    amounts = fit.amounts[len(fit.amounts) - len(columns) :]
    wrong = violates_sign_constraint(products, columns, amounts)
    moved = fit.log_evidence - null.log_evidence + log_positive(products, columns, fit)
    said, direct = auxiliary(effect, signature, amounts)
    auxiliary_log_likelihood = min(said, max(moved, 0.0))
    gain = moved + auxiliary_log_likelihood + direct
    return LinearFit(
        effect=effect,
        signature=signature,
        columns=columns,
        amounts=amounts,
        gain=min(gain, 0.0) if wrong else gain,
        auxiliary_log_likelihood=auxiliary_log_likelihood + direct,
        direct=direct,
        chi2_drop=0.0 if wrong else null.chi2 - fit.chi2,
        modulus_change=(1.0, 0.0) if wrong else modulus_change(null, fit),
    )


def modulus_change(before: Fit, after: Fit) -> tuple[float, float]:
    """E of one fit over E of another that lacks an effect, and the relative standard deviation that the
    effect adds to E. Both fits count 1/E from the same; E at most doubles.
    """
    changed = max(1 + after.amounts[0], 0.5)
    more = max(after.covariance[0, 0] - before.covariance[0, 0], 0.0)
    return float((1 + before.amounts[0]) / changed), float(np.sqrt(more) / changed)


def log_positive(products: GramMatrix, columns: Sequence[int], fit: Fit) -> float:
    """ln 2 Phi(mean / sd): what an amount's positive prior adds to the evidence with a symmetric one."""
    if len(columns) != 1 or not products.columns[columns[0]].positive:
        return 0.0
    return float(np.log(2.0) + log_ndtr(fit.amounts[-1] / fit.sd[-1]))


def violates_sign_constraint(
    products: GramMatrix, columns: Sequence[int], amounts: Float[np.ndarray, " k"]
) -> bool:
    """Whether an amount has the wrong sign, or is less than has a meaning."""
    return any(
        products.columns[j].positive and amount < products.columns[j].least
        for j, amount in zip(columns, amounts, strict=True)
    )
