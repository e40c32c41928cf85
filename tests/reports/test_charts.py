"""What the charts of a fruit are made of, axes, and the colours of classes."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import reports
from reports import charts
from reports.charts import padded
from reports.charts_fruit import fruit_charts, model_curve, residual_um
from reports.entries import FruitEntry
from reports.grasp_record import CurveRecord, FrameRecord, GraspRecord, ModelCurveRecord
from reports.palette import UNKNOWN, class_marks


def fruit_with(recording):
    return FruitEntry(
        fruit_id="A", ok=True, outcome="graded", E_MPa=0.5, E_sd_MPa=0.02, recordings=(recording,)
    )


def layers(chart, kind):
    return [layer for layer in chart["layers"] if layer["kind"] == kind]


def recorded(travel, force, model=None):
    return GraspRecord(
        grasp="g", curves=[CurveRecord(pad="tip", travel_mm=list(travel), force_N=list(force), model=model)]
    )


def hertz_like(rng, *, count, noise_N):
    """Frames of F = 3 d^1.5 in any order with noise in the force, and the model's travel under it."""
    travel = rng.permutation(np.linspace(0.05, 2.0, count))
    force = 3.0 * travel**1.5 + rng.normal(scale=noise_N, size=count)
    model = (np.maximum(force, 0.0) / 3.0) ** (2 / 3)
    return (
        travel,
        force,
        ModelCurveRecord(travel_mm=list(model), force_N=list(force), sd_mm=list(0.02 * model)),
    )


def test_a_force_chart_leaves_out_what_is_not_a_number():
    travel, force = np.linspace(0, 1, 9), np.linspace(0, 5, 9)
    force[3] = np.nan
    chart, *_ = fruit_charts(fruit_with(recorded(travel, force)))
    (marks,) = layers(chart, "marks")
    assert marks["x"] == pytest.approx(np.delete(travel, 3))
    assert marks["y"] == pytest.approx(np.delete(force, 3))
    assert not layers(chart, "line")


def test_what_belongs_to_a_point_goes_with_it():
    gone = float("nan")
    marks = charts.layer(
        "marks", [0, gone, 2, 3], [1, 5, gone, 7], tips=[*"abcd"], y_sd=[0.1, gone, gone, 0.4]
    )
    assert (marks["x"], marks["y"], marks["tips"], marks["y_sd"]) == ([0, 3], [1, 7], ["a", "d"], [0.1, 0.4])
    assert charts.layer("marks", [0, gone], [1, 2], tips=[])["tips"] == []


def test_long_recordings_are_thinned():
    travel = np.linspace(0, 1, 20_000)
    line = ModelCurveRecord(travel_mm=list(travel), force_N=list(travel), sd_mm=list(0.1 * travel))
    assert len(json.dumps(fruit_charts(fruit_with(recorded(travel, travel, line))))) < 20_000


def test_the_models_curve_is_the_law_of_its_frames_whatever_their_order():
    _, _, model = hertz_like(np.random.default_rng(3), count=400, noise_N=0.3)
    curve_mm, curve_N, sd_mm = model_curve([CurveRecord(pad="p", travel_mm=[], force_N=[], model=model)])
    assert (np.diff(curve_N) > 0).all()
    assert (np.diff(curve_mm) >= 0).all()
    assert curve_mm == pytest.approx((curve_N / 3.0) ** (2 / 3), abs=1e-6)
    assert sd_mm == pytest.approx(0.02 * curve_mm, abs=1e-6)
    assert model_curve([]) is None


@pytest.mark.parametrize("seed", range(5))
def test_the_models_curve_bends_one_way_however_its_frames_scatter(seed):
    """Twenty frames, each with 0.1 mm of noise: rising, ever more slowly, and near the noise-free law."""
    rng = np.random.default_rng(seed)
    force = rng.uniform(0.3, 4.0, 20)
    law = lambda N: 0.4 * N ** (2 / 3) + 0.2 * N - 0.2  # noqa: E731
    model = ModelCurveRecord(
        travel_mm=list(law(force) + rng.normal(scale=0.1, size=20)), force_N=list(force), sd_mm=[0.02] * 20
    )
    curve_mm, curve_N, sd_mm = model_curve([CurveRecord(pad="p", travel_mm=[], force_N=[], model=model)])
    assert (np.diff(curve_mm) > 0).all()
    assert (np.diff(curve_mm, 2) < 1e-12).all()
    assert np.sqrt(np.mean((curve_mm - law(curve_N)) ** 2)) < 0.1
    assert sd_mm == pytest.approx(0.02)


def test_the_band_is_two_standard_deviations_of_the_travel_each_way():
    travel, force, model = hertz_like(np.random.default_rng(4), count=60, noise_N=0.0)
    chart, _, *_ = fruit_charts(fruit_with(recorded(travel, force, model)))
    (band,), (line,) = layers(chart, "area"), layers(chart, "line")
    low, high = np.split(np.array(band["x"]), 2)
    assert high[::-1] - low == pytest.approx(4 * 0.02 * np.array(line["x"]), rel=1e-3)
    assert (low + high[::-1]) / 2 == pytest.approx(line["x"], rel=1e-4)


