"""Gels at fault, gels of springs and gels that stick: what is injected comes back."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from injected_mismatch import (
    E_MPA,
    FLAT,
    GEL_N_PER_MM,
    NOISE_MM,
    NOISE_N,
    PHASES,
    RADII_MM,
    TIME_S,
    Altered,
    Recording,
    injected_case,
    pad_axes,
    true_force,
)
from plain_model import case_model, screened_effects
from recorded_pad import recorded_pad

from fem.estimation import denoised_force as module
from fem.estimation.denoised_force import DenoisedForce
from fem.grasp_history import PadHistory
from fem.mismatch import gel_fault
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effects import (
    adhesion,
    gel_creep,
    gel_hysteresis,
    sensor_drift,
    sensor_nonlinear,
    slip,
    thermal_drift,
    third_contact,
)
from fem.mismatch.evidence.gel_relation import GelRecord, RelationFit, gel_records
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.pulling_markers import LEAST_EVIDENCE, Pull
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import TEMPERATURE, log_prior
from fem.mismatch.selection.grasp_explanations import all_explanations, ranked
from fem.mismatch.selection.model_selection import ModelSelection, select_model
from fem.mismatch.selection.modulus_with import modulus_of, modulus_with
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.reported_modulus import modulus_by, reported_modulus
from fem.mismatch.selection.screening import screened
from fem.mismatch.signature_variant import ONE_WAY

FAULTS = (sensor_nonlinear.EFFECT, gel_creep.EFFECT, gel_hysteresis.EFFECT)
ALL = (*FAULTS, thermal_drift.EFFECT)


@cache
def bent(a: float) -> Altered:
    """The reading bends; the largest force is that of both pads, which press alike."""

    def change(pad: Recording) -> Recording:
        size = np.linalg.norm(pad.force_N, axis=2, keepdims=True)
        return replace(pad, force_N=pad.force_N * (1 + a * size / size.max()))

    return change


@cache
def crept(creep: float, tau_s: float) -> Altered:
    """The gel's face goes on moving, and the markers' places with it."""

    def change(pad: Recording) -> Recording:
        memory = np.zeros_like(pad.gel_mm)
        for k in range(1, len(TIME_S)):
            fade = np.exp(-(TIME_S[k] - TIME_S[k - 1]) / tau_s)
            memory[k] = fade * memory[k - 1] + (1 - fade) * pad.gel_mm[k]
        return replace(pad, gel_mm=pad.gel_mm + creep * memory, position_mm=pad.position_mm + creep * memory)

    return change


@cache
def looped(share: float) -> Altered:
    """The force falls short below its peak so far."""

    def change(pad: Recording) -> Recording:
        r = pad.pushed_N / np.maximum.accumulate(np.maximum(pad.pushed_N, 1e-9))
        return replace(pad, force_N=pad.force_N * (1 - 4 * share * r * (1 - r))[:, None, None])

    return change


@cache
def bending_gel(a: float) -> Altered:
    """The gel itself bends, and is read rightly: force and places are true."""

    def change(pad: Recording) -> Recording:
        size = np.linalg.norm(pad.force_N, axis=2, keepdims=True)
        return replace(pad, gel_mm=pad.gel_mm / (1 + a * size / size.max()))

    return change


@cache
def model_of(altered: Altered = lambda pad: pad) -> CaseModel:
    """Kept by what is altered, which the functions above keep by its amounts."""
    return case_model(injected_case(altered, noise=0.3))[0]


@pytest.fixture
def unaltered() -> CaseModel:
    return model_of()


@pytest.fixture
def bent_reading() -> CaseModel:
    return model_of(bent(-0.3))


def measured(effect: GelFault, model: CaseModel) -> dict[str, float]:
    return effect.measured(model).values


@pytest.mark.parametrize(
    ("effect", "altered", "true", "rel"),
    [
        (sensor_nonlinear.EFFECT, bent(-0.3), {"a": -0.3}, {"a": 0.08}),
        (gel_creep.EFFECT, crept(0.25, 1.0), {"creep": 0.25, "creep_tau_s": 1.0}, {"creep": 0.08}),
        (gel_hysteresis.EFFECT, looped(0.12), {"share": 0.12}, {}),
    ],
    ids=["bent", "creeping", "looped"],
)
def test_a_fault_of_the_gel_is_measured_and_seen_and_E_is_right_with_it(effect, altered, true, rel):
    model = model_of(altered)
    values = measured(effect, model)
    assert values.keys() == true.keys()
    for name, value in true.items():
        assert values[name] == pytest.approx(value, rel=rel.get(name, 0.1))
    assert effect.direct_evidence(model) > 20
    assert modulus_of(model, effect.respond(model, values, ONE_WAY)).value == pytest.approx(E_MPA, rel=0.05)


@pytest.mark.parametrize("effect", FAULTS)
def test_a_sound_gel_shows_none_of_them(unaltered, effect):
    assert effect.direct_evidence(unaltered) < 0.0
    relation = effect.measured(unaltered)
    name = effect.amounts[0]
    assert abs(relation.values[name]) < max(4 * relation.sd[name], 0.02)
    (fit,) = screened_effects(unaltered, (effect,)).linear_fits
    assert fit.gain < 0
    assert fit.modulus_change[0] == pytest.approx(1.0, abs=0.005)


def test_a_gel_that_bends_and_is_read_rightly_is_unknown_physics():
    model, effect = model_of(bending_gel(0.5)), sensor_nonlinear.EFFECT
    linear = screened_effects(model, FAULTS)
    fit = next(fit for fit in linear.best if fit.effect is effect)
    assert fit.direct > 20  # the relation alone would have it
    assert fit.gain - fit.direct < -10
    assert select_model(model, linear, p_value=0.01).verdict == UNKNOWN


def test_a_fault_that_is_neither_shown_nor_excluded_is_in_the_error_bar(unaltered, monkeypatch):
    fault, plain = sensor_nonlinear.EFFECT, modulus_of(unaltered)
    relation = fault.measured(unaltered)
    widths = []
    for evidence in (-6.0, 3.0):
        weak = replace(relation, values={"a": 0.05}, evidence=evidence)
        monkeypatch.setitem(unaltered.memo.values, ("gel relation", fault.spec.name), weak)
        ranking = ranked(all_explanations(screened_effects(unaltered, (fault,))))
        weighed = [
            (each.probability, modulus_by(each, None, plain, None))
            for each in ranking
            if each.linear_fits or each.name == NONE
        ]
        widths.append(reported_modulus(NONE, weighed, plain).sd / plain.sd)
    assert widths[0] == pytest.approx(1.0, abs=0.01)
    assert widths[1] > 1.2


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (sensor_nonlinear.EFFECT, {"a": -0.35}),
        (sensor_nonlinear.EFFECT, {"a": 0.4}),
        (gel_creep.EFFECT, {"creep": 0.3, "creep_tau_s": 0.7}),
        (gel_hysteresis.EFFECT, {"share": 0.15}),
        (thermal_drift.EFFECT, {"strain_per_root_s": 2e-3, "N_per_root_s": 0.2}),
    ],
)
def test_each_law_undone_is_the_recording_as_it_truly_was(unaltered, effect, values):
    """Of forces without noise: what exceeds the largest has no true one."""
    for record in gel_records(unaltered):
        force = np.where(record.force_N[..., 2:] > 0, record.force_N, 0.0)
        largest = float(np.linalg.norm(force, axis=2).max())
        true = replace(record, force_N=force, largest_N=largest * (1 + values.get("a", 0.0)))
        back = effect.law.undone(effect.law.recorded(true, values), values)
        np.testing.assert_allclose(back.force_N, true.force_N, atol=1e-6 * largest)
        np.testing.assert_allclose(back.displacement_mm, true.displacement_mm, atol=1e-9)


def still(strain: float, N: float, *, linear: bool = False, seed: int = 0) -> GelRecord:
    """A pad that touches for a while, then nothing again, warming all the time; some markers never touch."""
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0.0, 10.0, 60)
    axis = np.linspace(-9.5, 9.5, 20)
    flat = np.column_stack([g.ravel() for g in np.meshgrid(axis, axis)] + [np.zeros(400)])
    air = (time_s < 2.5) | (time_s > 8.0)
    inside = np.linalg.norm(flat, axis=1) < 5
    force, moved = (sd * rng.normal(size=(60, 400, 3)) for sd in (1e-3, 4e-3))
    push = np.where(~air[:, None] & inside, 0.03, 0.0)
    force[..., 2] += push
    moved[..., 2] -= push / GEL_N_PER_MM[2]
    root = time_s if linear else np.sqrt(time_s)
    force[..., 2] += N / 400 * root[:, None]
    moved += strain * root[:, None, None] * flat
    before = time_s < 2.3
    return GelRecord(
        grasp="grasp-1", pad="left", time_s=time_s, rest_mm=flat,
        force_N=force - force[before].mean(axis=0), displacement_mm=moved - moved[before].mean(axis=0),
        turn=np.tile(np.eye(3), (60, 1, 1)), ever=inside, firm=inside, air=air,
        force_sd_N=1e-3, displacement_sd_mm=4e-3, lag1=0.0, largest_N=0.03, markers=400,
        zero_drift_N=np.zeros(60),
    )  # fmt: skip


def warmed(monkeypatch, *records: GelRecord) -> RelationFit | None:
    """What the effect measures of a case with these records."""
    monkeypatch.setattr(thermal_drift, "gel_records", lambda _: records)
    return thermal_drift.EFFECT.measured(SimpleNamespace(memoised=lambda _, compute: compute()))


def test_a_warming_gel_is_measured_where_it_touches_nothing(monkeypatch):
    relation = warmed(monkeypatch, still(1e-3, 0.3), still(1e-3, 0.3, seed=1))
    assert relation.values["strain_per_root_s"] == pytest.approx(1e-3, rel=0.05)
    assert relation.values["N_per_root_s"] == pytest.approx(0.3, rel=0.15)
    assert relation.evidence > 100


def test_a_pad_that_is_never_in_the_air_says_nothing_of_warming(monkeypatch):
    pressed = replace(still(1e-3, 0.3), air=np.zeros(60, dtype=bool))
    assert warmed(monkeypatch, pressed) is None
    other = still(1e-3, 0.3, seed=1)
    alone, together = warmed(monkeypatch, other), warmed(monkeypatch, pressed, other)
    assert alone is not None
    assert together == alone


def test_a_drift_of_the_force_alone_is_no_warming(monkeypatch):
    assert warmed(monkeypatch, still(0.0, 0.3), still(0.0, 0.3, seed=1)) is None


def test_a_bent_reading_is_no_warming_and_no_two_faults():
    model = model_of(bent(0.35))
    linear = screened_effects(model, ALL)
    assert thermal_drift.EFFECT.direct_evidence(model) == 0.0
    assert linear.best[0].name == "sensor_nonlinear"
    prior = log_prior("a+b", effects=len(ALL)) - log_prior("a", effects=len(ALL))
    explanations = all_explanations(linear)
    pairs = [explanation.gain for explanation in explanations if "+" in explanation.name]
    assert max(pairs, default=-np.inf) + TEMPERATURE * prior < linear.best[0].gain


def test_what_the_relation_leaves_open_is_in_the_error_bar():
    """Little creep whose time is hardly known: its relation's standard deviation is reported."""
    model, effect = model_of(crept(0.06, 1.0)), gel_creep.EFFECT
    linear = screened_effects(model, (effect,))
    again = refit(model, linear, linear.linear_fits[:1])
    sd_of = dict(zip((spec.name for spec in effect.spec.searched), modulus_with(again).sd, strict=True))
    relation = effect.relation_sd(model)
    assert relation["creep_tau_s"] > 0.2
    assert all(sd_of[name] >= relation[name] for name in relation)
    assert abs(np.log(again.parameters[0]["creep_tau_s"])) < 2 * sd_of["creep_tau_s"]


