"""Numbers of a trace that a model must give back: how it bends, decays and comes back."""

import numpy as np
from jaxtyping import Float

from fem.indentation.fit import TraceFit
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import Check

#: noisy copies of the model's trace from which a check's standard deviation is taken
COPIES = 100


def checks(
    trace: IndenterTrace, before: TraceFit, after: TraceFit, *, rng: np.random.Generator
) -> tuple[Check, ...]:
    """Measured, and by both laws; sd from white noise on the second law's trace."""
    noise = after.noise.white_N * rng.standard_normal((COPIES, len(trace.time_s)))
    copies = [_all_numbers(trace, after.force_N + one) for one in noise]
    forces = (trace.force_N, before.force_N, after.force_N)
    measured, first, second = (_all_numbers(trace, force) for force in forces)
    units = {"loop area": "N mm"}
    return tuple(
        Check(
            name=name,
            measured=measured[name],
            before=first[name],
            after=second[name],
            sd=float(np.std([one[name] for one in copies])),
            unit=units.get(name.split(",")[0], "1"),
        )
        for name in measured
    )


def _all_numbers(trace: IndenterTrace, force_N: Float[np.ndarray, " t"]) -> dict[str, float]:
    """Of each recording, with its number where there are several."""
    found: dict[str, float] = {}
    for k, (part, frames) in enumerate(zip(trace.parts, trace.slices, strict=True)):
        where = f", recording {k + 1}" if len(trace.parts) > 1 else ""
        found |= {name + where: value for name, value in _numbers(part, force_N[frames]).items()}
    return found


def _numbers(trace: IndenterTrace, force_N: Float[np.ndarray, " t"]) -> dict[str, float]:
    """Force at half the loading travel over that at its end; force kept in the hold; work not given back."""
    phases = np.array(trace.phases)
    deepest = int(np.argmax(trace.travel_mm >= trace.travel_mm.max() * (1 - 1e-3)))
    frames = np.arange(len(phases))
    start = trace.travel_mm[0]
    half = int(np.argmax(trace.travel_mm >= (start + trace.travel_mm[deepest]) / 2))
    found = {"half-way force": float(force_N[half] / force_N[deepest])}
    hold = np.flatnonzero((phases == "hold") & (frames >= deepest))
    if len(hold):
        unbroken = hold[: int(np.argmax(np.r_[np.diff(hold) > 1, True])) + 1]
        found["force kept in the hold"] = float(force_N[unbroken[-1]] / force_N[deepest])
    if (phases == "unload").any():
        found["loop area"] = float(np.trapezoid(force_N, trace.travel_mm))
    return found