def test_residuals_are_the_travel_beyond_the_curve_and_unknown_outside_it():
    force = np.array([0.5, 1.0, 2.5, 4.0, 9.0])
    curve = CurveRecord(pad="p", travel_mm=list(force / 2 + 0.03), force_N=list(force))
    residual = residual_um(curve, np.array([0.5, 2.0]), np.array([1.0, 4.0]))
    assert np.isnan(residual[[0, 4]]).all()
    assert residual[1:4] == pytest.approx(30.0)


def test_the_residual_chart_states_the_root_mean_square_of_its_marks():
    travel, force, model = hertz_like(np.random.default_rng(5), count=200, noise_N=0.2)
    _, chart, *_ = fruit_charts(fruit_with(recorded(travel, force, model)))
    (marks,) = layers(chart, "marks")
    stated = float(re.findall(r"([\d.]+) µm", chart["description"])[0])
    # 200 frames are thinned to 67 marks, whose root mean square scatters by 1 / sqrt(2 · 67)
    assert stated == pytest.approx(math.sqrt(np.mean(np.square(marks["y"]))), rel=0.3)
    assert chart["group"] == "g"


def test_one_outlier_leaves_the_residuals_their_scale_and_is_counted():
    """Its value is in the caption, and its mark is in the chart, which draws it as an arrow at the edge."""
    travel, force, model = hertz_like(np.random.default_rng(6), count=50, noise_N=0.1)
    plain = fruit_charts(fruit_with(recorded(travel, force, model)))[1]
    travel[7] += 0.8
    chart = fruit_charts(fruit_with(recorded(travel, force, model)))[1]
    (marks,) = layers(chart, "marks")
    assert max(marks["y"]) == pytest.approx(800, rel=0.1)
    assert chart["y"]["limits"] == pytest.approx(plain["y"]["limits"], rel=0.2)
    assert chart["caption"].startswith(plain["caption"])
    assert re.search(r"Arrows: 1 beyond the axis, the farthest at [78]\d\d$", chart["caption"])


def test_a_frame_that_knows_nothing_does_not_set_the_scale():
    frames = [FrameRecord(travel_mm=0.1 * k, E_MPa=0.5, E_sd_MPa=0.01, unloading=k > 9) for k in range(1, 20)]
    lost = FrameRecord(travel_mm=0.01, E_MPa=40.0, E_sd_MPa=39.0)
    chart = fruit_charts(fruit_with(GraspRecord(grasp="g", frames=[*frames, lost])))[-1]
    loading, unloading = layers(chart, "marks")
    assert (len(loading["x"]), loading["faint"]) == (10, False)
    assert (len(unloading["x"]), unloading["faint"]) == (10, True)
    assert chart["y"]["limits"][1] < 3


def test_marks_lie_inside_their_axes(large_batch):
    for chart in fruit_charts(large_batch.fruits[0]):
        for layer in layers(chart, "marks"):
            for axis in "xy":
                low, high = sorted(chart[axis]["limits"])
                assert all(low <= value <= high for value in layer[axis])


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=16), max_size=5), st.booleans())
def test_axis_limits_hold_the_values_and_are_never_empty(values, from_zero):
    lowest, highest = padded(values, from_zero=from_zero)
    assert lowest < highest
    assert all(lowest <= value <= highest for value in values if np.isfinite(value))


def palette(scheme):
    """Colours of static/palette.css by name, light or dark."""
    text = (Path(reports.__file__).parent / "static" / "palette.css").read_text()
    light, dark = text.split("@media screen and (prefers-color-scheme: dark)")
    pairs = re.findall(r"--([\w-]+): #([0-9a-f]+);", light if scheme == "light" else dark)
    return {name: code if len(code) == 6 else "".join(2 * letter for letter in code) for name, code in pairs}


def luminance(code):
    """Relative luminance of WCAG 2.2."""
    channels = np.array([int(code[k : k + 2], 16) for k in (0, 2, 4)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(colour, other):
    low, high = sorted((luminance(colour), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_stand_out_from_the_page(scheme):
    """WCAG 2.2: contrast of at least 3 for graphics, 4.5 for text."""
    colours = palette(scheme)
    marks = [colour for colour, _ in (*class_marks(tuple("abcde")).values(), UNKNOWN)]
    for name in (*marks, "pad0", "pad1", "pad2", "pad3"):
        assert contrast(colours[name], colours["paper"]) > 3.0, name
    for name in ("ink", "soft", "accent", "alarm", "caution", "good", "ship", "hold", "inspect"):
        assert contrast(colours[name], colours["paper"]) > 4.5, name
    for name in ("ship", "hold", "inspect"):
        assert contrast(colours["on-list"], colours[name]) > 4.5, name


def test_light_and_dark_pages_have_the_same_colours_and_no_page_has_others():
    light, dark = palette("light"), palette("dark")
    assert set(light) == set(dark)
    static = Path(reports.__file__).parent / "static"
    for name in ("kiosk.css", "explain.css", "history.css"):
        assert not re.findall(r"#[0-9a-f]{3,6}\b", (static / name).read_text()), name
    for path in static.glob("*.css"):
        if path.name != "uplot.css":
            assert set(re.findall(r"var\(--([\w-]+)\)", path.read_text())) - set(light) <= {"key"}, path.name


def test_classes_differ_in_shape_as_well_as_colour():
    marks = class_marks(("a", "b", "c", "d", "e"))
    assert len({shape for _, shape in marks.values()}) == len({colour for colour, _ in marks.values()}) == 5
