"""Nuisances: uncertain quantities of fruit, pad and mesh, with priors; never reported as effects.

Common to all recordings: the pit's place and size and Poisson's ratio, each with its prior, the dents' depth,
the share of a finer mesh's response, and the amounts of large deformation and of the fruit's rotation. Each
recording's own: undulations of the scanned surface, the pads' places on it, and the pads' approach at each
load. No model is exact to a micrometre, so each pad of each recording may also deviate by NORMAL_DISCREPANCY
of its response. It may do so in any smooth pattern over its patch, in proportion to the load or its square.
An effect acts on all recordings by one law; these nuisances do not, which separates them.
"""

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import rigid_part
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.sensitivity import POISSON_RATIO, SURFACE, mean_normal, tangents
from fem.mismatch.evidence.beyond_small_strain import beyond_small_strain
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import OfFinerMesh, OfInnerChange, OfResponse
from fem.mismatch.model.inner_changes import inner_changes, slid_response
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse

NORMAL_DISCREPANCY, TANGENTIAL_DISCREPANCY = 0.005, 0.003
"""Standard deviations of a pad's own discrepancies along its normal and along the skin, as shares of its
response at the greatest load."""
SMALLEST_POISSON_SD = 0.005
"""Least standard deviation of Poisson's ratio, for any source: a third of the categories' 0.015
(recon/pit/priors). Set by hand."""
DENT = 0.04
"""Relative standard deviation of the depth of the dent under a patch. Markers a millimetre apart resolve the
pressure at a patch's rim, where it is steepest, and their own places there, to a few hundredths."""
FINER_MESH = 0.5
"""Relative standard deviation of what a finer mesh adds to the response. It is computed for the plain law. A
stiff skin suppresses it (docs/decisions/0017): nothing is left at two standard deviations. Set by hand."""
APPROACH = 0.003
"""Standard deviation of a pad's approach at one load, as a share of its response at the greatest. While a
patch spans a few markers, they determine its pressure to some percent only."""
LOADS = (0.07, 0.14, 0.25, 0.42, 0.65, 1.0)
"""Loads, as shares of the greatest, with independent deviations of the approach; linear between."""
FEWEST = 8
"""Fewest touching markers of a pad in a frame: with fewer, a smooth pattern cannot be separated from its
rigid motion."""


def common_nuisances(model: CaseModel) -> list[Regressor]:
    """Nuisances of all recordings."""
    budget = model.case.budget
    inner = [_inner(model, recording) for recording in model.grasps]
    names = dict.fromkeys(name for changes in inner for name in changes if name not in SURFACE)
    columns = [
        Regressor(
            name=name,
            sd=_sd(name, budget),
            fields=[changes.get(name) for changes in inner],
            of_forces=OfInnerChange(name),
        )
        for name in names
    ]
    dents = [
        ObservationDelta(markers=model.compliance * _dent(recording, recording.tracks.unit_displacement))
        for recording in model.grasps
    ]
    columns.append(Regressor(name="dent", sd=DENT, fields=dents, of_forces=OfResponse(_dent)))
    return [*columns, *_finer_mesh(model), *beyond_small_strain(model)]


def _finer_mesh(model: CaseModel) -> list[Regressor]:
    """The column of the error of what a finer mesh adds, if the case has such a mesh."""
    if model.case.finer_mesh is None:
        return []
    fields = [ObservationDelta(markers=model.compliance * recording.added) for recording in model.grasps]
    return [Regressor(name="finer mesh", sd=FINER_MESH, fields=fields, of_forces=OfFinerMesh())]


def own_nuisances(model: CaseModel, recording: GraspResponse) -> list[tuple[str, float, ObservationDelta]]:
    """Nuisances of one recording: name, prior standard deviation, field."""
    budget = model.case.budget
    nuisances = [
        (name, budget.sd_of(name, history=recording.case.history), field)
        for name, field in _inner(model, recording).items()
        if name in SURFACE
    ]
    nuisances += [(name, budget.pose_sd_mm, field) for name, field in _places(model, recording)]
    return nuisances + _discrepancies(model, recording) + _approaches(model, recording)


