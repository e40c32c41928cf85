"""Relaxation of flesh: one to three Maxwell arms parallel to a spring."""

import numpy as np
from jaxtyping import Float

from fem.indentation.trace_effect import TraceEffect, Unknown, Values, unknown
from fem.mismatch.effects.viscoelastic import SPEC
from fem.mismatch.result import Parameter

#: most arms tried
ARMS = 3


def viscoelastic(arms: int) -> TraceEffect:
    """Relaxation R(t) = 1 - sum g + sum g exp(-t/tau): shares g, times tau that increase from arm to arm.

    Unknowns: weight of each arm over the spring that never relaxes (log), the first tau (log) and the ratio
    of each tau to the one before (log). Priors: a share of 0.1 to 0.75 with one arm; tau 0.3 to 60 s, later
    arms three to thirty times slower. Source: generalised Maxwell solid, Tschoegl, "The Phenomenological
    Theory of Linear Viscoelastic Behavior", 1989.
    """
    first = {1: 4.2, 2: 1.0, 3: 0.5}[arms]
    weights = tuple(
        Unknown(name=f"weight_{k + 1}", unit="1", scale="log", mean=-0.6 - 0.3 * (arms - 1), sd=1.0)
        for k in range(arms)
    )
    times = (
        Unknown(name="tau_1", unit="s", scale="log", mean=float(np.log(first)), sd=1.6 if arms == 1 else 1.0),
        *(
            Unknown(name=f"slower_{k + 1}", unit="1", scale="log", mean=float(np.log(9.0)), sd=0.7)
            for k in range(1, arms)
        ),
    )
    return TraceEffect(
        name=SPEC.name,
        unknowns=weights + times,
        relaxation=lambda value: arms_of(value, arms),
        parameters=viscoelastic_parameters,
    )


def arms_of(values: Values, arms: int) -> tuple[Float[np.ndarray, "k p"], Float[np.ndarray, "k p"]]:
    """Shares g and times tau (s) from the unknowns."""
    weight = np.stack([values[f"weight_{k + 1}"] for k in range(arms)])
    ratio = np.stack([values["tau_1" if k == 0 else f"slower_{k + 1}"] for k in range(arms)])
    return weight / (1 + weight.sum(axis=0)), np.cumprod(ratio, axis=0)


def viscoelastic_parameters(
    scaled: Float[np.ndarray, " u"], covariance: Float[np.ndarray, "u u"]
) -> dict[str, Parameter]:
    """g, tau_s, g_2, tau_2_s, ...: values, standard deviations, 90 % intervals, by the unknowns' posterior.

    A share's interval is normal on its logit, a time's on its logarithm. Derivatives are exact:
    d ln g_i / d ln w_j = delta_ij - g_j, and the logarithm of a tau is a sum.
    """
    arms = len(scaled) // 2
    weight = np.exp(scaled[:arms])
    g = weight / (1 + weight.sum())
    times = np.tril(np.ones((arms, arms)))
    log_g = np.eye(arms) - g
    parameters: dict[str, Parameter] = {}
    for k in range(arms):
        suffix = "" if k == 0 else f"_{k + 1}"
        sd = float(np.sqrt(log_g[k] @ covariance[:arms, :arms] @ log_g[k])) / (1 - g[k])
        share = unknown(SPEC, "g", scale="logit", mean=0.0, sd=1.0)
        parameters[f"g{suffix}"] = share.parameter(float(np.log(g[k] / (1 - g[k]))), sd)
        late = float(np.sqrt(times[k] @ covariance[arms:, arms:] @ times[k]))
        tau = unknown(SPEC, "tau_s", scale="log", mean=0.0, sd=1.0)
        parameters[f"tau{suffix}_s"] = tau.parameter(float(times[k] @ scaled[arms:]), late)
    return parameters
