"""The errors of the model, of a scanned surface and of markers on moved skin: so much is no finding."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from injected_mismatch import finders_mesh, injected_case, only_grasp
from plain_model import case_model

from fem.estimation.sensitivity import mean_normal
from fem.estimation.zero_drift import ZeroDrifts
from fem.mesh.boundary_fit import t10_jacobians
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect import Signature
from fem.mismatch.effects.skin import EFFECT as SKIN
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import GramMatrix, plain_data
from fem.mismatch.evidence.model_error import model_error_columns, model_error_shares
from fem.mismatch.evidence.surface_bias import surface_bias, with_drawn_surface
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import PlainModel, plain_model
from fem.mismatch.model.touched_skin import with_touched_skin
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.shape_derivative import WAVE_MM, with_surface_error

SHAPE = (4, 12, 3)
NOISE_MM = 0.01
COMPLIANCE = 2.0


class Recording:
    """Markers with equal and independent noise on one pad."""

    def __init__(self, position_mm: np.ndarray, unit: np.ndarray) -> None:
        self.balance = None
        self.rest = ZeroDrifts(measured=np.zeros(0), weight=np.zeros(0))
        tracks = SimpleNamespace(
            unit_displacement=unit,
            place_mm=np.random.default_rng(8).normal(size=SHAPE[1:]),
            position_mm=position_mm,
            episode=np.zeros(SHAPE[:2], dtype=int),
        )
        self.recording = SimpleNamespace(
            tracks=tracks,
            load=np.linspace(0.2, 1.0, SHAPE[0]),
            pad_of_marker=np.zeros(SHAPE[1], dtype=int),
            links=(None,),
            pose=np.broadcast_to(np.eye(4), (1, SHAPE[0], 4, 4)),
        )

    def rows(self, fields) -> tuple[np.ndarray, np.ndarray]:
        plain = np.array([field.markers.ravel() for field in fields])
        return plain, plain / NOISE_MM**2


def products(
    amount: float, *, share: float, ratio: float = 1.0, ways: int = 1, surface_sd: float = 0.0
) -> GramMatrix:
    """Of data with so much of an effect, model error first among the nuisances; the effect's column last."""
    rng = np.random.default_rng(3)
    unit, field = rng.normal(size=SHAPE), rng.normal(size=SHAPE)
    column = Regressor(name="own", sd=4.0, fields=[ObservationDelta(markers=field)])
    signature = Signature(variant=ONE_WAY, columns=(column,))
    effect = SimpleNamespace(spec=SPECS["skin"])
    errors = model_error_columns(
        [(effect, signature, (1,))] * ways,
        compliance_ratio=ratio,
        surface_sd={1: surface_sd},
        shares={"skin": share},
    )
    place = np.random.default_rng(8).normal(size=SHAPE[1:])
    position = place + COMPLIANCE * unit + amount * field + NOISE_MM * rng.normal(size=SHAPE)
    model = SimpleNamespace(compliance=COMPLIANCE, compliance_ratio=ratio, workers=1)
    return GramMatrix(model, [Recording(position, unit)], [column, *errors])


def gain(matrix: GramMatrix) -> float:
    errors = tuple(range(2, len(matrix.columns)))
    return matrix.fit((*errors, 1)).log_evidence - matrix.fit(errors).log_evidence


def test_so_much_as_the_model_is_off_by_is_no_finding_and_ten_times_that_is():
    sd = 0.02 * 4.0
    assert gain(products(sd, share=0.02)) < 0
    assert gain(products(10 * sd, share=0.02)) > 30
    assert gain(products(sd, share=1e-9)) > 5


def test_the_error_of_the_surface_adds_to_that_of_other_fruit():
    sd = 0.02 * 4.0
    assert gain(products(sd, share=0.0, surface_sd=sd)) == pytest.approx(gain(products(sd, share=0.02)))
    assert gain(products(3 * sd, share=0.02, surface_sd=2 * sd)) < gain(products(3 * sd, share=0.02)) - 1


def test_the_softer_the_flesh_the_more_is_error():
    amount = 3 * 0.02 * 4.0
    assert gain(products(amount, share=0.02, ratio=3.0)) < 0.1 < gain(products(amount, share=0.02))


def test_alternatives_of_one_effect_share_its_error():
    single, several = (products(0.2, share=0.02, ways=ways) for ways in (1, 4))
    variances = [sum(column.sd**2 for column in matrix.columns[2:]) for matrix in (single, several)]
    assert variances[0] == pytest.approx(variances[1])
    assert gain(several) == pytest.approx(gain(single), abs=1e-6)


