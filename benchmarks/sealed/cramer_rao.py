"""Cramer-Rao bound of each effect's amplitude from the markers' noise alone.

Fisher information of the linear signature, N DESIGN_EFFECT (every sample counts as one), with 1/E (no prior)
and the plain model's nuisances (their priors; not the model's own seeming amounts of effects) eliminated:

    sd^2 = [(N DESIGN_EFFECT + L)^-1] of the signature,      L = 0 for 1/E and for the signature

(Kay 1993, Fundamentals of Statistical Signal Processing, chapter 3). What a recording has to itself (places,
approaches, smooth errors of a patch) is eliminated in N already.

DESIGN_EFFECT thins the markers' motion alone. Sums of force and pads at rest count in full in N, so that here
they count DESIGN_EFFECT times as much as they tell, and what is eliminated has a prior tighter by its root:
the bound is too small for what is seen by the balance, by 3.2 for a pad's gain and 2.3 for a drift on one
fruit of the tests. Pit and Poisson's ratio are nuisances with the category's spread themselves, so that their
bounds are that spread at the least. Of several ways to show the one that is seen best counts, of two pads
their mean.
"""

import numpy as np
from reduced_case import ReducedCase

from fem.mismatch.model.marker_equations import DESIGN_EFFECT

PER_AMOUNT = {
    "viscoelastic": 1.0, "stiffening": 1.0, "graded_modulus": 1.0, "anisotropy": 1.0, "poisson_ratio": 1.0,
    "pit_offset": 1.0, "pit_size": 1.0, "damage": 1.0, "sensor_gain": 1.0, "gripper_compliance": 1.0,
    "clock_lag": 1.0, "sensor_nonlinear": 1.0, "gel_creep": 1.0, "gel_hysteresis": 1.0, "pose_error": 0.25,
    "sensor_drift": 1.0,
}  # fmt: skip
"""Amplitude (samples.mismatch.effect_levels) per amount of a signature, where they are proportional: for
small amounts they are the same number but for pose_error, whose size 1 is 4 mm. A skin's amount is Et/E,
its amplitude that times E; a drift's amount is in N/s, its amplitude that over the peak force, which is
known when the case is scored. Of others (a spot, a gap, slip, plastic set, adhesion) the linear signature
has no amplitude, and there is no bound here."""
SHIFTS = 2
"""Of a wrong pose the first amounts, mm along the skin, are its size; the others turn it."""
RELATIVE_FLOOR = 1e-12
"""Added to the scaled information's diagonal, so that exact twins give a wide bound and no failure."""


def amplitude_bounds(case: ReducedCase, *, E_MPa: float) -> dict[str, float]:
    """Standard deviation of each effect's amplitude at the least, by the effect's name."""
    plain = [0, *(j for j, one in enumerate(case.columns) if one["role"] == "nuisance")]
    information = information_of(case)
    found: dict[str, dict[str, float]] = {}
    for one in case.signatures:
        effect, own = one["effect"], list(one["columns"])
        scale = E_MPa if effect == "skin" else PER_AMOUNT.get(effect)
        if scale is None or not own:
            continue
        names = [case.columns[j]["name"] for j in own]
        chosen = own if effect != "pose_error" else own[:SHIFTS]
        variances = bound(information, case, [*plain, *own])[[len(plain) + own.index(j) for j in chosen]]
        pad = names[0].split()[0] if names[0].split()[0] in ("left", "right") else ""
        sd = scale * float(np.sqrt(variances.mean()))
        known = found.setdefault(effect, {})
        known[pad] = min(sd, known.get(pad, np.inf))
    return {effect: float(np.mean(list(own.values()))) for effect, own in found.items()}


def information_of(case: ReducedCase) -> np.ndarray:
    """N DESIGN_EFFECT over all columns."""
    total = np.zeros((len(case.columns),) * 2)
    for rows, products in zip(case.rows, case.products, strict=True):
        total[np.ix_(rows, rows)] += DESIGN_EFFECT * products[1:, 1:]
    return total


def bound(information: np.ndarray, case: ReducedCase, chosen: list[int]) -> np.ndarray:
    """Variances of the chosen columns' amounts; nuisances alone have a prior."""
    prior = [case.columns[j]["sd"] ** -2.0 if case.columns[j]["role"] == "nuisance" else 0.0 for j in chosen]
    matrix = information[np.ix_(chosen, chosen)] + np.diag(prior)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * scale[:, None] * scale + RELATIVE_FLOOR * np.eye(len(chosen))
    return np.asarray(np.diag(np.linalg.inv(scaled)) * scale**2)
