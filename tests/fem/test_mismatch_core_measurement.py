"""What belongs to sensors, machines and contacts: put into recordings by its definition, and found again."""

from dataclasses import fields, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh
from injected_mismatch import (
    E_MPA,
    FLAT,
    GEL_N_PER_MM,
    TIME_S,
    Altered,
    Recording,
    injected_case,
    linear_and_refitted,
    misplaced,
    on_pad,
    only_grasp,
    small_strain_model,
    true_mesh,
)
from jaxtyping import Float
from pinched_case_model import COMPLIANCE, in_full, model_of
from plain_model import case_model, screened_effects

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.zero_drift import REMEMBERED, zero_drift
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mismatch.effect import Amounts, Effect, Parameters, Response, Signature
from fem.mismatch.effects import (
    clock_lag,
    gripper_compliance,
    pit_offset,
    pit_size,
    pose_error,
    sensor_drift,
    sensor_gain,
)
from fem.mismatch.effects.pose_error import NAMES
from fem.mismatch.effects.slip import LEVEL_MM, slip_path
from fem.mismatch.evidence.friction_cone import ShearRatios
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.kinds import pit_change
from fem.mismatch.kinds.moved_markers import MovedMarkers
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import OfFinerMesh, drawn_force_noise
from fem.mismatch.model.marker_equations import BalanceEquations
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.procedure import plain_fits
from fem.mismatch.reported_values import candidates
from fem.mismatch.result import NINETY
from fem.mismatch.selection.model_selection import select_model
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.signature_variant import ONE_WAY, Variant, of_pad
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

AIR_S = TIME_S[:3].mean()


def gained(gain: float) -> Altered:
    return lambda pad: replace(pad, force_N=gain * pad.force_N)


def drifted(newton_per_s: float) -> Altered:
    def change(pad: Recording) -> Recording:
        grown = newton_per_s * (TIME_S - AIR_S) / len(FLAT)
        return replace(pad, force_N=pad.force_N + grown[:, None, None] * pad.axes[:, 2])

    return change


def given_way(mm_per_N: float) -> Altered:
    def change(pad: Recording) -> Recording:
        ahead = mm_per_N * pad.pushed_N[:, None] * pad.axes[:, 2]
        return replace(pad, position_mm=pad.position_mm + ahead[:, None], origin_mm=pad.origin_mm + ahead)

    return change


def late(lag_s: float) -> Altered:
    """Displacement and force are those of a little earlier, poses those of now."""

    def earlier(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1)
        read = [np.interp(TIME_S - lag_s, TIME_S, column) for column in flat.T]
        return np.stack(read, axis=1).reshape(values.shape)

    def change(pad: Recording) -> Recording:
        gel = earlier(pad.gel_mm)
        at_rest = pad.position_mm - pad.gel_mm - pad.origin_mm[:, None]
        position = pad.origin_mm[:, None] + earlier(at_rest) + gel
        return replace(pad, position_mm=position, gel_mm=gel, force_N=earlier(pad.force_N))

    return change


def refitted(effect: Effect, altered: Altered, **options: object) -> tuple[dict[str, float], str, float]:
    """Parameters, choice and modulus after a refit of one recording."""
    model, _, again = linear_and_refitted(only_grasp(injected_case(altered, **options), 0), effect)
    return again.parameters[0], again.variants[0].label, modulus(model, again)


def modulus(model: CaseModel, again) -> float:
    """E as an answer gives it: by least squares with the effect's response in place."""
    return modulus_of(again.model, again.response).value


@pytest.mark.parametrize("pad", ["left", "right"])
def test_what_is_known_of_the_gel_says_which_pad_has_the_gain(pad):
    case = only_grasp(injected_case(on_pad(pad, gained(0.8))), 0)
    grasp = case.grasps[0]
    known = tuple(replace(pad_case, gel_N_per_mm=1.1 * GEL_N_PER_MM[2]) for pad_case in grasp.pads)
    case = replace(case, grasps=(replace(grasp, pads=known),))
    model, _, again = linear_and_refitted(case, sensor_gain.EFFECT)
    assert again.variants == (of_pad(pad),)
    assert again.parameters[0]["gain"] == pytest.approx(0.8, rel=0.02)
    assert modulus(model, again) == pytest.approx(E_MPA, rel=0.03)