@pytest.mark.parametrize("effect", FAULTS)
def test_a_drift_of_the_reading_is_taken_out_before_a_law_is_fitted(unaltered, monkeypatch, effect):
    """A force that grows in all markers bends force against displacement: the law seems to be another."""
    sound = [still(0.0, 0.0, seed=seed) for seed in (0, 1)]
    drifting = [still(0.0, 1.5, linear=True, seed=seed) for seed in (0, 1)]
    before = sound[0].time_s < 2.3
    known = [
        replace(record, zero_drift_N=1.5 / 400 * (record.time_s - record.time_s[before].mean()))
        for record in drifting
    ]
    monkeypatch.setattr(gel_fault, "gel_records", lambda _: known)
    none, raw = (effect.fitted(unaltered, records) for records in (sound, drifting))
    without = effect.fitted(unaltered, effect.records(unaltered))
    assert without.evidence == pytest.approx(none.evidence)
    assert without.values == pytest.approx(none.values)
    assert raw.left > 1.5 * without.left


FORCE = true_force()
USED = FORCE.any(axis=(1, 2))
TURN = pad_axes(0, 1.0)
TIME = np.arange(len(FORCE)) * 1.0


def recorded(seed: int = 0, *, more: np.ndarray | float = 0.0, gel: np.ndarray | None = None) -> PadHistory:
    """A bed of springs, unless `gel` (displacement, pad axes) is given. `more`: force without the gel."""
    rng = np.random.default_rng(seed)
    moved = -FORCE / GEL_N_PER_MM if gel is None else gel
    force = (FORCE + more) @ TURN.T
    read = moved @ TURN.T + NOISE_MM * rng.normal(size=FORCE.shape)
    felt = force + NOISE_N * rng.normal(size=FORCE.shape)
    return recorded_pad(FLAT, felt, touching=FORCE.any(axis=2), sd_mm=NOISE_MM, sd_N=NOISE_N, gel_mm=read)


