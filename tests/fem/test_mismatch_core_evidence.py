"""Evidence by products of columns: what the dense Gaussian marginal of all data says, amounts written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from injected_mismatch import injected_case, only_grasp
from plain_model import case_model
from scipy.stats import multivariate_normal

from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.effect import Response
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import PLAIN_SD, GramMatrix
from fem.mismatch.evidence.nuisances import common_nuisances, own_nuisances
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor

SHAPE = (3, 4, 3)
SIZE = int(np.prod(SHAPE))
SDS = (0.7, 0.2, 3.0)


class SmallRecording:
    """A recording of few samples with a weight matrix of any kind."""

    def __init__(self, rng: np.random.Generator) -> None:
        root = rng.normal(size=(SIZE, SIZE))
        self.weight = root @ root.T / SIZE + 0.3 * np.eye(SIZE)
        self.balance = None
        self.rest = ZeroDrifts(measured=np.zeros(0), weight=np.zeros(0))
        tracks = SimpleNamespace(
            unit_displacement=rng.normal(size=SHAPE),
            place_mm=np.zeros(SHAPE[1:]),
            position_mm=2.0 * rng.normal(size=SHAPE),
        )
        self.recording = SimpleNamespace(tracks=tracks)

    def rows(self, fields) -> tuple[np.ndarray, np.ndarray]:
        plain = np.array([field.markers.ravel() for field in fields])
        return plain, plain @ self.weight


@pytest.fixture(scope="module")
def small():
    rng = np.random.default_rng(0)
    recorded = [SmallRecording(rng) for _ in range(2)]
    columns = [
        Regressor(
            name=f"{k}", sd=sd, fields=[ObservationDelta(markers=rng.normal(size=SHAPE)) for _ in recorded]
        )
        for k, sd in enumerate(SDS)
    ]
    columns[2] = Regressor(name="2", sd=SDS[2], fields=[columns[2].fields[0], None])
    return recorded, columns, GramMatrix(SimpleNamespace(compliance=0.4, workers=1), recorded, columns)


def dense_parts(small, chosen):
    """y of both recordings in a row, the covariance of their noise, the columns and their spreads."""
    recorded, columns, _ = small
    y = np.concatenate(
        [
            (r.recording.tracks.position_mm - 0.4 * r.recording.tracks.unit_displacement).ravel()
            for r in recorded
        ]
    )
    noise = np.zeros((2 * SIZE, 2 * SIZE))
    for k, r in enumerate(recorded):
        noise[k * SIZE : (k + 1) * SIZE, k * SIZE : (k + 1) * SIZE] = np.linalg.inv(r.weight)
    plain = np.concatenate([0.4 * r.recording.tracks.unit_displacement.ravel() for r in recorded])
    rows = [plain] + [
        np.concatenate([np.zeros(SIZE) if f is None else f.markers.ravel() for f in columns[j - 1].fields])
        for j in chosen
    ]
    sds = np.array([PLAIN_SD, *(SDS[j - 1] for j in chosen)])
    return y, noise, np.array(rows), sds


@pytest.mark.parametrize("chosen", [(), (1,), (3, 1), (1, 2, 3)])
def test_evidence_is_the_log_density_of_the_data_with_all_amounts_integrated_out(small, chosen):
    y, noise, rows, sds = dense_parts(small, chosen)
    truth = multivariate_normal(cov=noise + (rows.T * sds**2) @ rows).logpdf(y)
    constant = multivariate_normal(cov=noise).logpdf(0 * y)
    assert small[2].fit(chosen).log_evidence + constant == pytest.approx(truth, abs=1e-8)


def test_amounts_and_their_covariance_are_those_of_the_gaussian_posterior(small):
    y, noise, rows, sds = dense_parts(small, (1, 2, 3))
    precision = rows @ np.linalg.solve(noise, rows.T) + np.diag(sds**-2.0)
    fit = small[2].fit((1, 2, 3))
    expected = np.linalg.solve(precision, rows @ np.linalg.solve(noise, y))
    np.testing.assert_allclose(fit.amounts, expected, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(precision), rtol=1e-8)
    left = y - expected @ rows
    chi2 = left @ np.linalg.solve(noise, left) + (expected / sds) @ (expected / sds)
    assert fit.chi2 == pytest.approx(chi2, rel=1e-10)


def test_a_prior_mean_moves_the_density_of_the_data_and_stays_behind_with_its_column(small):
    recorded, columns, _ = small
    meant = [columns[0], replace(columns[1], mean=0.8), columns[2]]
    y, noise, rows, sds = dense_parts(small, (1, 2))
    markers = [equations.recording.tracks.unit_displacement for equations in recorded]
    model = SimpleNamespace(compliance=0.4, workers=1, plain=markers)
    products = GramMatrix(model, recorded, meant)
    truth = multivariate_normal(mean=0.8 * rows[2], cov=noise + (rows.T * sds**2) @ rows).logpdf(y)
    constant = multivariate_normal(cov=noise).logpdf(0 * y)
    assert products.fit((1, 2)).log_evidence + constant == pytest.approx(truth, abs=1e-8)
    about, chosen = products.about(model, Response(unit=markers), (1,))
    y, noise, rows, sds = dense_parts(small, (1,))
    truth = multivariate_normal(cov=noise + (rows.T * sds**2) @ rows).logpdf(y)
    assert about.fit(chosen).log_evidence + constant == pytest.approx(truth, abs=1e-8)


def test_what_one_recording_predicts_of_the_other_is_the_difference_of_two_evidences(small):
    y, noise, rows, sds = dense_parts(small, (1, 2))
    whole = noise + (rows.T * sds**2) @ rows
    a, b = slice(0, SIZE), slice(SIZE, 2 * SIZE)
    gain = whole[b, a] @ np.linalg.inv(whole[a, a])
    mean, covariance = gain @ y[a], whole[b, b] - gain @ whole[a, b]
    truth = multivariate_normal(mean=mean, cov=covariance, allow_singular=False).logpdf(y[b])
    products = small[2]
    predicted = products.fit((1, 2)).log_evidence - products.fit((1, 2), keep=[0]).log_evidence
    constant = multivariate_normal(cov=noise[b, b]).logpdf(np.zeros(SIZE))
    assert predicted + constant == pytest.approx(truth, abs=1e-8)


@pytest.fixture(scope="module")
def injected():
    """A recording of the injected fruit, with a case's own nuisances eliminated."""
    model, _ = case_model(only_grasp(injected_case(), 0))
    return model, [GraspEquations.of(model, recording) for recording in model.grasps]


