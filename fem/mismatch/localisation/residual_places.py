"""Where, when and in which component a mismatch sits: from a fit's residual in excess of noise.

The residual of every marker, frame and component is squared, in units of its noise variance. The excess over
MARKER_VARIANCE_INFLATION, which null recordings leave too, is added up by pad, phase and component. Each
pad's own rigid motion is taken out first, else what one pad shows is shared with the other by the fruit's.
One place in the flesh is named where a single softer ball explains most of the residual
(fem.mismatch.localisation.spot_search).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import CompliantFit, rigid_part
from fem.estimation.modulus_by_frame import modulus_per_frame
from fem.mismatch.localisation.spot_search import best_spots, fruit_map
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.marker_equations import MARKER_VARIANCE_INFLATION
from fem.mismatch.model.pads import pads_of
from fem.mismatch.result import FruitMap, ModulusCell, Where

PHASES = ("load", "hold", "unload")
PLACE_SHARE = 0.7
"""Share of the excess above which one pad, place, phase or component has it. Set by hand: well over half."""
PLACE_EXCESS = 0.05
"""Excess, as a share of noise, below which none of pads, phases and components is told from the others. Set
by hand."""
SPOT_SCORE = 20.0
"""Least standard score of a place in the flesh that is named. Set by hand, high: it is the best of many
places, and model errors score too."""


@dataclass(frozen=True, kw_only=True)
class Located:
    """The words of an answer's `where`, `when` and `component`, and the map."""

    where: Where
    when: str
    component: str
    maps: FruitMap


@dataclass(frozen=True, kw_only=True)
class ExcessVariance:
    """Residual in excess of noise, in units of its variance: (recordings, pads, phases, normal and shear).

    `count`: over how many numbers each is the sum.
    """

    amount: Float[np.ndarray, "g p 3 2"]
    count: Float[np.ndarray, "g p 3 2"]

    def most(self, share: Float[np.ndarray, " k"]) -> int | None:
        """Which of several parts has PLACE_SHARE of the excess, if one has."""
        enough = self.amount.sum() > PLACE_EXCESS * self.count.sum()
        total = float(share.sum())
        return (
            int(share.argmax()) if enough and share.max() > PLACE_SHARE * total and len(share) > 1 else None
        )


def located(forward: ForwardModel, residual: Sequence[Float[np.ndarray, "_f _n 3"]]) -> Located:
    """`residual`: of a fit at the markers' positions per recording, mm; rigid motions may be in it."""
    excess = excess_of(forward, residual)
    numbers = forward.adjoint_basis.observed(residual)
    return Located(
        where=_where(forward, excess, numbers),
        when=_when(excess),
        component=_component(excess),
        maps=fruit_map(forward, numbers),
    )


def excess_of(forward: ForwardModel, residual: Sequence[Float[np.ndarray, "_f _n 3"]]) -> ExcessVariance:
    """The sums that where, when and component are read from."""
    grasps = forward.base.grasps
    names = pads_of(forward)
    shape = (len(grasps), len(names), len(PHASES), 2)
    amount, count = np.zeros(shape), np.zeros(shape)
    for k, (recording, basis, field) in enumerate(
        zip(grasps, forward.adjoint_basis.grasps, residual, strict=True)
    ):
        touching = recording.tracks.episode >= 0
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
        for pad in range(len(recording.links)):
            for at, name in enumerate(PHASES):
                chosen = touching & (recording.pad_of_marker == pad) & (phase == name)[:, None]
                place = names.index(recording.pad_names[pad])
                samples = float(chosen.sum())
                for component, (squares, each) in enumerate(((normal, 1.0), (shear, 2.0))):
                    count[k, place, at, component] = each * samples
                    amount[k, place, at, component] = (
                        float(squares[chosen].sum()) - MARKER_VARIANCE_INFLATION * each * samples
                    )
    return ExcessVariance(amount=np.maximum(amount, 0.0), count=count)


def _where(forward: ForwardModel, excess: ExcessVariance, numbers: Float[np.ndarray, " k"]) -> Where:
    """The ball of flesh that explains most of the residual; else the pad with the excess; else both."""
    spots = best_spots(forward, numbers)
    best = max(spots, key=lambda spot: spot.score, default=None)
    if (
        best is not None
        and best.score > SPOT_SCORE
        and best.score**2 > PLACE_SHARE * float(numbers @ numbers)
    ):
        x, y, z = map(float, best.centre_mm)
        return Where(region="flesh", centre_mm=(x, y, z), radius_mm=best.radius_mm)
    names = pads_of(forward)
    if len(names) == 1:
        return Where(region=f"pad {names[0]}")
    pad = excess.most(excess.amount.sum(axis=(0, 2, 3)))
    return Where(region="both" if pad is None else f"pad {names[pad]}")


def _when(excess: ExcessVariance) -> str:
    """The phase that has most of the excess, each weighed by its number of samples."""
    count = excess.count.sum(axis=(0, 1, 3))
    phase = excess.most(excess.amount.sum(axis=(0, 1, 3)) / np.maximum(count, 1.0))
    return "all" if phase is None else PHASES[phase]


def _component(excess: ExcessVariance) -> str:
    part = excess.most(excess.amount.sum(axis=(0, 1, 2)))
    return "both" if part is None else ("normal", "shear")[part]


def modulus_cells(forward: ForwardModel, fits: Sequence[CompliantFit]) -> tuple[ModulusCell, ...]:
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
        for recording, fit in zip(forward.base.grasps, fits, strict=True)
        for row in modulus_per_frame(recording.case.history, recording.tracks, fit, recording.used)
        if np.isfinite(row.E_MPa)
    )
