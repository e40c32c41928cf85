"""Corrections of the plain model for finite strain: large deformation of the flesh, rotation of the fruit.

Soft flesh strains by large amounts in a grasp: two millimetres of indentation under a patch of six strain it
by a fifth. The plain model assumes small strain. Its error looks like a skin, or like stiffening with a very
small b. Their log Bayes factor is 10 to 69 on fruit of 0.2 to 0.4 MPa without mismatch (first blind test).
The column of large deformation is the response of Neo-Hookean flesh less the linear one.

If the flesh rotates by Q(t) as a whole, under forces f that do not rotate with it, its markers are at

    y = Q (X + s C Q' f) + c

X: their places, C: the unit-modulus compliance, c: any shift. With Q = I + W + W^2/2 + ..., the plain model
includes W X, each frame's own rigid motion, and s C f. The other terms of second order are

    W^2 X / 2 + s (W C f - C W f)

the shortening by rotation, and the rotation of the compliance with the fruit. A shear of a millimetre rotates
fruit by two degrees, which is 16 um at 27 mm. W is fitted to the markers themselves.
"""

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.inner_changes import LEADING
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.model.stress_history import neo_hookean_field, stiffening_path

LARGE_DEFORMATION, TURNED_FRUIT = "large deformation", "turned fruit"
"""Names of the columns."""
MEAN = 1.0
"""Prior mean of their amounts."""
SD = {LARGE_DEFORMATION: 0.1, TURNED_FRUIT: 0.25}
"""Prior standard deviation of their amounts. Large deformation: the root mean square of the difference from 1
in 28 records of fruit without mismatch (0.68 to 1.00, least in the softest fruit of 0.16 MPa), fitted without
model error (`benchmarks/mismatch_scores.py`). 0.05 and 0.25 were tried on the same bank. Turned fruit: set
by hand; its amount is 0.4 to 1.0 in these."""
POWER = {LARGE_DEFORMATION: 2.0, TURNED_FRUIT: 0.0}
"""Power of 1/E with which their displacement grows: large deformation is mostly of second degree in the
forces over E; of the turn the larger part does not depend on E."""
HARDLY_RAD = 0.002
"""Rotation below which no column is added. Set by hand: W C f is then below 1 um under half a millimetre of
indentation, W^2 X / 2 below 0.1 um."""
LOADED = 0.1
"""Frames above this share of the greatest load count for HARDLY_RAD: in lighter ones few markers touch."""
FIRST_LOADING = 0.5
"""Rotations are relative to their load-weighted mean up to this share of a contact's greatest load: a fruit
rotates as it is sheared, hardly as pads close. Set by hand."""


def beyond_small_strain(model: CaseModel) -> list[Regressor]:
    """The columns that can be computed and are not negligible; none if the response includes finite strain
    already (CaseModel.beyond_small_strain).
    """
    if not model.beyond_small_strain:
        return []
    large = large_deformation(model)
    flesh = [model.compliance * unit for unit in large] if isinstance(large, list) else []
    return [
        Regressor(
            name=name,
            mean=MEAN,
            sd=SD[name],
            power=POWER[name],
            fields=[None if field is None else ObservationDelta(markers=field) for field in fields],
        )
        for name, fields in ((LARGE_DEFORMATION, flesh), (TURNED_FRUIT, turned_fruits(model)))
        if any(field is not None for field in fields)
    ]


def displacement_beyond(model: CaseModel, *, large_deformation: bool = True) -> Fields:
    """Displacement of every recording's markers by these columns at their prior mean, mm.

    `large_deformation`: False if the law of an effect includes it.
    """
    moved = [np.zeros_like(recording.tracks.unit_displacement) for recording in model.grasps]
    for column in beyond_small_strain(model):
        if large_deformation or column.name != LARGE_DEFORMATION:
            for k, field in enumerate(column.fields):
                if field is not None and field.markers is not None:
                    moved[k] = moved[k] + column.mean * field.markers
    return moved


def large_deformation(model: CaseModel) -> Fields | FemFailure:
    """Change of the unit response by large deformation at every recording's markers, mm MPa; or the failure
    of its solve.
    """
    field = neo_hookean_field(model)
    return field if isinstance(field, FemFailure) else stiffening_path(model).at_markers(field)


def turned_fruits(model: CaseModel) -> list[Float[np.ndarray, "_f _n 3"] | None]:
    """`turned_fruit` of every recording, at the 1/E of the first call."""
    return model.memoised(
        TURNED_FRUIT, lambda: [turned_fruit(model, recording) for recording in model.grasps]
    )


def turned_fruit(model: CaseModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"] | None:
    """Displacement of the markers by the fruit's rotation, mm; None if it is held or hardly rotates."""
    tracks, s = recording.tracks, model.compliance
    seen = model.marker_equations(recording).turns(recording.excess(s))
    turn = from_first_loading(seen, recording.load, tracks.episode.max(axis=1))
    loaded = recording.load > LOADED
    if np.linalg.norm(turn[loaded], axis=1).max(initial=0.0) < HARDLY_RAD:
        return None
    arm = tracks.place_mm - tracks.place_mm.mean(axis=0)
    w = turn[:, None]
    shortened = np.cross(w, np.cross(w, arm)) / 2
    turned_compliance = np.cross(w, tracks.unit_displacement) - _under_turned_forces(model, recording, turn)
    return np.asarray(shortened + s * turned_compliance)


def from_first_loading(
    turn: Float[np.ndarray, "f 3"], load: Float[np.ndarray, " f"], contact: Int[np.ndarray, " f"]
) -> Float[np.ndarray, "f 3"]:
    """Rotations relative to first loading in each contact (numbered; -1: none); zero without contact."""
    since_first = np.zeros_like(turn)
    for number in np.unique(contact[contact >= 0]):
        frames = np.flatnonzero(contact == number)
        first = frames[: int(np.argmax(load[frames] >= FIRST_LOADING * load[frames].max())) + 1]
        since_first[frames] = turn[frames] - np.average(turn[first], axis=0, weights=load[first])
    return since_first


def _under_turned_forces(
    model: CaseModel, recording: GraspResponse, turn: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f n 3"]:
    """C W f at the markers, mm MPa, from leading patterns rotated about each axis and solved once."""
    patterns = recording.patterns[:LEADING]

    def compute() -> Float[np.ndarray, "3 r n 3"]:
        turned = np.cross(np.eye(3)[:, None, None], patterns[None]).reshape(-1, *patterns.shape[1:])
        return recording.response_to(turned).reshape(3, *patterns.shape)

    response = model.memoised(("turned forces", recording.case.name), compute)
    shares = recording.shares[:, : len(patterns)]
    return np.asarray(np.einsum("fa,fr,arnx->fnx", turn, shares, response, optimize=True))
