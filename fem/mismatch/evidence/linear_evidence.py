"""Linear Gaussian evidence: how well a set of unknown amounts explains all recordings.

With a ~ N(0, L^-1) amounts of fields phi (Regressor), y the data and W of
fem.mismatch.model.marker_equations,

    chi2 = y.Wy - b'(N + L)^-1 b,       ln p(y) = -(chi2 + ln det(N + L) - ln det L) / 2 + const

N = phi.W phi, b = phi.W y. DESIGN_EFFECT samples count as one; the unexplained residual counts as noise. The
plain model's own amount is 1/E, with a flat prior. Recordings are independent given their common amounts, so
the predictive density of one given others is the difference of two log evidences. y is relative to the plain
model's fit, so that no digits are lost.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.effect import Response
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.case_model import CaseModel, MemoTable
from fem.mismatch.model.force_noise import ALL, ForceNoise, noise_of_change, noise_products
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import Fields
from fem.parallel_map import parallel_map

PLAIN_SD = 3.0
"""Prior standard deviation of 1/E about the plain fit, relative: practically flat."""


def plain_data(model: CaseModel, recorded: GraspEquations) -> ObservationDelta:
    """A recording's excess over s c: positions of markers, mm, imbalance of forces, N, and zero drifts."""
    tracks = recorded.recording.tracks
    return ObservationDelta(
        markers=tracks.position_mm - tracks.place_mm - model.compliance * tracks.unit_displacement,
        balance=None if recorded.balance is None else recorded.balance.measured,
        rest=recorded.rest.measured,
    )


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fitted amounts of the chosen columns, their covariance; chi2 and log evidence of the data."""

    chosen: tuple[int, ...]
    chi2: float
    log_evidence: float
    amounts: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard deviations of the amounts."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class GramMatrix:
    """Products of all columns with each other and the data, recording by recording.

    Row 0 is the data (less prior means), row 1 the plain model (the derivative of its prediction with
    respect to ln s: s c, and columns whose prior mean grows with a power of s), then the columns in the order
    given. Column 0 is the plain model's, so that `columns[j]` is the j-th of those given, counted from one.
    Products with the data are corrected for `bias`, by recording and column: that of noise in the forces
    (fem.mismatch.model.force_noise) and `surface`, that of the scanned surface's error
    (fem.mismatch.evidence.surface_bias).
    """

    def __init__(
        self,
        model: CaseModel,
        recorded: Sequence[GraspEquations],
        columns: Sequence[Regressor],
        *,
        noise: Sequence[ForceNoise] = (),
        surface: Float[np.ndarray, "g c"] | None = None,
    ) -> None:
        self._noise, self._workers = tuple(noise), model.workers
        self._noise_products = MemoTable()
        self._compliance = model.compliance
        unit = [equations.recording.tracks.unit_displacement for equations in recorded]
        plain_fields = _along_compliance(model, unit, columns)
        self.columns = [
            Regressor(name="1/E", sd=PLAIN_SD, fields=plain_fields, of_forces=ALL),
            *columns,
        ]
        self._recorded = recorded
        self._surface = np.zeros((len(recorded), len(self.columns))) if surface is None else surface
        self.bias = self._with_same(self._biases(noise) + self._surface)
        self.rows: list[np.ndarray] = []
        self.products: list[np.ndarray] = []
        self.weighed: list[np.ndarray] = []
        self.data = [
            _less_prior_means(plain_data(model, equations), self.columns, k)
            for k, equations in enumerate(recorded)
        ]

        def rows(k: int) -> tuple[list[int], np.ndarray, np.ndarray]:
            known = [j for j, column in enumerate(self.columns) if column.fields[k] is not None]
            new = [j for j in known if self.columns[j].same_as is None]
            plain, heavy = recorded[k].rows([self.data[k], *(self.columns[j].fields[k] for j in new)])
            place = {j: at for at, j in enumerate(new, 1)}
            at = [0, *(place[j if (same := self.columns[j].same_as) is None else same] for j in known)]
            return known, (heavy @ plain.T)[np.ix_(at, at)], heavy[at]

        for known, products, heavy in parallel_map(rows, range(len(recorded)), workers=model.workers):
            self.rows.append(np.array(known, dtype=np.int64))
            self.products.append(_corrected(products, self.bias[len(self.rows) - 1, known]))
            self.weighed.append(heavy)

    @classmethod
    def from_products(
        cls,
        columns: Sequence[Regressor],
        rows: Sequence[Int[np.ndarray, " _"]],
        products: Sequence[Float[np.ndarray, "_ _"]],
    ) -> "GramMatrix":
        """A matrix from products that were computed before; it supports fits only.

        `columns` begin with 1/E. For each recording, `rows` are the columns on which it depends, `products`
        those of the data and these columns.
        """
        matrix = cls.__new__(cls)
        matrix.columns, matrix.rows, matrix.products = list(columns), list(rows), list(products)
        matrix.weighed, matrix.data, matrix._recorded = [], [], []
        matrix._noise, matrix._noise_products, matrix._workers = (), MemoTable(), 1
        matrix._compliance = float("nan")
        matrix.bias = np.zeros((len(rows), len(columns)))
        return matrix

    def _biases(self, noise: Sequence[ForceNoise]) -> Float[np.ndarray, "k c"]:
        """Products of each column with the noise of each recording; zero if it is not known."""
        known = parallel_map(
            lambda k: [_bias(column, noise[k], k) for column in self.columns],
            range(len(noise)),
            workers=self._workers,
        )
        return np.array(known) if known else np.zeros((len(self._recorded), len(self.columns)))

    def _by_response(self) -> Float[np.ndarray, "k c"]:
        """q (force_noise) of each column. The surface's bias, -s dphi . W dc, is all by the response."""

        def solved() -> np.ndarray:
            noise = parallel_map(
                lambda k: self._noise[k].of_response(self._recorded[k].weighed_markers),
                range(len(self._noise)),
                workers=self._workers,
            )
            return self._with_same(self._biases(noise) - self._surface)

        products: np.ndarray = self._noise_products.memoised("by response", solved)
        return products

    def _with_same(self, bias: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        """With the products of each column of model error, which are those of its effect's column."""
        same = [j if column.same_as is None else column.same_as for j, column in enumerate(self.columns)]
        return bias[:, same]

    def about(
        self,
        model: CaseModel,
        response: Response,
        chosen: Sequence[int],
        more: Sequence[Regressor] = (),
        *,
        signatures: Sequence[int] = (),
    ) -> tuple["GramMatrix", tuple[int, ...]]:
        """The products of the chosen columns and `more`, linearised about a nonlinear model; columns are
        renumbered.

        The result supports fits only: only the linear round's own columns can be linearised about a model.
        Its products with the noise of forces are those at the 1/E of `model`.

        `signatures`: columns that the model resembles at small amounts. The noise of forces in the model and
        in `more` is approximated by that of these columns, in their least-squares amounts
        (fem.mismatch.model.force_noise).
        """
        other = copy(self)
        other._compliance, other._noise, other._noise_products = model.compliance, (), MemoTable()
        biased = [j for j in signatures if self.bias[:, j].any()]
        moved = replace(response, shift_mm=None)  # no noise of forces reaches the shift of markers
        changes = [
            [moved.change(model, k) for k in range(len(self._recorded))],
            *(column.fields for column in more),
        ]
        like_signatures = self._amounts_of(biased, changes)
        share = model.compliance / self._compliance
        noise = noise_of_change(
            self.bias[:, [0, *biased]], self._products_of_noise(biased), like_signatures[0], share=share
        )
        bias = (self.bias + (1 - share) * self._by_response())[:, list(chosen)]
        other.bias = np.column_stack([noise.plain, bias, noise.signatures @ like_signatures[1:].T])
        old = [self.columns[j].at(share) for j in chosen]
        plain_fields = _along_compliance(model, response.unit, old)
        plain_column = Regressor(name="1/E", sd=PLAIN_SD, fields=plain_fields)
        other.columns = [plain_column, *old, *more]
        other.rows, other.products, other.weighed, other.data = [], [], [], []
        for k, equations in enumerate(self._recorded):
            data = plain_data(model, equations).plus(-1.0, response.change(model, k))
            data = _less_prior_means(data, old, k)
            other.data.append(data)
            fresh = [data, plain_fields[k], *(column.fields[k] for column in more)]
            plain, heavy = equations.rows(fresh)
            place = {int(j): at + 1 for at, j in enumerate(self.rows[k])}
            kept = [at for at, j in enumerate(chosen) if j in place]
            at = np.array([place[chosen[j]] for j in kept], dtype=np.int64)
            across = (self.weighed[k] @ plain.T)[at]
            products = np.empty((len(fresh) + len(at),) * 2)
            new = np.r_[0, 1, 2 + len(at) : len(products)]
            products[np.ix_(new, new)] = heavy @ plain.T
            products[2 : 2 + len(at), new] = across
            products[new, 2 : 2 + len(at)] = across.T
            products[2 : 2 + len(at), 2 : 2 + len(at)] = self.products[k][np.ix_(at, at)]
            own_rows = [0, *(j + 1 for j in kept), *range(len(chosen) + 1, len(chosen) + 1 + len(more))]
            products = _corrected(products, other.bias[k, own_rows])
            products[0, 0] += noise.square[k]
            other.products.append(products)
            other.rows.append(np.array(own_rows, dtype=np.int64))
        return other, tuple(range(1, len(other.columns)))

    def _products_of_noise(self, biased: Sequence[int]) -> Float[np.ndarray, "k c1 c1"]:
        """Q (force_noise) of the plain model's column and of these, for each recording; solved for once."""

        def of_recording(k: int) -> np.ndarray:
            known = [None if self.columns[j].fields[k] is None else self.columns[j] for j in biased]
            of_forces = [None if column is None else column.of_forces for column in known]
            return noise_products(of_forces, self._noise[k], self._recorded[k].weighed_markers)

        def of_signatures() -> np.ndarray:
            return np.array(parallel_map(of_recording, range(len(self._noise)), workers=self._workers))

        columns = [0, *biased]
        products = np.zeros((len(self.bias), len(columns), len(columns)))
        if biased and self._noise:
            products[:, 1:, 1:] = self._noise_products.memoised(tuple(biased), of_signatures)
        products[:, 0] = products[:, :, 0] = self._by_response()[:, columns]
        return products

    def _amounts_of(
        self, columns: Sequence[int], changes: Sequence[Sequence[ObservationDelta | None]]
    ) -> Float[np.ndarray, "c b"]:
        """Amounts of these columns in each of several fields (each by recording), by least squares."""
        normal, right = np.zeros((len(columns),) * 2), np.zeros((len(changes), len(columns)))
        if not columns:
            return right
        for k, equations in enumerate(self._recorded):
            place = {int(j): at + 1 for at, j in enumerate(self.rows[k])}
            to = [b for b, j in enumerate(columns) if j in place]
            at = [place[columns[b]] for b in to]
            normal[np.ix_(to, to)] += self.products[k][np.ix_(at, at)]
            fields = np.stack([equations.flat(change[k]) for change in changes])
            right[:, to] += fields @ self.weighed[k][at].T
        return np.asarray(np.linalg.lstsq(normal, right.T)[0].T)

    def marker_residual(self, k: int, fit: Fit) -> Float[np.ndarray, "f n 3"]:
        """Residual of a fit at recording k's markers, mm; places, scales and motions are fitted out."""
        remaining = self.data[k].markers
        assert remaining is not None, "data show markers"
        for amount, column in zip(fit.amounts, fit.chosen, strict=True):
            field = self.columns[column].fields[k]
            if field is not None and field.markers is not None:
                remaining = remaining - amount * field.markers
        return self._recorded[k].markers.residual(remaining)

    def fit(self, chosen: Sequence[int], *, keep: Sequence[int] | None = None) -> Fit:
        """The fit of the chosen columns and 1/E to the recordings to `keep` (default: all)."""
        names = [0, *chosen]
        kept = range(len(self.rows)) if keep is None else keep
        weight = np.array([self.columns[j].sd for j in names]) ** -2.0
        normal, right = self._normal_equations(names, kept)
        measured = np.array([self.columns[j].measured for j in names])
        total = sum(float(self.products[k][0, 0]) for k in kept)
        total += measured @ (normal @ measured - 2 * right)
        right -= normal @ measured
        normal += np.diag(weight)
        factor = np.linalg.cholesky(normal)
        beyond = np.linalg.solve(normal, right)
        chi2 = total - right @ beyond
        log_det = 2 * np.log(np.diag(factor)).sum() - np.log(weight).sum()
        return Fit(
            chosen=tuple(names),
            chi2=float(chi2),
            log_evidence=float(-(chi2 + log_det) / 2),
            amounts=measured + beyond,
            covariance=np.linalg.inv(normal),
        )

    def marginal(
        self, nuisances: Sequence[int], columns: Sequence[int]
    ) -> tuple[Float[np.ndarray, "c c"], Float[np.ndarray, " c"]]:
        """N and b of the columns after 1/E and the nuisances are integrated out (Schur complement).

        Without these columns' effects b is Gaussian with mean zero and covariance N.
        """
        names = [0, *nuisances, *columns]
        normal, right = self._normal_equations(names, range(len(self.rows)))
        cut = 1 + len(nuisances)
        prior = np.diag([self.columns[j].sd ** -2.0 for j in names[:cut]])
        solved = np.linalg.solve(normal[:cut, :cut] + prior, np.c_[normal[:cut, cut:], right[:cut]])
        left = normal[cut:, cut:] - normal[cut:, :cut] @ solved[:, :-1]
        return (left + left.T) / 2, right[cut:] - normal[cut:, :cut] @ solved[:, -1]

    def _normal_equations(
        self, names: Sequence[int], keep: Sequence[int]
    ) -> tuple[Float[np.ndarray, "c c"], Float[np.ndarray, " c"]]:
        """N and b of the columns over the recordings to `keep`, without priors."""
        place = {column: at for at, column in enumerate(names)}
        normal, right = np.zeros((len(names),) * 2), np.zeros(len(names))
        for k in keep:
            at = np.array([a for a, j in enumerate(self.rows[k]) if int(j) in place], dtype=np.int64)
            to = np.array([place[int(j)] for j in self.rows[k][at]], dtype=np.int64)
            normal[np.ix_(to, to)] += self.products[k][np.ix_(at + 1, at + 1)]
            right[to] += self.products[k][at + 1, 0]
        return normal, right


def _less_prior_means(data: ObservationDelta, columns: Sequence[Regressor], k: int) -> ObservationDelta:
    """Recording k's data less the columns' prior means."""
    for column in columns:
        if column.mean:
            data = data.plus(-column.mean, column.fields[k])
    return data


def _bias(column: Regressor, noise: ForceNoise, k: int) -> float:
    if column.of_forces is None or column.fields[k] is None:
        return 0.0
    return column.of_forces.product(noise)


def _corrected(products: Float[np.ndarray, "k k"], bias: Float[np.ndarray, " c"]) -> Float[np.ndarray, "k k"]:
    """Products of data and columns, less the bias of those of the data with each column."""
    corrected = products.copy()
    corrected[0, 1:] -= bias
    corrected[1:, 0] -= bias
    return corrected


def _along_compliance(model: CaseModel, unit: Fields, columns: Sequence[Regressor]) -> list[ObservationDelta]:
    """Derivative of each recording's prediction with respect to ln s: s c, and the columns' prior means by
    their powers. A change of c with s is left to the search of a refit, which follows s.
    """
    fields = [ObservationDelta(markers=model.compliance * response) for response in unit]
    for column in columns:
        if column.power:
            amount = column.power * column.mean
            fields = [field.plus(amount, more) for field, more in zip(fields, column.fields, strict=True)]
    return fields
