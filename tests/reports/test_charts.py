import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.charts_batch import ranking_chart, shore_chart, shortened
from reports.charts_fruit import force_chart, frames_chart, grasps_chart
from reports.entries import FruitEntry
from reports.grasp_record import CurveRecord, FrameRecord, GraspRecord, ModelCurveRecord
from reports.palette import UNKNOWN, class_marks
from reports.svg import AxisScale, padded, ticks


def parsed(chart):
    return ET.fromstring(str(chart))


def middles(chart):
    """Centre of every mark, in order."""
    found = []
    for mark in parsed(chart).iter():
        if not (mark.get("class") or "").startswith("mark"):
            continue
        if mark.tag == "circle":
            found.append((float(mark.get("cx", "")), float(mark.get("cy", ""))))
        else:
            points = np.array([pair.split(",") for pair in mark.get("points", "").split()], float)
            found.append((float(np.mean(points[:, 0])), float(np.ptp(points[:, 1]) / 2 + points[:, 1].min())))
    return found


def test_ranking_places_marks_by_modulus_softest_on_top(awkward_batch):
    places = np.array(middles(ranking_chart(awkward_batch, width_px=900)))
    moduli = np.array([0.21, 0.33, 0.58, 1.42])
    assert (np.diff(places[:, 1]) > 0).all()
    slope = np.diff(places[:, 0]) / np.diff(moduli)
    assert np.allclose(slope, slope.mean(), rtol=0.01)


def test_ranking_draws_every_class_limit_that_is_near(awkward_batch):
    limits = parsed(ranking_chart(awkward_batch, width_px=360)).iter("line")
    assert sum(line.get("class") == "limit" for line in limits) == 2
    far = replace(awkward_batch, classes=(("ripe", 0.35), ("hard", 50.0), ("stone", None)))
    drawn = parsed(ranking_chart(far, width_px=360))
    assert sum(line.get("class") == "limit" for line in drawn.iter("line")) == 1


def test_whiskers_are_one_standard_deviation_each_way(awkward_batch, graded):
    fruits = (graded("a", rank=1, E_MPa=0.5), graded("b", rank=2, E_MPa=1.0))
    chart = parsed(ranking_chart(replace(awkward_batch, fruits=fruits, classes=()), width_px=900))
    places = middles(ranking_chart(replace(awkward_batch, fruits=fruits, classes=()), width_px=900))
    per_MPa = (places[1][0] - places[0][0]) / 0.5
    paths = [path.get("d", "") for path in chart.iter("path") if "whisker" in path.get("class", "")]
    low, high = (float(re.findall(pattern, paths[1])[0]) for pattern in (r"^M([\d.]+),", r"H([\d.]+)"))
    assert (high - low) / 2 == pytest.approx(0.03 * per_MPa, abs=0.1)
    assert (high + low) / 2 == pytest.approx(places[1][0], abs=0.1)


def test_all_drawing_stays_inside_the_picture(awkward_batch, large_batch):
    charts = [
        ranking_chart(batch, width_px=px) for batch in (awkward_batch, large_batch) for px in (360, 900)
    ]
    charts += [shore_chart(large_batch), grasps_chart(large_batch.fruits[0])]
    charts += [force_chart(large_batch.fruits[0].recordings[0])]
    for chart in charts:
        width, height = (float(value) for value in parsed(chart).get("viewBox", "").split()[2:])
        places = np.array(middles(chart))
        assert (places > 0).all()
        assert (places < [width, height]).all()


def test_charts_have_no_ids_to_clash_and_no_styles(large_batch):
    for chart in (ranking_chart(large_batch, width_px=900), shore_chart(large_batch)):
        for part in parsed(chart).iter():
            assert not {"id", "style", "href"} & set(part.attrib)


def test_ranking_without_a_modulus_or_without_deviations_is_still_a_chart(empty_batch):
    assert middles(ranking_chart(empty_batch, width_px=360)) == []
    bare = FruitEntry(fruit_id="a", ok=True, outcome="graded", rank=1, E_MPa=0.3)
    assert len(middles(ranking_chart(replace(empty_batch, fruits=(bare,)), width_px=360))) == 1


def recorded(travel, force, model=None):
    curve = CurveRecord(pad="tip", travel_mm=list(travel), force_N=list(force), model=model)
    return GraspRecord(grasp="g", curves=[curve])


