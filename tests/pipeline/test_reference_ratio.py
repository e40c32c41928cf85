"""What reference bodies say of the gripper, and what it does to the moduli of the fruit."""

import csv
import io
import math
import statistics
from datetime import UTC, datetime

import numpy as np
import pytest
from graded_results import graded
from rich.console import Console
from small_batches import batch_of_balls

from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import ModulusRecord
from pipeline.problem import BatchRefused
from pipeline.ranking.reference_ratio import against_references, as_measured, combined_ratio
from pipeline.ranking.report_entries import batch_entry
from pipeline.ranking.run_summary import print_summary
from pipeline.run.reporting import _status
from reports.grasp_record import GraspRecord
from reports.page import report_html
from reports.tables import ranking_csv

GAIN = 1.12
READS = "The gripper reads 1.12 ± 0.03 times the known modulus of the reference body (ball)"


def record(name, E_MPa, *, sd=0.02, common=0.01, known=None, outcome="graded"):
    given = {} if known is None else {"reference_E_MPa": known, "reference_E_sd_MPa": 0.01 * known}
    modulus = ModulusRecord(
        E_MPa=E_MPa, E_sd_MPa=sd * E_MPa, common_sd_MPa=common * E_MPa, parts_sd_MPa={"noise": sd * E_MPa}
    )
    grasps = (GraspRecord(grasp="g", E_MPa=E_MPa, E_energy_MPa=1.01 * E_MPa, E_energy_sd_MPa=0.02),)
    changes = {"outcome": outcome, "modulus": modulus if outcome == "graded" else None}
    changes |= {"grasps": grasps, "warnings": ("w",)}
    return graded(name, E_MPa, changes=changes, reference=known is not None, **given)


def batch_read_with(gain):
    """Two fruit of 0.4 and 0.8 MPa and a ball of 0.5, as a gripper of this gain reads them."""
    return [record("soft", 0.4 * gain), record("firm", 0.8 * gain), record("ball", 0.5 * gain, known=0.5)]


def arrays(*values):
    return (np.array(row, dtype=float) for row in values)


def doubt_of_widened(before, after, gain):
    """The only doubt of a fruit whose modulus stays as it was and has ln `gain` in its error bar."""
    E = before.modulus.E_MPa
    assert after.modulus.E_MPa == E
    assert after.modulus.E_sd_MPa == pytest.approx(E * math.hypot(0.02, math.log(gain)))
    assert after.modulus.common_sd_MPa == pytest.approx(E * math.hypot(0.01, math.log(gain)))
    assert after.grasps == before.grasps
    (doubt,) = after.doubts
    assert after.warnings == (doubt, "w")
    return doubt


def test_the_mean_is_weighted_by_both_errors():
    """Two bodies by hand: ln r of variances 0.0004 + 0.0001 and 0.0001 + 0.0001."""
    ratio = combined_ratio(*arrays([1.1, 2.0], [0.022, 0.02], [0, 0], [1.0, 2.0], [0.01, 0.02]))
    variances = np.array([0.02**2 + 0.01**2, 0.01**2 + 0.01**2])
    weights = 1 / variances
    assert math.log(ratio.ratio) == pytest.approx(weights[0] * math.log(1.1) / weights.sum())
    chi2 = (math.log(1.1)) ** 2 / variances.sum()  # of two values: their difference over its variance
    assert ratio.chi2 == pytest.approx(chi2)
    assert ratio.disagree
    assert ratio.ln_sd == pytest.approx(math.sqrt(chi2 / weights.sum()))


def test_the_error_covers_the_truth_and_a_sound_gripper_is_seldom_doubted():
    """Drawn grippers of gain 1 and three bodies each, a third of their variance common to all three."""
    rng = np.random.default_rng(7)
    n, runs, known, sd, common = 3, 3000, 0.5, 0.02, 0.0115
    independent = math.sqrt(sd**2 - common**2)
    z, doubted, disagreeing = [], 0, 0
    for _ in range(runs):
        errors = independent * rng.standard_normal(n) + common * rng.standard_normal()
        said = known * np.exp(0.01 * rng.standard_normal(n))
        E = known * np.exp(errors)
        ratio = combined_ratio(E, sd * E, common * E, said, 0.01 * said)
        z.append(math.log(ratio.ratio) / ratio.ln_sd)
        doubted += ratio.apart
        disagreeing += ratio.disagree
    assert np.std(z) == pytest.approx(1.0, abs=0.05)
    assert doubted / runs == pytest.approx(0.0455, abs=0.015)
    assert disagreeing / runs == pytest.approx(0.01, abs=0.006)


