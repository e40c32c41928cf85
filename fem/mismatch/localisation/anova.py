"""Which circumstance the modulus varies with: an analysis of variance of ln E over frames, pads and grasps.

    ln E = sum of factors + noise,      F = (rise of the squares without the factor / its d) / (squares / n)

each factor against all others (Fisher's partial F-test; Seber and Lee, Linear Regression Analysis, 2003,
chapter 4). Cells weigh by their noise. Neighbouring frames err alike, so n is cut down by (1 - r) / (1 + r),
r the correlation of the residual from one frame to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import fdtrc

from fem.estimation.compliance_fit import CompliantFit
from fem.estimation.modulus_by_frame import BOTH, FrameModulus, modulus_per_frame
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import ModulusCell, Variance

LEAST_SHARE_OF_FORCE = 0.2
"""Frames with less than this share of the greatest force carry too little to be compared."""
FLOOR_SD = 0.01
"""No cell counts as better known than this, as a share of E: no model is."""
LARGEST_CORRELATION = 0.95
"""Between frames: at most this is believed, which leaves a fortieth of them; a short trace may show more by
chance."""


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Secant moduli of single pads, with what may matter to them; one row per frame, pad and grasp."""

    ln_modulus: Float[np.ndarray, " n"]
    sd: Float[np.ndarray, " n"]
    factors: dict[str, Float[np.ndarray, "n _c"]]
    neighbour: Bool[np.ndarray, " n"]


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
        for recording, table in zip(forward.base.grasps, _tables(forward, fits), strict=True)
        for row in table
        if np.isfinite(row.E_MPa)
    )


def analysis_of_variance(forward: ForwardModel, fits: Sequence[CompliantFit]) -> tuple[Variance, ...]:
    """Load, time, rate, grasp, pad, cycle and phase, the largest share first; what never varies left out."""
    cells = _cells(forward, _tables(forward, fits))
    return explained(cells) if len(cells.ln_modulus) > 2 else ()


def explained(cells: Cells) -> tuple[Variance, ...]:
    """Each factor's share of the variance that the others leave, and its p-value."""
    weight = 1 / cells.sd
    y = weight * cells.ln_modulus
    ones = weight[:, None]
    columns = {name: weight[:, None] * values for name, values in cells.factors.items()}
    whole = np.hstack([ones, *columns.values()])
    residual, rank = _residual(whole, y)
    pairs = residual[1:][cells.neighbour[1:]] @ residual[:-1][cells.neighbour[1:]]
    correlation = float(np.clip(pairs / max(residual @ residual, 1e-300), 0.0, LARGEST_CORRELATION))
    free = max((len(y) - rank) * (1 - correlation) / (1 + correlation), 1.0)
    total = _residual(ones, y)[0]
    variances = []
    for name in columns:
        others = np.hstack([ones, *(other for key, other in columns.items() if key != name)])
        without, lower = _residual(others, y)
        if rank == lower:
            continue
        rise = max(float(without @ without - residual @ residual), 0.0)
        ratio = (
            rise
            / (rank - lower)
            / max(float(residual @ residual) / (len(y) - rank), 1e-300)
            * free
            / (len(y) - rank)
        )
        variances.append(
            Variance(
                factor=name,
                share=rise / max(float(total @ total), 1e-300),
                p_value=float(fdtrc(rank - lower, free, max(ratio, 0.0))),
            )
        )
    return tuple(sorted(variances, key=lambda row: -row.share))


def _residual(
    columns: Float[np.ndarray, "n c"], y: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], int]:
    """Residual of y after regression on the columns, and their rank."""
    amounts, _, rank, _ = np.linalg.lstsq(columns, y, rcond=1e-9)
    return y - columns @ amounts, int(rank)


def _tables(forward: ForwardModel, fits: Sequence[CompliantFit]) -> list[tuple[FrameModulus, ...]]:
    return [
        modulus_per_frame(recording.case.history, recording.tracks, fit, recording.used)
        for recording, fit in zip(forward.base.grasps, fits, strict=True)
    ]


def _cells(forward: ForwardModel, tables: Sequence[tuple[FrameModulus, ...]]) -> Cells:
    """Rows of single pads with enough force."""
    rows: list[tuple[float, ...]] = []
    kinds: list[tuple[str, str, str, str]] = []
    for recording, table in zip(forward.base.grasps, tables, strict=True):
        history = recording.case.history
        greatest = max(row.force_N for row in table)
        names = recording.pad_names
        cycle = np.max([pad.episode.max(axis=1) for pad in history.pads], axis=0)
        start = history.time_s[np.flatnonzero(recording.used)[0]]
        for name in names:
            pad_rows = [row for row in table if row.pad == name and row.pad != BOTH]
            pace = (
                np.abs(np.gradient([row.force_N for row in pad_rows], [row.time_s for row in pad_rows]))
                if len(pad_rows) > 1
                else np.zeros(len(pad_rows))
            )
            fresh = True
            for row, speed in zip(pad_rows, pace, strict=True):
                usable = np.isfinite(row.E_MPa) and row.force_N >= LEAST_SHARE_OF_FORCE * greatest
                if not usable:
                    fresh = True
                    continue
                sd = np.hypot(row.E_sd_MPa / row.E_MPa, FLOOR_SD)
                rows.append((np.log(row.E_MPa), sd, row.force_N, row.time_s - start, speed, not fresh))
                kinds.append((recording.case.name, name, str(cycle[row.frame]), row.phase))
                fresh = False
    values = np.array(rows, dtype=float).reshape(len(rows), 6)
    words = np.array(kinds).reshape(len(rows), 4)
    factors = {"load": values[:, 2:3], "time": values[:, 3:4], "rate": values[:, 4:5]}
    factors |= {name: _levels(words[:, k]) for k, name in enumerate(("grasp", "pad", "cycle", "phase"))}
    return Cells(
        ln_modulus=values[:, 0], sd=values[:, 1], factors=factors, neighbour=values[:, 5].astype(bool)
    )


def _levels(words: np.ndarray) -> Float[np.ndarray, "n c"]:
    """One column per level but the first."""
    return np.asarray(words[:, None] == np.unique(words)[1:], dtype=float)