def test_a_column_of_the_error_has_the_products_of_its_signature():
    matrix = products(0.2, share=0.02)
    at = {int(j): row + 1 for row, j in enumerate(matrix.rows[0])}
    np.testing.assert_array_equal(matrix.products[0][at[2]], matrix.products[0][at[1]])
    np.testing.assert_array_equal(matrix.weighed[0][at[2]], matrix.weighed[0][at[1]])


def test_the_shipped_shares_are_of_known_effects():
    assert model_error_shares().keys() <= SPECS.keys()
    assert all(0 < share < 0.5 for share in model_error_shares().values())


ERROR_MM = 0.2
SEEDS = (11, 12, 13)


@cache
def forward_with(error_mm: float, seed: int) -> CaseModel:
    """The finder's model of a fruit without a skin, almost without noise; its mesh has a drawn error."""
    case = injected_case(noise=0.02)
    if error_mm:
        pads = [
            (pad.surface_mm, -mean_normal(pad.force_N[8]))
            for grasp in case.grasps
            for pad in grasp.history.pads
        ]
        rng = np.random.default_rng(seed)
        case = replace(case, mesh=with_surface_error(case.mesh, pads, sd_mm=error_mm, rng=rng))
    case = replace(case, budget=replace(case.budget, surface_sd_mm=ERROR_MM))
    return case_model(case)[0]


def equations_of(model: CaseModel) -> list[GraspEquations]:
    return [GraspEquations.of(model, recording) for recording in model.grasps]


def product_of_skin(model: CaseModel) -> float:
    """phi . W y of a skin, the sum over recordings."""
    (column,) = SKIN.signatures(model)[0].columns
    total = 0.0
    for equations, field in zip(equations_of(model), column.fields, strict=True):
        plain, weighed = equations.rows([plain_data(model, equations), field])
        total += float(weighed[1] @ plain[0])
    return total


def expected_product(model: CaseModel) -> float:
    signature = SKIN.signatures(model)[0]
    bias = surface_bias(model, equations_of(model), [(SKIN, signature, (1,))], columns=2)
    return float(bias.products.sum())


def test_the_expected_product_is_the_mean_over_surface_errors_and_their_opposites() -> None:
    """Of errors that other seeds draw; pairs of opposite errors leave no first order."""
    exact = product_of_skin(forward_with(0.0, 0))
    pairs = [
        np.mean([product_of_skin(forward_with(sign * ERROR_MM, seed)) for sign in (1, -1)]) for seed in SEEDS
    ]
    expected = np.mean([expected_product(forward_with(ERROR_MM, seed)) for seed in SEEDS])
    assert expected > 0
    assert np.mean(pairs) - exact == pytest.approx(expected, rel=0.5)


def test_skins_that_errors_of_the_surface_feign_are_within_the_stated_spread() -> None:
    """Of data that the exact surface's response makes, on surfaces that other seeds draw; n is subtracted."""
    exact = forward_with(0.0, 0)
    off = []
    for seed in SEEDS:
        pairs = []
        for sign in (1, -1):
            model = forward_with(sign * ERROR_MM, seed)
            recorded, signature = equations_of(model), SKIN.signatures(model)[0]
            bias = surface_bias(model, recorded, [(SKIN, signature, (1,))], columns=2)
            normal, right = np.zeros((2, 2)), -bias.products.sum(axis=0)
            for k, equations in enumerate(recorded):
                unit = equations.recording.tracks.unit_displacement
                data = exact.compliance * (exact.grasps[k].tracks.unit_displacement - unit)
                fields = [ObservationDelta(markers=data), ObservationDelta(markers=unit)]
                plain, weighed = equations.rows([*fields, signature.columns[0].fields[k]])
                normal += weighed[1:] @ plain[1:].T
                right += weighed[1:] @ plain[0]
            pairs.append(np.linalg.solve(normal, right)[1] / bias.sd[1])
        off.append(np.mean(pairs))
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 2


def test_columns_of_other_effects_and_of_the_plain_model_stay() -> None:
    model = forward_with(0.0, 0)
    equations = equations_of(model)
    signature = SKIN.signatures(model)[0]
    surface = surface_bias(model, equations, [(SKIN, signature, (2,))], columns=3).products
    assert not surface[:, :2].any()
    columns = [replace(signature.columns[0], name="another"), *signature.columns]
    before = GramMatrix(model, equations, columns).products
    after = GramMatrix(model, equations, columns, surface=surface).products
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        change = np.zeros_like(a)
        change[0, 3] = change[3, 0] = -surface[k, 2]
        np.testing.assert_allclose(b - a, change, atol=1e-9 * np.abs(a).max())