def test_force_curve_leaves_out_what_is_not_a_number():
    travel, force = np.linspace(0, 1, 9), np.linspace(0, 5, 9)
    force[3] = np.nan
    chart = force_chart(recorded(travel, force))
    assert len(re.findall(r"M[\d.]+ [\d.]+h0", chart)) == 8
    assert len(list(parsed(chart).iter("polyline"))) == 2
    assert middles(force_chart(recorded(np.full(3, np.nan), np.full(3, np.nan)))) == []


def test_long_recordings_are_thinned():
    travel = np.linspace(0, 1, 20_000)
    line = ModelCurveRecord(travel_mm=list(travel), force_N=list(travel), sd_mm=list(0.1 * travel))
    assert len(force_chart(recorded(travel, travel, line))) < 40_000


def test_the_models_line_lies_in_its_band_and_both_reach_the_last_frame():
    travel = np.linspace(0, 2, 41)
    line = ModelCurveRecord(
        travel_mm=list(travel + 0.1), force_N=list(travel**1.5), sd_mm=list(0.05 * travel)
    )
    tree = parsed(force_chart(recorded(travel, travel**1.5, line)))
    drawn = [one.get("points") for one in tree.iter("polyline") if "model" in one.get("class", "")]
    (band,) = [one.get("points") for one in tree.iter("polygon") if "spread" in one.get("class", "")]
    (points,) = [np.array([pair.split(",") for pair in text.split()], dtype=float) for text in drawn]
    corners = np.array([pair.split(",") for pair in band.split()], dtype=float)
    low, high = np.split(corners, 2)
    assert points[:, 0] == pytest.approx((low[:, 0] + high[::-1, 0]) / 2, abs=0.11)
    assert corners[:, 0].max() > points[-1, 0] + 5
    assert points[-1, 1] == points[:, 1].min()


def test_a_frame_that_knows_nothing_does_not_set_the_scale():
    frames = [FrameRecord(travel_mm=0.1 * k, E_MPa=0.5, E_sd_MPa=0.01, unloading=k > 9) for k in range(1, 20)]
    lost = FrameRecord(travel_mm=0.01, E_MPa=40.0, E_sd_MPa=39.0)
    recording = GraspRecord(grasp="g", frames=[*frames, lost])
    fruit = FruitEntry(
        fruit_id="A", ok=True, outcome="graded", E_MPa=0.5, E_sd_MPa=0.02, recordings=(recording,)
    )
    chart = frames_chart(fruit)
    assert len(re.findall(r"M[\d.]+ [\d.]+h0", chart)) == 19
    assert "faint" in chart
    assert max(float(t) for t in re.findall(r">(\d+\.?\d*)</text>", chart)) < 3


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.integers(2, 12))
def test_ticks_are_few_and_inside(lowest, span, at_most):
    found = ticks(lowest, lowest + span, at_most=at_most)
    assert len(found) <= at_most
    slack = 1e-6 * (span + abs(lowest))
    assert all(lowest - slack <= value <= lowest + span + slack for value in found)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=16), max_size=5), st.booleans())
def test_axis_limits_hold_the_values_and_are_never_empty(values, from_zero):
    lowest, highest = padded(values, from_zero=from_zero)
    assert lowest < highest
    assert all(lowest <= value <= highest for value in values if np.isfinite(value))


def test_scale_maps_its_ends_onto_its_ends():
    scale = AxisScale(lowest=2.0, highest=4.0, start_px=100.0, end_px=0.0)
    assert [scale(value) for value in (2.0, 3.0, 4.0)] == [100.0, 50.0, 0.0]


def test_class_colours_stand_out_from_white():
    """WCAG 2.2 contrast (L1 + 0.05) / (L2 + 0.05) of at least 3 for graphics."""
    for colour, _ in [*class_marks(("a", "b", "c", "d", "e")).values(), UNKNOWN]:
        channels = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        assert 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) > 3.0


def test_classes_differ_in_shape_as_well_as_colour():
    marks = class_marks(("a", "b", "c", "d", "e"))
    assert len({shape for _, shape in marks.values()}) == len({colour for colour, _ in marks.values()}) == 5


def test_a_long_name_is_cut_in_its_middle():
    assert shortened("short", px=100.0) == "short"
    cut = shortened("x" * 40 + "-17", px=100.0)
    assert len(cut) <= 100.0 / 7.4
    assert cut.endswith("-17")
