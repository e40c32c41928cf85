"""One effect, or two at once, fitted with the full nonlinear model: Gauss-Newton on evidence.

Parameters are searched on the scale of their EffectParameter. Finite-difference slopes of the response about
the current parameters are columns like any other. Their amounts are the step, and their covariance is that of
the parameters. The evidence is that of the last linearised model (Laplace). Priors are as wide as those of
the signatures' amounts; a parameter without one has a prior as wide as its bounds allow.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from fem.fem_failure import FemFailure
from fem.mismatch.effect import Effect, Response, superposed
from fem.mismatch.effect_spec import EffectParameter
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION
from fem.mismatch.evidence.law_error import modulated_changes
from fem.mismatch.evidence.linear_evidence import Fit, GramMatrix
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.selection.screening import LinearFit, LinearRound
from fem.mismatch.signature_variant import Variant

ROUNDS = 9
"""Rounds at most."""
STEP = 0.03
"""Difference step as a share of the prior spread."""
MOST_STEP = 1.0
"""In prior spreads: the longest step of a round in any parameter."""
MARGIN = 1e-3
"""Margin from both bounds, as a share of a parameter's range: some laws have no solution at a bound."""
SAME_E = 0.01
"""Relative change of 1/E below which the model is not computed again: E is known no better."""
MOST_CHANGE = 2.0
"""Factor by which 1/E changes at most in a round, so that a hardly known 1/E does not run away. Set by hand;
further rounds go on from there."""
TRUST = 10.0
"""Standard deviations by which a held-out fit may move a parameter along its slope. Set by hand, wider than
other recordings determine it and narrow enough for linear slopes."""
MOST_SINGLE_RESPONSES = 12
"""Cached responses of single effects: a round of differences of two effects needs fewer. Set by hand."""
LAST_ROUND_GAIN = 0.3
"""Log evidence; a round of a refit that gains less is the last. This is a fifteenth of the difference that
gives two explanations odds of 20 to 1 at the temperature of the posterior."""
OTHER_START_SHARE = 0.8
"""Another start is used above this share of the gain at the linear amounts. It does not depend on slopes at
zero, and the search from there ends nearer to the truth (`benchmarks/mismatch.py`, pose_error)."""
NEARER, LEAST_SHARE = 0.6, 0.2
"""Factor that moves a start towards zero if it has no model, and the smallest share that is tried."""


@dataclass(frozen=True, kw_only=True)
class Refit:
    """`parameters` of each effect by name; `covariance` on the scale searched (relative where `log`).

    `ahead`: for each parameter, a step on the scale searched, and the response after that step.
    `products`: the linearised model at the end, its columns `nuisances` and `slopes`, `fit` of all of them.
    `others`: equations of all signatures given the model of one effect, with columns as in the linear round.
    `model`: with the 1/E to which `fit`'s first amount is relative, and the search's warm starts for another
    search. `at_an_end`: for each effect, whether a parameter is at the end of its bounds, where it means
    another cause. `last_gain`: log evidence that the last round gained. `signal`: chi-square of the plain
    model less that of `fit`.
    """

    effects: tuple[Effect, ...]
    variants: tuple[Variant, ...]
    parameters: tuple[dict[str, float], ...]
    covariance: Float[np.ndarray, "p p"]
    response: Response
    ahead: tuple[tuple[float, Response], ...]
    products: GramMatrix
    nuisances: tuple[int, ...]
    slopes: tuple[int, ...]
    fit: Fit
    log_evidence: float
    others: SignatureEquations | None
    model: CaseModel
    at_an_end: tuple[bool, ...]
    last_gain: float
    signal: float

    @property
    def converged(self) -> bool:
        """Whether the search reached its tolerance."""
        return self.last_gain < LAST_ROUND_GAIN

    def near(self) -> GramMatrix:
        """The linearised model with its slopes limited to TRUST standard deviations.

        Otherwise directions that a single recording determines would make predictions of the others
        arbitrary.
        """
        other = copy(self.products)
        other.columns = list(other.columns)
        for column, sd in zip(self.slopes, TRUST * self.fit.sd[-len(self.slopes) :], strict=True):
            slope = other.columns[column]
            other.columns[column] = replace(slope, sd=min(slope.sd, float(sd)))
        return other

    @property
    def name(self) -> str:
        """Effects' names, sorted and joined."""
        return "+".join(sorted(effect.spec.name for effect in self.effects))