def test_one_pads_gain_over_the_others_is_found():
    """Which of two pads it is cannot be told from their ratio: Young's modulus takes up what is common."""
    pad, gain = "right", 0.8
    parameters, choice, E = refitted(sensor_gain.EFFECT, on_pad(pad, gained(gain)))
    as_said = parameters["gain"] if choice == pad else 1 / parameters["gain"]
    assert as_said == pytest.approx(gain, rel=0.02)
    assert pytest.approx(E_MPA * (1 if choice == pad else gain), rel=0.03) == E


def test_E_is_averaged_over_the_pads_that_may_have_the_gain():
    """Nothing is known of the gels: with 0.8 on the right pad E is right, with 1.25 on the left 0.8 of it."""
    model = small_strain_model(only_grasp(injected_case(on_pad("right", gained(0.8))), 0))
    linear = screened_effects(model, [sensor_gain.EFFECT])
    selected = select_model(model, linear, p_value=0.0)
    first = selected.ranking[0]
    ((share, other),) = first.alternatives
    assert 0.35 < share <= 0.5
    assert {fit.variants[0].label for fit in (first.refit, other)} == {"left", "right"}
    said = candidates(selected, linear)[0].modulus
    of_right, of_left = E_MPA, 0.8 * E_MPA
    E_MPa = of_left if first.refit.variants[0].label == "left" else of_right
    mean = (1 - share) * E_MPa + share * (of_right + of_left - E_MPa)
    assert said.value == pytest.approx(mean, rel=0.03)
    assert NINETY * said.sd >= 0.95 * max(abs(said.value - E) for E in (of_left, of_right))


@pytest.mark.parametrize(
    ("effect", "altered", "name", "value", "tolerance"),
    [
        (sensor_drift.EFFECT, on_pad("right", drifted(0.1)), "newton_per_s", 0.1, 0.08),
        # a mesh this coarse is itself 0.04 mm/N too stiff
        (gripper_compliance.EFFECT, given_way(0.4), "mm_per_N", 0.4, 0.15),
        (clock_lag.EFFECT, late(0.12), "lag_s", 0.12, 0.08),
        (pose_error.EFFECT, on_pad("left", misplaced((0.0, 0.0), 4.0)), NAMES[2], 4.0, 0.15),
    ],
    ids=["drift", "jaws", "clock", "turned pad"],
)
def test_a_fault_is_found_again_with_its_pad_and_size(effect, altered, name, value, tolerance):
    parameters, choice, E = refitted(effect, altered)
    # the pads share their x: one turned forth and the other turned back push at the same angle
    other = effect is pose_error.EFFECT and choice == "right"
    assert (-1 if other else 1) * parameters[name] == pytest.approx(value, rel=tolerance)
    if effect is sensor_drift.EFFECT:
        assert choice == "right"
        assert pytest.approx(E_MPA, rel=0.03) == E


class Overshooting(MovedMarkers):
    """Starts too far, where it has no model, as a pit has none that pokes out of the fruit."""

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        return super().start(model, signature, 1.2 * amounts)

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        if parameters["mm_per_N"] > 0.45:
            raise FemFailure(FemProblem.PIT_OUTSIDE_FRUIT, "no such fruit")
        return super().respond(model, parameters, variant)


