"""E's error bar holds a gain and a scale that no check reports; a common factor stands beside it."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.batch.settings import SensorSettings
from pipeline.fruit.sensor_scale import COMMON_SD, E_PER_GAIN, PICTURE_SD, known_gels, sensor_scale
from tactile.consistency.finding import FindingKind
from tactile.consistency.gain import GAIN_SD, LAW_SD, gain_left
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
        measured = gain + bias + rng.normal(0, noise, n)
        unseen_gain = gain_left(measured, np.full(n, noise))
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


def test_the_sensor_of_a_recording_is_found_by_name_key_and_serial():
    sources = [
        [gel.source for gel in known_gels(name, None)]
        for name in (
            "GelSight Mini, marked gel",
            "gelsight-mini",
            "Tac3D A1-0040R",
            "20x20 marker gel",
            "gel",
        )
    ]
    model = 'the sensor model "{}"'
    names = ["gelsight-mini", "gelsight-mini", "tac3d", "marker-gel-20x20"]
    assert sources == [*([model.format(name)] for name in names), []]