def refit(
    model: CaseModel, linear: LinearRound, linear_fits: Sequence[LinearFit], *, first: Refit | None = None
) -> Refit:
    """The effects of these signatures, refitted. `first`: the first effect's full model, where a pair begins.

    Raises FemFailure if their model cannot be computed at any start, or at a later step.
    """
    specs = [spec for fit in linear_fits for spec in fit.effect.spec.searched]
    model = model if first is None else first.model
    search = _Search(model, linear, tuple(linear_fits), specs)
    now, _ = search.followed(search.begun(model, () if first is None else first.parameters))
    gained = float("inf")
    for _ in range(ROUNDS):
        step = now.fit.amounts[-len(specs) :]
        step = step * min(1.0, MOST_STEP / max(float(np.abs(step / search.spread).max()), 1e-12))
        ahead = next(
            (
                tried
                for share in (1.0, 0.3)
                if search.merit(tried := search.bounded(now.at + share * step)) > now.merit
            ),
            None,
        )
        gained = 0.0
        if ahead is not None:
            gained = search.merit(ahead) - now.merit
            now = search.linearised(ahead)
        now, again = search.followed(now)
        if not again and gained < LAST_ROUND_GAIN:
            break
    count = len(specs)
    # slopes are at a fixed 1/E, parameters also change with 1/E (strain_power)
    along = np.eye(len(now.fit.amounts))[-count:]
    along[:, 0] = search.power
    return Refit(
        effects=tuple(fit.effect for fit in linear_fits),
        variants=tuple(fit.signature.variant for fit in linear_fits),
        parameters=tuple(search.by_effect(now.at)),
        covariance=along @ now.fit.covariance @ along.T,
        response=now.response,
        ahead=now.ahead,
        products=now.products,
        nuisances=now.chosen[: len(now.chosen) - count],
        slopes=now.chosen[len(now.chosen) - count :],
        fit=now.fit,
        log_evidence=now.log_evidence,
        others=search.others_equations(now) if len(linear_fits) == 1 else None,
        model=search.model,
        at_an_end=search.at_an_end(now.at),
        last_gain=gained,
        signal=linear.null.chi2 - now.fit.chi2,
    )


@dataclass(frozen=True, kw_only=True)
class _Linearised:
    """`merit`: log evidence with parameters fixed; `log_evidence`: with the parameters' widths (Laplace)."""

    at: Float[np.ndarray, " p"]
    merit: float
    log_evidence: float
    response: Response
    ahead: tuple[tuple[float, Response], ...]
    products: GramMatrix
    chosen: tuple[int, ...]
    fit: Fit