def test_where_the_linear_answer_has_no_model_the_search_starts_nearer_to_nothing():
    plain = gripper_compliance.EFFECT
    overshooting = Overshooting(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    assert refitted(overshooting, given_way(0.4))[0]["mm_per_N"] == pytest.approx(0.4, abs=0.06)


def rms(field: np.ndarray) -> float:
    return float(np.sqrt((field**2).mean()))


def beyond_motions(
    model: CaseModel, unit: Float[np.ndarray, "f n 3"], shift_mm: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "f n 3"]:
    """What a model leaves of the first recording's markers where E is E_MPA, mm."""
    recording = model.grasps[0]
    beyond = recording.tracks.position_mm - recording.tracks.place_mm - shift_mm - unit / E_MPA
    return model.marker_equations(recording).residual(beyond)


@pytest.fixture(scope="module")
def unaltered() -> CaseModel:
    return case_model(injected_case(noise=0.0))[0]


@pytest.mark.parametrize(
    ("effect", "altered", "parameters", "variant"),
    [
        (sensor_gain.EFFECT, on_pad("left", gained(1.3)), (1.3,), of_pad("left")),
        (pose_error.EFFECT, on_pad("left", misplaced((2.0, -1.5), 4.0)), (2.0, -1.5, 4.0), of_pad("left")),
    ],
)
def test_each_model_with_the_true_parameters_takes_a_recording_back_to_what_happened(
    unaltered, effect, altered, parameters, variant
):
    """The gel's displacement drives the model, so its forces are those of springs with each pad's gain."""
    model, _ = case_model(only_grasp(injected_case(altered, noise=0.0), 0))
    names = [spec.name for spec in effect.spec.searched]
    response = effect.respond(model, dict(zip(names, parameters, strict=True)), variant)
    true, recording = unaltered.grasps[0], model.grasps[0]
    shift = 0.0 if response.shift_mm is None else response.shift_mm[0]
    np.testing.assert_allclose(recording.tracks.position_mm - shift, true.tracks.position_mm, atol=2e-3)
    off = response.unit[0] - true.tracks.unit_displacement
    assert np.linalg.norm(off) < 0.02 * np.linalg.norm(true.tracks.unit_displacement)
    if response.balance is not None:
        load = np.linalg.norm(recording.force_N, axis=2).sum(axis=1).max()
        unbalanced = BalanceEquations.of(recording).measured - response.balance[0]
        assert np.abs(unbalanced - BalanceEquations.of(true).measured).max() < 0.01 * load


@pytest.fixture(scope="module")
def with_finer_mesh() -> CaseModel:
    """On the mesh that the truth was solved on."""
    return small_strain_model(replace(injected_case(noise=0.0), finer_mesh=true_mesh()))


def test_the_plain_response_is_that_of_the_finer_mesh(with_finer_mesh):
    """It leaves less of what was solved on that mesh."""
    left = []
    for model in (small_strain_model(injected_case(noise=0.0)), with_finer_mesh):
        fits = plain_fits(model.base)
        left.append(np.mean([fit.residual_rms_mm for fit in fits]))
    assert left[1] < 0.5 * left[0]


def test_what_a_finer_mesh_adds_is_not_exact_for_other_laws(with_finer_mesh):
    """A column of the plain model has its field, and takes it back where the data say so."""
    (column,) = [each for each in common_nuisances(with_finer_mesh) if each.name == "finer mesh"]
    for recording, field in zip(with_finer_mesh.grasps, column.fields, strict=True):
        back = recording.excess(with_finer_mesh.compliance) + field.markers
        coarse = recording.over_time(recording.response)
        np.testing.assert_allclose(back, recording.excess(with_finer_mesh.compliance, coarse), atol=1e-12)
    coarse_alone = small_strain_model(injected_case(noise=0.0))
    assert "finer mesh" not in [each.name for each in common_nuisances(coarse_alone)]


def test_noise_of_the_forces_moves_markers_as_on_the_finer_mesh_alone(with_finer_mesh):
    """The same draws, on a model that has no other mesh; places of touch differ by the mesh."""
    alone = small_strain_model(replace(injected_case(noise=0.0), mesh=true_mesh()))
    compliance = with_finer_mesh.compliance
    weigh = [GraspEquations.of(with_finer_mesh, each).weighed_markers for each in with_finer_mesh.grasps]
    ours, true = (
        drawn_force_noise(model.base, weigh, compliance=compliance) for model in (with_finer_mesh, alone)
    )
    for noise, expected, weighed in zip(ours, true, weigh, strict=True):
        np.testing.assert_allclose(noise.force_N, expected.force_N, atol=1e-9)
        added = OfFinerMesh().fields(noise)
        near = np.linalg.norm(noise.over_time(noise.response - expected.response))
        assert near < 0.1 * np.linalg.norm(added)
        of_added = np.stack([weighed(field) for field in added])
        assert np.linalg.norm(noise.weighed - expected.weighed) < 0.1 * np.linalg.norm(of_added)


def test_effects_of_no_size_leave_the_response_of_the_finer_mesh(with_finer_mesh):
    recording = with_finer_mesh.grasps[0]
    plain = recording.tracks.unit_displacement
    assert np.abs(recording.added).max() > 1e-3 * np.abs(plain).max()
    ((no_pit_change,), _) = pit_change._exact(with_finer_mesh, np.zeros(4))
    no_shift = pose_error._exact(with_finer_mesh, recording, "left", np.zeros(3))[0]
    for unit in (no_pit_change, no_shift):
        np.testing.assert_allclose(unit, plain, atol=1e-6 * np.abs(plain).max())


@pytest.mark.proof
def test_which_pad_is_misplaced_is_told_in_full_where_the_linear_round_takes_the_other():
    """The two pads differ too little in the linear round for its choice to be the same on every machine."""
    model, _ = case_model(injected_case(on_pad("left", misplaced((0.5, 2.0), 2.2))))
    linear = screened_effects(model, [pose_error.EFFECT])
    assert {fit.signature.variant for fit in linear.linear_fits} == {of_pad("left"), of_pad("right")}
    most = max(fit.gain for fit in linear.linear_fits)
    right_first = [
        replace(fit, gain=most + 1.0) if fit.signature.variant == of_pad("right") else fit
        for fit in linear.linear_fits
    ]
    linear = replace(linear, linear_fits=tuple(right_first))
    best = select_model(model, linear, p_value=0.0).ranking[0].refit
    assert best.variants == (of_pad("left"),)
    # the mesh differs between machines, and the estimate with it: within what the search says of itself
    sd = np.sqrt(np.diag(best.covariance))
    assert (sd < [0.35, 0.45, 0.25]).all()
    off = np.array([best.parameters[0][name] for name in NAMES]) - [0.5, 2.0, 2.2]
    assert (np.abs(off) < 3 * sd).all(), f"{off} mm, mm, degrees with standard deviations {sd}"


def turning(pad: Recording) -> Recording:
    """The fruit turns by up to three degrees about the pads' x and one about its own z, its skin with it."""
    turn = np.linspace(0.0, 1.0, len(TIME_S))[:, None] * (0.06 * pad.axes[:, 0] + [0.0, 0.0, 0.02])
    return replace(pad, position_mm=pad.position_mm + np.cross(turn[:, None], pad.place_mm))


def test_a_misplaced_pad_rides_on_a_turning_fruit_where_it_truly_is():
    wrong = on_pad("left", misplaced((2.0, -1.5), 4.0))
    model, _ = case_model(only_grasp(injected_case(lambda pad: wrong(turning(pad)), noise=0.0), 0))
    still, _ = case_model(only_grasp(injected_case(wrong, noise=0.0), 0))
    names = [spec.name for spec in pose_error.EFFECT.spec.searched]
    truth = dict(zip(names, (2.0, -1.5, 4.0), strict=True))
    left = []
    for case in (model, still):
        response = pose_error.EFFECT.respond(case, truth, of_pad("left"))
        left.append(beyond_motions(case, response.unit[0], response.shift_mm[0]))
    # as much as on a fruit that does not turn: 1.1 um, and 3 where the pad rides where it seems to be
    assert rms(left[0]) < 1.5 * rms(left[1])


def test_the_weight_of_an_unaltered_fruit_starts_no_search_for_a_tilt():
    def weighs(pad: Recording) -> Recording:
        share = 0.13 / len(FLAT) * (np.linalg.norm(pad.force_N, axis=2) > 0).any(axis=1)
        return replace(pad, force_N=pad.force_N + share[:, None, None] * np.array([1.0, 0.0, 0.0]))

    model, _ = case_model(injected_case(weighs, noise=0.0))
    for pad in ("left", "right"):
        assert abs(pose_error.EFFECT.other_start(model, of_pad(pad))["tilt_deg"]) < 1.0


def test_equal_gains_of_both_pads_leave_forces_that_do_not_balance_as_they_are():
    model, _ = case_model(injected_case(on_pad("left", gained(1.3)), noise=0.0))
    left, right = sensor_gain.EFFECT.signatures(model)
    for number, recording in enumerate(model.grasps):
        recorded = model.balance_equations(recording).measured
        sums = [signature.columns[0].fields[number].balance for signature in (left, right)]
        assert np.abs(recorded).max() > 0.01
        np.testing.assert_allclose(sums[0] + sums[1], 0.0, atol=1e-9 * np.abs(recorded).max())
        ahead = sensor_gain.EFFECT.respond(model, {"gain": 1 + 1e-5}, left.variant).balance[number]
        np.testing.assert_allclose(ahead / 1e-5, sums[0], atol=1e-3 * np.abs(sums[0]).max())


SPRING_RATIO = 0.25
DEPTH_MM = 0.1
STEP_MM = 0.02


def dragged(skin_mm: np.ndarray, mu: float) -> tuple[SimpleNamespace, np.ndarray]:
    """One marker pressed in evenly, whose skin is dragged along x; and where Coulomb's law leaves the gel."""
    bound = mu / SPRING_RATIO * DEPTH_MM
    gel, slid = np.zeros(len(skin_mm)), 0.0
    for frame, skin in enumerate(skin_mm):
        gel[frame] = np.clip(skin - slid, -bound, bound)
        slid = skin - gel[frame]
    moved = np.column_stack([gel, np.zeros_like(gel), np.full_like(gel, -DEPTH_MM)])[:, None]
    plain = np.column_stack([skin_mm, np.zeros_like(gel), np.full_like(gel, -DEPTH_MM)])[:, None]
    tracks = SimpleNamespace(
        position_mm=moved,
        place_mm=np.zeros((1, 3)),
        gel_displacement_mm=moved,
        unit_displacement=plain,
        episode=np.zeros((len(gel), 1), dtype=np.int64),
        sd_mm=np.array([0.004]),
    )
    pose = np.tile(np.eye(4), (1, len(gel), 1, 1))
    recording = SimpleNamespace(tracks=tracks, pose=pose, pad_of_marker=np.array([0]))
    return recording, skin_mm - gel


def path_of(recording: SimpleNamespace, mu: float) -> np.ndarray:
    """With equations that leave every field as it is: the skin is where the plain model says."""
    equations = SimpleNamespace(residual=lambda field: field)
    ratio = np.array([SPRING_RATIO])
    return slip_path(recording, equations, compliance=1.0, mu=mu, spring_ratio=ratio)[:, 0, 0]


def test_a_skin_dragged_forth_and_back_slides_as_coulomb_says():
    out = np.arange(0, 0.2, STEP_MM)
    recording, slid = dragged(np.concatenate([out, out[::-1]]), 0.2)
    assert slid.max() > 0.08
    assert path_of(recording, 0.2) == pytest.approx(slid, abs=1e-12)


def test_nothing_slides_where_friction_is_high():
    recording, slid = dragged(np.arange(0, 0.2, STEP_MM), 0.8)
    assert (slid == 0).all()
    assert (path_of(recording, 0.8) == 0).all()


def test_a_shear_at_the_touch_within_its_own_error_is_no_slip():
    bound = 0.05 / SPRING_RATIO * DEPTH_MM
    recording, _ = dragged(np.full(6, bound + 0.9 * LEVEL_MM), 0.05)
    assert (path_of(recording, 0.05) == 0).all()


def markers(rng: np.random.Generator, mu: float, *, count: int = 400, frames: int = 10) -> ShearRatios:
    """Ratios that fall off from zero, cut by the cone; 3 % noise."""
    ratio = np.minimum(np.repeat(rng.exponential(0.06, size=count), frames), mu)
    sd = 0.03 * np.maximum(ratio, 0.02)
    return ShearRatios(
        ratio=np.abs(ratio + sd * rng.normal(size=len(ratio))),
        sd=sd,
        marker=np.repeat(np.arange(count), frames),
    )


@pytest.mark.parametrize("mu", [0.08, 0.12])
def test_markers_that_slip_pile_up_on_the_cone(mu):
    ratios = markers(np.random.default_rng(1), mu)
    tried = np.linspace(0.5 * mu, 2 * mu, 61)
    ratio_of_mu = [ratios.log_ratio(x) for x in tried]
    assert max(ratio_of_mu) > 10
    assert tried[int(np.argmax(ratio_of_mu))] == pytest.approx(mu, rel=0.05)


def test_a_smooth_distribution_is_no_cone():
    for seed in range(20):
        ratios = markers(np.random.default_rng(seed), np.inf)
        assert max(ratios.log_ratio(mu) for mu in np.geomspace(0.05, 1.0, 40)) < 1


@pytest.mark.parametrize(
    ("seed", "spread", "sd", "of_each", "widest", "most"),
    [(3, 0.05, 0.03, 10, 0.18, 0.0), (4, 0.06, 0.01, 1, 0.3, 1.0)],
    ids=["ratios known no better than to themselves", "a broad top"],
)
def test_sizes_of_vectors_of_noise_are_no_cone(seed, spread, sd, of_each, widest, most):
    """The size of a vector of noise is hardly ever near nothing."""
    size = np.linalg.norm(np.random.default_rng(seed).normal(0, spread, (4000, 2)), axis=1)
    marker = np.repeat(np.arange(4000 // of_each), of_each)
    ratios = ShearRatios(ratio=size, sd=np.full(4000, sd), marker=marker)
    assert max(ratios.pile_up(mu) for mu in np.geomspace(0.05, widest, 40)) <= most


def test_markers_beyond_a_cone_refute_it():
    ratios = markers(np.random.default_rng(2), 0.2)
    assert ratios.loss(0.1) > 50
    assert ratios.loss(0.2) < 1


AFTER = 5


def let_go(case: MismatchCase, newton_per_s: float) -> MismatchCase:
    """One recording that goes on in the air, its right pad's sensor drifting from the first frame on."""
    (grasp,) = only_grasp(case, 0).grasps
    history = grasp.history
    time = np.concatenate([history.time_s, history.time_s[-1] + 0.25 * np.arange(1, AFTER + 1)])
    rng = np.random.default_rng(3)
    pads = []
    for pad, motion in zip(history.pads, grasp.pads, strict=True):
        normal = motion.pose[0, :3, 2]
        grown = newton_per_s * (time - AIR_S) / len(FLAT) * (pad.name == "right")
        more = {
            name: np.concatenate([getattr(pad, name), np.repeat(getattr(pad, name)[:1], AFTER, axis=0)])
            for name in ("position_mm", "gel_displacement_mm", "force_N", "episode")
        }
        more["force_N"][-AFTER:] = pad.force_sd_N * rng.normal(size=more["force_N"][-AFTER:].shape)
        more["force_N"] = more["force_N"] + grown[:, None, None] * normal
        pads.append(replace(pad, **more))
    motions = tuple(
        replace(
            motion,
            pose=np.concatenate([motion.pose, np.repeat(motion.pose[:1], AFTER, axis=0)]),
            normal_N=np.concatenate([motion.normal_N, np.zeros(AFTER)]),
        )
        for motion in grasp.pads
    )
    phase = (*history.phase, *("air",) * AFTER)
    history = replace(history, time_s=time, phase=phase, pads=tuple(pads))
    return replace(case, grasps=(replace(grasp, history=history, pads=motions),))


def felt(history: GraspHistory, case: MismatchCase, pad: int):
    return zero_drift(history, pad, case.grasps[0].pads[pad].pose[0, :3, 2])


def test_a_drift_is_measured_in_the_air_on_its_own_pad_alone():
    case = let_go(injected_case(on_pad("right", lambda pad: pad)), 0.05)
    left, right = (felt(case.grasps[0].history, case, pad) for pad in (0, 1))
    assert right.sure
    assert right.rate_N_per_s == pytest.approx(0.05, abs=3 * right.sd_N_per_s)
    assert not left.sure
    assert abs(left.rate_N_per_s) < 3 * left.sd_N_per_s


def test_what_a_gel_may_remember_is_no_drift():
    case = let_go(injected_case(on_pad("right", lambda pad: pad)), 0.0)
    history = case.grasps[0].history
    right = history.pads[1]
    peak = np.abs((right.force_N @ case.grasps[0].pads[1].pose[0, :3, 2]).sum(axis=1)).max()
    kept = right.force_N.copy()
    kept[-AFTER:] += REMEMBERED * peak / len(FLAT) * case.grasps[0].pads[1].pose[0, :3, 2]
    assert not felt(replace(history, pads=(history.pads[0], replace(right, force_N=kept))), case, 1).sure


def test_without_frames_after_the_contact_nothing_is_said():
    case = only_grasp(injected_case(on_pad("right", lambda pad: pad)), 0)
    assert felt(case.grasps[0].history, case, 1) is None


def test_a_drift_that_markers_noise_hides_is_found_by_its_size_and_taken_out_of_the_modulus():
    rate = 0.02  # half a millinewton on a marker at the end, half its noise
    model, linear, again = linear_and_refitted(
        let_go(injected_case(on_pad("right", lambda pad: pad)), rate), sensor_drift.EFFECT
    )
    assert again.variants == (of_pad("right"),)
    assert again.parameters[0]["newton_per_s"] == pytest.approx(rate, rel=0.1)
    assert linear.best[0].gain > 10
    assert modulus_of(model, again.response).value == pytest.approx(E_MPA, rel=0.03)


OFFSET = tuple(spec.name for spec in pit_offset.SPEC.searched)


@cache
def model() -> CaseModel:
    return model_of()


def solved(place: tuple[float, float, float, float]) -> np.ndarray:
    """c(t) of the recording with the pit there, the mesh's nodes moved and everything anew."""
    mesh = with_pit_moved(fruit_mesh(), np.array(place))
    return in_full(model(), UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free"))


def responded(effect, names: tuple[str, ...], values: tuple[float, ...]) -> np.ndarray:
    return effect.respond(model(), dict(zip(names, values, strict=True)), ONE_WAY).unit[0]


def test_pits_of_other_sizes_answer_as_the_fruit_solved_with_them():
    """Exact for the first size that a search asks for, near it read off a curve; else exact."""
    search = replace(model(), warm_starts=WarmStarts())
    plain = model().grasps[0].tracks.unit_displacement
    for scale, tolerance in ((0.78, 1e-6), (0.72, 0.06)):
        (response,) = pit_size.EFFECT.respond(search, {"scale": scale}, ONE_WAY).unit
        expected = solved((0, 0, 0, np.log(scale)))
        assert np.linalg.norm(response - expected) < tolerance * np.linalg.norm(expected - plain)


def test_a_pit_elsewhere_answers_as_the_fruit_solved_with_it():
    response = responded(pit_offset.EFFECT, OFFSET, (1.5, -1.0, 0.5))
    expected = solved((1.5, -1.0, 0.5, 0.0))
    plain = model().grasps[0].tracks.unit_displacement
    assert np.linalg.norm(response - expected) < 1e-6 * np.linalg.norm(expected - plain)


@pytest.mark.parametrize(("effect", "way"), [(pit_offset.EFFECT, 0), (pit_size.EFFECT, 3)])
def test_signatures_are_slopes_of_fruit_solved_with_the_pit_a_little_moved(effect, way):
    step = 0.02 if way == 3 else 0.1
    place = np.zeros(4)
    place[way] = step
    slope = COMPLIANCE * (solved(tuple(place)) - solved(tuple(-place))) / (2 * step)
    (signature,) = effect.signatures(model())
    markers = signature.columns[0].fields[0].markers
    # each frame has its own rigid motion, so fields are compared without rigid motions
    modes = rigid_motion(model().grasps[0].tracks.place_mm).reshape(-1, 6)

    def strained(field: np.ndarray) -> np.ndarray:
        flat = field.reshape(len(field), -1).T
        return flat - modes @ np.linalg.lstsq(modes, flat, rcond=None)[0]

    off = np.linalg.norm(strained(slope) - strained(markers))
    assert off < 0.02 * np.linalg.norm(strained(markers))


def test_an_amount_of_the_signature_is_where_the_search_starts():
    (signature,) = pit_size.EFFECT.signatures(model())
    assert pit_size.EFFECT.start(model(), signature, np.array([np.log(1.2)])) == {"scale": pytest.approx(1.2)}
    (signature,) = pit_offset.EFFECT.signatures(model())
    start = pit_offset.EFFECT.start(model(), signature, np.array([0.5, -1.0, 9.0]))
    assert list(start.values()) == pytest.approx([0.5, -1.0, 6.0])