def denoised_force(pad: PadHistory, turn: np.ndarray, used: np.ndarray) -> DenoisedForce:
    """In the frames used."""
    denoised = module.denoised_force(pad, turn, used)
    assert denoised.force_N.shape == pad.force_N.shape
    return replace(denoised, force_N=denoised.force_N[used])


def off(denoised: DenoisedForce, truth: np.ndarray) -> float:
    """Root mean square error, N."""
    return float(np.sqrt(((denoised.force_N - (truth @ TURN.T)[USED]) ** 2).mean()))


def test_springs_push_by_their_displacement_with_less_noise_than_the_recorded_forces():
    pad = recorded()
    denoised = denoised_force(pad, TURN, USED)
    assert denoised.sd_N == pytest.approx(GEL_N_PER_MM[2] * NOISE_MM, rel=0.05)
    assert off(denoised, FORCE) < 0.5 * NOISE_N
    springs = -(pad.gel_displacement_mm[USED] @ TURN) * GEL_N_PER_MM @ TURN.T
    assert np.abs(denoised.force_N - springs).max() < 0.02 * FORCE.max()


def test_noise_said_to_be_left_is_the_noise_that_is_left():
    denoised = denoised_force(recorded(1), TURN, USED)
    error = (denoised.force_N - (FORCE @ TURN.T)[USED]) @ TURN
    assert error[:, :, 2].std() == pytest.approx(denoised.sd_N, rel=0.2)