def _sd(name: str, budget: ErrorBudget) -> float:
    sd = budget.sd_of(name)
    return max(sd, SMALLEST_POISSON_SD) if name == POISSON_RATIO else sd


def _inner(model: CaseModel, recording: GraspResponse) -> dict[str, ObservationDelta]:
    return {
        cause: ObservationDelta(markers=model.compliance * change)
        for cause, change in inner_changes(model, recording).items()
    }


def _places(model: CaseModel, recording: GraspResponse) -> list[tuple[str, ObservationDelta]]:
    """Shift of each pad along its own x and y over the skin."""
    return [
        (f"{name} {axis}", ObservationDelta(markers=model.compliance * moved))
        for pad, name in enumerate(recording.pad_names)
        for axis, moved in zip("xy", slid_response(model, recording, pad), strict=True)
    ]


def _dent(recording: GraspResponse, response: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    """c less each pad's own rigid motion in each frame: the dent's shape without the pads' approach."""
    tracks, dent = recording.tracks, np.zeros_like(response)
    for pad in range(len(recording.links)):
        mine = recording.pad_of_marker == pad
        touching = tracks.episode[:, mine] >= 0
        enough = touching & (touching.sum(axis=1, keepdims=True) >= FEWEST)
        rigid = rigid_part(response[:, mine], tracks.place_mm[mine], enough)
        dent[:, mine] = enough[..., None] * response[:, mine] - rigid
    return dent


def _discrepancies(model: CaseModel, recording: GraspResponse) -> list[tuple[str, float, ObservationDelta]]:
    """Polynomials of second degree over each patch, along three directions, times load and its square."""
    discrepancies = []
    for pad, name in enumerate(recording.pad_names):
        mine = recording.own_markers(pad)[0, :, 0]
        normal = mean_normal(recording.links[pad].place.normal)
        axes = np.vstack([tangents(recording.links[pad].place.normal), normal])
        size = _greatest_response(model, recording, pad)
        x, y = ((recording.tracks.place_mm - recording.tracks.place_mm[mine].mean(axis=0)) @ axes[:2].T).T
        x, y = x / np.abs(x[mine]).max(), y / np.abs(y[mine]).max()
        shapes = np.stack([np.ones_like(x), x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3]) * mine
        for way, axis in enumerate(axes):
            sd = size * (NORMAL_DISCREPANCY if way == 2 else TANGENTIAL_DISCREPANCY)
            for k, shape in enumerate(shapes):
                for power in (1, 2):
                    field = (recording.load**power)[:, None, None] * (shape[:, None] * axis)
                    discrepancies.append(
                        (f"{name} discrepancy {way}{k}{power}", sd, ObservationDelta(markers=field))
                    )
    return discrepancies


def _greatest_response(model: CaseModel, recording: GraspResponse, pad: int) -> float:
    """Root mean square over a pad's markers of their response at the greatest load, mm."""
    mine = recording.own_markers(pad)[0, :, 0]
    response = model.compliance * recording.tracks.unit_displacement[int(np.argmax(recording.load)), mine]
    return float(np.sqrt((response**2).sum(axis=1).mean()))


def _approaches(model: CaseModel, recording: GraspResponse) -> list[tuple[str, float, ObservationDelta]]:
    """Shift of each pad along its normal near each of LOADS, the same in loading and unloading."""
    approaches = []
    near = [np.interp(recording.load, LOADS, unit) for unit in np.eye(len(LOADS))]
    for pad, name in enumerate(recording.pad_names):
        mine = recording.own_markers(pad)[0, :, 0]
        normal = mean_normal(recording.links[pad].place.normal)
        sd = APPROACH * _greatest_response(model, recording, pad)
        for k, share in enumerate(near):
            field = share[:, None, None] * (mine[:, None] * normal)
            approaches.append((f"{name} approach {k}", sd, ObservationDelta(markers=field)))
    return approaches
