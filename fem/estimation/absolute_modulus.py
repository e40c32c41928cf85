"""The modulus from one loaded frame: how far markers stand inside the scanned surface.

Without a first touch to compare with, only the distance normal to the skin is known: n . (y - X) = s n . c
+ n . R q, with X the marker's place on the unloaded mesh. A scan off by a tenth of a millimetre goes
straight into it (15-18 % of E in presses of one or two millimetres), and into its spread here.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.estimation.compliance_fit import GAUGE_SD_MM, MarkerTracks, rigid_motion


@dataclass(frozen=True, kw_only=True)
class AbsoluteFit:
    """1/E by least squares and by the energy of the normal forces; relative spread of either.

    `residual_mm` is along the skin's outward normal, as a vector (NaN out of contact).
    """

    compliance: float
    energy_compliance: float
    noise: float
    surface: float
    residual_mm: Float[np.ndarray, "1 n 3"]


def absolute_compliance(
    tracks: MarkerTracks,
    force_N: Float[np.ndarray, "t n 3"],
    frame: int,
    *,
    pad_of_marker: Int[np.ndarray, " n"],
    surface_sd_mm: Float[np.ndarray, " p"],
    fruit_moves: bool,
) -> AbsoluteFit:
    """The fit to one `frame` of `tracks`; the surface's error is one unknown shift per pad, of
    standard deviation `surface_sd_mm` each, in the spread only."""
    on = tracks.episode[frame] >= 0
    normal, weight = tracks.normal[on], 1 / tracks.sd_mm[on]
    gap = _dot(tracks.position_mm[frame, on] - tracks.place_mm[on], normal)
    unit = _dot(tracks.unit_displacement[frame, on], normal)
    rigid = np.einsum("nx,nxk->nk", normal, rigid_motion(tracks.place_mm)[on])
    columns = np.column_stack([unit, rigid]) if fruit_moves else unit[:, None]
    rows = columns * weight[:, None]
    prior = np.diag([0.0] + [1 / GAUGE_SD_MM**2] * (columns.shape[1] - 1))
    inverse = np.linalg.inv(rows.T @ rows + prior)
    solution = inverse @ rows.T @ (gap * weight)
    residual = gap - columns @ solution
    compression = gap - (columns[:, 1:] @ solution[1:])
    push = _dot(force_N[frame, on], normal)
    touching = np.unique(pad_of_marker[on])
    depth = [abs(float(gap[pad_of_marker[on] == pad].mean())) for pad in touching]
    field = np.full((1, len(on), 3), np.nan)
    field[0, on] = residual[:, None] * normal
    return AbsoluteFit(
        compliance=float(solution[0]),
        energy_compliance=float(push @ compression) / float(push @ unit),
        noise=float(np.sqrt(inverse[0, 0])) / abs(float(solution[0])),
        surface=float(np.linalg.norm(surface_sd_mm[touching])) / float(np.sum(depth)),
        residual_mm=field,
    )


def _dot(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.einsum("nx,nx->n", a, b))
