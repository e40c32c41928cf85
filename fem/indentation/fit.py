"""Fit of a law: most probable unknowns, their covariance, evidence, and prediction of other frames."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from fem.indentation.contact_law import Law
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import SHARE, TraceNoise, least_share, noise_of
from fem.mismatch.result import Modulus

#: most Gauss-Newton steps (laws of ten silicone curves need more than 40), and the decrease of the misfit
#: below which they stop
STEPS, ENOUGH = 150, 0.02
#: step of forward differences on the unknowns' own scales
NUDGE = 1e-4
#: unexplained shares among which each fit chooses, equally likely a priori
SHARES = np.geomspace(SHARE, 0.5, 16)
#: rounds of fit and choice of share, and the larger share of the first round
ROUNDS, TOLERANT = 6, 0.05


@dataclass(frozen=True, kw_only=True)
class TraceFit:
    """One law's fit. `scaled`: unknowns on their scales; `share`: unexplained share of the force;
    `usual_share`: its least value, SHARE or that from the rig's error.

    `force_N`: in all frames, fitted or not; `noise`: of the fitted frames.
    `converged`: whether the misfit of the last step fell by less than ENOUGH, within STEPS.
    """

    law: Law
    noise: TraceNoise
    share: float
    usual_share: float
    scaled: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    force_N: Float[np.ndarray, " t"]
    log_evidence: float
    chi_square: float
    converged: bool

    @property
    def log_score(self) -> float:
        """Log evidence minus ln 2 for each unknown of the effects: of two forms that explain the data about
        equally, the simpler one is reported.
        """
        count = sum(len(effect.unknowns) for effect in self.law.effects)
        return self.log_evidence - count * float(np.log(2.0))

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard deviations on the unknowns' scales."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def modulus(self) -> Modulus:
        """E with its standard deviation, to first order."""
        value = float(np.exp(self.scaled[0]))
        return Modulus(value=value, sd=value * float(self.sd[0]))


@dataclass(frozen=True, kw_only=True)
class _Target:
    """Objective of the fit: misfit of the fitted frames and of the priors, for one noise."""

    law: Law
    trace: IndenterTrace
    frames: Bool[np.ndarray, " t"]
    noise: TraceNoise
    mean: Float[np.ndarray, " k"]
    precision: Float[np.ndarray, " k"]

    def misfit(
        self, scaled: Float[np.ndarray, "p k"], force_N: Float[np.ndarray, "p t"]
    ) -> Float[np.ndarray, " p"]:
        """-2 log of likelihood times prior, without constants."""
        gap = (self.trace.force_N - force_N)[:, self.frames]
        prior = (scaled - self.mean) ** 2 @ self.precision
        return np.asarray(np.einsum("pt,tp->p", gap, self.noise.solve(gap.T)) + prior)

    def newton(
        self,
        scaled: Float[np.ndarray, " k"],
        force_N: Float[np.ndarray, " t"],
        slope: Float[np.ndarray, "t k"],
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """Gauss-Newton matrix J' C^-1 J + prior precision, and the negative gradient."""
        slope = slope[self.frames]
        weighted = self.noise.solve(np.column_stack([slope, (self.trace.force_N - force_N)[self.frames]]))
        matrix = slope.T @ weighted[:, :-1] + np.diag(self.precision)
        return matrix, slope.T @ weighted[:, -1] - self.precision * (scaled - self.mean)

    def log_evidence(
        self,
        scaled: Float[np.ndarray, " k"],
        force_N: Float[np.ndarray, " t"],
        slope: Float[np.ndarray, "t k"],
    ) -> float:
        """Natural logarithm of the marginal likelihood of the law, linearised about `scaled`."""
        matrix, downhill = self.newton(scaled, force_N, slope)
        gap = (self.trace.force_N - force_N)[self.frames]
        misfit = (scaled - self.mean) ** 2 @ self.precision - downhill @ np.linalg.solve(matrix, downhill)
        log_det = np.linalg.slogdet(matrix)[1] - np.log(self.precision).sum()
        return float(self.noise.log_likelihoods(gap, np.ones(1))[0] - 0.5 * (misfit + log_det))


