"""The error that may be left in a number which was measured and not corrected."""

import numpy as np


def unseen_error(measured: float, measured_sd: float, *, prior_sd: float) -> float:
    """Root mean square of an error e ~ N(0, prior_sd^2) that was measured as N(e, measured_sd^2).

    With w = prior_sd^2 / (prior_sd^2 + measured_sd^2) the posterior is N(w measured, w measured_sd^2), and e
    stays in the number whole: sqrt((w measured)^2 + w measured_sd^2).

    >>> round(unseen_error(0.0, 0.03, prior_sd=0.04), 4), round(unseen_error(0.08, 0.0, prior_sd=0.04), 4)
    (0.024, 0.08)
    """
    if prior_sd == 0.0:
        return 0.0
    w = prior_sd**2 / (prior_sd**2 + measured_sd**2)
    return float(np.sqrt((w * measured) ** 2 + w * measured_sd**2))
