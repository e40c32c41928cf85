"""Young's modulus by weighted least squares over all frames and markers of a contact.

Each marker is compared with itself over time:

    y_i(t) = X_i + s c_i(t) + [R q(t)]_i + g_i d_i(t) + noise

y: the marker's measured position; c: the displacement that the measured forces cause in a fruit of unit
modulus. The unknowns are s = 1/E, common to all; q(t), the fruit's rigid motion, six per frame; X_i, the
marker's place on the unloaded fruit, three per marker and contact; g_i, the scale error of the marker's gel
displacement d_i, with prior mean zero and a known standard deviation. X_i cancels the error of the scanned
surface. X_i and g_i are eliminated for each marker in closed form; 1 + 6 T normal equations remain. Noise
that correlates between frames counts with its variance in a mean over frames (fem.estimation.coloured_noise).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve

from fem.estimation.coloured_noise import variance_inflation
from fem.solid.rigid_core import rigid_modes

GAUGE_SD_MM = 10.0
"""Prior standard deviation of the fruit's rigid motion at its markers. It fixes the motion common to all
frames, which the X_i leave free, and is far above any real motion."""


@dataclass(frozen=True, kw_only=True)
class MarkerTracks:
    """All markers of all pads in the frames under load; `episode` is -1 where a marker touches nothing.

    `place_mm` and `normal` (outward): of the markers on the fruit's skin. `sd_mm`: noise of one component in
    one frame, `lag1` its correlation between neighbouring frames of these.
    """

    place_mm: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    position_mm: Float[np.ndarray, "t n 3"]
    unit_displacement: Float[np.ndarray, "t n 3"]
    gel_displacement_mm: Float[np.ndarray, "t n 3"]
    episode: Int[np.ndarray, "t n"]
    sd_mm: Float[np.ndarray, " n"]
    lag1: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class CompliantFit:
    """`compliance` is 1/E (1/MPa).

    `motion_mm` is [R q(t)]_i; `residual_mm` the residual of the fit, NaN out of contact, and
    `residual_rms_mm` its root mean square per component.
    """

    compliance: float
    motion_mm: Float[np.ndarray, "t n 3"]
    residual_mm: Float[np.ndarray, "t n 3"]
    residual_rms_mm: float


def fit_compliance(tracks: MarkerTracks, *, scale_sd: float, fruit_moves: bool) -> CompliantFit:
    """The least-squares fit; `fruit_moves` is False where the fruit stands on a fixed base.

    Memory grows as (n markers) (t frames) + (6 t)^2.
    """
    columns = tracks.unit_displacement[None]
    equations = _equations(tracks, columns, scale_sd=scale_sd)
    known, turns, moved = _without_motions(equations, 1, fruit_moves=fruit_moves)
    compliance = known.right / known.normal[0]
    motion, left = _unexplained(tracks, columns, equations, np.append(compliance, moved - compliance @ turns))
    residual = np.where((tracks.episode >= 0)[:, :, None], left, np.nan)
    return CompliantFit(
        compliance=float(compliance[0]),
        motion_mm=motion,
        residual_mm=residual,
        residual_rms_mm=float(np.sqrt(np.nanmean(residual**2))),
    )


def _unexplained(
    tracks: MarkerTracks,
    columns: Float[np.ndarray, "k t n 3"],
    equations: "_Equations",
    theta: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, "t n 3"], Float[np.ndarray, "t n 3"]]:
    """For the amounts and motions `theta`: the fruit's motion at the markers, and the residual."""
    k, frames = len(columns), len(tracks.position_mm)
    scale = (equations.observed - equations.along @ theta) / equations.stiffness
    motion = np.einsum("nxl,tl->tnx", rigid_motion(tracks.place_mm), theta[k:].reshape(frames, 6))
    explained = motion + scale[:, None] * tracks.gel_displacement_mm
    explained += np.einsum("k,ktnx->tnx", theta[:k], columns)
    return motion, about_episode_mean(tracks.position_mm - tracks.place_mm - explained, tracks.episode)


@dataclass(frozen=True, kw_only=True)
class Information:
    """Normal equations N a = b of the amounts a of several displacement fields; other unknowns eliminated."""

    normal: Float[np.ndarray, "k k"]
    right: Float[np.ndarray, " k"]


@dataclass(frozen=True, kw_only=True)
class JudgedInformation(Information):
    """The same, with the residual of the markers' positions.

    `scores`: each marker's share of b - N a at the solution, the product of its residual with each field;
    with independent noise their squares add up to the diagonal of N. `influence`: derivative of b by each
    marker's position in each frame.
    """

    scores: Float[np.ndarray, "n k"]
    influence: Float[np.ndarray, "k t n 3"]


