"""One modulus per fruit from all its grasps, and the pit's place: one linear Gaussian inference.

The unknowns common to the grasps are ln E, the pit's offset (3) and size (1) relative to the prior, and
Poisson's ratio. Each grasp has its own surface, pose, force scales, misfit and scatter. Every unknown but
ln E has a prior. With N the information of the data, L that of the priors, P = (N + L)^-1 and x the row of P
that belongs to ln E,

    var(ln E) = x N x + sum_k x_k^2 L_k

splits the variance exactly into the sensors' noise and each prior's share. An unknown that the data do not
inform contributes its sensitivity times its spread; one that they inform contributes less.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.error_budget import DISCRETISATION, MODEL, SCATTER, TACTILE, ErrorBudget, part_of
from fem.estimation.information import FORCE_SCALE, GraspInformation
from fem.estimation.sensitivity import PIT, POISSON_RATIO
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory

NOTICED = 0.03
"""Relative scatter between grasps, beyond their errors, that gives a warning."""
MOST_TENSION = 6.0
"""chi-square per degree of freedom of the pads' numbers that gives a warning. Set by hand: the probability
above it is 0.01 with two numbers and 1e-5 with four; the largest of the sample batch's four fruit is 2.2."""
RANK = 1e-9
"""Singular values of a grasp's information below this share of the greatest one are rounding."""
MOST_ROUNDS, STILL = 50, 1e-5
"""Amounts are s p: each round scales the fields by the last s, until ln E changes by less than STILL, a
thousandth of the least error bar (1 %)."""


@dataclass(frozen=True, kw_only=True)
class PitPosterior:
    """Posterior of the pit: x, y, z (mm, fruit frame) and ln of its size, all relative to the prior's pit.

    `prior_sd`, `sd`: before and after; `covariance` after.
    """

    offset_mm: Float[np.ndarray, "3"]
    ln_size: float
    covariance: Float[np.ndarray, "4 4"]
    prior_sd: Float[np.ndarray, "4"]

    @property
    def sd(self) -> Float[np.ndarray, "4"]:
        """Standard deviations of x, y, z (mm) and ln size."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def moved(self) -> Float[np.ndarray, "4"]:
        """Posterior mean of each relative to the prior, in the prior's standard deviations."""
        return np.append(self.offset_mm, self.ln_size) / np.where(self.prior_sd > 0, self.prior_sd, np.inf)

    @property
    def learnt(self) -> Float[np.ndarray, "4"]:
        """Share of the prior's variance that the data removed."""
        return np.asarray(1 - (self.sd / np.where(self.prior_sd > 0, self.prior_sd, np.inf)) ** 2)


@dataclass(frozen=True, kw_only=True)
class FruitModulus:
    """`E_MPa` of the fruit, its standard deviation, and the parts that add up to it in squares (MPa).

    `pit` is None if its place was not inferred. `grasps`: their number.
    """

    E_MPa: float
    E_sd_MPa: float
    parts_sd_MPa: dict[str, float]
    pit: PitPosterior | None
    grasps: int
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class GraspEvidence:
    """A grasp's input to the inference: its information, and further errors of its E.

    `misfit_sd`, `discretisation_sd`: relative, from the misfit of the model and the size of elements.
    `history`: the recording, for the surface error under its own pads; None: the budget's numbers alone.
    """

    information: GraspInformation
    E_MPa: float
    misfit_sd: float
    discretisation_sd: float
    history: GraspHistory | None = None


