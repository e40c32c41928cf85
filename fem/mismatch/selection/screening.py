"""Screening: every effect's signatures by linear Gaussian evidence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from fem.fem_failure import FemFailure
from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION, large_deformation
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import Fit, GramMatrix
from fem.mismatch.evidence.model_error import NullDraws, model_error_columns, scale_prior
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.evidence.surface_bias import SurfaceBias, surface_bias
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import DRAWS, drawn_force_noise
from fem.mismatch.model.observation_delta import Regressor
from fem.parallel_map import parallel_map

Auxiliary: TypeAlias = Callable[[Effect, Signature, Float[np.ndarray, " k"]], tuple[float, float]]
"""Auxiliary log likelihood of a signature at given amounts, and log evidence of its direct marks."""


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """One signature of one effect among the columns of a case, fitted with the nuisances.

    `gain`: log evidence over that of the nuisances, with `auxiliary_log_likelihood` (fem.mismatch.effect).
    Its part `direct` does not depend on the motion. `modulus_change`: E with the effect over E without, and
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
    """All products of a case; `null`: the fit of the nuisances; `linear_fits`: every signature's.

    `equations`: of all signatures, with the nuisances integrated out; `null_draws`: their data without
    mismatch. `surface_sd`: by column, the part of the model error that the error of the surface causes.
    `without`: effects, variants of effects, or large deformation that could not be computed, with
    the reason. `numbers`: count of all recordings' numbers, including frames left out by thinning.
    """

    products: GramMatrix
    nuisances: tuple[int, ...]
    null: Fit
    linear_fits: tuple[LinearFit, ...]
    equations: SignatureEquations
    null_draws: NullDraws
    surface_sd: Mapping[int, float]
    without: dict[str, str]
    numbers: float

    @property
    def best(self) -> tuple[LinearFit, ...]:
        """Each effect's best signature, the greatest gain first."""
        best: dict[str, LinearFit] = {}
        for fit in sorted(self.linear_fits, key=lambda fit: -fit.gain):
            best.setdefault(fit.name, fit)
        return tuple(best.values())


def screened(
    model: CaseModel,
    recorded: Sequence[GraspEquations],
    effects: Sequence[Effect],
    *,
    noise_draws: int = DRAWS,
) -> LinearRound:
    """Signatures of all effects, their products, and the evidence of each alone.

    `noise_draws`: number of draws of the forces' noise (fem.mismatch.model.force_noise).
    """
    recording: list[tuple[Effect, Signature]] = []
    without: dict[str, str] = {}
    answers = parallel_map(lambda effect: _signatures(model, effect), effects, workers=model.workers)
    for effect, answer in zip(effects, answers, strict=True):
        if isinstance(answer, FemFailure):
            without[effect.spec.name] = answer.detail
        else:
            recording += [(effect, signature) for signature in answer if not signature.untried]
            without |= {f"{effect.spec.name} ({s.variant.label})": s.untried for s in answer if s.untried}
    if model.beyond_small_strain and isinstance(large := large_deformation(model), FemFailure):
        without[LARGE_DEFORMATION] = large.detail
    known = common_nuisances(model)
    columns = list[Regressor](known)
    signatures: list[tuple[Effect, Signature, tuple[int, ...]]] = []
    for effect, signature in recording:
        first = len(columns) + 1
        columns += signature.columns
        signatures.append((effect, signature, tuple(range(first, len(columns) + 1))))
    without_errors = len(columns) + 1
    surface = SurfaceBias(products=np.zeros((len(recorded), without_errors)))
    try:
        surface = surface_bias(model, recorded, signatures, columns=without_errors)
    except FemFailure as failure:
        without["the error of the surface"] = failure.detail
    errors = model_error_columns(signatures, compliance_ratio=model.compliance_ratio, surface_sd=surface.sd)
    of_errors = range(len(columns) + 1, len(columns) + len(errors) + 1)
    columns += errors
    noise = drawn_force_noise(
        model.base,
        [equations.weighed_markers for equations in recorded],
        compliance=model.compliance,
        draws=noise_draws,
        workers=model.workers,
    )
    return linear_round(
        GramMatrix(
            model,
            recorded,
            columns,
            noise=noise,
            surface=np.pad(surface.products, ((0, 0), (0, len(errors)))),
        ),
        (*range(1, len(known) + 1), *of_errors),
        signatures,
        auxiliary=lambda *signature_at_amounts: _auxiliary(model, *signature_at_amounts),
        surface_sd=surface.sd,
        without=without,
        numbers=sum(equations.nuisances.shape[1] / equations.recording.kept for equations in recorded),
    )