class _Search:
    """Parameters of several effects on the scale of the search, and the model linearised about them."""

    def __init__(
        self,
        model: CaseModel,
        linear: LinearRound,
        linear_fits: tuple[LinearFit, ...],
        specs: Sequence[EffectParameter],
    ) -> None:
        warm_start = model.warm_starts or WarmStarts()
        self.model = replace(model, warm_starts=warm_start.copy())
        self.linear, self.linear_fits = linear, linear_fits
        holds_it = any(fit.effect.spec.holds_large_deformation for fit in linear_fits)
        self.nuisances = tuple(
            j
            for j in linear.nuisances
            if not (holds_it and linear.products.columns[j].name == LARGE_DEFORMATION)
        )
        self.signatures = tuple(j for fit in linear_fits for j in fit.columns)
        self.log = np.array([spec.log for spec in specs])
        low, high = (np.array([getattr(spec, end) for spec in specs]) for end in ("low", "high"))
        self.low, self.high = self._scale(low), self._scale(high)
        quarter = (self.high - self.low) / 4
        known = [
            priors.get(spec.name)
            for fit in linear_fits
            for priors in [fit.effect.prior(model, fit.signature)]
            for spec in fit.effect.spec.searched
        ]
        wide = [
            share if spec.spread is None else spec.spread for share, spec in zip(quarter, specs, strict=True)
        ]
        self.spread = np.array(
            [sd if prior is None else prior.sd for sd, prior in zip(wide, known, strict=True)]
        )
        mean = np.array([np.nan if prior is None else prior.mean for prior in known])
        self.mean, self.positive = self._scale(mean), mean <= low
        self.held = np.array([prior is not None and prior.measured for prior in known])
        self.power = np.array([spec.strain_power for spec in specs])
        self.low_is_a_law = np.array([spec.low_is_a_law for spec in specs])
        self.known: dict[bytes, tuple[Response, float]] = {}
        # one effect's responses are cached while another's parameters vary
        self.single_response = lru_cache(MOST_SINGLE_RESPONSES)(self._single_response)

    def _scale(self, values: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        return np.asarray(
            np.where(self.log, np.log(np.where(self.log, np.maximum(values, 1e-9), 1.0)), values)
        )

    def from_prior(self, at: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """The parameters less the means of measured priors, in standard deviations; zero for others."""
        return np.asarray(np.where(self.held, (at - self.mean) / self.spread, 0.0))

    def begun(self, model: CaseModel, known: Sequence[dict[str, float]] = ()) -> _Linearised:
        """The model at the start; if there is none, as for a pit that pokes out, at a start nearer to zero.

        If an effect has another start that gains about as much, that one is used. `known`: parameters at
        which the first effects start.

        Raises FemFailure if there is no model down to LEAST_SHARE of the linear amounts.
        """
        share, before = 1.0, None
        while True:
            starts = [
                *known,
                *(
                    fit.effect.start(model, fit.signature, share * fit.amounts)
                    for fit in self.linear_fits[len(known) :]
                ),
            ]
            try:
                now = self.linearised(self.scaled(starts))
                break
            except FemFailure:
                share *= NEARER
                if share < LEAST_SHARE or starts == before:
                    raise
                before = starts
        plain = self.linear.null.log_evidence
        for k, fit in enumerate(self.linear_fits[len(known) :], start=len(known)):
            other = fit.effect.other_start(model, fit.signature.variant)
            if other is not None:
                tried = [*starts[:k], other, *starts[k + 1 :]]
                if self.merit(self.scaled(tried)) - plain > OTHER_START_SHARE * (now.merit - plain):
                    starts = tried
                    now = self.linearised(self.scaled(tried))
        return now

    def scaled(self, starts: Sequence[Mapping[str, float]]) -> Float[np.ndarray, " p"]:
        values = [
            start[spec.name]
            for fit, start in zip(self.linear_fits, starts, strict=True)
            for spec in fit.effect.spec.searched
        ]
        return self.bounded(self._scale(np.array(values, dtype=float)))

    def bounded(self, at: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        margin = MARGIN * (self.high - self.low)
        return np.asarray(np.clip(at, self.low + margin, self.high - margin))

    def at_an_end(self, at: Float[np.ndarray, " p"]) -> tuple[bool, ...]:
        """For each effect, whether a parameter is at the end of its bounds."""
        margin = 1.01 * MARGIN * (self.high - self.low)
        ends = ((at <= self.low + margin) & ~self.low_is_a_law) | (at >= self.high - margin)
        first = np.cumsum([0, *(len(fit.effect.spec.searched) for fit in self.linear_fits)])
        return tuple(bool(ends[a:b].any()) for a, b in pairwise(first))

    def by_effect(self, at: Float[np.ndarray, " p"]) -> list[dict[str, float]]:
        """The parameters of each effect by name."""
        values = iter(np.where(self.log, np.exp(np.where(self.log, at, 0.0)), at).tolist())
        return [{spec.name: next(values) for spec in fit.effect.spec.searched} for fit in self.linear_fits]

    def respond(self, at: Float[np.ndarray, " p"]) -> Response:
        """The sum of the effects' changes of the plain model's response."""
        responses = [
            self.single_response(k, tuple(parameters.items()), self.model.compliance)
            for k, parameters in enumerate(self.by_effect(at))
        ]
        return responses[0] if len(responses) == 1 else superposed(self.model, responses)

    def _single_response(
        self, number: int, parameters: tuple[tuple[str, float], ...], _compliance: float
    ) -> Response:
        fit = self.linear_fits[number]
        return fit.effect.respond(self.model, dict(parameters), fit.signature.variant)

    def followed(self, now: _Linearised) -> tuple[_Linearised, bool]:
        """The model at the fit's 1/E, on which large deformation depends; and whether 1/E changed.

        Parameters change with 1/E so that the law stays the same (EffectParameter.strain_power). In soft
        flesh 1/E and the model's own error are nearly collinear: that fit omits the error's columns.
        """
        firm = [j for j in now.chosen if now.products.columns[j].same_as is None]
        share = float(np.clip(1 + now.products.fit(firm).amounts[0], 1 / MOST_CHANGE, MOST_CHANGE))
        if abs(share - 1) < SAME_E:
            return now, False
        before = self.model
        self.model, self.known = replace(before, compliance=before.compliance * share), {}
        try:
            return self.linearised(self.bounded(now.at + self.power * np.log(share))), True
        except FemFailure:
            self.model, self.known = before, {}
            return now, False

    def merit(self, at: Float[np.ndarray, " p"]) -> float:
        """Log evidence of the model with these parameters fixed; -inf if there is no model."""
        try:
            return self._about(at)[1]
        except FemFailure:
            return float("-inf")

    def _about(self, at: Float[np.ndarray, " p"]) -> tuple[Response, float]:
        key = at.tobytes()
        if key not in self.known:
            response = self.respond(at)
            products, chosen = self.linear.products.about(
                self.model, response, self.nuisances, signatures=self.signatures
            )
            offset = self.from_prior(at)
            merit = products.fit(chosen).log_evidence - float(offset @ offset) / 2
            self.known = {key: (response, merit)}
        return self.known[key]

    def linearised(self, at: Float[np.ndarray, " p"]) -> _Linearised:
        """The model about these parameters, with its slopes as columns.

        Laplace: the slopes' remaining gain is subtracted; only their widths and priors count.
        """
        response, merit = self._about(at)
        slopes: list[Regressor] = []
        steps: list[tuple[float, Response]] = []
        for k, spread in enumerate(self.spread):
            step = STEP * spread * (1 if at[k] + STEP * spread < self.high[k] else -1)
            try:
                ahead = self.respond(at + step * np.eye(len(at))[k])
            except FemFailure:
                step = -step
                ahead = self.respond(at + step * np.eye(len(at))[k])
            steps.append((float(step), ahead))
            slopes.append(
                Regressor(
                    name=f"slope {k}",
                    sd=float(spread),
                    fields=[
                        ObservationDelta()
                        .plus(1 / step, ahead.change(self.model, k))
                        .plus(-1 / step, response.change(self.model, k))
                        for k in range(len(response.unit))
                    ],
                )
            )
        products, chosen = self.linear.products.about(
            self.model, response, self.nuisances, slopes, signatures=self.signatures
        )
        fit, offset = products.fit(chosen), self.from_prior(at)
        last = slice(len(fit.amounts) - len(slopes), None)
        covariance, step = fit.covariance[last, last], fit.amounts[last]
        log_evidence = fit.log_evidence - (step @ np.linalg.solve(covariance, step) + offset @ offset) / 2
        above = ((at - self.mean) / np.sqrt(np.diag(covariance)))[self.positive]
        log_evidence += (np.log(2.0) + log_ndtr(above)).sum()
        # the columns' priors are about these parameters
        fit = replace(fit, amounts=fit.amounts - fit.covariance[:, last] @ (offset / self.spread))
        return _Linearised(
            at=at,
            merit=merit,
            log_evidence=float(log_evidence),
            response=response,
            ahead=tuple(steps),
            products=products,
            chosen=chosen,
            fit=fit,
        )

    def others_equations(self, now: _Linearised) -> SignatureEquations:
        """The equations of all signatures given the model and the errors of its law, with its slopes
        integrated out.
        """
        equations, cut = self.linear.equations, len(now.chosen) - len(self.spread)
        slopes = [now.products.columns[j] for j in now.chosen[cut:]]
        products, chosen = self.linear.products.about(
            self.model,
            now.response,
            (*self.nuisances, *equations.columns),
            [*slopes, *modulated_changes(self.model, now.response)],
            signatures=self.signatures,
        )
        ends = np.cumsum([len(self.nuisances), len(equations.columns), len(slopes)])
        nuisances, signatures, slope_columns, errors = (chosen[a:b] for a, b in pairwise([0, *ends, None]))
        normal, right = products.marginal((*nuisances, *slope_columns), (*signatures, *errors))
        mine, law = slice(len(signatures)), slice(len(signatures), None)
        alone = replace(equations, normal=normal[mine, mine], right=right[mine])
        energy = np.diag(products.marginal((), errors)[0])
        return alone.given_law(normal[law, law], normal[mine, law], energy=energy)