def test_a_gain_stays_a_gain():
    pad = recorded(2)
    greater = denoised_force(replace(pad, force_N=1.3 * pad.force_N), TURN, USED)
    assert greater.force_N == pytest.approx(1.3 * denoised_force(pad, TURN, USED).force_N, abs=2e-3)


def test_a_drift_of_which_the_gel_knows_nothing_survives():
    drift = (TIME * 2e-3)[:, None, None] * [0.0, 0.0, 1.0]
    denoised = denoised_force(recorded(3, more=drift), TURN, USED)
    more = ((denoised.force_N - denoised_force(recorded(3), TURN, USED).force_N) @ TURN)[:, :, 2].mean(axis=1)
    np.testing.assert_allclose(more, (TIME * 2e-3)[USED], atol=3e-3)


def test_a_gel_that_is_no_bed_of_springs_keeps_its_recorded_patterns():
    gel = -np.sign(FORCE) * np.abs(FORCE / GEL_N_PER_MM) ** 0.6
    assert off(denoised_force(recorded(4, gel=gel), TURN, USED), FORCE) < NOISE_N


def test_where_displacement_is_the_worse_sensor_the_forces_are_taken_as_they_are():
    pad = replace(recorded(5), displacement_sd_mm=2 * NOISE_N / GEL_N_PER_MM[2])
    denoised = denoised_force(pad, TURN, USED)
    np.testing.assert_array_equal(denoised.force_N, pad.force_N[USED])
    assert denoised.sd_N == NOISE_N