def joint_modulus(
    grasps: Sequence[GraspEvidence],
    *,
    budget: ErrorBudget,
    infer_pit: bool,
    pit_at: Float[np.ndarray, "4"] | None = None,
) -> FruitModulus:
    """The inference above. Raises ValueError without a grasp, FemFailure (NOT_CONVERGED) if ln E does not
    converge.

    `infer_pit` False keeps pit and Poisson's ratio at their priors and only counts the effect of their spread
    on E. `pit_at`: offset (mm) and ln size, relative to the prior, of the pit in the model behind the
    information. Grasps that scatter beyond their errors get a random effect each (DerSimonian and Laird
    1986). With `infer_pit`, pads that contradict each other count less (`_tension`).
    """
    if not grasps:
        raise ValueError("joint_modulus needs at least one grasp, found none")
    at = np.zeros(4) if pit_at is None else pit_at
    solution, between, modulus = _converged(grasps, budget, at, infer_pit=infer_pit)
    tension = _tension(grasps, solution, 1 / modulus) if infer_pit else 1.0
    if tension > 1:
        grasps = [replace(grasp, information=grasp.information.weakened(tension)) for grasp in grasps]
        solution, between, modulus = _converged(grasps, budget, at, infer_pit=infer_pit)
    parts = solution.parts()
    pit = _pit(solution, at) if infer_pit and any(u.name in PIT for u in solution.unknowns) else None
    return FruitModulus(
        E_MPa=modulus,
        E_sd_MPa=modulus * float(np.linalg.norm(list(parts.values()))),
        parts_sd_MPa={part: share * modulus for part, share in parts.items()},
        pit=pit,
        grasps=len(grasps),
        warnings=_warnings(grasps, between, tension),
    )


def _converged(
    grasps: Sequence[GraspEvidence], budget: ErrorBudget, at: Float[np.ndarray, "4"], *, infer_pit: bool
) -> tuple["_Solution", float, float]:
    """The solution, the variance between grasps and E (MPa), once ln E no longer changes."""
    ln_s, between = -float(np.mean([np.log(grasp.E_MPa) for grasp in grasps])), 0.0
    for _ in range(MOST_ROUNDS):
        unknowns = _unknowns(grasps, between, budget=budget, pit_at=at)
        solution = _solve(grasps, unknowns, float(np.exp(ln_s)), infer_pit=infer_pit)
        step = float(solution.mean[0])
        ln_s += step
        between = _between(*_one_by_one(grasps, solution, float(np.exp(ln_s))))
        if abs(step) < STILL:
            break
    else:
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"ln E of all grasps together still changes by {abs(step):.2g} after {MOST_ROUNDS} "
            f"rounds, expected at most {STILL:.0e}: the grasps contradict each other. Grade them one "
            "by one",
        )
    return solution, between, float(np.exp(-ln_s))


def _tension(grasps: Sequence[GraspEvidence], solution: "_Solution", s: float) -> float:
    """chi-square per degree of freedom of the pads' numbers about the solution, all priors included.

    Above one the pads differ by more than noise and priors allow. Another cause separates them (a contact
    unlike the model's), and a pit moved to explain it would be wrong. Their information is divided by it
    (Birge 1932, Physical Review 40). It is one if there is nothing to compare.
    """
    numbers, began = 0, 0.0
    for known in (grasp.information for grasp in grasps):
        numbers += int(np.linalg.matrix_rank(known.normal, rtol=RANK, hermitian=True))
        explained = known.right @ np.linalg.pinv(known.normal, rcond=RANK, hermitian=True) @ known.right
        began += s**2 * known.normal[0, 0] - 2 * s * known.right[0] + float(explained)
    if numbers < 2:
        return 1.0
    change = solution.mean
    off = change - [unknown.mean for unknown in solution.unknowns]
    chi2 = began - 2 * solution.right @ change + change @ solution.normal @ change + solution.weight @ off**2
    return max(1.0, float(chi2) / (numbers - 1))


@dataclass(frozen=True, kw_only=True)
class _Unknown:
    """One unknown: its grasp (None: all), its prior, and the part of the error bar that it adds to."""

    name: str
    part: str
    sd: float
    mean: float = 0.0
    grasp: int | None = None