def test_more_bodies_do_not_lessen_what_they_share():
    many = combined_ratio(*(np.full(100, v) for v in (0.5, 0.01, 0.005, 0.5, 0.005)))
    assert many.ln_sd == pytest.approx(math.hypot(0.01, math.sqrt((0.02**2 - 0.01**2 + 0.01**2) / 100)))


def test_a_batch_without_a_reference_is_as_measured():
    records = batch_read_with(GAIN)[:2]
    assert against_references(records, correct=True) == (records, None)


@pytest.mark.parametrize("correct", [False, True])
def test_a_sound_gripper_changes_nothing(correct):
    records = batch_read_with(1.01)
    checked_records, finding = against_references(records, correct=correct)
    assert not finding.alarm
    assert "1.01 ± 0.02 times" in finding.sentences[0]
    assert "(ball): within 2 standard deviations" in finding.sentences[0]
    for before, after in zip(records, checked_records, strict=True):
        assert (after.modulus, after.doubts, after.grasps) == (before.modulus, before.doubts, before.grasps)


def test_a_gain_puts_every_fruit_in_doubt_and_widens_its_error_by_the_gain():
    records = batch_read_with(GAIN)
    checked_records, finding = against_references(records, correct=False)
    assert finding.alarm
    assert READS in finding.sentences[0]
    for before, after in zip(records[:2], checked_records[:2], strict=True):
        assert "gripper reads 1.12 ± 0.03" in doubt_of_widened(before, after, GAIN)
    assert (checked_records[2].modulus, checked_records[2].doubts) == (records[2].modulus, ())


@pytest.mark.parametrize("gain", [0.7, 1.12, 1.4])
def test_a_correction_gives_the_true_moduli_and_carries_the_ratios_error(gain):
    """The fruit are of 0.4 and 0.8 MPa whatever the gripper's gain."""
    corrected_records, finding = against_references(batch_read_with(gain), correct=True)
    assert finding.corrected
    assert not finding.alarm
    ratio_sd = math.hypot(0.02, 0.01)
    for fruit_record, truth in zip(corrected_records, (0.4, 0.8), strict=False):
        assert fruit_record.modulus.E_MPa == pytest.approx(truth)
        assert fruit_record.modulus.E_sd_MPa == pytest.approx(truth * math.hypot(0.02, ratio_sd))
        assert fruit_record.modulus.common_sd_MPa == pytest.approx(truth * math.hypot(0.01, ratio_sd))
        assert fruit_record.grasps[0].E_MPa == pytest.approx(truth)
        assert fruit_record.grasps[0].E_energy_MPa == pytest.approx(1.01 * truth)
        assert fruit_record.doubts == ()
    assert corrected_records[2].modulus.E_MPa == 0.5 * gain


@pytest.mark.parametrize("gain", [12.7, 1.6, 1 / 12.7])
@pytest.mark.parametrize("correct", [False, True])
def test_a_ratio_that_no_gripper_has_corrects_nothing_and_names_the_number_that_was_typed(gain, correct):
    records = batch_read_with(gain)
    checked_records, finding = against_references(records, correct=correct)
    assert finding.alarm
    assert not finding.corrected
    assert "Check reference_E_MPa = 0.5 MPa of ball for typing errors" in finding.sentences[0]
    assert "drupe corrects none" in finding.sentences[0]
    for before, after in zip(records[:2], checked_records[:2], strict=True):
        doubt = doubt_of_widened(before, after, gain)
        assert "Check reference_E_MPa = 0.5 MPa of ball for typing errors" in doubt
    assert _status(checked_records, finding) == 4


def test_what_is_kept_stays_as_measured_so_that_a_second_run_corrects_once():
    records = batch_read_with(GAIN)
    corrected_records, _ = against_references(records, correct=True)
    kept = [as_measured(*pair) for pair in zip(records, corrected_records, strict=True)]
    assert [kept_record.modulus for kept_record in kept] == [record.modulus for record in records]
    assert kept[0].reference.E_MPa == pytest.approx(0.4)
    assert kept[0].reference.corrected
    again, _ = against_references(kept, correct=True)
    assert again == corrected_records
    undone, _ = against_references(kept[:2], correct=False)
    assert undone == records[:2]


