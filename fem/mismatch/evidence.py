"""Linear Gaussian evidence: how well a set of unknown amounts explains all recordings.

With a ~ N(0, L^-1) amounts of fields phi (Column), y the data and W of fem.mismatch.normal,

    chi2 = y.Wy - b'(N + L)^-1 b,       ln p(y) = -(chi2 + ln det(N + L) - ln det L) / 2 + const

N = phi.W phi, b = phi.W y. Every sample counts; what is not explained counts as noise. The plain model's own
amount is 1/E, with a flat prior. Recordings are independent given the amounts that they share, so that what
one of them would have predicted for another is the difference of two evidences. y counts from the plain model's
fit, so that no digits are lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.baseline import Seen
from fem.mismatch.fields import Column, Field
from fem.mismatch.ground import Ground
from fem.mismatch.normal import BalanceEquations, MarkerEquations

PLAIN_SD = 3.0
"""Prior of how far 1/E is from what the plain fit found, as a share of it: flat."""


@dataclass(frozen=True)
class Recorded:
    """One recording's equations: its two channels, or its markers alone where a base holds the fruit."""

    seen: Seen
    markers: MarkerEquations
    balance: BalanceEquations | None

    @classmethod
    def of(cls, ground: Ground, seen: Seen) -> "Recorded":
        """The recording's equations, with the case's own spreads of marker scales."""
        budget = ground.base.case.budget
        markers = MarkerEquations.of(
            seen,
            compliance=ground.compliance,
            gel_scale_sd=budget.gel_scale_sd,
        )
        balances = seen.case.support == "free" and len(seen.links) > 1
        return cls(seen, markers, BalanceEquations.of(seen) if balances else None)

    def rows(self, fields: Sequence[Field | None]) -> tuple[np.ndarray, np.ndarray]:
        """The fields and their W-images, laid out flat over markers in contact and sums of force."""
        touching = self.seen.tracks.episode >= 0
        cut = 3 * int(touching.sum())
        width = cut + (0 if self.balance is None else self.balance.measured.size)
        plain, weighed = np.zeros((len(fields), width)), np.zeros((len(fields), width))
        for row, field in enumerate(fields):
            if field is not None and field.markers is not None:
                plain[row, :cut] = field.markers[touching].ravel()
                weighed[row, :cut] = self.markers.weighed(field.markers)[touching].ravel()
            if field is not None and field.balance is not None and self.balance is not None:
                plain[row, cut:] = field.balance.ravel()
                weighed[row, cut:] = self.balance.weighed(field.balance).ravel()
        return plain, weighed


def plain_data(
    ground: Ground, recorded: Recorded, *, unit: np.ndarray | None = None, shift_mm: np.ndarray | None = None
) -> Field:
    """What a recording shows beyond s c: positions of markers, mm, and the imbalance of forces, N.

    `unit` stands for c, `shift_mm` is taken out of the positions: an effect's nonlinear model.
    """
    tracks = recorded.seen.tracks
    response = tracks.unit_displacement if unit is None else unit
    beyond = tracks.position_mm - tracks.place_mm - ground.compliance * response
    return Field(
        markers=beyond if shift_mm is None else beyond - shift_mm,
        balance=None if recorded.balance is None else recorded.balance.measured,
    )


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Amounts of the chosen columns after the fit, their covariance; chi2 and ln evidence of the data."""

    chosen: tuple[int, ...]
    chi2: float
    log_evidence: float
    amounts: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard deviations of the amounts."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class Products:
    """Products of all columns with each other and the data, recording by recording.

    Row 0 is the data, row 1 the plain model (its response s c), then the columns in the order given.
    """

    def __init__(self, ground: Ground, recorded: Sequence[Recorded], columns: Sequence[Column]) -> None:
        self.columns = [
            Column(name="1/E", sd=PLAIN_SD, fields=[_plain(ground, one) for one in recorded]),
            *columns,
        ]
        self.rows: list[np.ndarray] = []
        self.products: list[np.ndarray] = []
        self.weighed: list[np.ndarray] = []
        for k, one in enumerate(recorded):
            known = [j for j, column in enumerate(self.columns) if column.fields[k] is not None]
            plain, heavy = one.rows([plain_data(ground, one), *(self.columns[j].fields[k] for j in known)])
            self.rows.append(np.array(known, dtype=np.int64))
            self.products.append(heavy @ plain.T)
            self.weighed.append(heavy)

    def fit(self, chosen: Sequence[int], *, keep: Sequence[int] | None = None) -> Fit:
        """The fit of the chosen columns (1/E is always one of them) to the recordings to `keep` (all)."""
        names = [0, *chosen]
        place = {column: at for at, column in enumerate(names)}
        weight = np.array([self.columns[j].sd for j in names]) ** -2.0
        normal, right, total = np.diag(weight), np.zeros(len(names)), 0.0
        for k in range(len(self.rows)) if keep is None else keep:
            at = np.array([a for a, j in enumerate(self.rows[k]) if int(j) in place], dtype=np.int64)
            to = np.array([place[int(j)] for j in self.rows[k][at]], dtype=np.int64)
            own = self.products[k]
            normal[np.ix_(to, to)] += own[np.ix_(at + 1, at + 1)]
            right[to] += own[at + 1, 0]
            total += own[0, 0]
        factor = np.linalg.cholesky(normal)
        amounts = np.linalg.solve(normal, right)
        chi2 = total - right @ amounts
        log_det = 2 * np.log(np.diag(factor)).sum() - np.log(weight).sum()
        return Fit(
            chosen=tuple(names),
            chi2=float(chi2),
            log_evidence=float(-(chi2 + log_det) / 2),
            amounts=amounts,
            covariance=np.linalg.inv(normal),
        )


def _plain(ground: Ground, one: Recorded) -> Field:
    return Field(markers=ground.compliance * one.seen.tracks.unit_displacement)
