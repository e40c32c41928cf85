"""Evidence by products of columns: what the dense Gaussian marginal of all data says, amounts written out."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from injected_mismatch import injected_case, only_grasp
from jaxtyping import Float
from plain_model import case_model
from scipy.stats import multivariate_normal

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import GAUGE_SD_MM, rigid_motion
from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.effect import Response
from fem.mismatch.effects.sensor_gain import EFFECT as GAIN
from fem.mismatch.effects.skin import EFFECT as SKIN
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import PLAIN_SD, GramMatrix
from fem.mismatch.evidence.nuisances import common_nuisances, own_nuisances
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import (
    ALL,
    ForceNoise,
    NoiseOfChange,
    OfFlesh,
    OfInnerChange,
    OfResponse,
    OfSomeForces,
    drawn_force_noise,
    noise_of_change,
    noise_products,
)
from fem.mismatch.model.marker_equations import (
    DESIGN_EFFECT,
    LEAST_NOISE_SHARE,
    MARKER_VARIANCE_INFLATION,
    BalanceEquations,
    MarkerEquations,
)
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import ARM_MM, GraspResponse, plain_model
from fem.mismatch.selection.cross_validation import noise_left_mm2, predictive, predictive_gain

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


def test_a_measured_amount_is_the_prior_mean_where_its_column_is_chosen(small):
    recorded, columns, _ = small
    known = [columns[0], replace(columns[1], measured=0.8), columns[2]]
    products = GramMatrix(SimpleNamespace(compliance=0.4, workers=1), recorded, known)
    y, noise, rows, sds = dense_parts(small, (1, 2))
    covariance, mean = noise + (rows.T * sds**2) @ rows, 0.8 * rows[2]
    constant = multivariate_normal(cov=noise).logpdf(0 * y)
    fit = products.fit((1, 2))
    truth = multivariate_normal(mean=mean, cov=covariance).logpdf(y)
    assert fit.log_evidence + constant == pytest.approx(truth, abs=1e-8)
    expected = [0.0, 0.0, 0.8] + sds**2 * (rows @ np.linalg.solve(covariance, y - mean))
    np.testing.assert_allclose(fit.amounts, expected, rtol=1e-9)
    assert products.fit((1,)).log_evidence == pytest.approx(small[2].fit((1,)).log_evidence, abs=1e-10)


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


COMPLIANCE, SCALE_SD = 4.0, 0.004


@cache
def recording() -> GraspResponse:
    """One recording, noise and all."""
    return plain_model(only_grasp(injected_case(), 0)).grasps[0]


@cache
def dense() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which samples touch (flat), their weights, all unknowns' columns (flat rows), their priors' weights.

    Unknown: each contact's place along x, y, z; each marker's gel scale and its shift with the load; each
    frame's rigid motion and its noise in each force pattern.
    """
    grasp = recording()
    tracks = grasp.tracks
    episode = tracks.episode
    frames, count = episode.shape
    columns, prior = [], []

    def add(column: np.ndarray, weight: float) -> None:
        columns.append(column[episode >= 0].ravel())
        prior.append(weight)

    def blank() -> np.ndarray:
        return np.zeros((frames, count, 3))

    for marker in range(count):
        for contact in np.unique(episode[:, marker][episode[:, marker] >= 0]):
            for way in range(3):
                column = blank()
                column[episode[:, marker] == contact, marker, way] = 1
                add(column, 0.0)
        column = blank()
        column[:, marker] = tracks.gel_displacement_mm[:, marker]
        add(column, SCALE_SD**-2)
        for way in range(3):
            column = blank()
            column[:, marker, way] = grasp.load
            add(column, (COMPLIANCE * grasp.uneven[marker, way]) ** -2.0)
    rigid = rigid_motion(tracks.place_mm)
    felt = COMPLIANCE * grasp.force_sd_N * grasp.response
    for frame in range(frames):
        for mode in range(6):
            column = blank()
            column[frame] = rigid[:, :, mode]
            add(column, GAUGE_SD_MM**-2)
        for pattern in felt:
            column = blank()
            column[frame] = pattern
            add(column, 1.0)
    weight = np.broadcast_to(
        tracks.sd_mm[None, :, None] ** -2.0 / (MARKER_VARIANCE_INFLATION * DESIGN_EFFECT), (frames, count, 3)
    )
    return episode >= 0, weight[episode >= 0].ravel(), np.array(columns), np.array(prior)


