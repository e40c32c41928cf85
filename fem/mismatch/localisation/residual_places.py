"""Place, time and component of a mismatch, from a fit's residual in excess of noise.

The residual of every marker, frame and component is squared, in units of its noise variance. Its excess over
MARKER_VARIANCE_INFLATION, which null recordings have too, is summed by pad, phase and component. Each pad's
own rigid motion is removed first; otherwise the fruit's motion would spread one pad's residual to the other.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import CompliantFit, rigid_part
from fem.estimation.modulus_by_frame import modulus_per_frame
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import MARKER_VARIANCE_INFLATION
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.result import ModulusCell

PHASES = ("load", "hold", "unload")
PLACE_SHARE = 0.7
"""Share of the excess above which it is attributed to one pad, phase or component. Set by hand: well over
half."""
PLACE_EXCESS = 0.05
"""Excess, as a share of noise, below which it is attributed to no single pad, phase or component. Set by
hand."""


def located(model: CaseModel, residual: Fields) -> tuple[str, str, str]:
    """The words of an answer's region, `when` and `component`.

    `residual`: a fit's residual of the markers' positions per recording, mm; it may include rigid motions.
    """
    names = model.pads
    amount, count = _excess(model, residual, names)
    enough = amount.sum() > PLACE_EXCESS * count.sum()

    def most(share: Float[np.ndarray, " k"]) -> int | None:
        """The part of several that has PLACE_SHARE of the excess, if any."""
        has = enough and len(share) > 1 and share.max() > PLACE_SHARE * share.sum()
        return int(share.argmax()) if has else None

    # phases are compared by their mean excess per number
    phase = most(amount.sum(axis=(0, 2)) / np.maximum(count.sum(axis=(0, 2)), 1.0))
    component = most(amount.sum(axis=(0, 1)))
    pad = 0 if len(names) == 1 else most(amount.sum(axis=(1, 2)))
    return (
        "both" if pad is None else f"pad {names[pad]}",
        "all" if phase is None else PHASES[phase],
        "both" if component is None else ("normal", "shear")[component],
    )


def _excess(
    model: CaseModel, residual: Fields, names: Sequence[str]
) -> tuple[Float[np.ndarray, "p 3 2"], Float[np.ndarray, "p 3 2"]]:
    """Residual in excess of noise, in units of its variance, by pad, phase, and normal and shear; number of
    terms in each sum.
    """
    amount, count = np.zeros((len(names), len(PHASES), 2)), np.zeros((len(names), len(PHASES), 2))
    for recording, basis, field in zip(model.grasps, model.adjoint_basis.grasps, residual, strict=True):
        touching = recording.touching
        scaled = basis.equations.residual(field)
        for pad in range(len(recording.links)):
            markers = np.flatnonzero(recording.pad_of_marker == pad)
            scaled[:, markers] -= rigid_part(
                scaled[:, markers], recording.tracks.place_mm[markers], touching[:, markers]
            )
        scaled /= recording.tracks.sd_mm[:, None]
        normal = np.einsum("tnx,nx->tn", scaled, recording.tracks.normal) ** 2
        shear = (scaled**2).sum(axis=2) - normal
        phase = np.array(recording.case.history.phase)[recording.used]
        for pad, name in enumerate(recording.pad_names):
            for at, of_phase in enumerate(PHASES):
                chosen = touching & (recording.pad_of_marker == pad) & (phase == of_phase)[:, None]
                numbers = chosen.sum() * np.array([1.0, 2.0])
                squares = np.array([normal[chosen].sum(), shear[chosen].sum()])
                place = names.index(name), at
                count[place] += numbers
                amount[place] += np.maximum(squares - MARKER_VARIANCE_INFLATION * numbers, 0.0)
    return amount, count


def modulus_cells(model: CaseModel, fits: Sequence[CompliantFit]) -> tuple[ModulusCell, ...]:
    """E per frame, pad (and all pads together) and grasp; `fits`: the plain fit of each recording."""
    return tuple(
        ModulusCell(
            grasp=recording.case.name,
            pad=row.pad,
            time_s=row.time_s,
            phase=row.phase,
            E_MPa=row.E_MPa,
            E_sd_MPa=row.E_sd_MPa,
        )
        for recording, fit in zip(model.grasps, fits, strict=True)
        for row in modulus_per_frame(recording.case.history, recording.tracks, fit, recording.used)
        if np.isfinite(row.E_MPa)
    )
