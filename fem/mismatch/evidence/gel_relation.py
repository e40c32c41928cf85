"""Relation of force and displacement of the gels at each marker, which needs no model of the fruit.

A gel without a fault is linear. For each marker, along the pad's normal,

    f_i(t) + K d_i(t) = e_i K d_i(t) + l (f_i - mean of f over neighbours) + noise

K: normal stiffness of the pad's gel under one marker; e_i: the marker's scale error; l: coefficient of a
layer of gel, which is no bed of separate springs, where the pressure has curvature (a patch's rim). A fault
of the sensor (a GelLaw with parameters theta) maps true force and displacement (f, d) to recorded ones; its
inverse makes the relation linear again. theta minimises

    chi2(theta) = sum of r^2 / (s_f^2 + K^2 s_d^2),      r = f_true(theta) + K d_true(theta),

with K, e_i and l fitted too. Force and displacement are both noisy, so a regression of one on the other is
attenuated. Columns are therefore evaluated at their mean by inverse variance, (f / s_f^2 - d / (K s_d^2)) /
(1 / s_f^2 + 1 / (K s_d)^2). Its noise is independent of that of r (Fuller 1987, Measurement Error Models,
section 1.2). True values are nuisances at their best fit (Fuller's functional model), so chi2 needs no
determinant of its variance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.zero_drift import zero_drift
from fem.mismatch.mismatch_case import GraspCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse

FIRM = 0.25
"""A marker counts if its force reaches this share of the pad's largest. Markers at the rim, where a layer is
not a bed of springs, are left out (RIM in fem.estimation.prepared_grasp)."""
FEWEST_MARKERS = 8
"""Fewest such markers of a pad: fewer do not determine what all have in common. Set by hand."""
NEIGHBOURS = 4
"""Neighbours of a marker on a square grid, over which the layer's term averages."""
LAYER_SD = 0.3
"""Prior standard deviation of l, as a share of the pressure's curvature term. Set by hand, wide."""
ROUNDS, STEP, STILL = 20, 1e-3, 1e-3
"""Most Gauss-Newton rounds; the columns' difference step, and the step that ends the rounds, over the
parameters' prior standard deviations."""
COURSES = 4
"""Leading time courses of a contact's forces that are kept (LEAST_PATTERNS in
fem.estimation.prepared_grasp)."""
AROUND = 25
"""Markers to which a quadratic surface is fitted: two on each side of the middle in a square grid. The fit
reduces a single marker's scale error to a third."""
FELT, MOST_SLOPE = 3.0, 5.0
"""Standard deviations of force above which its noise is scaled by the law's slope; greatest factor."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Shares of a round's step, tried in turn until one fits better. Set by hand."""
DESIGN_EFFECT = 15.0
"""Design effect, as for the markers' motion (fem.mismatch.model.marker_equations): residuals of the linear
law correlate between neighbouring markers and frames."""


