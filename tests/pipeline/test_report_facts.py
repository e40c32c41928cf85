"""Facts and settings on the report are words that a reader knows."""

from dataclasses import fields

from pipeline.ranking.report_entries import _QUALITY, _flat, _label, _shown
from recon.checks.quality import ReconQuality


def test_every_measure_of_a_mesh_has_words():
    assert {field.name for field in fields(ReconQuality)} == set(_QUALITY)


def test_a_measure_without_words_is_its_name_with_its_unit():
    assert _label("rim_gap_mm") == "rim gap (mm)"


def test_settings_are_written_as_a_reader_does():
    settings = {
        "recon": {"fruit_model": True, "providers": ["CPU", "GPU"]},
        "mismatch": [],
        "grading": {"classes": [{"name": "ripe", "E_max_MPa": 0.3}, {"name": "firm"}]},
    }
    assert _flat(settings) == [
        ("recon.fruit_model", "yes"),
        ("recon.providers", "CPU, GPU"),
        ("mismatch", "none"),
        ("grading.classes 1: name", "ripe"),
        ("grading.classes 1: E_max_MPa", "0.3"),
        ("grading.classes 2: name", "firm"),
    ]


def test_figures_have_three_digits_and_switches_are_words():
    assert [_shown(value) for value in (0.012345, 1861.4, 24, False)] == ["0.0123", "1861", "24", "no"]