def test_the_drawn_error_has_the_size_that_is_asked_for_and_turns_no_element() -> None:
    mesh = finders_mesh()
    size_mm = []
    for seed in range(8):
        moved = with_surface_error(mesh, [], sd_mm=ERROR_MM, rng=np.random.default_rng(seed))
        assert t10_jacobians(moved.nodes_mm, moved.tets).min() > 0
        np.testing.assert_array_equal(moved.nodes_mm[mesh.pit_nodes], mesh.nodes_mm[mesh.pit_nodes])
        off = np.linalg.norm((moved.nodes_mm - mesh.nodes_mm)[mesh.outer_nodes], axis=1)
        size_mm.append(np.sqrt(np.mean(off**2)))
    assert np.sqrt(np.mean(np.square(size_mm))) == pytest.approx(ERROR_MM, rel=0.15)
    assert WAVE_MM > 4 * ERROR_MM


def test_the_nearby_solid_is_the_factorised_one_to_first_order() -> None:
    model = forward_with(0.0, 0)
    (solid,) = model.base.solids.values()
    nearby = with_drawn_surface(model)
    (moved,) = nearby.base.solids.values()
    exact = UnitModulusSolid.factorise(nearby.mesh, poisson_ratio=solid.poisson_ratio, support=solid.support)
    field = np.random.default_rng(3).normal(size=3 * len(solid.mesh.nodes_mm))
    load = (solid.stiffness @ field).reshape(1, -1, 3)  # balanced
    before, expected = solid.displacement(load), exact.displacement(load)
    change, off = (expected - before).ravel(), (moved.displacement(load) - expected).ravel()
    assert 0 < off @ solid.stiffness @ off < 1e-3 * (change @ solid.stiffness @ change)


STRETCH = 0.02


@cache
def plain() -> PlainModel:
    return plain_model(only_grasp(injected_case(noise=0.0), 0))


def moving(field) -> PlainModel:
    """The same recording, its skin moved by field(place, normal) times the load, for E = 1 MPa."""
    base = plain()
    recording = base.grasps[0]
    unit = np.zeros_like(recording.tracks.unit_displacement)
    for pad, link in enumerate(recording.links):
        mine = recording.pad_of_marker == pad
        place = recording.tracks.place_mm[mine]
        unit[:, mine] = recording.load[:, None, None] * field(
            place - place.mean(axis=0), mean_normal(link.place.normal)
        )
    return replace(
        base, grasps=(replace(recording, tracks=replace(recording.tracks, unit_displacement=unit)),)
    )


def moved_places(base: PlainModel) -> np.ndarray:
    moved_mm = [COMPLIANCE * recording.tracks.unit_displacement for recording in base.grasps]
    after = with_touched_skin(base, moved_mm).grasps[0].case.history.pads
    before = base.grasps[0].case.history.pads
    return np.concatenate([a.surface_mm - b.surface_mm for a, b in zip(after, before, strict=True)])


def test_places_go_back_by_half_the_step_in_which_the_marker_touched():
    base = moving(lambda place, normal: STRETCH * (place - np.outer(place @ normal, normal)))
    recording = base.grasps[0]
    back = moved_places(base)
    episode = np.concatenate([pad.episode[recording.used] for pad in recording.case.history.pads], axis=1)
    first = (episode >= 0).argmax(axis=0)
    late = (episode >= 0).any(axis=0) & (first == first.max())
    assert late.sum() > 3
    k = first.max()
    middle = (recording.load[k - 1] + recording.load[k]) / 2
    for pad, link in enumerate(recording.links):
        markers = late & (recording.pad_of_marker == pad)
        place = recording.tracks.place_mm - recording.tracks.place_mm[recording.pad_of_marker == pad].mean(
            axis=0
        )
        normal = mean_normal(link.place.normal)
        along = place - np.outer(place @ normal, normal)
        got = np.einsum("nx,nx->n", back[markers], along[markers]) / (along[markers] ** 2).sum(axis=1)
        assert got == pytest.approx(-COMPLIANCE * STRETCH * middle, rel=0.15)
        assert np.abs(back[markers] @ normal).max() < 1e-9


def test_a_dent_along_the_normal_moves_no_place():
    dent = moving(lambda place, normal: np.outer(-0.1 * np.exp(-(place**2).sum(axis=1) / 8), normal))
    assert np.abs(moved_places(dent)).max() < 0.02


def test_flesh_that_gives_way_nowhere_leaves_places_as_they_were():
    base = plain()
    nothing = [np.zeros_like(recording.tracks.unit_displacement) for recording in base.grasps]
    after = with_touched_skin(base, nothing).grasps[0].case.history.pads
    for pad_after, other in zip(after, base.grasps[0].case.history.pads, strict=True):
        assert (pad_after.surface_mm == other.surface_mm).all()