def test_a_recordings_own_nuisances_eliminated_are_those_kept_as_columns(injected):
    model, recorded = injected
    known = common_nuisances(model)
    products = GramMatrix(model, recorded, known)
    chosen = tuple(range(1, len(known) + 1))
    fit = products.fit(chosen)
    none = (np.zeros((0, 0)),) * 3
    bare = [
        GraspEquations(equations.recording, equations.markers, equations.balance, equations.rest, *none)
        for equations in recorded
    ]
    kept = list(known)
    for k, recording in enumerate(model.grasps):
        for name, sd, field in own_nuisances(model, recording):
            fields = [field if j == k else None for j in range(len(recorded))]
            kept.append(Regressor(name=name, sd=sd, fields=fields))
    whole = GramMatrix(model, bare, kept).fit(tuple(range(1, len(kept) + 1)))
    assert fit.chi2 == pytest.approx(whole.chi2, rel=1e-9)
    size = len(chosen) + 1
    np.testing.assert_allclose(fit.amounts, whole.amounts[:size], atol=1e-7)
    np.testing.assert_allclose(fit.covariance, whole.covariance[:size, :size], rtol=1e-6, atol=1e-12)
    assert len(kept) - len(known) > 50
    # what they eliminate counts the same whatever the common columns
    without = GramMatrix(model, bare, kept).fit(tuple(range(len(known) + 1, len(kept) + 1)))
    expected = whole.log_evidence - without.log_evidence
    assert fit.log_evidence - products.fit(()).log_evidence == pytest.approx(expected, abs=1e-6)
