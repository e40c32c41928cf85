"""The reported E: mean over all explanations, weighted by probability, and the 90 % interval of the mixture.

A refitted explanation has an E of its own; another has that of its linear signature. "unknown" has the plain
model's E, with the spread that unknown physics has caused. If no mismatch was detected, effects widen the
error bar and do not move E.
"""

from collections.abc import Sequence

from fem.mismatch.result import NONE, UNKNOWN, HeldOut, Modulus, mixture
from fem.mismatch.selection.grasp_explanations import Hypothesis

LARGE_MISFIT = 2.0
"""Held-out residual over that of noise, both root mean square. Set by hand."""
UNKNOWN_MODULUS_SD, LARGE_MISFIT_MODULUS_SD = 0.17, 0.3
"""Relative standard deviation of E under unknown physics, without and with a large misfit. Nine of ten errors
of the plain model on labelled cases with an effect are within 1.645 of it, for 34 and 28 cases
(`benchmarks/results/mismatch.csv`)."""


def reported_modulus(
    verdict: str | tuple[str, ...],
    weighed: Sequence[tuple[float, Modulus | None]],
    plain: Modulus,
) -> Modulus:
    """E as the module's docstring says; the plain model's where no explanation has an E.

    `weighed`: probability and E of each explanation.
    """
    known = [(weight, modulus) for weight, modulus in weighed if modulus is not None]
    if not sum(weight for weight, _ in known) > 0:
        return plain
    about = plain.value if verdict == NONE else None
    return mixture(*zip(*known, strict=True), about=about)


def modulus_by(
    hypothesis: Hypothesis, refitted: Modulus | None, plain: Modulus, heldout: HeldOut | None
) -> Modulus | None:
    """E by one explanation. `refitted`: that of its refit, if there is one; `heldout`: the plain model's
    error in held-out recordings.
    """
    if hypothesis.name == NONE:
        return plain
    if hypothesis.name == UNKNOWN:
        return plain.widened(unknown_spread(heldout))
    if hypothesis.refit is not None or hypothesis.modulus_change is None:
        return refitted
    ratio, added = hypothesis.modulus_change
    return Modulus(value=ratio * plain.value, sd=ratio * plain.sd).widened(added)


def unknown_spread(heldout: HeldOut | None) -> float:
    """Relative spread of E by unknown physics."""
    large = heldout is not None and heldout.rms_before > LARGE_MISFIT * heldout.noise_rms
    return LARGE_MISFIT_MODULUS_SD if large else UNKNOWN_MODULUS_SD