def _unknowns(
    grasps: Sequence[GraspEvidence], between: float, *, budget: ErrorBudget, pit_at: Float[np.ndarray, "4"]
) -> list[_Unknown]:
    """ln s first (no prior), then pit, Poisson's ratio and each grasp's own; only those with a spread."""
    unknowns = [_Unknown(name="ln s", part=TACTILE, sd=np.inf)]
    known = {cause for grasp in grasps for cause in grasp.information.causes}
    for name in (*PIT, POISSON_RATIO):
        if name in known:
            mean = -float(pit_at[PIT.index(name)]) if name in PIT else 0.0
            unknowns.append(_Unknown(name=name, part=part_of(name), sd=budget.sd_of(name), mean=mean))
    elements_sd = float(np.sqrt(np.mean([grasp.discretisation_sd**2 for grasp in grasps])))
    unknowns.append(_Unknown(name=DISCRETISATION, part=DISCRETISATION, sd=elements_sd))
    for k, grasp in enumerate(grasps):
        for name, sd in ((MODEL, grasp.misfit_sd), (SCATTER, float(np.sqrt(between)))):
            unknowns.append(_Unknown(name=name, part=name, sd=sd, grasp=k))
        for number, cause in enumerate(grasp.information.causes):
            if cause == FORCE_SCALE:
                name = f"{cause} {number}"
                unknowns.append(_Unknown(name=name, part=TACTILE, sd=budget.force_scale_sd, grasp=k))
            elif cause not in (*PIT, POISSON_RATIO):
                sd = budget.sd_of(cause, history=grasp.history)
                unknowns.append(_Unknown(name=cause, part=part_of(cause), sd=sd, grasp=k))
    return [unknown for unknown in unknowns if unknown.sd > 0]


@dataclass(frozen=True)
class _Solution:
    """The posterior of all unknowns; `fixed` ones stay at their prior and contribute by their sensitivity."""

    unknowns: list[_Unknown]
    fixed: Bool[np.ndarray, " u"]
    normal: Float[np.ndarray, "u u"]
    right: Float[np.ndarray, " u"]

    @cached_property
    def covariance(self) -> Float[np.ndarray, "u u"]:
        """P; zero for fixed unknowns."""
        free = np.flatnonzero(~self.fixed)
        covariance = np.zeros_like(self.normal)
        covariance[np.ix_(free, free)] = np.linalg.inv(
            (self.normal + np.diag(self.weight))[np.ix_(free, free)]
        )
        return covariance

    @property
    def weight(self) -> Float[np.ndarray, " u"]:
        """L, the priors' information."""
        return np.array([unknown.sd**-2 for unknown in self.unknowns])

    @property
    def mean(self) -> Float[np.ndarray, " u"]:
        """Change of every unknown from the point of linearisation."""
        prior = np.array([unknown.mean for unknown in self.unknowns])
        held = np.where(self.fixed, prior, 0.0)
        return np.asarray(held + self.covariance @ (self.right - self.normal @ held + self.weight * prior))

    def parts(self) -> dict[str, float]:
        """Relative standard deviations of E by cause; their squares add up to its variance."""
        x = self.covariance[0]
        shares = x**2 * self.weight
        shares[self.fixed] = (x @ self.normal)[self.fixed] ** 2 / self.weight[self.fixed]
        variance = {TACTILE: float(x @ self.normal @ x)}
        for unknown, share in zip(self.unknowns, shares, strict=True):
            variance[unknown.part] = variance.get(unknown.part, 0.0) + float(share)
        return {part: float(np.sqrt(value)) for part, value in variance.items()}