def fit(
    law: Law,
    trace: IndenterTrace,
    no_contact: NoContactNoise,
    starts: Float[np.ndarray, "s k"],
    *,
    frames: Bool[np.ndarray, " t"] | None = None,
) -> TraceFit:
    """Damped Gauss-Newton from the likeliest start, alternating with the choice of the unexplained share.

    Only the chosen `frames` are fitted; the history includes all. Evidence by Laplace:
    log L + log prior + k/2 log 2 pi - 1/2 log det H, averaged over the unexplained shares; the parameters are
    those at the likeliest share (MacKay, "Information Theory, Inference, and Learning Algorithms", 2003,
    ch. 27 and 28).
    """
    frames = np.ones(len(trace.time_s), dtype=bool) if frames is None else frames
    shares = SHARES[min(least_share(trace), SHARES[-1]) * (1 - 1e-9) <= SHARES]
    whole = noise_of(trace, no_contact).part(frames)

    def target_at(share: float) -> _Target:
        noise = whole.part(slice(None), share)
        mean, sd = np.array([(u.mean, u.sd) for u in law.unknowns]).T
        return _Target(law=law, trace=trace, frames=frames, noise=noise, mean=mean, precision=sd**-2.0)

    share = TOLERANT
    target = target_at(share)
    scaled = starts[int(np.argmin(target.misfit(starts, law.force_N(trace, starts))))]
    for _ in range(ROUNDS):
        scaled, force, slope, converged = _descend(target, scaled)
        gap = (trace.force_N - force)[frames]
        before, share = share, float(shares[int(np.argmax(whole.log_likelihoods(gap, shares)))])
        if share == before:
            break
        target = target_at(share)
    logs = [target_at(float(trial_share)).log_evidence(scaled, force, slope) for trial_share in shares]
    return TraceFit(
        law=law,
        noise=target.noise,
        share=share,
        usual_share=float(shares[0]),
        scaled=scaled,
        covariance=np.linalg.inv(target.newton(scaled, force, slope)[0]),
        force_N=force,
        log_evidence=float(logsumexp(logs) - np.log(len(logs))),
        chi_square=float(gap @ gap / no_contact.sd_N**2),
        converged=converged,
    )


def from_prior(law: Law, trace: IndenterTrace, no_contact: NoContactNoise) -> TraceFit:
    """The fit that starts from the prior's mean."""
    return fit(law, trace, no_contact, np.array([[u.mean for u in law.unknowns]]))


def _with_slopes(
    law: Law, trace: IndenterTrace, scaled: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t k"]]:
    """Force and its derivatives at `scaled`, from one vectorised run."""
    force = law.force_N(trace, np.vstack([scaled, scaled + NUDGE * np.eye(len(scaled))]))
    return force[0], (force[1:] - force[0]).T / NUDGE


def _descend(
    target: _Target, scaled: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " t"], Float[np.ndarray, "t k"], bool]:
    """Levenberg-Marquardt: unknowns, force, derivatives, and whether it converged within the steps."""
    damping = 1e-2
    force, slope = _with_slopes(target.law, target.trace, scaled)
    now, converged = float(target.misfit(scaled[None], force[None])[0]), False
    for _ in range(STEPS):
        matrix, downhill = target.newton(scaled, force, slope)
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), downhill)
        trial = scaled + np.clip(step, -2.0, 2.0)
        trial_force, trial_slope = _with_slopes(target.law, target.trace, trial)
        fall = now - float(target.misfit(trial[None], trial_force[None])[0])
        if fall > 0:
            converged = fall < ENOUGH
            scaled, force, slope, now = trial, trial_force, trial_slope, now - fall
            damping = max(damping * 0.1, 1e-8)
        else:
            converged = damping > 1e6  # not even the shortest step reduces the misfit
            damping *= 10
        if converged:
            break
    return scaled, force, slope, converged


#: rounds in which the force that moves a compliant machine converges to the law's force, and the share of
#: each round's change that is applied, so that a machine softer than the specimen converges too
AGREEMENT_ROUNDS, TAKEN = 60, 0.5


def future_frames(trace: IndenterTrace) -> Bool[np.ndarray, " t"]:
    """Frames to predict from the past: all from the start of unloading, else the second half of the hold.

    If the tool never rests, the last third. For several recordings, those of each.
    """
    if len(trace.parts) > 1:
        return np.concatenate([future_frames(part) for part in trace.parts])
    phases = np.array(trace.phases)
    frames = np.arange(len(phases))
    after = frames > trace.deepest
    unload = np.flatnonzero((phases == "unload") & after)
    if len(unload) and len(phases) - unload[0] >= 5:
        return np.asarray(frames >= unload[0])
    hold = np.flatnonzero((phases == "hold") & after)
    first = hold[len(hold) // 2] if len(hold) >= 10 else 2 * len(phases) // 3
    return np.asarray(frames >= first)


def predicted_N(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> Float[np.ndarray, " t"]:
    """Predicted force at each recording's end by the law refitted without it; NaN elsewhere."""
    future = future_frames(trace)
    again = fit(known.law, trace, no_contact, known.scaled[None], frames=~future)
    return np.where(future, without_measured(known.law, again.scaled, trace, future), np.nan)


def share_missed(predicted_N: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]) -> float:
    """Root mean square error of the prediction over the root mean square force, in predicted frames."""
    out = np.isfinite(predicted_N)
    return float(np.sqrt(np.mean((predicted_N - force_N)[out] ** 2) / np.mean(force_N[out] ** 2)))


def without_measured(
    law: Law, scaled: Float[np.ndarray, " k"], trace: IndenterTrace, mask: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """The law's force. In frames of `mask` it, not the measured force, also moves a compliant machine."""
    blind = trace.force_N.copy()
    blind[mask] = np.interp(trace.time_s[mask], trace.time_s[~mask], trace.force_N[~mask])
    force = law.force_N(replace(trace, force_N=blind), scaled[None])[0]
    for _ in range(AGREEMENT_ROUNDS if any(effect.give_mm is not None for effect in law.effects) else 0):
        blind[mask] += TAKEN * (force - blind)[mask]
        force = law.force_N(replace(trace, force_N=blind), scaled[None])[0]
    return np.asarray(force)
