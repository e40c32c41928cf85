"""The page of a mismatch: verdict first, everything inside one file, hostile text escaped, nothing lost."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import numpy as np
import pytest
from browser import assert_readable, chromium, require_named_cells
from fake_explanation import candidate, fake_explanation

from fem.mismatch.result import Candidate, FruitMap, ModulusCell
from pipeline.diagnosis.diagnosis import Diagnosis
from pipeline.diagnosis.explaining import explain_entry
from reports import explain_page
from reports.effect_words import explain_verdict
from reports.explain_charts import modulus_over_time
from reports.explain_page import explain_html
from reports.skin_picture import map_picture


@pytest.fixture(autouse=True)
def _small_maps(monkeypatch):
    """Pages with maps a few pixels wide; tests/pipeline/test_explain_command.py draws them as wide as users
    see them.
    """
    monkeypatch.setattr(explain_page, "map_picture", partial(map_picture, view_px=50))


OCTAHEDRON = np.array(
    [[4, 0, 2], [4, 2, 1], [4, 1, 3], [4, 3, 0], [5, 2, 0], [5, 1, 2], [5, 3, 1], [5, 0, 3]]
)


def bumpy_map():
    axes = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    return FruitMap(
        vertices_mm=25.0 * axes,
        triangles=OCTAHEDRON,
        modulus_score=np.array([-8.0, 1, 0, 0, 0, 0]),
        visible=np.array([50.0, 50, 0.1, 0.1, 0.1, 0.1]),
    )


def entry(answer=None, **changes):
    answer = answer or fake_explanation()
    made = explain_entry(
        Diagnosis(
            explanation=answer,
            grasps=("grasp-1",),
            contacts_mm={"left": np.array([[24.0, 0, 0], [20, 3, 0], [20, -3, 0]])},
        ),
        **{"case": "N-01", "category": "nectarine", "seconds": {}, "inputs": {}, "versions": {}},
        made=datetime(2026, 11, 20, 9, tzinfo=UTC),
    )
    known = {
        "cells": tuple(
            ModulusCell(grasp="grasp-1", pad=pad, time_s=float(s), phase="hold", E_MPa=0.3, E_sd_MPa=0.01)
            for pad in ("left", "right")
            for s in range(20)
        ),
        "traces": answer.traces[:1],
        "maps": bumpy_map(),
        "notes": ("Only one grasp.",),
    }
    return replace(made, **known | changes)


def test_the_verdict_stands_first_and_the_sections_follow_in_order():
    page = explain_html(entry())
    order = [
        "The flesh creeps",
        "What to do:",
        "Only one grasp.",
        "What explains it",
        "0.28",
        "six sides",
        'class="drawn"',
        "drupe predicts each recording",
        "What to record next",
        "Hold one grasp",
        "E over time, grasp-1",
        "Force over approach, grasp-1",
    ]
    places = [page.index(words) for words in order]
    assert places == sorted(places)


def test_the_page_is_whole_without_a_network_and_the_same_each_time():
    page = explain_html(entry())
    assert page.count("<script") == 3  # data of the charts, their library, and what draws them
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "default-src 'none'" in page
    assert page == explain_html(entry())


def test_hostile_text_stays_text(hostile):
    page = explain_html(
        entry(case=hostile, notes=(hostile,), next_grasp=hostile, grasps=(hostile,), inputs={hostile: "ab"})
    )
    assert page.count("<script") == 3
    assert "{{ 7*7 }}" in page


@pytest.mark.parametrize(
    "verdict",
    [
        ("none",),
        pytest.param(("unknown",), marks=pytest.mark.proof),
        ("clock_lag", "viscoelastic"),
        pytest.param(("skin+slip",), marks=pytest.mark.proof),
    ],
)
def test_every_kind_of_verdict_has_a_page_even_with_nothing_else_known(verdict):
    nothing = dict.fromkeys(("ranking", "cells", "traces", "notes"), ())
    nothing |= {"maps": None, "heldout": None, "next_grasp": None, "contacts_mm": {}}
    bare = entry(verdict=verdict, **nothing)
    assert explain_verdict(bare) in explain_html(bare).replace("&#39;", "'")
    full = entry(verdict=verdict)
    assert explain_verdict(full) in explain_html(full).replace("&#39;", "'")


def test_the_verdict_states_the_scales_that_no_error_bar_of_it_includes():
    scales = "Each ± excludes the sensor's scales, 8.0 % of E."
    assert explain_verdict(entry(verdict=("none",), scale_sd=0.08)).endswith(scales)
    assert "scales" not in explain_verdict(entry(verdict=("none",)))
    assert "scales" not in explain_verdict(entry(scale_sd=0.08, withheld="no law holds"))


def test_an_effect_named_from_one_recording_is_called_unconfirmed():
    confirmed, single = entry(grasps=("a", "b")), entry(grasps=("a",))
    said = "One recording cannot confirm an effect: record another."
    assert said in explain_verdict(single)
    assert said in explain_verdict(replace(single, verdict=("pose_error", "slip")))
    assert said not in explain_verdict(confirmed)
    assert said not in explain_verdict(replace(single, verdict=("none",)))


def test_an_effect_without_words_is_told_by_its_name():
    pose = Candidate(effect="pose_error", probability=1.0, parameters={}, log_evidence=9.0, gain=20.0)
    pose_entry = entry(verdict=("pose_error",), effects={}, ranking=(pose,))
    assert "Pose error (pose error" in explain_verdict(pose_entry)


def test_parameters_have_titles_with_units_and_no_names_of_the_program():
    page = explain_html(entry()).replace("\u00a0", " ")
    assert "Share of the resistance that fades: 0.310 ± 0.015<br>" in page
    assert '<th scope="row">Time over which it fades (s)</th>' in page
    assert not re.search(r">[^<]*\b(tau_s|lag_s|Et_N_per_mm)\b", page.partition("<script")[0])


def test_parameters_of_one_title_are_apart():
    pads = {"sensor_gain.pad": "left", "sensor_drift.pad": "right"}
    pair = candidate("sensor_gain+sensor_drift", 1.0, gain=1.1, **pads)
    page = explain_html(entry(answer=fake_explanation(ranking=(pair,))))
    for title in ("Which pad, sensor gain: left", "Which pad, sensor drift: right"):
        assert title in page
    further = candidate("viscoelastic", 1.0, g=0.2, g_2=0.1, tau_s=4.2, tau_2_s=40.0)
    page = explain_html(entry(answer=fake_explanation(ranking=(further,))))
    heads = re.findall(r'<th scope="row">(.*?)</th>', page)
    assert [head for head in heads if "fades" in head] == [
        "Share of the resistance that fades", "Share of the resistance that fades, g_2",
        "Time over which it fades (s)", "Time over which it fades (s), tau_2_s",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_and_nothing_is_cut_off(tmp_path, scheme, width):
    pages = {
        "several": entry(verdict=("clock_lag", "viscoelastic")),
        "unknown": entry(verdict=("unknown",), withheld="no law holds", heldout=None, p_nominal="nominal"),
    }
    with chromium() as browser:
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        for name, shown in pages.items():
            path = tmp_path / f"{name}.html"
            path.write_text(explain_html(shown), encoding="utf-8")
            page.goto(path.as_uri())
            assert_readable(page, width)


@pytest.mark.slow
def test_on_a_phone_each_cell_names_its_column(tmp_path):
    path = tmp_path / "mismatch.html"
    path.write_text(explain_html(entry()), encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 900})
        page.goto(path.as_uri())
        cells = page.locator(".stacked td:visible")
        assert cells.count() == 3 * 6 + 2 * 2  # explanations; parameters of the first
        require_named_cells(cells)
        assert not any(
            head.is_visible() and head.bounding_box()["x"] >= 0 for head in page.locator("thead").all()
        )


def test_no_two_parts_of_the_page_have_one_name():
    """As a screen reader lists them."""
    labels = re.findall(r'<(?:section|div)[^>]*aria-label(?:ledby)?="([^"]*)"', explain_html(entry()))
    assert len(labels) > 7
    assert len(set(labels)) == len(labels)


def test_pads_have_the_colours_that_they_have_elsewhere():
    """All pads together come last."""
    cells = tuple(
        ModulusCell(grasp="grasp-1", pad=pad, phase="loading", time_s=t, E_MPa=1.0 + 0.01 * t, E_sd_MPa=0.01)
        for pad in ("all", "left", "right")
        for t in (0.0, 1.0)
    )
    (chart,) = modulus_over_time(entry(cells=cells), with_effect=False)
    marks = [layer for layer in chart["layers"] if layer["kind"] == "marks"]
    named = [(layer["name"], layer["colour"], layer["shape"]) for layer in marks]
    assert named[:2] == [("pad left", "pad0", "circle"), ("pad right", "pad1", "square")]
    assert named[2][0] == "all pads"


def test_lines_of_E_are_named_in_the_key_where_they_cover_no_mark():
    (chart,) = modulus_over_time(entry(), with_effect=True)
    lines = [layer for layer in chart["layers"] if layer["kind"] == "rules"]
    assert [layer["name"] for layer in lines] == ["without", "with the effect"]
    assert not any(layer["names"] for layer in lines)
