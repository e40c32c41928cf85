"""Sensors drawn wide: their ranges, their gel wide enough, and what markers say of a contact they tile."""

import numpy as np

from samples.mismatch.drawn_fruit import CATEGORIES, drawn_fruit, seen_anew, seen_by_drawn_sensor
from samples.mismatch.marker_sensor import drawn_sensor
from tactile.readers.sensor_model import model_named


def test_drawn_sensors_stay_in_their_ranges_and_cover_the_contact() -> None:
    rng = np.random.default_rng(0)
    drawn = [drawn_sensor(rng, contact_mm=8.0) for _ in range(200)]
    kn = np.array([s.gel.kn_MPa_per_mm for s in drawn])
    ratio = np.array([s.gel.kt_MPa_per_mm for s in drawn]) / kn
    assert 0.1 <= kn.min() < 0.12
    assert 0.42 < kn.max() <= 0.5
    assert ratio.min() >= 0.2
    assert ratio.max() <= 0.35
    assert all(14 <= s.markers <= 22 and 0.8 <= s.pitch_mm <= 1.3 for s in drawn)
    assert all(s.half_width_mm > 8.0 for s in drawn)
    assert len({s.markers for s in drawn}) > 4
    assert {model_named(s.name) for s in drawn} == {None}, "their gels are not that of a sensor model"


def test_another_record_keeps_the_gel_and_changes_noise_scan_and_prior() -> None:
    rng = np.random.default_rng(1)
    first = seen_by_drawn_sensor(drawn_fruit("a", category=CATEGORIES[0], rng=rng), rng)
    again = seen_anew(first, rng)
    assert again.sensor.gel == first.sensor.gel
    assert again.sensor.pitch_mm == first.sensor.pitch_mm
    assert again.sensor.displacement_mm != first.sensor.displacement_mm
    assert again.mesh_error_mm != first.mesh_error_mm
    assert again.prior != first.prior
    assert again.fruit == first.fruit
