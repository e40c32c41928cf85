"""A sensor's gain and scale in E's error bar, and what a reference body makes of them."""

import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from graded_results import graded

from pipeline.batch.records import ModulusRecord
from pipeline.batch.settings import SensorSettings
from pipeline.fruit.elasticity import GAIN, OWN_GAIN, SENSOR
from pipeline.fruit.sensor_scale import COMMON_SD, E_PER_GAIN, PICTURE_SD, known_gels, sensor_scale
from pipeline.ranking.error_parts import COMMON_SCALE, about_error
from pipeline.ranking.reference_ratio import PART, Ratio, against_references, corrected_modulus
from pipeline.ranking.report_entries import _facts
from pipeline.ranking.verified_scale import verified, with_own_gain
from reports.entries import FruitEntry
from reports.tables import RANKING_COLUMNS, _row
from tactile.consistency.finding import FindingKind
from tactile.consistency.gain import GAIN_SD, LAW_SD, UnseenGain, gain_left
from tactile.consistency.of_recording import recording_findings
from tactile.readers.recording import GelPad, read_recording

SAMPLE = Path(__file__).parents[2] / "samples" / "data" / "two-fruits" / "fruits" / "N01" / "grasps"

LAW = 1.1 * E_PER_GAIN * LAW_SD
"""What the law's own error leaves of E in sound recordings, a tenth more for their noise."""


@pytest.fixture(scope="module")
def sound():
    return [read_recording(path) for path in sorted(SAMPLE.glob("*.h5"))]


def changed(sound, *, only="", **factors):
    """Fields of the pads times factors."""

    def scaled(pad):
        if only not in pad.name or not isinstance(pad, GelPad):
            return pad
        return replace(pad, **{name: getattr(pad, name) * by for name, by in factors.items()})

    return [replace(recording, pads=tuple(map(scaled, recording.pads))) for recording in sound]


def kinds(recordings, settings=None):
    """What is said of the gels by what is known of their sensor."""
    return {
        finding.kind
        for recording in recordings
        for finding in recording_findings(recording, None, None, gels=known_gels(recording.sensor, settings))
    }


@pytest.mark.parametrize(
    ("force", "only", "error"),
    [(1.0, "", 0.0), (1.065, "", 0.067), (0.935, "", 0.067), (1.065, "left", 0.034)],
)
def test_a_gain_below_the_checks_limit_is_in_the_error_bar(sound, force, only, error):
    """`error`: what it does to E of this fruit (benchmarks/field_mistakes.py --grade)."""
    gain = sensor_scale(changed(sound, force_N=force, only=only), None).gain
    assert error / 2 < gain < 1.3 * error + LAW


def test_a_gain_that_the_check_reports_is_the_findings(sound):
    assert sensor_scale(changed(sound, force_N=1.25), None).gain < LAW


@pytest.mark.parametrize("n", [1, 2, 20])
@pytest.mark.parametrize("noise", [0.002, 0.04])
def test_the_bias_of_the_gels_law_does_not_average_out_over_grasps(n, noise):
    """Gains, biases and noise as assumed; a gain that is left has the root mean square that is given."""
    rng = np.random.default_rng(n)
    left = []
    for _ in range(1500):
        gain, bias = rng.normal(0, GAIN_SD), rng.normal(0, LAW_SD)
        unseen_gain = gain_left(gain + bias + rng.normal(0, noise, n), np.full(n, noise))
        left.append(gain / np.hypot(unseen_gain.shared, unseen_gain.independent))
    assert 0.9 < np.sqrt(np.mean(np.square(left))) < 1.1


def test_only_the_noise_of_recordings_is_their_own():
    few, many = (gain_left(np.zeros(n), np.full(n, 0.01)) for n in (1, 100))
    assert few.independent > 0.008
    assert many.independent < few.independent / 8
    assert few.shared == pytest.approx(many.shared, rel=0.1)
    assert gain_left(np.full(9, 0.06), np.full(9, 0.01)).independent == pytest.approx(
        few.independent / 3, rel=0.1
    )


def test_a_gain_that_no_recording_measures_has_its_prior_spread(sound):
    dead = changed(sound, displacement_mm=0.0, force_N=0.0)
    assert sensor_scale(dead, None).gain == pytest.approx(1.1 * 0.04)


@pytest.mark.parametrize("change", [{}, {"displacement_mm": 1.1, "force_N": 1.1}, {"rest_mm": 1.1}])
@pytest.mark.parametrize("sensor", ["20x20 marker gel", "own gel"])
def test_ten_per_cent_of_the_pictures_are_in_the_error_bar_whether_the_pitch_is_known_or_not(
    sound, change, sensor
):
    """E is 14.8 % off where displacement and forces are 1.1 times too large, rest positions as designed. A
    pitch that is off has a doubt of its own, so that it makes this part no wider.
    """
    read_so = changed([replace(recording, sensor=sensor) for recording in sound], **change)
    pictures = sensor_scale(read_so, None).pictures
    assert np.log(1.148) / 2 < pictures < 0.1
    assert pictures == pytest.approx(1.45 * PICTURE_SD)