@dataclass(frozen=True, kw_only=True)
class GelRecord:
    """One pad of one recording, all frames and markers of its history, pad axes (z into the fruit).

    `firm`: markers that reach FIRM of the largest force; `ever`: those that touch at some time. `turn`: the
    pad's axes as columns, frame by frame. `largest_N`: largest force on one marker of any pad of the
    recording, without its noise. `air`: frames in which nothing touches. `markers`: number of the whole pad.
    `zero_drift_N`: each marker's force along z without contact, where the drift is certain; else zero.
    """

    grasp: str
    pad: str
    time_s: Float[np.ndarray, " t"]
    rest_mm: Float[np.ndarray, "n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    turn: Float[np.ndarray, "t 3 3"]
    ever: Bool[np.ndarray, " n"]
    firm: Bool[np.ndarray, " n"]
    air: Bool[np.ndarray, " t"]
    force_sd_N: float
    displacement_sd_mm: float
    lag1: float
    largest_N: float
    markers: int
    zero_drift_N: Float[np.ndarray, " t"]

    @property
    def total_N(self) -> Float[np.ndarray, " t"]:
        """Normal force of the pad's markers."""
        return np.asarray(self.force_N[:, :, 2].sum(axis=1))

    def without_zero_drift(self) -> "GelRecord":
        """The record less zero drift, which bends the curve of force and displacement as a fault does."""
        grown = self.zero_drift_N[:, None, None] * np.array([0.0, 0.0, 1.0])
        return replace(self, force_N=self.force_N - grown, zero_drift_N=np.zeros_like(self.zero_drift_N))


class GelLaw(Protocol):
    """A sensor's fault: the map from true force and displacement of a pad to recorded ones, and back."""

    def recorded(self, true: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """With the fault."""
        ...

    def undone(self, recorded: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """Without it."""
        ...


@dataclass(frozen=True, kw_only=True)
class RelationFit:
    """`values` and `sd` of the parameters; `evidence`: log Bayes factor of the law by Laplace's approximation
    (chi-square over DESIGN_EFFECT); `left`: chi-square per number after the law is inverted.
    """

    values: dict[str, float]
    sd: dict[str, float]
    evidence: float
    left: float


def gel_records(model: CaseModel) -> tuple[GelRecord, ...]:
    """Records of every pad of every recording, memoised for the case."""
    return model.memoised("gel records", lambda: tuple(chain(*map(_records, model.grasps))))


def _records(recording: GraspResponse) -> list[GelRecord]:
    records = [_record(recording.case, k, pad.force_N) for k, pad in enumerate(recording.case.history.pads)]
    largest = max(_largest_N(record) for record in records)
    return [replace(record, largest_N=largest) for record in records]


def _record(case: GraspCase, pad: int, force_N: Float[np.ndarray, "t n 3"]) -> GelRecord:
    """Record of one pad with these forces (fruit frame)."""
    history, motion = case.history.pads[pad], case.pads[pad]
    turn = motion.pose[:, :3, :3]
    largest = np.einsum("tj,tnj->tn", turn[:, :, 2], history.force_N).max(axis=0)
    time_s = case.history.time_s
    drift_N = np.zeros(len(time_s))
    drift = zero_drift(case.history, pad, turn[0, :, 2])
    if drift is not None and drift.sure:
        drift_N = drift.grown_N(time_s) / len(history.rest_mm)
    return GelRecord(
        grasp=case.name,
        pad=history.name,
        time_s=time_s,
        rest_mm=history.rest_mm,
        force_N=np.einsum("tji,tnj->tni", turn, force_N),
        displacement_mm=np.einsum("tji,tnj->tni", turn, history.gel_displacement_mm),
        turn=turn,
        ever=np.asarray((history.episode >= 0).any(axis=0)),
        firm=np.asarray(largest > max(FIRM * float(largest.max()), 6 * history.force_sd_N)),
        air=np.array([phase == "air" for phase in case.history.phase]),
        force_sd_N=history.force_sd_N,
        displacement_sd_mm=history.displacement_sd_mm,
        lag1=history.lag1,
        largest_N=float(largest.max()),
        markers=motion.markers,
        zero_drift_N=drift_N,
    )


def _largest_N(record: GelRecord) -> float:
    """The largest force on one firm marker, each smoothed by a quadratic surface over its neighbours.

    Without smoothing, the largest of some hundred markers has a large scale error.
    """
    if record.firm.sum() < FEWEST_MARKERS:
        return float(np.linalg.norm(record.force_N, axis=2).max())
    size = np.linalg.norm(_leading(record.force_N[:, record.firm]), axis=2)
    flat = record.rest_mm[record.firm, :2]
    near = cKDTree(flat).query(flat, k=min(AROUND, len(flat)))[1]
    x, y = np.moveaxis(flat[near] - flat[:, None], 2, 0)
    surface = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    at_place = np.linalg.pinv(surface)[:, 0]
    return float(np.einsum("nk,tnk->tn", at_place, size[:, near]).max())


def _leading(force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n 3"]:
    """Its projection on COURSES leading time courses; most noise is in the others."""
    left, size, right = np.linalg.svd(force_N.reshape(len(force_N), -1), full_matrices=False)
    return np.asarray(((left * size)[:, :COURSES] @ right[:COURSES]).reshape(force_N.shape))


def fit_law(
    records: Sequence[GelRecord],
    law: GelLaw,
    *,
    start: Mapping[str, float],
    prior_sd: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    scale_sd: float,
) -> RelationFit | None:
    """The parameters that make the relation linear; None where no pad has enough firm markers.

    `prior_sd`: of each parameter about no fault; `scale_sd`: relative scale error of single markers.
    """
    chosen = [record for record in records if record.firm.sum() >= FEWEST_MARKERS]
    if not chosen:
        return None
    names = list(start)
    spread = np.array([prior_sd[name] for name in names])
    low, high = (np.array([bounds[name][end] for name in names]) for end in (0, 1))
    at = np.array([start[name] for name in names])
    now = _about(chosen, law, names, at, spread, scale_sd)
    damping = np.diag(spread**-2.0)
    for _ in range(ROUNDS):
        step = np.linalg.solve(now.normal + damping, now.right)
        for share in SHARES:
            ahead = np.clip(at + share * step, low, high)
            tried = _about(chosen, law, names, ahead, spread, scale_sd)
            if tried.chi2 < now.chi2:
                break
        else:
            break
        moved = float((np.abs(ahead - at) / spread).max())
        at, now = ahead, tried
        if moved < STILL:
            break
    plain = _about(chosen, None, names, at, spread, scale_sd)
    covariance = np.linalg.inv(now.normal / DESIGN_EFFECT + np.diag(spread**-2.0))
    sd = np.sqrt(np.diag(covariance))
    width = (np.linalg.slogdet(covariance)[1] - 2 * np.log(spread).sum()) / 2
    return RelationFit(
        values=dict(zip(names, at.tolist(), strict=True)),
        sd=dict(zip(names, sd.tolist(), strict=True)),
        evidence=float((plain.chi2 - now.chi2) / 2 / DESIGN_EFFECT - ((at / spread) ** 2).sum() / 2 + width),
        left=now.chi2 / now.count,
    )


@dataclass(frozen=True, kw_only=True)
class _Normal:
    """chi-square with stiffness, scales and layer fitted, and the normal equations of the parameters."""

    chi2: float
    count: int
    normal: Float[np.ndarray, "k k"]
    right: Float[np.ndarray, " k"]


def _about(
    records: Sequence[GelRecord],
    law: GelLaw | None,
    names: Sequence[str],
    at: Float[np.ndarray, " k"],
    spread: Float[np.ndarray, " k"],
    scale_sd: float,
) -> _Normal:
    """Normal equations of all records, linearised at `at`; without a law, chi-square as recorded."""
    normal, right, chi2, count = np.zeros((len(at), len(at))), np.zeros(len(at)), 0.0, 0
    for record in records:
        values = dict(zip(names, at.tolist(), strict=True))
        true = record if law is None else law.undone(record, values)
        noise = _noise(record, true, law, values)
        stiffness = stiffness_of(true, noise)
        mean = _mean_of_both(true, stiffness, noise)
        residual = _excess(true, stiffness)
        columns = []
        if law is not None:
            here = _excess(law.recorded(mean, values), stiffness)
            for name, step in zip(names, STEP * spread, strict=True):
                ahead = law.recorded(mean, {**values, name: values[name] + float(step)})
                columns.append((_excess(ahead, stiffness) - here) / step)
        firm = record.firm
        variance = noise.force_N**2 + (stiffness * noise.displacement_mm) ** 2
        white = float(variance_inflation(np.array([record.lag1]))[0])
        root = np.broadcast_to(1 / np.sqrt(variance * white), residual.shape)[:, firm]
        pressed = root * mean.force_N[:, firm, 2]
        fields = [residual, *columns, mean.force_N[..., 2], _bend(mean)]
        rows = np.stack([root * field[:, firm] for field in fields])
        # eliminates each marker's scale in closed form
        power = (pressed**2).sum(axis=0) + scale_sd**-2
        across = np.einsum("ktn,tn->kn", rows, pressed)
        products = np.einsum("ktn,ltn->kl", rows, rows) - (across / power) @ across.T
        nuisance = products[-2:, -2:] + np.diag([0.0, LAYER_SD**-2.0])
        taken = np.linalg.solve(nuisance, products[-2:, :-2])
        products = products[:-2, :-2] - products[:-2, -2:] @ taken
        chi2 += float(products[0, 0])
        right += products[1:, 0] if law is not None else 0.0
        normal += products[1:, 1:] if law is not None else 0.0
        count += int(residual[:, firm].size)
    return _Normal(chi2=chi2, count=count, normal=normal, right=right)


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """Standard deviations of normal force and displacement after a law is inverted."""

    force_N: Float[np.ndarray, "t n"]
    displacement_mm: Float[np.ndarray, "t 1"]


def _noise(recorded: GelRecord, true: GelRecord, law: GelLaw | None, values: Mapping[str, float]) -> _Noise:
    """Noise after the law is inverted: in force, scaled by the inverse's slope at each marker; in
    displacement, by its impulse response in each frame (noise of first order in time).
    """
    force = np.full(recorded.force_N.shape[:2], recorded.force_sd_N)
    moved = np.full((len(recorded.time_s), 1), recorded.displacement_sd_mm)
    if law is None:
        return _Noise(force_N=force, displacement_mm=moved)
    more = law.undone(replace(recorded, force_N=recorded.force_N * (1 + STEP)), values)
    felt = recorded.force_N[..., 2]
    pressed = felt > FELT * recorded.force_sd_N
    slope = (more.force_N[..., 2] - true.force_N[..., 2]) / np.where(pressed, STEP * felt, 1.0)
    force = force * np.where(pressed, np.clip(slope, 1 / MOST_SLOPE, MOST_SLOPE), 1.0)
    frames = np.arange(len(recorded.time_s))
    answer = law.undone(_impulses(recorded), values).displacement_mm[..., 2]
    coloured = recorded.lag1 ** np.abs(frames[:, None] - frames)
    grown = np.einsum("tj,jk,tk->t", answer, coloured, answer, optimize=True)
    return _Noise(force_N=force, displacement_mm=moved * np.sqrt(grown)[:, None])


def _impulses(record: GelRecord) -> GelRecord:
    """A record with one marker for each frame, displaced by 1 mm in that frame."""
    count = len(record.time_s)
    impulses = np.eye(count)[..., None] * np.array([0.0, 0.0, 1.0])
    every = np.ones(count, dtype=bool)
    return replace(
        record,
        rest_mm=np.zeros((count, 3)),
        displacement_mm=impulses,
        force_N=np.zeros_like(impulses),
        ever=every,
        firm=every,
    )


def stiffness_of(record: GelRecord, noise: _Noise) -> float:
    """Normal stiffness of the gel under one firm marker, N/mm: orthogonal regression, noise in both."""
    force, moved = (part[:, record.firm, 2] for part in (record.force_N, record.displacement_mm))
    ratio = float((noise.force_N**2).mean() / (noise.displacement_mm**2).mean())
    ff, dd, fd = (float((a * b).sum()) for a, b in ((force, force), (moved, moved), (-force, moved)))
    half = (ff - ratio * dd) / 2
    return float((half + np.sqrt(half**2 + ratio * fd**2)) / fd)


def _excess(record: GelRecord, stiffness: float) -> Float[np.ndarray, "t n"]:
    """f + K d along the normal."""
    return np.asarray(record.force_N[..., 2] + stiffness * record.displacement_mm[..., 2])


def _mean_of_both(record: GelRecord, stiffness: float, noise: _Noise) -> GelRecord:
    """Normal force and displacement of a linear gel, from both measurements by inverse variance; shear as
    recorded.
    """
    by_force = 1 / noise.force_N**2
    by_gel = 1 / (stiffness * noise.displacement_mm) ** 2
    normal = (by_force * record.force_N[..., 2] - by_gel * stiffness * record.displacement_mm[..., 2]) / (
        by_force + by_gel
    )
    force, moved = record.force_N.copy(), record.displacement_mm.copy()
    force[..., 2], moved[..., 2] = normal, -normal / stiffness
    return replace(record, force_N=force, displacement_mm=moved)


def _bend(record: GelRecord) -> Float[np.ndarray, "t n"]:
    """Normal force less its mean over the nearest markers, N."""
    count = min(NEIGHBOURS + 1, len(record.rest_mm))
    flat = record.rest_mm[:, :2]
    near = np.asarray(cKDTree(flat).query(flat, k=count)[1])[:, 1:]
    normal = record.force_N[..., 2]
    return np.asarray(normal - normal[:, near].mean(axis=2))