def test_a_gel_that_does_not_move_says_nothing_and_the_forces_keep_their_patterns():
    assert off(denoised_force(recorded(6, gel=np.zeros_like(FORCE)), TURN, USED), FORCE) < NOISE_N


def test_forces_near_their_noise_come_out_as_strong_as_they_are():
    """Touching markers are told by their noisy force; a fit to those alone would make springs too stiff."""
    truth = FORCE * (5 * NOISE_N / np.abs(FORCE).max())
    rng = np.random.default_rng(6)
    force = truth + NOISE_N * rng.normal(size=FORCE.shape)
    pad = replace(
        recorded(),
        gel_displacement_mm=(-truth / GEL_N_PER_MM + NOISE_MM * rng.normal(size=FORCE.shape)) @ TURN.T,
        force_N=force @ TURN.T,
        episode=np.where(force[:, :, 2] > 3 * NOISE_N, 0, -1),
    )
    push_N = (denoised_force(pad, TURN, USED).force_N @ TURN)[:, :, 2].sum(axis=1)
    expected = truth[USED][:, :, 2].sum(axis=1)
    assert (push_N @ expected) / (expected @ expected) == pytest.approx(1.0, abs=0.03)


REACH_MM = 0.15
CURVATURE_MM = 30.0


def drawn_out(when: Callable[[str], bool]) -> Altered:
    """Skin of a sphere of radius CURVATURE_MM draws the gel out beside the contact, up to the reach.

    (r^2 - a^2) / 2R over a contact of radius a; at markers within the largest contact, in these phases.
    """
    r2 = (FLAT**2).sum(axis=1)
    height = (r2 - RADII_MM[:, None] ** 2) / 2 / CURVATURE_MM
    chosen = np.array([when(phase) for phase in PHASES])[:, None] & (RADII_MM[:, None] > 0)
    near = r2 < RADII_MM.max() ** 2
    stretch = np.where(chosen & near & (height > 0) & (height < REACH_MM), height, 0.0)

    def change(pad: Recording) -> Recording:
        along = stretch[..., None] * pad.axes[:, 2]
        return replace(
            pad,
            gel_mm=pad.gel_mm + along,
            position_mm=pad.position_mm + along,
            force_N=pad.force_N - GEL_N_PER_MM[2] * along,
        )

    return change


def unevenly(when: Callable[[str], bool]) -> Altered:
    """The same, each marker of the rim with all or nothing of what its square and a neighbour's pull with.

    A rim of pull is narrower than a marker's square. Every pad and every recording by draws of its own.
    """
    rng = np.random.default_rng(11)

    def change(pad: Recording) -> Recording:
        pulled = drawn_out(when)(pad)
        share = 2.0 * rng.integers(2, size=(len(FLAT), 1))
        return replace(pulled, force_N=pad.force_N + share * (pulled.force_N - pad.force_N))

    return change


def drifting(newton_per_s: float) -> Altered:
    """The normal force of a pad grows from the start, evenly over its markers."""
    grown = newton_per_s * TIME_S[:, None, None] / len(FLAT)
    return lambda pad: replace(pad, force_N=pad.force_N + grown * pad.axes[:, 2])


def as_recorded(pad: Recording) -> Recording:
    return pad


