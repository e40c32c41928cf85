"""Where a mismatch sits, as maps and in words, and which circumstance the modulus varies with."""

import numpy as np
import pytest
from coarse_fruit import HALF_AXES_MM
from pinched_forward_model import COMPLIANCE, forward_of

from fem.estimation.compliance_fit import fit_compliance
from fem.mismatch.effects.soft_spot import CENTRE, EFFECT
from fem.mismatch.localisation.adjoint_maps import fruit_map
from fem.mismatch.localisation.anova import Cells, analysis_of_variance, explained, modulus_cells
from fem.mismatch.localisation.residual_places import located
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, MARKER_VARIANCE_INFLATION
from fem.mismatch.signature_variant import ONE_WAY

SPOT_MM = np.array([HALF_AXES_MM[0] - 4.5, 1.0, -0.5])
NOISE_MM = 0.004


def left_by_plain(forward: ForwardModel) -> list[np.ndarray]:
    tracks = forward.base.grasps[0].tracks
    return [tracks.position_mm - tracks.place_mm - COMPLIANCE * tracks.unit_displacement]


def injected_spot(rng: np.random.Generator) -> ForwardModel:
    plain = forward_of()
    place = {**dict(zip(CENTRE, SPOT_MM, strict=True)), "radius_mm": 4.5, "ratio": 0.35}
    more = EFFECT.respond(plain, place, ONE_WAY).unit[0] - plain.base.grasps[0].tracks.unit_displacement
    return forward_of(COMPLIANCE * more + NOISE_MM * rng.normal(size=more.shape))


def test_map_of_the_modulus_is_softest_above_the_injected_spot():
    forward = injected_spot(np.random.default_rng(0))
    place = located(forward, left_by_plain(forward))
    softest = place.maps.vertices_mm[place.maps.modulus_score.argmin()]
    assert np.linalg.norm(softest - [HALF_AXES_MM[0], 1.0, -0.5]) < 5.0
    assert place.maps.modulus_score.min() < -10
    assert np.median(place.maps.law_error) > 1.5


def test_injected_spot_is_named_with_its_place():
    forward = injected_spot(np.random.default_rng(1))
    place = located(forward, left_by_plain(forward))
    assert place.where.region == "flesh"
    assert place.where.centre_mm is not None
    assert np.linalg.norm(np.array(place.where.centre_mm) - SPOT_MM) < 3.0


def test_fault_of_one_pads_shear_is_named_so():
    forward = forward_of()
    recording = forward.base.grasps[0]
    rough = np.zeros_like(recording.tracks.position_mm)
    on_pad = recording.pad_of_marker == 1
    wave = np.sin(3 * recording.tracks.place_mm[on_pad, 1]) * (-1.0) ** np.arange(on_pad.sum())
    rough[:, on_pad, 2] = 0.05 * np.sin(np.arange(len(rough)))[:, None] * wave
    rng = np.random.default_rng(2)
    place = located(forward, [rough + NOISE_MM * rng.normal(size=rough.shape)])
    assert (place.where.region, place.component) == ("pad right", "shear")


def test_noise_alone_has_standard_scores_and_no_place():
    rng = np.random.default_rng(3)
    forward = forward_of()
    shape = forward.base.grasps[0].tracks.position_mm.shape
    maps = [
        fruit_map(forward, forward.adjoint_basis.observed([NOISE_MM * rng.normal(size=shape)]))
        for _ in range(20)
    ]
    # Recordings leave ALIKE numbers for each independent one; these draws are independent all.
    thinned = np.sqrt(DESIGN_EFFECT * MARKER_VARIANCE_INFLATION)
    scores = thinned * np.array([map_.modulus_score for map_ in maps])
    # Scores allow for errors of markers' scales too, which these draws have none of.
    assert 0.3 < np.sqrt((scores**2).mean()) < 1.2
    assert 0.3 < np.sqrt(np.mean([map_.law_error**2 for map_ in maps])) < 1.2
    place = located(forward, [NOISE_MM * rng.normal(size=shape)])
    assert (place.where.region, place.when, place.component) == ("both", "all", "both")


def test_a_soft_spot_far_from_every_pad_is_not_visible():
    maps = fruit_map(forward := forward_of(), forward.adjoint_basis.observed(left_by_plain(forward)))
    under_pad = np.linalg.norm(maps.vertices_mm - [HALF_AXES_MM[0], 0, 0], axis=1).argmin()
    on_top = maps.vertices_mm[:, 2].argmax()
    assert maps.visible[under_pad] > 10 * maps.visible[on_top]


def drawn_cells(rng: np.random.Generator, *, slope: float = 0.0) -> Cells:
    """Sixty cells whose ln E grows with the load by `slope`."""
    load = rng.uniform(1.0, 5.0, 60)
    pad = np.tile([0.0, 1.0], 30)
    ln_modulus = slope * load + 0.02 * rng.normal(size=60)
    return Cells(
        ln_modulus=ln_modulus,
        sd=np.full(60, 0.02),
        factors={"load": load[:, None], "pad": pad[:, None], "time": rng.uniform(size=(60, 1))},
        neighbour=np.ones(60, dtype=bool),
    )


def test_factor_that_the_modulus_varies_with_comes_first():
    rows = explained(drawn_cells(np.random.default_rng(5), slope=0.05))
    assert rows[0].factor == "load"
    assert rows[0].share > 0.5
    assert rows[0].p_value < 1e-6


def test_p_values_of_factors_without_effect_are_even():
    rng = np.random.default_rng(6)
    drawn = [row.p_value for _ in range(150) for row in explained(drawn_cells(rng))]
    assert np.mean(np.array(drawn) < 0.1) == pytest.approx(0.1, abs=0.05)


def test_table_of_the_modulus_gives_it_back_and_what_never_varies_is_left_out():
    rng = np.random.default_rng(7)
    shape = forward_of().base.grasps[0].tracks.position_mm.shape
    forward = forward_of(1e-4 * rng.normal(size=shape))
    fits = [fit_compliance(forward.base.grasps[0].tracks, scale_sd=0.004, fruit_moves=True)]
    cells = modulus_cells(forward, fits)
    moduli = [cell.E_MPa for cell in cells if cell.E_sd_MPa < 0.02 * cell.E_MPa]
    assert np.median(moduli) == pytest.approx(1 / COMPLIANCE, rel=0.02)
    factors = {row.factor for row in analysis_of_variance(forward, fits)}
    assert not factors & {"grasp", "cycle"}