@pytest.mark.parametrize("correct", [False, True])
def test_bodies_that_contradict_each_other_judge_nothing_and_doubt_every_fruit(correct):
    """Ratios of 1 and 3: their mean may lie within 2 of its widened errors of 1, and says nothing."""
    records = [*batch_read_with(1.0), record("other", 1.5, known=0.5)]
    checked_records, finding = against_references(records, correct=correct)
    assert finding.alarm
    assert not finding.corrected
    assert "because the reference bodies contradict each other" in finding.sentences[0]
    assert "disagree beyond their errors (chi-square" in finding.sentences[1]
    assert "ball 1.00 ± 0.02, other 3.00 ± 0.07" in finding.sentences[1]
    assert "as expected" not in " ".join(finding.sentences)
    for before, after in zip(records[:2], checked_records[:2], strict=True):
        doubt = doubt_of_widened(before, after, 3)
        assert "contradict each other (ball 1.00 ± 0.02, other 3.00 ± 0.07)" in doubt
    assert [fruit_record.doubts for fruit_record in checked_records[2:]] == [(), ()]
    assert _status(checked_records, finding) == 4


def test_a_reference_that_was_not_graded_checks_nothing_and_says_so():
    records = [*batch_read_with(GAIN)[:2], record("ball", 0.5, known=0.5, outcome="never-touches")]
    checked_records, finding = against_references(records, correct=True)
    assert finding.alarm
    assert "No reference body is graded (ball: never-touches)" in finding.sentences[0]
    assert [record.modulus for record in checked_records[:2]] == [record.modulus for record in records[:2]]


@pytest.fixture
def root(tmp_path):
    return batch_of_balls(
        tmp_path, "soft", "firm", "ball", settings='category = "nectarine"\n[reference]\ncorrect = true\n',
        table="fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        "soft,,,,\nfirm,,,,\nball,true,0.5,0.005,0.48\n",
    )  # fmt: skip


@pytest.mark.parametrize("correct", [False, True])
def test_ranking_page_and_terminal_say_it(root, correct):
    checked_records, finding = against_references(batch_read_with(GAIN), correct=correct)
    batch, moment = open_batch(root), datetime(2026, 8, 14, tzinfo=UTC)
    entry = batch_entry(
        batch, checked_records, results=Results(root / "results"), inputs={}, started=moment, finished=moment,
        exit_status=0, finding=finding,
    )  # fmt: skip
    rows = {row["fruit_id"]: row for row in csv.DictReader(io.StringIO(ranking_csv(entry)))}
    assert list(rows) == ["soft", "firm", "ball"]
    assert [rows[name]["rank"] for name in rows] == ["1", "2", ""]
    assert rows["soft"]["E_uncorrected_MPa"] == ("0.448" if correct else "")
    assert float(rows["soft"]["E_MPa"]) == pytest.approx(0.4 if correct else 0.448)
    assert rows["ball"]["E_uncorrected_MPa"] == ""
    assert bool(rows["firm"]["doubts"]) != correct
    E_MPa = [float(rows[name]["E_MPa"]) for name in ("soft", "firm")]
    assert entry.mean_E_MPa == pytest.approx(statistics.fmean(E_MPa), rel=1e-3)
    assert entry.between_sd_MPa == pytest.approx(statistics.stdev(E_MPa), rel=1e-3)
    page = report_html(entry)
    assert "1.12 ± 0.03" in page
    assert ("E as measured" in page) == correct
    console = Console(file=io.StringIO(), width=200)
    print_summary(entry, root / "results", console=console)
    text = console.file.getvalue()
    assert "2 of 2 fruit graded" in text
    assert ("warning: The gripper reads 1.12" in text) != correct
    assert READS in text
    assert ("E corrected by the reference body" in text) == correct


def test_to_correct_there_must_be_a_reference(root):
    (root / "fruits.csv").write_text("fruit_id\nsoft\nfirm\nball\n")
    with pytest.raises(
        BatchRefused, match=r'"reference\.correct" is true, but fruits\.csv lists no reference body'
    ):
        open_batch(root)
