"""Mistakes of the field: in table, page and exit status, and scored by the kind of what is said of them."""

import json
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from field_list import MISTAKES, naming
from field_mistakes import E_range_MPa
from sample_batches import drupe, first_fruit, ready_batch, scale_force

from pipeline.fruit.input_doubts import Doubt, PitKind
from tactile.consistency.finding import Finding, FindingKind

ROOT = Path(__file__).parents[2]


def named_by(kind, how="named", **more):
    of_recording = isinstance(kind, FindingKind)
    words = "in whatever words"
    answer = Finding(kind, words, **more) if of_recording else Doubt(sentence=words, kind=kind, **more)
    return {mistake.name for mistake in MISTAKES if naming(answer, mistake) == how}


@pytest.mark.parametrize("kind", [FindingKind.WIDTH, FindingKind.ASIDE, FindingKind.TOO_DEEP])
def test_a_finding_with_several_causes_names_no_mistake_and_counts_among_several(kind):
    assert named_by(kind) == set()
    assert len(named_by(kind, "among several")) > 1


def test_each_fault_of_a_pit_is_named_by_its_own_kind_alone():
    assert named_by(PitKind.AWAY) == {"pit moved 10 mm", "pit moved 6 mm"}
    assert named_by(PitKind.SIZE) == {"pit x 1.4", "pit x 0.6"}
    assert named_by(PitKind.TURNED) == {"pit turned by 90 degrees"}


def test_a_unit_is_named_by_itself_and_not_by_another_and_one_of_two_is_among_several():
    assert named_by(FindingKind.SCALE, field="force", detail="pounds") == {"force in pounds"}
    either = {"kind": FindingKind.SCALE, "detail": "kilonewtons or kPa/mm (or MPa/m)"}
    assert named_by(**either) == set()
    assert named_by(how="among several", **either) >= {"force in kN", "stiffness in kPa/mm"}


def test_a_cause_that_explains_as_much_as_the_first_counts_among_several():
    also = {"also": frozenset({FindingKind.SIGN}), "field": "force"}
    assert "force sign" not in named_by(FindingKind.AXES, **also)
    assert "force sign" in named_by(FindingKind.AXES, "among several", **also)


def test_a_field_is_named_by_itself_and_not_by_the_other():
    assert named_by(FindingKind.SIGN, field="force") == {"force sign"}
    assert named_by(FindingKind.AXES, field="displacement") == {"displacement x and z exchanged"}
    axes = {"force x and z exchanged", "displacement x and z exchanged"}
    assert named_by(FindingKind.AXES, "among several") == axes


def test_a_fruit_of_which_nothing_is_said_is_not_named():
    assert all(naming(None, mistake) == "" for mistake in MISTAKES)


@pytest.mark.parametrize("category", ["nectarine", "plum", "phantom"])
def test_moduli_are_judged_by_the_range_that_the_product_has(category):
    prior = tomllib.loads(
        (ROOT / "recon" / "pit" / "priors" / f"{category}.toml").read_text(encoding="utf-8")
    )
    assert E_range_MPa(category) == tuple(prior["plausible"]["E_MPa"])


@pytest.mark.slow
def test_a_gain_puts_E_in_doubt_and_grams_refuse_it(tmp_path):
    batch = ready_batch(tmp_path / "batch", 1)
    grasp = first_fruit(batch) / "grasps" / "grasp-1.h5"
    scale_force(grasp, 1.25)
    drupe("grade", "--no-screen", batch, "--jobs", 1, status=4)
    row = pd.read_csv(batch / "results" / "ranking.csv").iloc[0]
    assert "both pads' force is 1.2" in row.doubts
    assert row.doubts in row.warnings
    assert 0.14 < row.E_sd_MPa / row.E_MPa < 0.2
    page = (batch / "results" / "report.html").read_text()
    assert "Graded, but in doubt: 1 of 1" in page
    assert "E is in doubt:" in page
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 4
    scale_force(grasp, 101.97 / 1.25)
    drupe("grade", "--no-screen", batch, "--jobs", 1, status=3)
    row = pd.read_csv(batch / "results" / "ranking.csv").iloc[0]
    assert row.outcome == "implausible-recording"
    assert row.reason.startswith("grasp-1.h5: both pads' force is 10")
    assert "Cause: forces look like grams" in row.reason
    assert pd.isna(row.E_MPa)