def linear_round(
    products: GramMatrix,
    nuisances: tuple[int, ...],
    signatures: Sequence[tuple[Effect, Signature, tuple[int, ...]]],
    *,
    auxiliary: Auxiliary,
    surface_sd: Mapping[int, float],
    without: dict[str, str],
    numbers: float,
) -> LinearRound:
    """The evidence of each signature, from products alone.

    `nuisances`: columns of the plain model; `signatures`: each with its columns; `auxiliary`: its auxiliary
    log likelihood at the fitted amounts; `surface_sd`: as in LinearRound.
    """
    ways: dict[str, list[tuple[int, ...]]] = {}
    for effect, _, columns in signatures:
        ways.setdefault(effect.spec.name, []).append(columns)
    errors = {j: same for j in nuisances if (same := products.columns[j].same_as) is not None}
    equations = SignatureEquations.of(products, nuisances, ways)
    bare = SignatureEquations.of(products, without_model_error(products, nuisances), ways)
    error_sd = {same: products.columns[j].sd for j, same in errors.items()}
    null = products.fit(nuisances)
    return LinearRound(
        products=products,
        nuisances=nuisances,
        null=null,
        linear_fits=tuple(
            _linear_fit(products, nuisances, null, auxiliary, *signature) for signature in signatures
        ),
        equations=equations,
        null_draws=NullDraws(
            bare=bare,
            error_sd=np.array([error_sd.get(j, 0.0) for j in bare.columns]),
            prior=scale_prior(),
        ),
        surface_sd=surface_sd,
        without=without,
        numbers=numbers,
    )


def without_model_error(products: GramMatrix, nuisances: Sequence[int]) -> list[int]:
    """The nuisances without those of the model's own error."""
    return [j for j in nuisances if products.columns[j].same_as is None]


def _signatures(model: CaseModel, effect: Effect) -> Sequence[Signature] | FemFailure:
    try:
        return effect.signatures(model)
    except FemFailure as failure:
        return failure


def _auxiliary(
    model: CaseModel, effect: Effect, signature: Signature, amounts: Float[np.ndarray, " k"]
) -> tuple[float, float]:
    """Auxiliary log likelihood of a signature at these amounts, and log evidence of its direct marks."""
    said = 0.0
    if effect.says_more:
        said = effect.auxiliary_log_likelihood(
            model, effect.start(model, signature, amounts), signature.variant
        )
    return said, effect.direct_evidence(model)


def _linear_fit(
    products: GramMatrix,
    nuisances: tuple[int, ...],
    null: Fit,
    auxiliary: Auxiliary,
    effect: Effect,
    signature: Signature,
    columns: tuple[int, ...],
) -> LinearFit:
    """One signature fitted with the nuisances; a meaningless amount has a gain of zero at most."""
    fit = products.fit([*nuisances, *columns])
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
        modulus_change=(1.0, 0.0)
        if wrong
        else modulus_change(products, without_model_error(products, nuisances), fit, columns),
    )


def modulus_change(
    products: GramMatrix, nuisances: Sequence[int], fit: Fit, columns: Sequence[int]
) -> tuple[float, float]:
    """E with effects over E without, and the relative standard deviation that they add to E; E at most
    doubles. `fit`: with the model's own error, the effects' `columns` last; `nuisances`: of the plain model.

    The model's own error is known at a fixed E: it widens the effects' amounts a, and does not change E at
    given amounts. With B the fit with the effects and without that error,

    1/E at a = (1/E)_B + d (a - a_B),      d = cov_B(1/E, a) cov_B(a)^-1
    """
    if not columns:
        return 1.0, 0.0
    without, with_effects = products.fit(nuisances), products.fit([*nuisances, *columns])
    last = slice(len(with_effects.amounts) - len(columns), None)
    slope = np.linalg.solve(with_effects.covariance[last, last], with_effects.covariance[last, 0])
    last_of_fit = slice(len(fit.amounts) - len(columns), None)
    held = np.diag([products.columns[j].measured_sd ** 2 for j in columns])
    amounts, covariance = fit.amounts[last_of_fit], fit.covariance[last_of_fit, last_of_fit] + held
    changed = max(1 + with_effects.amounts[0] + slope @ (amounts - with_effects.amounts[last]), 0.5)
    return (
        float((1 + without.amounts[0]) / changed),
        float(np.sqrt(slope @ covariance @ slope) / changed),
    )


def log_positive(products: GramMatrix, columns: Sequence[int], fit: Fit) -> float:
    """ln 2 Phi(mean / sd): log evidence of an amount's positive prior over that of a symmetric one."""
    if len(columns) != 1 or not products.columns[columns[0]].positive:
        return 0.0
    return float(np.log(2.0) + log_ndtr(fit.amounts[-1] / fit.sd[-1]))


def violates_sign_constraint(
    products: GramMatrix, columns: Sequence[int], amounts: Float[np.ndarray, " k"]
) -> bool:
    """Whether an amount has the wrong sign, or is below its `least`."""
    return any(
        products.columns[j].positive and amount < products.columns[j].least
        for j, amount in zip(columns, amounts, strict=True)
    )