@cache
def equations() -> MarkerEquations:
    """The product's own."""
    return MarkerEquations.of(recording(), compliance=COMPLIANCE, gel_scale_sd=SCALE_SD)


def left_by_least_squares(field: np.ndarray) -> np.ndarray:
    """What ridge regression on all unknowns leaves, samples in contact, flat."""
    touching, weight, columns, prior = dense()
    y = field[touching].ravel()
    normal = (columns * weight) @ columns.T + np.diag(prior)
    amounts = np.linalg.lstsq(normal, (columns * weight) @ y, rcond=1e-13)[0]
    return y - amounts @ columns


@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_left_is_what_least_squares_on_every_unknown_leaves(seed):
    rng = np.random.default_rng(seed)
    grasp = recording()
    field = rng.normal(size=grasp.tracks.position_mm.shape) + grasp.tracks.unit_displacement
    touching, weight, _, _ = dense()
    expected = left_by_least_squares(field)
    np.testing.assert_allclose(equations().residual(field)[touching].ravel(), expected, atol=2e-6)
    np.testing.assert_allclose(
        equations().weighed(field)[touching].ravel(), weight * expected, atol=2e-6 * weight.max()
    )


def test_noise_leaves_what_the_dense_projection_of_its_covariance_leaves():
    tracks = recording().tracks
    touching, weight, columns, prior = dense()
    normal = (columns * weight) @ columns.T + np.diag(prior)
    left = np.eye(len(weight)) - columns.T @ (np.linalg.pinv(normal, rcond=1e-13) @ (columns * weight))
    frame, marker, way = np.nonzero(touching[:, :, None] & np.ones(3, dtype=bool))
    same = (marker[:, None] == marker) & (way[:, None] == way)
    covariance = same * tracks.lag1.mean() ** np.abs(frame[:, None] - frame) * tracks.sd_mm[marker] ** 2
    expected = np.einsum("ij,jk,ik->", left, covariance, left, optimize=True)
    assert expected < 0.97 * np.trace(covariance)
    assert noise_left_mm2(equations(), np.random.default_rng(1)) == pytest.approx(expected, rel=0.02)


def test_balance_counts_as_the_dense_marginal_of_noise_and_nuisances():
    balance = BalanceEquations.of(recording())
    flat = balance.nuisances.reshape(len(balance.nuisances), -1)
    noise = np.diag(1 / balance.weight.ravel())
    spread = np.linalg.inv(balance.inverse) - (flat * balance.weight.ravel()) @ flat.T
    covariance = noise + flat.T @ np.linalg.inv(spread) @ flat
    field = np.random.default_rng(4).normal(size=balance.measured.shape)
    expected = np.linalg.solve(covariance, field.ravel()).reshape(field.shape)
    np.testing.assert_allclose(
        balance.weighed(field), expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max()
    )


def test_noise_of_the_balance_is_that_of_all_markers_forces_together():
    grasp = recording()
    rng = np.random.default_rng(5)
    position = grasp.tracks.position_mm
    centre = position.mean(axis=(0, 1))
    drawn = []
    for _ in range(300):
        force = grasp.force_sd_N * rng.normal(size=position.shape[1:])
        drawn.append([*force.sum(axis=0), *(np.cross(position[5] - centre, force).sum(axis=0) / ARM_MM)])
    scatter = np.std(drawn, axis=0) * np.sqrt(BalanceEquations.of(grasp).weight[5])
    assert (np.abs(scatter - 1) < 0.25).all()


def test_the_weight_of_the_fruit_is_no_imbalance():
    grasp = recording()
    pull = np.tile([0.3, 0.0, -1.2, 0.0, 0.2, 0.0], (len(grasp.force_N), 1))
    without, with_weight = (
        float((pull * BalanceEquations.of(grasp, weight_N=weight).weighed(pull)).sum())
        for weight in (0.0, 1.5)
    )
    assert with_weight < 3.0 < 1e-3 * without


