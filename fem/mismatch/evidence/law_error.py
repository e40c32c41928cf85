"""Fields that the error of an effect's law may have: the law's own change, modulated.

A law that is not exact errs where and when it acts. Its error is in the space of its change of the
observations times smooth functions of place and time: polynomials in load, time and place on the pad, in all
directions or along the pad's normal, on one pad or in one recording. All directions of that space count
alike (SignatureEquations.resemblance).
"""

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Response
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse

POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of load and time, each relative to its greatest value in the recording."""
WITH_PLACE = ((0, 0), (1, 0))
"""Those that functions of the place multiply, too: they grow with the load at most."""


def modulated_changes(model: CaseModel, response: Response) -> list[Regressor]:
    """Columns of the modulated change that a response makes to the plain model's prediction."""
    each = [_of_recording(recording, response.change(model, k)) for k, recording in enumerate(model.grasps)]
    names = sorted({name for known in each for name in known})
    columns = [Regressor(name=name, sd=1.0, fields=[known.get(name) for known in each]) for name in names]
    alone = [
        Regressor(
            name=f"recording {k + 1}",
            sd=1.0,
            fields=[known[f"{POWERS[0]}"] if j == k else None for j in range(len(each))],
        )
        for k, known in enumerate(each)
    ]
    return columns + alone


def _of_recording(recording: GraspResponse, change: ObservationDelta) -> dict[str, ObservationDelta]:
    """The modulated changes of one recording by name."""
    elapsed = recording.time_s - recording.time_s[0]
    time = elapsed / max(float(elapsed.max()), np.finfo(float).tiny)
    growth = {powers: recording.load ** powers[0] * time ** powers[1] for powers in POWERS}
    modulated = {
        f"{powers}": ObservationDelta(
            markers=None if change.markers is None else change.markers * share[:, None, None],
            balance=None if change.balance is None else change.balance * share[:, None],
            rest=change.rest if powers == POWERS[0] else None,
        )
        for powers, share in growth.items()
    }
    if change.markers is None:
        return modulated
    x, y, normal = _places(recording)
    along = np.einsum("fnx,nx->fn", change.markers, normal)[:, :, None] * normal
    for powers in WITH_PLACE:
        share = growth[powers][:, None, None]
        for name, of_place in (("x", x), ("y", y), ("x^2 + y^2", x**2 + y**2)):
            markers = change.markers * share * of_place[:, None]
            modulated[f"{powers} {name}"] = ObservationDelta(markers=markers)
        modulated[f"{powers} normal"] = ObservationDelta(markers=along * share)
    for pad in range(len(recording.links)):
        modulated[f"pad {pad}"] = ObservationDelta(markers=change.markers * recording.own_markers(pad))
    return modulated


def _places(
    recording: GraspResponse,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Each marker's place on its pad, about the contact's centre over its radius; the pad's normal."""
    pads = recording.pad_of_marker
    place, normal = np.zeros((len(pads), 2)), np.zeros((len(pads), 3))
    pressed = np.linalg.norm(recording.force_N, axis=2).sum(axis=0)
    for pad in range(len(recording.links)):
        mine, axes = pads == pad, recording.turn_of(pad)
        at = recording.tracks.place_mm[mine] @ axes[:, :2]
        weight = pressed[mine] / max(float(pressed[mine].sum()), np.finfo(float).tiny)
        at = at - weight @ at
        radius = float(np.sqrt(weight @ (at**2).sum(axis=1)))
        place[mine] = at / radius if radius > 0 else 0.0
        normal[mine] = axes[:, 2]
    return place[:, 0], place[:, 1], normal