def information(
    tracks: MarkerTracks, columns: Float[np.ndarray, "k t n 3"], *, scale_sd: float, fruit_moves: bool
) -> Information:
    """The information of `tracks` on fields in place of s c (module docstring)."""
    equations = _equations(tracks, columns, scale_sd=scale_sd)
    return _without_motions(equations, len(columns), fruit_moves=fruit_moves)[0]


def _without_motions(
    equations: "_Equations", k: int, *, fruit_moves: bool
) -> tuple[Information, Float[np.ndarray, "k m"], Float[np.ndarray, " m"]]:
    """The information on k fields; the motions fitted to each of them, and to the markers' positions."""
    normal, right = equations.normal[:k, :k], equations.right[:k]
    if not fruit_moves:
        motions = len(equations.right) - k
        return Information(normal=normal, right=right), np.zeros((k, motions)), np.zeros(motions)
    factor = cho_factor(equations.normal[k:, k:])
    turns = cho_solve(factor, equations.normal[k:, :k]).T
    known = Information(
        normal=normal - turns @ equations.normal[k:, :k], right=right - turns @ equations.right[k:]
    )
    return known, turns, cho_solve(factor, equations.right[k:])


def judged_information(
    tracks: MarkerTracks, columns: Float[np.ndarray, "k t n 3"], *, scale_sd: float, fruit_moves: bool
) -> JudgedInformation:
    """`information`, with the residual of these few fields."""
    k, frames = len(columns), len(tracks.position_mm)
    equations = _equations(tracks, columns, scale_sd=scale_sd)
    known, turns, moved = _without_motions(equations, k, fruit_moves=fruit_moves)
    normal, right = known.normal, known.right
    amounts = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    _, left = _unexplained(tracks, columns, equations, np.append(amounts, moved - amounts @ turns))
    rigid = rigid_motion(tracks.place_mm)
    left *= marker_weight(tracks)[:, None]
    gel_share = (equations.along[:, :k] - equations.along[:, k:] @ turns.T) / equations.stiffness[:, None]
    scores = np.einsum("tnx,ktnx->nk", left, columns, optimize=True)
    turned = np.einsum("tnx,nxl->ntl", left, rigid, optimize=True).reshape(len(rigid), -1)
    scores -= (
        turned @ turns.T + gel_share * np.einsum("tnx,tnx->n", left, tracks.gel_displacement_mm)[:, None]
    )
    still = np.einsum("nxl,ktl->ktnx", rigid, turns.reshape(k, frames, 6), optimize=True)
    still += gel_share.T[:, None, :, None] * tracks.gel_displacement_mm
    influence = np.stack([about_episode_mean(field, tracks.episode) for field in columns - still])
    influence *= marker_weight(tracks)[:, None]
    return JudgedInformation(normal=normal, right=right, scores=scores, influence=influence)


def marker_weight(tracks: MarkerTracks) -> Float[np.ndarray, " n"]:
    """Inverse of the variance that is assigned to a component of each marker, 1/mm2."""
    return np.asarray(1 / (variance_inflation(tracks.lag1) * tracks.sd_mm**2))


@dataclass(frozen=True)
class _Equations:
    """For k amounts and 6 t motions; with the eliminated terms of the markers' scales."""

    normal: Float[np.ndarray, "m m"]
    right: Float[np.ndarray, " m"]
    along: Float[np.ndarray, "n m"]
    observed: Float[np.ndarray, " n"]
    stiffness: Float[np.ndarray, " n"]