def _solve(
    grasps: Sequence[GraspEvidence], unknowns: list[_Unknown], s: float, *, infer_pit: bool
) -> _Solution:
    """The normal equations of all grasps about 1/E = s."""
    size = len(unknowns)
    normal, right = np.zeros((size, size)), np.zeros(size)
    for k, grasp in enumerate(grasps):
        names = ["ln s", *grasp.information.causes]
        names = [f"{n} {i - 1}" if n == FORCE_SCALE else n for i, n in enumerate(names)]
        amounts = np.zeros((len(names), size))
        for at, unknown in enumerate(unknowns):
            if unknown.grasp in (None, k):
                name = "ln s" if unknown.name in (DISCRETISATION, MODEL, SCATTER) else unknown.name
                if name in names:
                    amounts[names.index(name), at] = 1.0
        normal_of_grasp = s**2 * grasp.information.normal
        normal += amounts.T @ normal_of_grasp @ amounts
        right += amounts.T @ (s * grasp.information.right - normal_of_grasp[:, 0])
    fixed = np.array([not infer_pit and unknown.name in (*PIT, POISSON_RATIO) for unknown in unknowns])
    return _Solution(unknowns, fixed, normal, right)


def _pit(solution: _Solution, at: Float[np.ndarray, "4"]) -> PitPosterior:
    """The pit's part of the posterior; coordinates without a spread do not move."""
    names = [unknown.name for unknown in solution.unknowns]
    known = [k for k, name in enumerate(PIT) if name in names]
    chosen = [names.index(PIT[k]) for k in known]
    place, covariance, prior_sd = at.astype(float), np.zeros((4, 4)), np.zeros(4)
    place[known] += solution.mean[chosen]
    covariance[np.ix_(known, known)] = solution.covariance[np.ix_(chosen, chosen)]
    prior_sd[known] = [solution.unknowns[k].sd for k in chosen]
    return PitPosterior(
        offset_mm=place[:3], ln_size=float(place[3]), covariance=covariance, prior_sd=prior_sd
    )


def _one_by_one(
    grasps: Sequence[GraspEvidence], solution: _Solution, s: float
) -> tuple[Float[np.ndarray, " g"], Float[np.ndarray, " g"]]:
    """ln s of each grasp alone, less that of all, at the joint pit and Poisson's ratio, and its variance."""
    left, variance = np.zeros(len(grasps)), np.zeros(len(grasps))
    for k, grasp in enumerate(grasps):
        unknowns = [
            replace(unknown, mean=float(mean) if unknown.grasp is None else 0.0, grasp=None)
            for unknown, mean in zip(solution.unknowns, solution.mean, strict=True)
            if unknown.grasp in (None, k) and unknown.part not in (DISCRETISATION, MODEL, SCATTER)
        ]
        alone = _solve([grasp], [replace(unknowns[0], mean=0.0), *unknowns[1:]], s, infer_pit=False)
        left[k], variance[k] = alone.mean[0], alone.covariance[0, 0] + grasp.misfit_sd**2
    return left, variance


def _between(left: Float[np.ndarray, " g"], variance: Float[np.ndarray, " g"]) -> float:
    """Variance of the random effect of grasps, given the variance of each one's ln s; at least zero."""
    if len(left) < 2:
        return 0.0
    weight = 1 / variance
    excess = float(weight @ (left - np.average(left, weights=weight)) ** 2) - (len(left) - 1)
    return max(0.0, excess / float(weight.sum() - (weight**2).sum() / weight.sum()))


def _warnings(grasps: Sequence[GraspEvidence], between: float, tension: float) -> tuple[str, ...]:
    """Warnings about grasps that disagree, and about pads that disagree."""
    warnings = []
    if np.sqrt(between) > NOTICED:
        each = ", ".join(f"{grasp.E_MPa:.3f}" for grasp in grasps)
        warnings.append(f"the grasps of this fruit disagree beyond their errors ({each} MPa)")
    if tension > MOST_TENSION:
        warnings.append(
            f"the pads differ by {np.sqrt(tension):.1f} times the expected noise and pit uncertainty. "
            "Possible causes are a soft spot, a pad's gain, a wrong pose, or a misplaced pit. E is a "
            "compromise with a wider error bar"
        )
    return tuple(warnings)
