"""The most probable unknowns of a law, their covariance, and the evidence for the law."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from fem.indentation.contact_law import Law
from fem.indentation.rig_error import rig_error
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import NoContactNoise, TraceNoise, joint_clock

#: Gauss-Newton steps at most, and the fall of the misfit below which they stop
STEPS, ENOUGH = 40, 0.02
#: forward differences on the unknowns' own scales
NUDGE = 1e-4
SHARE, SHARE_SD = 0.02, 0.35
"""Least share of the force that any law in the catalogue leaves unexplained, and how fast larger ones get
improbable (half a normal in the logarithm). Of 1, 2 and 3 % it is the least with which laws fitted to four
fifths of a curve predict the last one (development mixtures of benchmarks/silicone_cylinders.py)."""
OTHER_RATIO = 5.0
"""Times as much is left by physics that is not in the catalogue."""
#: shares among which each fit chooses
SHARES = np.geomspace(SHARE, 0.5, 16)
FLOOR = 0.03
"""Share of the peak force below which the unexplained part no longer falls with the force (set by hand)."""
#: rounds of fit and choice of share, and the tolerant share of the first
ROUNDS, TOLERANT = 6, 0.05
#: starts that are followed for a few steps
FOLLOWED, FEW = 2, 6
#: a damping's gain over the middle one, as a share of the whole, that is worth a run for its slopes
CLEARLY = 0.3


@dataclass(frozen=True, kw_only=True)
class TraceFit:
    """One law's fit. `scaled`: unknowns on their scales; `share` of the force it leaves unexplained.

    `force_N` and `jacobian` are of every frame, fitted or not; `noise` is that of the frames fitted.
    `converged`: whether the misfit of the last step fell by less than ENOUGH, within STEPS.
    """

    law: Law
    noise: TraceNoise
    share: float
    scaled: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    force_N: Float[np.ndarray, " t"]
    jacobian: Float[np.ndarray, "t k"]
    log_evidence: float
    log_evidence_of_other: float
    chi_square: float
    converged: bool

    @property
    def log_score(self) -> float:
        """Log evidence with the prior of the effects' forms: each further unknown halves it."""
        count = sum(len(effect.unknowns) for effect in self.law.effects)
        return self.log_evidence + count * float(np.log(0.5))

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard deviations on the unknowns' scales."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """What is minimised: misfit of the fitted frames and of the priors, for one noise."""

    law: Law
    trace: IndenterTrace
    frames: Bool[np.ndarray, " t"]
    noise: TraceNoise
    mean: Float[np.ndarray, " k"]
    precision: Float[np.ndarray, " k"]

    def misfit(
        self, scaled: Float[np.ndarray, "p k"], force_N: Float[np.ndarray, "p t"]
    ) -> Float[np.ndarray, " p"]:
        """-2 log of likelihood times prior, but for constants."""
        gap = (self.trace.force_N - force_N)[:, self.frames]
        prior = (scaled - self.mean) ** 2 @ self.precision
        return np.asarray(np.einsum("pt,tp->p", gap, self.noise.solve(gap.T)) + prior)

    def newton(
        self,
        scaled: Float[np.ndarray, " k"],
        force_N: Float[np.ndarray, " t"],
        slope: Float[np.ndarray, "t k"],
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """Gauss-Newton's matrix J' C^-1 J + prior precision, and the downhill slope."""
        slope = slope[self.frames]
        weighted = self.noise.solve(np.column_stack([slope, (self.trace.force_N - force_N)[self.frames]]))
        matrix = slope.T @ weighted[:, :-1] + np.diag(self.precision)
        return matrix, slope.T @ weighted[:, -1] - self.precision * (scaled - self.mean)


def noise_with(
    no_contact: NoContactNoise, trace: IndenterTrace, share: float, frames: Bool[np.ndarray, " t"]
) -> TraceNoise:
    """White noise and, besides, `share` of the measured force (of FLOOR of its peak at least)."""
    size = np.maximum(np.abs(trace.force_N), FLOOR * np.abs(trace.force_N).max())
    clock = joint_clock(trace, white_N=no_contact.white_N)
    return TraceNoise(white_N=no_contact.slow_N, wander_N=share * size[frames], clock=clock[frames])


def jacobian_N(
    law: Law, trace: IndenterTrace, scaled: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t k"]]:
    """Force and its slopes, all rows of one run."""
    rows = np.vstack([scaled, scaled + NUDGE * np.eye(len(scaled))])
    force = law.force_N(trace, rows)
    return force[0], (force[1:] - force[0]).T / NUDGE


def fit(
    law: Law,
    trace: IndenterTrace,
    no_contact: NoContactNoise,
    starts: Float[np.ndarray, "s k"],
    *,
    frames: Bool[np.ndarray, " t"] | None = None,
    follow: int = FOLLOWED,
) -> TraceFit:
    """Damped Gauss-Newton from the `follow` likeliest starts, the unexplained share chosen in turn.

    Only the chosen `frames` are fitted; history runs through all. Evidence by Laplace:
    log L + log prior + k/2 log 2 pi - 1/2 log det H, summed over the unexplained share with its prior; the
    parameters are those at the likeliest share (MacKay, "Information Theory, Inference, and Learning
    Algorithms", 2003, ch. 27 and 28).
    """
    if frames is None:
        frames = np.ones(len(trace.time_s), dtype=bool)
    mean = np.array([u.mean for u in law.unknowns])
    precision = np.array([u.sd for u in law.unknowns]) ** -2.0
    least = min(max(rig_error(trace), SHARE), SHARES[-1])
    share, shares = TOLERANT, SHARES[least * (1 - 1e-9) <= SHARES]

    of_all = noise_with(no_contact, trace, 1.0, frames)

    def posterior(share: float) -> Posterior:
        noise = replace(of_all, wander_N=share * of_all.wander_N)
        return Posterior(law=law, trace=trace, frames=frames, noise=noise, mean=mean, precision=precision)

    target = posterior(share)
    order = np.argsort(target.misfit(starts, law.force_N(trace, starts)))[:follow]
    scaled = starts[order[0]]
    if follow > 1:
        scaled = min((_descend(target, starts[k], steps=FEW) for k in order), key=lambda one: one[0])[1]
    for _ in range(ROUNDS):
        _, scaled, force, slope, converged = _descend(target, scaled, steps=STEPS)
        gap = (trace.force_N - force)[frames]
        before, share = share, float(shares[int(np.argmax(of_all.log_likelihoods(gap, shares)))])
        if share == before:
            break
        target = posterior(share)
    matrix, _ = target.newton(scaled, force, slope)
    logs = _log_evidences(posterior, scaled, gap, slope[frames], shares)
    return TraceFit(
        law=law,
        noise=target.noise,
        share=share,
        scaled=scaled,
        covariance=np.linalg.inv(matrix),
        force_N=force,
        jacobian=slope,
        log_evidence=float(logsumexp(logs + log_prior_of_shares(shares, SHARE))),
        log_evidence_of_other=float(logsumexp(logs + log_prior_of_shares(shares, OTHER_RATIO * SHARE))),
        chi_square=float(gap @ gap / no_contact.white_N**2),
        converged=converged,
    )


def log_prior_of_shares(shares: Float[np.ndarray, " s"], median: float) -> Float[np.ndarray, " s"]:
    """Log-normal about the median, over the shares that are tried."""
    log = -0.5 * (np.log(shares / median) / SHARE_SD) ** 2
    return np.asarray(log - logsumexp(log))


def _log_evidences(
    posterior: Callable[[float], Posterior],
    scaled: Float[np.ndarray, " k"],
    gap: Float[np.ndarray, " t"],
    slope: Float[np.ndarray, "t k"],
    shares: Float[np.ndarray, " s"],
) -> Float[np.ndarray, " s"]:
    """Natural logarithm of the marginal likelihood of the law, linear round `scaled`, for each share."""
    logs = []
    for share in shares:
        target = posterior(float(share))
        off = scaled - target.mean
        weighted = target.noise.solve(np.column_stack([slope, gap]))
        matrix = slope.T @ weighted[:, :-1] + np.diag(target.precision)
        downhill = slope.T @ weighted[:, -1] - target.precision * off
        misfit = off**2 @ target.precision - downhill @ np.linalg.solve(matrix, downhill)
        log_det = np.linalg.slogdet(matrix)[1] - np.log(target.precision).sum()
        logs.append(target.noise.log_likelihood(gap) - 0.5 * (misfit + log_det))
    return np.array(logs)


def _descend(
    target: Posterior, scaled: Float[np.ndarray, " k"], *, steps: int
) -> tuple[float, Float[np.ndarray, " k"], Float[np.ndarray, " t"], Float[np.ndarray, "t k"], bool]:
    """Levenberg-Marquardt: misfit, unknowns, force, slopes, and whether it settled within the steps.

    Three dampings are tried at once, as rows of one run. The middle one's slopes come in the same run;
    another is taken only where it is clearly better.
    """
    law, trace = target.law, target.trace
    damping = 1e-2
    force, slope = jacobian_N(law, trace, scaled)
    now, converged = float(target.misfit(scaled[None], force[None])[0]), False
    for _ in range(steps):
        matrix, downhill = target.newton(scaled, force, slope)
        tries = damping * np.array([0.03, 1.0, 100.0])
        scale = np.diag(np.diag(matrix))
        step = np.stack([np.linalg.solve(matrix + d * scale, downhill) for d in tries])
        rows = scaled + np.clip(step, -2.0, 2.0)
        run = law.force_N(trace, np.vstack([rows, rows[1] + NUDGE * np.eye(len(scaled))]))
        values = target.misfit(rows, run[:3])
        values = np.where(np.isfinite(values), values, np.inf)
        best = int(np.argmin(values))
        if not values[best] < now:
            converged = damping > 1e6  # not even the shortest step gains anything
            if converged:
                break
            damping *= 1e3
            continue
        if values[1] - values[best] < CLEARLY * (now - values[best]):
            best = 1
        fall, now = now - float(values[best]), float(values[best])
        scaled, damping = rows[best], max(float(tries[best]) * 0.3, 1e-8)
        if best == 1:
            force, slope = run[1], (run[3:] - run[1]).T / NUDGE
        else:
            force, slope = jacobian_N(law, trace, scaled)
        converged = fall < ENOUGH
        if converged:
            break
    return now, scaled, force, slope, converged
