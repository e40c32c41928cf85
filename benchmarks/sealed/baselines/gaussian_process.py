"""Baseline: a Gaussian-process discrepancy beside E (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425).

    y(x) = s c(x) + delta(x) + noise,      delta ~ GP(0, k),    x = (place on the patch, load, time)

k: a squared exponential with a length for each input, its hyperparameters by greatest marginal likelihood on
what the plain model leaves (scikit-learn's GaussianProcessRegressor); then s by generalised least squares
under k. It says that something is missing, where the process earns LEAST_GAIN, and never what.
"""

import warnings
from typing import Any

import numpy as np
from jaxtyping import Float
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from fem.mismatch.result import NONE, UNKNOWN, Modulus

LEAST_GAIN = 10.0
"""ln marginal likelihood over that of noise alone from which something is missing: four hyperparameters gain
some by themselves (set by hand)."""
LENGTHS, LENGTH_BOUNDS = (4.0, 4.0, 0.5, 3.0), (0.1, 100.0)
"""First lengths of the kernel: mm along the patch twice, share of the load, s; and bounds of all."""
X_MM, LOAD, TIME_S = slice(2, 4), 4, 5
"""Where place, load and time stand in a sample (reduced_case.SAMPLE)."""
RESIDUAL, RESPONSE = 6, 7
"""Where residual and response stand there."""


def gaussian_process(samples: Float[np.ndarray, "s 9"], E: Modulus) -> dict[str, Any]:
    """The answer for the samples of a case whose plain model has this E."""
    X = np.column_stack([samples[:, X_MM], samples[:, LOAD], samples[:, TIME_S]])
    scale = float(samples[:, RESIDUAL].std()) or 1.0
    y, c = samples[:, RESIDUAL] / scale, samples[:, RESPONSE] / scale
    kernel = ConstantKernel(0.3, (1e-4, 1e2)) * RBF(LENGTHS, LENGTH_BOUNDS) + WhiteKernel(0.7, (1e-3, 10.0))
    process = GaussianProcessRegressor(kernel, normalize_y=False, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(X, y)
    gain = process.log_marginal_likelihood_value_ - _noise_alone(y)
    covariance = process.kernel_(X)
    weighed = np.linalg.solve(covariance, np.column_stack([c, y]))
    information = max(float(c @ weighed[:, 0]), 1e-12)
    share = float(c @ weighed[:, 1]) / information
    sd = float(np.hypot(E.sd, E.value / np.sqrt(information)))
    return {
        "verdict": [UNKNOWN if gain > LEAST_GAIN else NONE],
        "order": [],
        "E": [E.value / max(1 + share, 0.1), sd],
        "heldout_ratio": _held_out(process, X, y, samples[:, 0]),
        "gain": gain,
    }


def _noise_alone(y: np.ndarray) -> float:
    """ln likelihood of independent noise of the spread that fits best."""
    variance = float(np.mean(y**2))
    return float(-len(y) / 2 * (np.log(2 * np.pi * variance) + 1))


def _held_out(process: GaussianProcessRegressor, X: np.ndarray, y: np.ndarray, grasp: np.ndarray) -> float:
    """Squares left of each grasp predicted by the process of the others, over those without one."""
    left = 0.0
    for one in np.unique(grasp):
        mine = grasp == one
        if mine.all():
            return float("nan")
        others = GaussianProcessRegressor(process.kernel_, optimizer=None).fit(X[~mine], y[~mine])
        left += float(((y[mine] - others.predict(X[mine])) ** 2).sum())
    return left / float((y**2).sum())