STICKS = drawn_out(lambda phase: phase == "unload")
BULGES = drawn_out(lambda phase: phase != "air")


@cache
def adhering_model(altered: Altered) -> CaseModel:
    return case_model(injected_case(altered))[0]


@pytest.fixture
def sticky() -> CaseModel:
    return adhering_model(STICKS)


def chosen(model: CaseModel) -> ModelSelection:
    effects = [effect for effect in EFFECTS if effect.spec.name in ("adhesion", "slip")]
    assert len(effects) == 2
    return select_model(model, screened_effects(model, effects), p_value=0.0)


def test_a_gel_that_sticks_is_named_and_its_reach_is_where_it_lets_go(sticky):
    selection = chosen(sticky)
    assert selection.verdict == "adhesion"
    best = selection.ranking[0].refit
    (parameters,) = best.parameters
    assert parameters[adhesion.REACH] == pytest.approx(REACH_MM, abs=3 * NOISE_MM + 0.01)
    # the forces hold the pull: the response is the plain model's
    for unit, recording in zip(best.response.unit, sticky.grasps, strict=True):
        np.testing.assert_array_equal(unit, recording.tracks.unit_displacement)
    assert best.converged
    value, sd = sticky.pull.reach_mm
    assert NOISE_MM <= sd < 0.02
    assert abs(value - REACH_MM) < 3 * sd


def test_what_a_gel_pulls_with_is_noise_of_the_balance(sticky):
    """A rim of pull is narrower than a marker's square; the sum over markers is off by some of them."""
    pulls = 0
    for recording in sticky.grasps:
        variance = (1 / sticky.balance_equations(recording).weight[:, :3]).sum(axis=1)
        added = variance - variance.min()
        held = np.zeros(len(variance))
        for pad, motion in zip(recording.case.history.pads, recording.case.pads, strict=True):
            normal = np.einsum("tnx,tx->tn", pad.force_N, motion.pose[:, :3, 2])[recording.used]
            held += np.where(normal < -6 * pad.force_sd_N, normal**2, 0.0).sum(axis=1)
        assert (added[held == 0] == 0).all()
        assert added.max() == pytest.approx(held.max(), rel=0.2)
        pulls += int((added > variance.min()).sum())
    assert pulls > 0


def test_a_rim_that_is_felt_unevenly_is_no_third_contact(monkeypatch):
    """What the pads are out of balance by is then not borne by anything else."""
    case = injected_case(unevenly(lambda phase: phase == "unload"))
    model = case_model(case)[0]
    cases = [recording.case for recording in model.grasps]
    assert min(Pull.of([case]).evidence for case in cases) < LEAST_EVIDENCE < Pull.of(cases).evidence
    assert third_contact.EFFECT.signatures(model) == []
    with monkeypatch.context() as patched:
        patched.setattr(CaseModel, "gels_stick", False)
        assert third_contact.EFFECT.signatures(case_model(case)[0]) != []


def test_a_gel_that_bulges_beside_the_contact_adds_no_noise():
    model = adhering_model(BULGES)
    for recording in model.grasps:
        equations = model.balance_equations(recording)
        assert (equations.weight == equations.weight[0]).all()


@pytest.mark.parametrize(
    "altered",
    [as_recorded, BULGES, drifting(-0.3)],
    ids=["null case", "a gel that bulges beside the contact", "a force that drifts to a pull"],
)
def test_what_only_looks_like_a_pull_has_no_signature(altered):
    assert adhesion.EFFECT.signatures(adhering_model(altered)) == []


def test_where_nothing_pulls_every_other_effect_counts_as_without_it():
    model = adhering_model(as_recorded)
    recorded = [GraspEquations.of(model, recording) for recording in model.grasps]
    others = [sensor_drift.EFFECT, slip.EFFECT]
    with_it, without = (screened(model, recorded, tried) for tried in ([*others, adhesion.EFFECT], others))
    assert [fit.gain for fit in with_it.linear_fits] == [fit.gain for fit in without.linear_fits]
    assert with_it.null.chi2 == without.null.chi2