def test_a_sensor_without_noise_counts_as_if_it_had_a_share_of_the_response():
    grasp = recording()
    episode, response = grasp.tracks.episode, COMPLIANCE * grasp.tracks.unit_displacement
    squares = []
    for marker in range(episode.shape[1]):
        for contact in np.unique(episode[:, marker][episode[:, marker] >= 0]):
            moved = response[episode[:, marker] == contact, marker]
            squares.append(((moved - moved.mean(axis=0)) ** 2).ravel())
    share_mm = LEAST_NOISE_SHARE * np.sqrt(np.concatenate(squares).mean())
    counted = MARKER_VARIANCE_INFLATION * DESIGN_EFFECT * variance_inflation(grasp.tracks.lag1)
    for noise_mm, expected_mm in ((1e-6, share_mm), (0.5 * share_mm, share_mm), (3 * share_mm, 3 * share_mm)):
        seen = replace(grasp, tracks=replace(grasp.tracks, sd_mm=np.full(episode.shape[1], noise_mm)))
        weight = MarkerEquations.of(seen, compliance=COMPLIANCE, gel_scale_sd=SCALE_SD).weight
        np.testing.assert_allclose(weight, 1 / (counted * expected_mm**2), rtol=1e-9)


SEEDS = range(6)


@cache
def noisy() -> tuple[CaseModel, ForceNoise]:
    model, _ = case_model(only_grasp(injected_case(), 0))
    return model, drawn(model, GraspEquations.of(model, model.grasps[0]))


def drawn(model: CaseModel, equations: GraspEquations) -> ForceNoise:
    """Of the model's only recording."""
    (noise,) = drawn_force_noise(model.base, [equations.weighed_markers], compliance=model.compliance)
    return noise


def directly(fields: np.ndarray, noise: ForceNoise) -> float:
    """The product of the module's docstring with fields that were solved for."""
    return float(
        np.mean([(field * weighed).sum() for field, weighed in zip(fields, noise.weighed, strict=True)])
    )


def linear_nuisances(model: CaseModel) -> list[Regressor]:
    """Those that follow from the forces linearly, as all but large deformation do."""
    return [column for column in common_nuisances(model) if column.name != LARGE_DEFORMATION]


def test_pit_and_poissons_ratio_follow_from_forces_like_their_own_fields() -> None:
    """Of noise that is the recording's own forces: the product is that of the nuisances' fields."""
    model, noise = noisy()
    recording = noise.recording
    count = noise.moved.shape[1]
    whole = ForceNoise(
        compliance=model.compliance,
        recording=recording,
        force_N=recording.patterns[None, :count],
        moved=recording.moved[None, :count],
        response=recording.response[None, :count],
        weighed=noise.weighed[:1],
        adjoint=noise.adjoint[:1, :count],
        adjoint_response=noise.adjoint_response[:1, :count],
    )
    for column in linear_nuisances(model):
        field = column.fields[0]
        assert isinstance(field, ObservationDelta)
        assert field.markers is not None
        product = column.of_forces.product(whole)
        expected = float((field.markers * noise.weighed[0]).sum())
        scale = float(np.abs(field.markers * noise.weighed[0]).sum())
        assert product == pytest.approx(expected, abs=0.02 * scale), column.name


def test_the_plain_models_product_is_negative() -> None:
    """Noise in a regressor attenuates it."""
    assert ALL.product(noisy()[1]) < 0


