"""Simulates one sealed case into a folder that holds what `drupe explain` reads, and no label."""

from pathlib import Path

import numpy as np
from sealed_draw import ATTEMPTS, SealedCase, plan_of

from samples.mismatch.case_files import write_case_files
from samples.mismatch.case_simulation import as_recorded, true_recordings, with_amount
from samples.sample_failure import NotInEquilibrium

NOISE = 99
"""Put to the end of a case's seed for its noise; any number does."""


def simulated(case: SealedCase, folder: Path) -> tuple[int, tuple[float, ...]]:
    """Writes the case's folder; the attempt that found its balance, and the true peak force of each grasp, N.

    Raises NotInEquilibrium where no attempt does.
    """
    for attempt in range(ATTEMPTS):
        try:
            return attempt, _attempt(case, attempt, folder)
        except NotInEquilibrium:
            continue
    raise NotInEquilibrium(f"{case.case_id} found no balance in {ATTEMPTS} draws")


def _attempt(case: SealedCase, attempt: int, folder: Path) -> tuple[float, ...]:
    noise = np.random.default_rng([*case.seed(attempt), NOISE])
    plan = plan_of(case, attempt)
    truths = true_recordings(plan)
    peaks = tuple(truth.peak_force_N for truth in truths)
    injected = tuple(with_amount(one, max(peaks)) for one in plan.injected)
    recordings = tuple(as_recorded(truth, injected, plan.out_of_catalogue) for truth in truths)
    write_case_files(folder, plan.drawn, recordings, peaks_N=peaks, rng=noise)
    return peaks
