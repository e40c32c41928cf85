"""Numbers of a trace that a model must give back: how it bends, decays and comes back."""

import numpy as np
from jaxtyping import Float

from fem.indentation.fit import TraceFit
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import Check
from fem.mismatch.selection.predictive_checks import COPIES, compared

UNITS = {"half-way force": "1", "force kept in the hold": "1", "loop area": "N mm"}


def checks(
    trace: IndenterTrace, before: TraceFit, after: TraceFit, *, rng: np.random.Generator
) -> tuple[Check, ...]:
    """Measured, and by both laws, of each recording; sd from white noise on the second law's trace."""
    noise = after.noise.white_N * rng.standard_normal((COPIES, len(trace.time_s)))
    comparisons: list[Check] = []
    for k, part, frames in zip(trace.numbers, trace.parts, trace.slices, strict=True):
        where = f", recording {k + 1}" if len(trace.parts) > 1 else ""
        forces = (part.force_N, before.force_N[frames], after.force_N[frames])
        numbers = [_numbers(part, force) for force in forces]
        copies = [_numbers(part, forces[2] + noise_N[frames]) for noise_N in noise]
        comparisons += compared(numbers, copies, UNITS, suffix=where)
    return tuple(comparisons)


def _numbers(trace: IndenterTrace, force_N: Float[np.ndarray, " t"]) -> dict[str, float]:
    """Force at half the loading travel over that at its end; force kept in the hold; work not given back."""
    phases = np.array(trace.phases)
    deepest = trace.deepest
    half = int(np.argmax(trace.travel_mm >= (trace.travel_mm[0] + trace.travel_mm[deepest]) / 2))
    numbers = {"half-way force": float(force_N[half] / force_N[deepest])}
    hold = deepest + np.flatnonzero(phases[deepest:] == "hold")
    if len(hold):
        last = hold[int(np.argmax(np.r_[np.diff(hold) > 1, True]))]
        numbers["force kept in the hold"] = float(force_N[last] / force_N[deepest])
    if (phases == "unload").any():
        numbers["loop area"] = float(np.trapezoid(force_N, trace.travel_mm))
    return numbers