@pytest.mark.proof
def test_drawn_noise_of_the_response_is_as_large_as_the_real_one() -> None:
    """As the equations weigh it: between recordings of one grasp with their noise and nearly without.

    A common scale of all forces is left out: the gel's fitted stiffness is E, and no noise of single markers;
    and what is not in the patterns' courses over time, which the equations leave out too.
    """
    quiet, _ = case_model(only_grasp(injected_case(noise=0.02), 0))
    real, ours = [], []
    for seed in SEEDS:
        model, _ = case_model(only_grasp(injected_case(seed=seed), 0))
        equations = GraspEquations.of(model, model.grasps[0])
        recording, still = model.grasps[0], quiet.grasps[0]
        assert np.array_equal(recording.used, still.used)
        unit = recording.tracks.unit_displacement
        noise = drawn(model, equations)
        shares = recording.shares[:, : noise.response.shape[1]]
        course = np.linalg.qr(shares)[0]
        off = np.tensordot(course @ course.T, unit - still.tracks.unit_displacement, axes=1)
        real.append(energy(equations, off, unit))
        ours += [
            energy(equations, np.tensordot(shares, pattern_noise, axes=1), unit)
            for pattern_noise in noise.response
        ]
    assert np.mean(ours) == pytest.approx(np.mean(real), rel=0.25)


def energy(equations: GraspEquations, field: np.ndarray, without: np.ndarray) -> float:
    """phi . W phi, the field's share of another taken out."""
    heavy = equations.weighed_markers(without)
    other = field - without * float((field * heavy).sum() / (without * heavy).sum())
    return float((other * equations.weighed_markers(other)).sum())


def test_solved_fields_of_noise_have_the_products_that_adjoint_fields_say() -> None:
    model, noise = noisy()
    columns = [
        *SKIN.signatures(model)[0].columns,
        *GAIN.signatures(model)[0].columns,
        *linear_nuisances(model),
    ]
    kinds = set()
    for column in columns:
        kinds.add(type(column.of_forces))
        fields = column.of_forces.fields(noise)
        scale = float(np.abs(fields * noise.weighed).sum())
        product = column.of_forces.product(noise)
        assert product == pytest.approx(directly(fields, noise), abs=1e-6 * scale), column.name
    assert kinds == {OfFlesh, OfSomeForces, OfInnerChange, OfResponse}


def test_noise_by_response_is_that_of_the_plain_models_own_column() -> None:
    model, noise = noisy()
    weigh = GraspEquations.of(model, model.grasps[0]).weighed_markers
    responses = ALL.fields(noise)
    products = noise_products(
        [ALL, *(column.of_forces for column in SKIN.signatures(model)[0].columns)], noise, weigh
    )
    by_response = noise.of_response(weigh)
    np.testing.assert_allclose(by_response.weighed, [weigh(draw) for draw in responses], rtol=1e-9)
    assert ALL.product(by_response) == pytest.approx(products[0, 0], rel=1e-9)
    (column,) = SKIN.signatures(model)[0].columns
    assert column.of_forces.product(by_response) == pytest.approx(products[0, 1], rel=1e-6)


@pytest.mark.parametrize("share", [0.5, 1.0, 1.3])
def test_a_model_at_another_modulus_has_the_bias_of_draws_at_that_modulus(share: float) -> None:
    """The plain model's field grows with 1/E, those of the kept columns stay."""
    model, noise = noisy()
    equations = GraspEquations.of(model, model.grasps[0])
    columns = [*SKIN.signatures(model)[0].columns, *linear_nuisances(model)]
    products = GramMatrix(model, [equations], columns, noise=[noise])
    other = replace(model, compliance=share * model.compliance)
    about, _ = products.about(other, Response.plain(model), range(1, len(columns) + 1))
    drawn_there = drawn(other, equations)
    assert about.bias[0, 0] == pytest.approx(ALL.product(drawn_there), rel=1e-6)
    for column, bias in zip(columns, about.bias[0, 1:], strict=True):
        assert bias == pytest.approx(column.of_forces.product(drawn_there) / share, rel=1e-4, abs=1e-6)


DRAWS, NUMBERS = 4000, 30


def drawn_errors() -> tuple[Float[np.ndarray, "p d"], Float[np.ndarray, "c p d"]]:
    """Noise e of the data, and of the columns 1/E and two signatures, which share a part of it; W is 1."""
    parts = np.random.default_rng(0).normal(size=(4, DRAWS, NUMBERS))
    e = parts[0] + 0.8 * parts[1]
    return e, np.stack(
        [parts[1] - 0.3 * parts[2], 0.5 * parts[1] + parts[2], 0.4 * parts[0] + 0.2 * parts[3]]
    )


