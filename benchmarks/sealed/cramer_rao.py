"""Cramer-Rao bound of each effect's amplitude from noise alone.

Fisher information N of the linear signature with every sample counting as one, with 1/E (no prior) and the
plain model's nuisances (their priors; not the model error) eliminated:

    sd^2 = [(N + L)^-1] of the signature,      L = 0 for 1/E and for the signature

(Kay 1993, Fundamentals of Statistical Signal Processing, chapter 3). What a recording has to itself (places,
approaches, smooth errors of a patch) is eliminated in N. Pit and Poisson's ratio are nuisances with the
category's spread themselves, so that their bounds are that spread at the least. Of several ways to show the
one that is seen best counts, of two pads their mean.

Noise is the finder's own: MARKER_VARIANCE_INFLATION of it, of LEAST_NOISE_SHARE at least, in the frames that
it uses. For very quiet sensors and thinned recordings physics would allow less. Where gels stick, what they
pull with is noise of the balance too (fem.mismatch.model.pulling_markers), which widens the bounds there.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from reduced_case import OF_MODEL_ERROR, ReducedCase

from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import MarkerEquations
from fem.mismatch.selection.screening import LinearRound

PER_AMOUNT = {
    "viscoelastic": 1.0, "stiffening": 1.0, "graded_modulus": 1.0, "anisotropy": 1.0, "poisson_ratio": 1.0,
    "pit_offset": 1.0, "pit_size": 1.0, "damage": 1.0, "sensor_gain": 1.0, "gripper_compliance": 1.0,
    "clock_lag": 1.0, "sensor_nonlinear": 1.0, "gel_creep": 1.0, "gel_hysteresis": 1.0, "pose_error": 0.25,
    "sensor_drift": 1.0,
}  # fmt: skip
"""Amplitude (samples.mismatch.injected) per amount of a signature, where they are proportional: for
small amounts they are the same number but for pose_error, whose size 1 is 4 mm. A skin's amount is Et/E,
its amplitude that times E; a drift's amount is in N/s, its amplitude that over the peak force, which is
known when the case is scored. Of others (a spot, a gap, slip, plastic set, adhesion) the linear signature
has no amplitude, and there is no bound here."""
MAIN_PARAMETER = {
    "viscoelastic": "g", "stiffening": "b", "skin": "Et_N_per_mm", "graded_modulus": "gamma",
    "anisotropy": "axial", "poisson_ratio": "nu", "pit_offset": "offset_mm", "pit_size": "scale",
    "damage": "dmax", "sensor_gain": "gain", "sensor_drift": "newton_per_s",
    "gripper_compliance": "mm_per_N", "clock_lag": "lag_s", "pose_error": "shift_mm",
    "sensor_nonlinear": "a", "gel_creep": "creep", "gel_hysteresis": "share",
}  # fmt: skip
"""Parameter of a label whose distance from WITHOUT is the amplitude; of a drift in N/s, as its bound."""
WITHOUT = {"pit_size": 1.0, "sensor_gain": 1.0}
"""That parameter without the effect, where it is not zero."""
NUISANCE = "nuisance"
"""Role of the plain model's columns (reduced_case)."""
SHIFTS = 2
"""Of a wrong pose the first amounts, mm along the skin, are its size; the others turn it."""
RELATIVE_FLOOR = 1e-12
"""Added to the scaled information's diagonal, so that exact twins give a wide bound and no failure."""


def amplitude_bounds(
    information: np.ndarray, case: ReducedCase, *, E_MPa: float, nuisances: Sequence[str] = (NUISANCE,)
) -> dict[str, float]:
    """Standard deviation of each effect's amplitude at the least, by the effect's name.

    `nuisances`: roles of the columns that are eliminated beside 1/E. With OF_MODEL_ERROR among them the bound
    includes the model's own error.
    """
    plain = [0, *(j for j, column in enumerate(case.columns) if column["role"] in nuisances)]
    bounds: dict[str, dict[str, float]] = {}
    for signature in case.signatures:
        effect, column_indices = signature["effect"], list(signature["columns"])
        scale = E_MPa if effect == "skin" else PER_AMOUNT.get(effect)
        if scale is None or not column_indices:
            continue
        names = [case.columns[j]["name"] for j in column_indices]
        chosen = column_indices if effect != "pose_error" else column_indices[:SHIFTS]
        variances = bound(information, case.columns, [*plain, *column_indices])
        sd = scale * float(np.sqrt(variances[[len(plain) + column_indices.index(j) for j in chosen]].mean()))
        pad = names[0].split()[0] if names[0].split()[0] in ("left", "right") else ""
        known = bounds.setdefault(effect, {})
        known[pad] = min(sd, known.get(pad, np.inf))
    return {effect: float(np.mean(list(by_pad.values()))) for effect, by_pad in bounds.items()}


def amplitude_of(effect: str, parameters: Mapping[str, Any], **without: float) -> float | None:
    """Of an effect by the parameters of its label; None where it has no amplitude in these units.

    `without`: that parameter without the effect, by the effect, where it is the case's own.

    >>> amplitude_of("pit_size", {"scale": 0.75})
    0.25
    >>> amplitude_of("pose_error", {"pad": "left", "shift_mm": [0.0, 2.0], "tilt_deg": 1.0})
    0.5
    """
    name = MAIN_PARAMETER.get(effect)
    if name is None or name not in parameters:
        return None
    change = np.asarray(parameters[name]) - (WITHOUT | without).get(effect, 0.0)
    return float(np.linalg.norm(change)) * (PER_AMOUNT[effect] if effect == "pose_error" else 1.0)


def amplitudes_of(
    effects: Sequence[str], parameters: Mapping[str, Any], **without: float
) -> dict[str, float]:
    """Of the effects that have one; of several effects `parameters` are by effect."""
    by_effect = parameters if len(effects) > 1 else dict.fromkeys(effects, parameters)
    sizes = {effect: amplitude_of(effect, by_effect.get(effect, {}), **without) for effect in effects}
    return {effect: size for effect, size in sizes.items() if size is not None}


def information_of(model: CaseModel, linear: LinearRound) -> np.ndarray:
    """N over all columns of a linear round, every sample counting as one.

    Columns of the model error have none. The round's own products count so many of the markers' numbers as
    one (DESIGN_EFFECT), and those of the forces' balance in full, so that equations are formed anew.
    """
    columns = linear.products.columns
    total = np.zeros((len(columns),) * 2)
    for k, recording in enumerate(model.grasps):
        markers = MarkerEquations.of(
            recording,
            compliance=model.compliance,
            gel_scale_sd=model.case.budget.gel_scale_sd,
            design_effect=1.0,
        )
        equations = GraspEquations.of(model, recording, markers=markers)
        known = [
            j for j, column in enumerate(columns) if column.fields[k] is not None and column.same_as is None
        ]
        plain, weighed = equations.rows([columns[j].fields[k] for j in known])
        total[np.ix_(known, known)] += weighed @ plain.T
    return total


def bound(information: np.ndarray, columns: Sequence[dict[str, Any]], chosen: list[int]) -> np.ndarray:
    """Variances of the chosen columns' amounts; nuisances and model error alone have a prior."""
    known = (NUISANCE, OF_MODEL_ERROR)
    prior = [columns[j]["sd"] ** -2.0 if columns[j]["role"] in known else 0.0 for j in chosen]
    matrix = information[np.ix_(chosen, chosen)] + np.diag(prior)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * scale[:, None] * scale + RELATIVE_FLOOR * np.eye(len(chosen))
    return np.asarray(np.diag(np.linalg.inv(scaled)) * scale**2)
