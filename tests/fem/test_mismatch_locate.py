"""Where a mismatch sits, as a map and in words."""

import numpy as np
import pytest
from coarse_fruit import HALF_AXES_MM
from pinched_case_model import COMPLIANCE, model_of

from fem.estimation.compliance_fit import fit_compliance
from fem.mismatch.effects.soft_spot import CENTRE, EFFECT
from fem.mismatch.localisation.residual_places import located, modulus_cells
from fem.mismatch.localisation.spot_search import OTHERS, RADII_MM, best_spots, fruit_map
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, MARKER_VARIANCE_INFLATION
from fem.mismatch.signature_variant import ONE_WAY

SPOT_MM = np.array([HALF_AXES_MM[0] - 4.5, 1.0, -0.5])
NOISE_MM = 0.004


def left_by_plain(model: CaseModel) -> list[np.ndarray]:
    tracks = model.grasps[0].tracks
    return [tracks.position_mm - tracks.place_mm - COMPLIANCE * tracks.unit_displacement]


def injected_spot(rng: np.random.Generator) -> CaseModel:
    plain = model_of()
    place = {**dict(zip(CENTRE, SPOT_MM, strict=True)), "radius_mm": 4.5, "ratio": 0.35}
    more = EFFECT.respond(plain, place, ONE_WAY).unit[0] - plain.grasps[0].tracks.unit_displacement
    return model_of(COMPLIANCE * more + NOISE_MM * rng.normal(size=more.shape))


def test_map_of_the_modulus_is_softest_above_the_injected_spot():
    model = injected_spot(np.random.default_rng(0))
    maps = fruit_map(model, model.adjoint_basis.observed(left_by_plain(model)))
    softest = maps.vertices_mm[maps.modulus_score.argmin()]
    assert np.linalg.norm(softest - [HALF_AXES_MM[0], 1.0, -0.5]) < 5.0
    assert maps.modulus_score.min() < -10


def test_injected_spot_is_named_with_its_place():
    """By the best single ball for what the plain model leaves, as the signature's start has it."""
    model = injected_spot(np.random.default_rng(1))
    residual = model.adjoint_basis.observed(left_by_plain(model))
    best = max(best_spots(model, residual, radii_mm=RADII_MM, others=OTHERS), key=lambda spot: spot.score)
    assert best.score**2 > 0.7 * float(residual @ residual)
    place = EFFECT.where(dict(zip((*CENTRE, "radius_mm"), (*best.centre_mm, best.radius_mm), strict=True)))
    assert place.region == "flesh"
    assert np.linalg.norm(np.array(place.centre_mm) - SPOT_MM) < 3.0


def test_fault_of_one_pads_shear_is_named_so():
    model = model_of()
    recording = model.grasps[0]
    rough = np.zeros_like(recording.tracks.position_mm)
    on_pad = recording.pad_of_marker == 1
    wave = np.sin(3 * recording.tracks.place_mm[on_pad, 1]) * (-1.0) ** np.arange(on_pad.sum())
    rough[:, on_pad, 2] = 0.05 * np.sin(np.arange(len(rough)))[:, None] * wave
    rng = np.random.default_rng(2)
    region, _, component = located(model, [rough + NOISE_MM * rng.normal(size=rough.shape)])
    assert (region, component) == ("pad right", "shear")


def test_noise_alone_has_standard_scores_and_no_place():
    rng = np.random.default_rng(3)
    model = model_of()
    shape = model.grasps[0].tracks.position_mm.shape
    maps = [
        fruit_map(model, model.adjoint_basis.observed([NOISE_MM * rng.normal(size=shape)])) for _ in range(20)
    ]
    # Recordings leave ALIKE numbers for each independent one; these draws are independent all.
    thinned = np.sqrt(DESIGN_EFFECT * MARKER_VARIANCE_INFLATION)
    scores = thinned * np.array([map_.modulus_score for map_ in maps])
    # Scores allow for errors of markers' scales too, which these draws have none of.
    assert 0.3 < np.sqrt((scores**2).mean()) < 1.2
    assert located(model, [NOISE_MM * rng.normal(size=shape)]) == ("both", "all", "both")


def test_a_soft_spot_far_from_every_pad_is_not_visible():
    maps = fruit_map(model := model_of(), model.adjoint_basis.observed(left_by_plain(model)))
    under_pad = np.linalg.norm(maps.vertices_mm - [HALF_AXES_MM[0], 0, 0], axis=1).argmin()
    on_top = maps.vertices_mm[:, 2].argmax()
    assert maps.visible[under_pad] > 10 * maps.visible[on_top]


def test_table_of_the_modulus_gives_it_back():
    rng = np.random.default_rng(7)
    shape = model_of().grasps[0].tracks.position_mm.shape
    model = model_of(1e-4 * rng.normal(size=shape))
    fits = [fit_compliance(model.grasps[0].tracks, scale_sd=0.004, fruit_moves=True)]
    cells = modulus_cells(model, fits)
    moduli = [cell.E_MPa for cell in cells if cell.E_sd_MPa < 0.02 * cell.E_MPa]
    assert np.median(moduli) == pytest.approx(1 / COMPLIANCE, rel=0.02)
