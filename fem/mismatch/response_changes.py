"""What responses change of the plain model: their slopes along a parameter, and the sum of several."""

from collections.abc import Sequence

import numpy as np

from fem.mismatch.effect import Response
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta


def slope_fields(
    forward: ForwardModel, here: Response, ahead: Response, step: float
) -> list[ObservationDelta]:
    """d(what the recordings show) / d(parameter)."""
    fields = []
    for k in range(len(here.unit)):
        markers = forward.compliance * (ahead.unit[k] - here.unit[k])
        if here.shift_mm is not None and ahead.shift_mm is not None:
            markers = markers + ahead.shift_mm[k] - here.shift_mm[k]
        balance = None
        if here.balance is not None and ahead.balance is not None:
            balance = (ahead.balance[k] - here.balance[k]) / step
        rest = None
        if here.rest is not None and ahead.rest is not None:
            rest = (ahead.rest[k] - here.rest[k]) / step
        fields.append(ObservationDelta(markers=markers / step, balance=balance, rest=rest))
    return fields


def superposed(forward: ForwardModel, responses: Sequence[Response]) -> Response:
    """One response with the changes of all: small changes add up."""
    unit, shift, balance, rest = [], [], [], []
    for k, recording in enumerate(forward.base.grasps):
        plain = recording.tracks.unit_displacement
        unit.append(plain + sum(response.unit[k] - plain for response in responses))
        shift.append(
            sum(
                (response.shift_mm[k] for response in responses if response.shift_mm is not None),
                np.zeros_like(plain),
            )
        )
        zero = np.zeros((len(plain), 6))
        balance.append(
            sum((response.balance[k] for response in responses if response.balance is not None), zero)
        )
        nothing = np.zeros(len(recording.links))
        rest.append(sum((response.rest[k] for response in responses if response.rest is not None), nothing))
    return Response(unit=unit, shift_mm=shift, balance=balance, rest=rest)