def _equations(tracks: MarkerTracks, columns: Float[np.ndarray, "k t n 3"], *, scale_sd: float) -> _Equations:
    """Normal equations without the markers' places and scales."""
    k, frames = len(columns), len(tracks.position_mm)
    y, d, *fields = (
        about_episode_mean(values, tracks.episode)
        for values in (tracks.position_mm - tracks.place_mm, tracks.gel_displacement_mm, *columns)
    )
    rigid = rigid_motion(tracks.place_mm)
    weight = marker_weight(tracks)
    c = np.stack(fields)
    weighted = weight[:, None] * c
    flat, size = weighted.reshape(k, -1), k + 6 * frames
    normal, right = np.zeros((size, size)), np.zeros(size)
    normal[:k, :k], right[:k] = flat @ c.reshape(k, -1).T, flat @ y.ravel()
    normal[:k, k:] = np.einsum("nxl,ktnx->ktl", rigid, weighted, optimize=True).reshape(k, -1)
    normal[k:, :k] = normal[:k, k:].T
    normal[k:, k:] = motion_equations(rigid, weight, tracks.episode)
    right[k:] = np.einsum("n,nxl,tnx->tl", weight, rigid, y, optimize=True).ravel()
    # Each marker's scale error is eliminated by a rank-one update.
    along = np.empty((len(weight), size))
    along[:, :k] = np.einsum("ktnx,tnx->nk", weighted, d, optimize=True)
    along[:, k:] = np.einsum("n,nxl,tnx->ntl", weight, rigid, d, optimize=True).reshape(len(weight), -1)
    observed = np.einsum("n,tnx,tnx->n", weight, d, y, optimize=True)
    stiffness = np.einsum("n,tnx,tnx->n", weight, d, d, optimize=True) + 1 / scale_sd**2
    normal -= along.T @ (along / stiffness[:, None])
    right -= along.T @ (observed / stiffness)
    normal[np.arange(k, size), np.arange(k, size)] += 1 / GAUGE_SD_MM**2
    return _Equations(normal, right, along, observed, stiffness)


def rigid_motion(place_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 6"]:
    """Displacement by three shifts (mm) and small rotations about the centre, in mm at the mean radius."""
    modes = rigid_modes(place_mm, centre_mm=place_mm.mean(axis=0))
    modes[:, :, 3:] /= mean_radius_mm(place_mm)
    return modes


def rigid_part(
    field_mm: Float[np.ndarray, "t n 3"], place_mm: Float[np.ndarray, "n 3"], on: Bool[np.ndarray, "t n"]
) -> Float[np.ndarray, "t n 3"]:
    """Each frame's rigid motion that fits the field best at the markers that are `on`; zero elsewhere."""
    modes, weight = rigid_motion(place_mm), on.astype(float)
    normal = np.einsum("tn,nxk,nxl->tkl", weight, modes, modes, optimize=True) + 1e-6 * np.eye(6)
    right = np.einsum("tn,nxk,tnx->tk", weight, modes, field_mm, optimize=True)
    motion = np.linalg.solve(normal, right[..., None])[..., 0]
    return np.asarray(np.einsum("nxk,tk->tnx", modes, motion) * weight[..., None])


def mean_radius_mm(place_mm: Float[np.ndarray, "n 3"]) -> float:
    """Mean distance from the centre, at which rigid_motion expresses a rotation in mm."""
    return max(float(np.linalg.norm(place_mm - place_mm.mean(axis=0), axis=1).mean()), 1e-9)


def about_episode_mean(
    values: Float[np.ndarray, "t n 3"], episode: Int[np.ndarray, "t n"]
) -> Float[np.ndarray, "t n 3"]:
    """Each marker's series less its mean over the same contact; zero out of contact."""
    about = np.zeros_like(values)
    for contact in range(int(episode.max()) + 1):
        during = (episode == contact)[:, :, None]
        mean = values.sum(axis=0, where=during) / np.maximum(during.sum(axis=0), 1)
        np.subtract(values, mean, out=about, where=during)
    return about


def motion_equations(
    rigid: Float[np.ndarray, "n 3 k"], weight: Float[np.ndarray, " n"], episode: Int[np.ndarray, "t n"]
) -> Float[np.ndarray, "m m"]:
    """Normal equations of k motions a frame, m = k t, less the contacts' means: sum_i w_i R_i' W_i R_i.

    W_i = I - 1 1' / T_e over the T_e frames of each contact e of marker i. The first part couples no frames;
    the second is one product of frames by markers per contact and pair of motions, and no (n, t, t) array.
    """
    frames, modes = len(episode), rigid.shape[2]
    gram = np.einsum("n,nxk,nxl->nkl", weight, rigid, rigid)
    blocks = np.zeros((modes, modes, frames, frames))
    touching = np.asarray(episode >= 0, dtype=float)
    diagonal = np.arange(frames)
    blocks[:, :, diagonal, diagonal] = np.einsum("tn,nkl->klt", touching, gram, optimize=True)
    for contact in range(int(episode.max()) + 1):
        chosen = np.flatnonzero((episode == contact).any(axis=0))
        member = np.asarray(episode[:, chosen] == contact, dtype=float)
        share = gram[chosen] / member.sum(axis=0)[:, None, None]
        for j, k in zip(*np.triu_indices(modes), strict=True):
            block = (member * share[:, j, k]) @ member.T
            blocks[j, k] -= block
            if j != k:
                blocks[k, j] -= block
    return blocks.transpose(2, 0, 3, 1).reshape(modes * frames, modes * frames)
