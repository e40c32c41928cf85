"""Error of an effect's own law: columns beside the effect's full model.

No law is exact, and its error grows with the effect. The columns are f d: d is the change of the observations
by the effect, without the part that another modulus would make, and f a smooth function over a patch and its
load. Their amounts have mean zero and the standard deviation `law_error` of EffectSpec. So the error widens
the effect's parameters, and another effect counts only for what these columns do not explain. One more column
for each recording scales its change alone.
"""

from collections.abc import Sequence

import numpy as np

from fem.mismatch.effect import Effect, Response
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse


def law_error_columns(model: CaseModel, effect: Effect, response: Response) -> list[Regressor]:
    """The columns of an effect with this response."""
    changes = _without_modulus(model, [response.change(model, k) for k in range(len(model.grasps))])
    shaped = [_shaped(recording, change) for recording, change in zip(model.grasps, changes, strict=True)]
    alone = [[change if at == k else None for at, change in enumerate(changes)] for k in range(len(changes))]
    fields: list[Sequence[ObservationDelta | None]] = [changes, *zip(*shaped, strict=True), *alone]
    return [
        Regressor(name=f"law error {effect.spec.name}", sd=effect.spec.law_error, fields=field)
        for field in fields
    ]


def _without_modulus(model: CaseModel, changes: Sequence[ObservationDelta]) -> list[ObservationDelta]:
    """The changes less the plain response in its least-squares amount."""
    plain = [model.compliance * recording.tracks.unit_displacement for recording in model.grasps]
    pairs = [
        (response[recording.touching].ravel(), change.markers[recording.touching].ravel())
        for recording, response, change in zip(model.grasps, plain, changes, strict=True)
        if change.markers is not None
    ]
    amount = sum(a @ b for a, b in pairs) / sum(a @ a for a, _ in pairs)
    return [
        change.plus(-amount, ObservationDelta(markers=response))
        for change, response in zip(changes, plain, strict=True)
    ]


def _shaped(recording: GraspResponse, change: ObservationDelta) -> list[ObservationDelta]:
    """The change of the markers times each function, and its part along the pads' normals."""
    markers = change.markers
    assert markers is not None, "Response.change gives the markers"
    normal = np.zeros_like(recording.tracks.place_mm)
    x, y = np.zeros((2, len(normal)))
    for pad in range(len(recording.links)):
        mine = recording.pad_of_marker == pad
        axes, place_mm = recording.turn_of(pad), recording.tracks.place_mm[mine]
        across = (place_mm - place_mm.mean(axis=0)) @ axes[:, :2]
        x[mine], y[mine] = (across / np.sqrt((across**2).sum(axis=1).mean())).T
        normal[mine] = axes[:, 2]
    load, wide = (2 * recording.load - 1)[:, None], x**2 + y**2 - 1
    fields = [markers * np.atleast_2d(f)[..., None] for f in (load, x, y, wide, load * wide)]
    fields.append(np.einsum("fnx,nx->fn", markers, normal)[..., None] * normal)
    return [ObservationDelta(markers=field) for field in fields]