def mean_product(a: Float[np.ndarray, "p d"], b: Float[np.ndarray, "p d"]) -> float:
    return float((a * b).sum(axis=1).mean())


def found_at(amounts: tuple[float, float], share: float = 1.0) -> NoiseOfChange:
    e, fields = drawn_errors()
    bias = np.array([[mean_product(field, e) for field in fields]])
    products = np.array([[[mean_product(a, b) for b in fields] for a in fields]])
    return noise_of_change(bias, products, np.array(amounts), share=share)


@pytest.mark.parametrize("share", [1.0, 0.5, 1.3])
@pytest.mark.parametrize("amounts", [(0.0, 0.0), (0.2, 0.1), (-0.4, -0.3), (-0.3, 0.2)])
def test_products_are_those_of_noise_that_the_effect_and_1_over_E_have_changed(
    amounts: tuple[float, float], share: float
) -> None:
    e, fields = drawn_errors()
    plain = share * fields[0] + amounts[0] * fields[1] + amounts[1] * fields[2]
    changed = e + fields[0] - plain
    noise = found_at(amounts, share)
    assert noise.square == pytest.approx(mean_product(e, e) - mean_product(changed, changed))
    assert noise.plain == pytest.approx(mean_product(plain, changed))
    for product, field in zip(noise.signatures[0], fields[1:], strict=True):
        assert product == pytest.approx(mean_product(field, changed))


def test_a_large_effect_leaves_no_more_noise_than_the_least_that_its_signatures_can() -> None:
    e, fields = drawn_errors()
    product, square = mean_product(fields[1], e), mean_product(fields[1], fields[1])
    for large in (1.2, 30.0):
        noise = found_at((large * product / square, 0.0))
        assert noise.square == pytest.approx(product**2 / square)
        assert noise.signatures[0, 0] == pytest.approx(0.0, abs=1e-9 * product)


COUNT, SD = 30, 0.8


def dense_density(data: list[np.ndarray], fields: list[list[np.ndarray]], sd: list[float]) -> float:
    """ln p of recordings that share the amounts of their fields."""
    stacked = np.concatenate(data)
    columns = [np.concatenate(parts) for parts in zip(*fields, strict=True)]
    covariance = np.eye(len(stacked)) + sum(s**2 * np.outer(c, c) for s, c in zip(sd, columns, strict=True))
    return float(multivariate_normal.logpdf(stacked, cov=covariance))


def test_it_is_the_density_of_each_recording_given_the_others():
    rng = np.random.default_rng(8)
    fields = [[rng.normal(size=COUNT) for _ in range(2)] for _ in range(3)]
    data = [0.6 * grasp_fields[1] + rng.normal(size=COUNT) for grasp_fields in fields]
    rows = [np.vstack([values, *grasp_fields]) for values, grasp_fields in zip(data, fields, strict=True)]
    products = GramMatrix.from_products(
        [Regressor(name="1/E", sd=PLAIN_SD, fields=()), Regressor(name="effect", sd=SD, fields=())],
        [np.arange(2)] * 3,
        [grasp_rows @ grasp_rows.T for grasp_rows in rows],
    )
    before, after = predictive(products, ()), predictive(products, (1,))

    def expected(k: int, count: int) -> float:
        others = [j for j in range(3) if j != k]
        sd = [PLAIN_SD, SD][:count]
        used = [grasp_fields[:count] for grasp_fields in fields]
        rest = dense_density([data[j] for j in others], [used[j] for j in others], sd)
        return dense_density(data, used, sd) - rest

    each = [expected(k, 2) - expected(k, 1) for k in range(3)]
    np.testing.assert_allclose(after - before, each, atol=1e-8)
    gain, error = predictive_gain(before, after)
    assert gain == pytest.approx(sum(each))
    assert error == pytest.approx(np.sqrt(3) * np.std(each, ddof=1))


def test_a_single_recording_has_none():
    assert predictive_gain(None, np.ones(2)) is None
