"""The model-discrepancy prior: the model's own error resembles small amounts of some effects.

A model that is a little off resembles a thin skin on the fruit, or jaws that give way. In null cases by
another solver (fem.mismatch.selection.null_reference) such amounts are small and similar over sizes, shapes
and moduli, once the noise of the forces is taken out of the equations (fem.mismatch.evidence.force_noise).
They are part of the plain model, with mean zero and a spread that covers those fruit: only what exceeds them
counts as an effect, and no parameter is known better than to that spread. (Set on the fruit of the null
reference set itself, so that its p-values are somewhat too small for others.)
"""

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import Regressor


def discrepancy_columns(
    forward: ForwardModel,
    found: Iterable[tuple[Effect, Signature]],
    *,
    without: Collection[str] = (),
) -> list[Regressor]:
    """Columns of the effects that have a DiscrepancyPrior, one for each alternative of theirs.

    `without`: names of effects that are left out. The zero drift of pads is no error of the model, and left
    out.
    """
    columns = []
    for effect, signature in found:
        spec, prior = effect.spec, effect.spec.discrepancy
        if prior is None or spec.name in without:
            continue
        size = forward.compliance * forward.compliance_ratio if prior.per_compliance else 1.0
        (column,) = signature.columns
        fields = [None if field is None else replace(field, rest=None) for field in column.fields]
        columns.append(
            replace(
                column,
                name=f"discrepancy {spec.name}",
                mean=prior.mean * size,
                sd=prior.sd * size,
                positive=False,
                fields=fields,
                discrepancy_of=spec,
            )
        )
    return columns


def trades_with_modulus(column: Regressor) -> bool:
    """Whether it is the amount of a discrepancy that trades off with 1/E in soft flesh."""
    spec = column.discrepancy_of
    return spec is not None and spec.discrepancy is not None and spec.discrepancy.trades_with_modulus


def discrepancy_spread(effect: Effect) -> float:
    """What the model's own error adds to the standard deviation of an effect's parameter."""
    prior = effect.spec.discrepancy
    return 0.0 if prior is None or not prior.saturating else float(np.hypot(prior.mean, prior.sd))