def test_ten_per_cent_of_the_pictures_at_rest_positions_as_designed_are_not_doubted(sound):
    assert kinds(changed(sound, displacement_mm=1.1, force_N=1.1)) == set()


@pytest.mark.parametrize("by", ["displacement_scale_sd", "picture_scale_sd"])
@pytest.mark.parametrize("sd", [0.01, 0.05, 0.1])
def test_a_stated_picture_scale_has_the_share_of_the_forces_too(sound, by, sd):
    stated, settings = sound, SensorSettings(name="own", picture_scale_sd=sd)
    if by == "displacement_scale_sd":
        stated = [
            replace(recording, pads=tuple(replace(pad, displacement_scale_sd=sd) for pad in recording.pads))
            for recording in sound
        ]
        settings = SensorSettings(name="own", picture_scale_sd=0.2)
    assert sensor_scale(stated, settings).pictures == pytest.approx(1.45 * sd)


def test_the_common_scale_is_stated_by_the_recording_or_by_the_batch_or_assumed(sound, tmp_path):
    assert sensor_scale(sound, None).common == COMMON_SD == 0.03
    batch = SensorSettings(name="gel", common_scale_sd=0.01)
    assert sensor_scale(sound, batch).common == pytest.approx(0.01)
    path = tmp_path / "g.h5"
    path.write_bytes((SAMPLE / "grasp-1.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs["force_scale_sd"] = 0.02
    assert sensor_scale([read_recording(path)], batch).common == pytest.approx(0.02)
    with h5py.File(path, "r+") as file:
        file["pads/left"].attrs["force_scale_sd"] = 0.06
    assert sensor_scale([read_recording(path)], batch).common == pytest.approx(0.04)


@pytest.mark.parametrize("factor", [2.0, 0.5, 1.2, 1 / 1.2])
def test_stiffness_and_forces_off_together_are_doubted_by_the_sensors_model(sound, factor):
    scaled = changed(sound[:1], force_N=factor, gel_kn_MPa_per_mm=factor, gel_kt_MPa_per_mm=factor)
    assert kinds(scaled) == {FindingKind.STIFFNESS_NOT_OF_SENSOR}


def test_a_sensor_without_a_model_is_compared_with_the_batchs_settings(sound):
    scaled = changed(sound[:1], force_N=1.2, gel_kn_MPa_per_mm=1.2, gel_kt_MPa_per_mm=1.2)
    unknown = [replace(recording, sensor="own gel") for recording in scaled]
    assert kinds(unknown) == set()
    settings = SensorSettings(name="own gel", gel_kn_MPa_per_mm=0.22)
    assert kinds(unknown, settings) == {FindingKind.STIFFNESS_NOT_OF_SENSOR}


def test_no_check_of_a_recording_by_itself_sees_stiffness_and_forces_off_together(sound):
    (scaled, _) = changed(sound, force_N=2.0, gel_kn_MPa_per_mm=2.0, gel_kt_MPa_per_mm=2.0)
    assert recording_findings(scaled, None, None) == []
    (finding,) = recording_findings(scaled, None, None, gels=known_gels(scaled.sensor, None))
    assert "gel_kn_MPa_per_mm is 0.44" in finding.says
    assert finding.relative_sd > 0.25  # half of what E is off, over E as found


def test_a_sound_gel_and_one_within_three_deviations_are_not_doubted(sound):
    assert kinds(sound) == set()
    near = changed(sound, force_N=1.1, gel_kn_MPa_per_mm=1.1, gel_kt_MPa_per_mm=1.1)
    assert kinds(near) == set()
    assert kinds(near, SensorSettings(name="gel", gel_kn_MPa_per_mm=0.242, gel_kt_MPa_per_mm=0.0605)) == set()


@pytest.mark.parametrize("scale", [1.1, 0.9, 1.04])
def test_a_pitch_that_is_not_the_sensors_is_doubted(sound, scale):
    plane = np.array([scale, scale, 1.0])
    assert kinds(changed(sound[:1], rest_mm=plane, force_N=scale**2)) == {FindingKind.PITCH_NOT_OF_SENSOR}


OWN, PICTURES, HIDDEN_GAIN, COMMON = 0.012, 0.05, UnseenGain(shared=0.03, independent=0.004), 0.03
OWN_GAIN_OF_E = E_PER_GAIN * HIDDEN_GAIN.independent


def record(name, E_MPa, *, known=None, outcome="graded", gain=HIDDEN_GAIN):
    """As grading leaves it: relative parts OWN, PICTURES and `gain` of the error, COMMON beside it."""
    own_gain, shared_gain = E_PER_GAIN * gain.independent * E_MPa, E_PER_GAIN * gain.shared * E_MPa
    parts = {"noise": OWN * E_MPa, SENSOR: PICTURES * E_MPa, GAIN: shared_gain, OWN_GAIN: own_gain}
    modulus = ModulusRecord(
        E_MPa=E_MPa,
        E_sd_MPa=math.hypot(*parts.values()),
        common_sd_MPa=math.hypot(PICTURES * E_MPa, shared_gain),
        scale_sd_MPa=COMMON * E_MPa,
        parts_sd_MPa=parts,
    )
    given = {} if known is None else {"reference_E_MPa": known, "reference_E_sd_MPa": 0.01 * known}
    changes = {"outcome": outcome, "modulus": modulus if outcome == "graded" else None}
    return graded(name, E_MPa, changes=changes, reference=known is not None, **given)


def after(read, *, correct):
    """A fruit of 0.4 MPa beside a body of 0.5, both read by this factor."""
    checked_records, _ = against_references(
        [record("soft", 0.4 * read), record("ball", 0.5 * read, known=0.5)], correct=correct
    )
    return checked_records[0].modulus


def adds_up(modulus):
    return math.hypot(*modulus.parts_sd_MPa.values()) == pytest.approx(modulus.E_sd_MPa)


def test_a_body_shows_a_gain_that_the_assumed_scales_would_cover():
    """6 % are one standard deviation of what is assumed, and four of what the body is known to."""
    corrected = after(1.06, correct=True)
    assert corrected.E_MPa == pytest.approx(0.4)
    assert corrected.scale_sd_MPa == corrected.parts_sd_MPa[SENSOR] == corrected.parts_sd_MPa[GAIN] == 0.0
    assert corrected.parts_sd_MPa[OWN_GAIN] == pytest.approx(0.4 * OWN_GAIN_OF_E)
    assert corrected.parts_sd_MPa[PART] == pytest.approx(0.4 * math.hypot(OWN, 0.01, OWN_GAIN_OF_E))
    assert corrected.common_sd_MPa == pytest.approx(corrected.parts_sd_MPa[PART])
    assert adds_up(corrected)
    doubted = after(1.06, correct=False)
    assert doubted.E_sd_MPa > math.log(1.06) * doubted.E_MPa
    assert adds_up(doubted)


def test_a_body_read_as_known_leaves_what_it_is_known_to():
    modulus = after(1.0, correct=False)
    body = math.hypot(OWN, 0.01, OWN_GAIN_OF_E)
    parts = modulus.parts_sd_MPa
    left = math.hypot(modulus.scale_sd_MPa, parts[SENSOR], parts[GAIN]) / modulus.E_MPa
    assert left < body < math.hypot(PICTURES, COMMON)
    assert modulus.scale_sd_MPa < COMMON / 3 * modulus.E_MPa
    assert adds_up(modulus)


def test_without_a_graded_body_the_assumed_scale_stays():
    records = [record("soft", 0.4), record("ball", 0.5, known=0.5, outcome="never-touches")]
    checked_records, _ = against_references(records, correct=True)
    assert checked_records[0].modulus == records[0].modulus
    assert against_references(records[:1], correct=False)[0][0].modulus == records[0].modulus


def test_a_body_that_contradicts_the_assumed_scales_makes_them_wider():
    """1 % is assumed; a ratio that is further from 1 than that and its own error allow leaves more."""
    before = ModulusRecord(
        E_MPa=0.4,
        E_sd_MPa=0.005,
        common_sd_MPa=0.004,
        scale_sd_MPa=0.0,
        parts_sd_MPa={SENSOR: 0.004, "a": 0.003},
    )
    for ln_ratio, ln_sd in ((0.06, 0.01), (-0.06, 0.005), (0.1, 0.06)):
        after = verified(before, ln_ratio, ln_sd)
        w = 0.01**2 / (0.01**2 + ln_sd**2)
        expected = math.sqrt((w * ln_ratio) ** 2 + w * ln_sd**2)
        assert after.parts_sd_MPa[SENSOR] == pytest.approx(0.4 * expected)
        assert (after.parts_sd_MPa[SENSOR] > before.parts_sd_MPa[SENSOR]) == (
            abs(ln_ratio) > math.hypot(0.01, ln_sd)
        )
        assert after.common_sd_MPa == pytest.approx(after.parts_sd_MPa[SENSOR])
        assert adds_up(after)


@pytest.mark.parametrize("ratio", [0.9, 1.0, 1.2])
def test_the_gain_of_the_gripper_goes_with_the_bodys_ratio_and_the_noise_of_a_fruit_stays(ratio):
    before = record("soft", 0.4, gain=UnseenGain(shared=0.05, independent=0.02)).modulus
    after = corrected_modulus(before, Ratio(ratio=ratio, ln_sd=0.01))
    assert after.parts_sd_MPa[GAIN] == 0.0
    assert after.parts_sd_MPa[OWN_GAIN] == pytest.approx(0.4 / ratio * E_PER_GAIN * 0.02)
    assert after.E_sd_MPa / after.E_MPa == pytest.approx(math.hypot(OWN, E_PER_GAIN * 0.02, 0.01))


@pytest.mark.parametrize("ratio", [1.0, 1.2])
def test_a_gain_that_only_one_fruits_recordings_show_stays_in_its_error_bar(ratio):
    odd = record("odd", 0.4 * ratio, gain=UnseenGain(shared=0.07, independent=0.004))
    ball = record("ball", 0.5 * ratio, known=0.5)
    modulus = against_references([odd, ball], correct=True)[0][0].modulus
    own_gain_sd = E_PER_GAIN * math.sqrt(0.07**2 - HIDDEN_GAIN.shared**2)
    assert modulus.parts_sd_MPa[OWN_GAIN] / modulus.E_MPa == pytest.approx(
        math.hypot(own_gain_sd, OWN_GAIN_OF_E)
    )
    assert math.sqrt(modulus.E_sd_MPa**2 - modulus.common_sd_MPa**2) > own_gain_sd * modulus.E_MPa
    split = with_own_gain(odd.modulus, HIDDEN_GAIN.shared * E_PER_GAIN)
    assert adds_up(split)
    assert split.E_sd_MPa == odd.modulus.E_sd_MPa
    assert with_own_gain(odd.modulus, 0.1) == odd.modulus


@pytest.mark.parametrize("correct", [False, True])
def test_the_error_bar_covers_drawn_grippers(correct):
    """Scales and gains drawn as they are assumed, the gain measured in four pads of fruit and body with one
    bias of the gel's law; the error of E over both parts of its error bar.
    """
    rng = np.random.default_rng(5)
    z = []
    for _ in range(1000):
        gain, bias = rng.normal(0, GAIN_SD), rng.normal(0, LAW_SD)
        scale = math.exp(rng.normal(0, math.hypot(COMMON, PICTURES)) + E_PER_GAIN * gain)
        of_fruit, of_body = (gain_left(gain + bias + rng.normal(0, 0.01, 4), np.full(4, 0.01)) for _ in "fb")
        fruit = record("soft", 0.4 * scale * math.exp(rng.normal(0, OWN)), gain=of_fruit)
        read = 0.5 * scale * math.exp(rng.normal(0, OWN) + rng.normal(0, 0.01))
        body = record("ball", read, known=0.5, gain=of_body)
        modulus = against_references([fruit, body], correct=correct)[0][0].modulus
        sd = math.hypot(modulus.E_sd_MPa, modulus.scale_sd_MPa)
        z.append(math.log(modulus.E_MPa / 0.4) * modulus.E_MPa / sd)
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.1
    assert np.mean(np.abs(z) > 2) < 0.07


def test_the_error_bar_without_a_body_covers_drawn_grippers():
    rng = np.random.default_rng(6)
    z = []
    for _ in range(1000):
        gain, bias = rng.normal(0, GAIN_SD), rng.normal(0, LAW_SD)
        left = gain_left(gain + bias + rng.normal(0, 0.01, 4), np.full(4, 0.01))
        error = rng.normal(0, math.hypot(COMMON, PICTURES, OWN)) + E_PER_GAIN * gain
        modulus = record("soft", 0.4, gain=left).modulus
        z.append(error / (math.hypot(modulus.E_sd_MPa, modulus.scale_sd_MPa) / 0.4))
    assert 0.92 < np.sqrt(np.mean(np.square(z))) < 1.08


def test_report_and_ranking_show_the_common_scale_beside_the_error_bar():
    fruit = record("soft", 0.4)
    said = about_error(fruit.modulus)
    assert f"A {COMMON_SCALE} adds ± 3 % of E" in said
    assert "To remove it, add a body of known modulus to fruits.csv (reference = true)." in said
    assert (f"In addition to the error bar: {COMMON_SCALE}", "± 0.012 MPa") in _facts(fruit, None)
    entry = FruitEntry(fruit_id="soft", ok=True, outcome="graded", E_MPa=0.4, E_scale_sd_MPa=0.012)
    assert RANKING_COLUMNS[26] == "E_scale_sd_MPa"
    assert _row(entry)["E_scale_sd_MPa"] == 0.012
    assert COMMON_SCALE not in about_error(fruit.modulus.model_copy(update={"scale_sd_MPa": 0.0}))
