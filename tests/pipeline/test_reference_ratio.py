"""Reference bodies: rules of their own, and what they say of the gripper, E and temperature."""

import csv
import io
import math
import statistics
from datetime import UTC, datetime

import numpy as np
import pytest
from graded_results import graded, results_of, rows
from rich.console import Console
from small_batches import NECTARINE, batch_of_balls, write_ball

from pipeline.batch.fruits_table import read_fruits
from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import ModulusRecord, read_record
from pipeline.batch.settings_file import read_settings
from pipeline.batch.task import fruit_task
from pipeline.history.stored_batch import stored_batch
from pipeline.problem import BatchRefused
from pipeline.ranking.reference_ratio import against_references, as_measured, combined_ratio
from pipeline.ranking.reference_temperature import at_reference_temperature
from pipeline.ranking.report_entries import batch_entry
from pipeline.ranking.run_summary import print_summary
from pipeline.run.checking import check, implausible
from pipeline.run.reporting import _status
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh
from reports.grasp_record import FrameRecord, GraspRecord
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


DIRECTIONS, FACES = ball(3)
HEAD = "fruit_id,mass_g,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
FRUITS = "".join(f"F{k},90,,,,\n" for k in range(4))
BALL = "ball,9,true,0.5,0.01,0.48\n"


@pytest.fixture
def made(tmp_path):
    """Four ready nectarines of radius 28 mm and a reference ball of 10 mm: no nectarine's size or mass."""

    def make(rows=FRUITS + BALL, settings=NECTARINE):
        names = ("F0", "F1", "F2", "F3", "ball")
        batch_of_balls(tmp_path, *names, table=HEAD + rows, settings=settings)
        write_ball(tmp_path / "fruits" / "ball" / "fruit.ply", radius_mm=10)
        return tmp_path

    return make


def said(tmp_path, row):
    path = tmp_path / "fruits.csv"
    path.write_text(HEAD + "F0,90,,,,\n" + row + "\n")
    return "\n".join(map(str, read_fruits(path)[1]))


@pytest.mark.parametrize("yes", ["true", "True", "yes", "1"])
def test_a_reference_is_read_and_a_fruit_is_none(tmp_path, yes):
    path = tmp_path / "fruits.csv"
    path.write_text(HEAD + f"F0,90,,,,\nF1,90,false,,,\nball,9,{yes},0.5,0.01,0.48\n")
    rows, faults = read_fruits(path)
    assert not faults
    assert [row.reference for row in rows] == [False, False, True]
    body = rows[2]
    assert (body.reference_E_MPa, body.reference_E_sd_MPa, body.reference_poisson_ratio) == (0.5, 0.01, 0.48)


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (
            "ball,,maybe,0.5,0.01,0.48",
            'reference is "maybe"; expected true for a reference body of known modulus',
        ),
        ("ball,,,0.5,,", 'reference_E_MPa is "0.5", but reference is not true; write true'),
        ("ball,,true,,0.01,0.48", "reference_E_MPa is empty; expected the reference body's Young's modulus"),
        ("ball,,true,500,10,0.48", "0.0005 to 60 MPa; is it in kPa (0.5 MPa)?"),
        ("ball,,true,-0.5,0.01,0.48", 'reference_E_MPa is "-0.5"; expected'),
        ("ball,,true,0.5,,0.48", "reference_E_sd_MPa is empty; expected one standard deviation"),
        ("ball,,true,0.5,0.3,0.48", "at most 0.25 MPa (half of its modulus)"),
        ("ball,,true,0.5,0.01,0.5", 'reference_poisson_ratio is "0.5"; expected 0.1 to 0.4999'),
    ],
)
def test_a_bad_cell_is_named_by_file_line_and_column(tmp_path, row, sentence):
    text = said(tmp_path, row)
    assert sentence in text
    assert str(tmp_path / "fruits.csv") in text
    assert "line 3 (ball)" in text
    assert len(text.splitlines()) == 1


def test_a_reference_is_graded_as_a_solid_phantom_of_its_own_ratio(made):
    settings = (
        'category = "nectarine"\npoisson_ratio = 0.42\npoisson_ratio_sd = 0.02\n'
        '[[mismatch]]\neffect = "skin"\nparameters = { Et_N_per_mm = 0.2 }\n'
        '[[mismatch]]\neffect = "sensor_gain"\nparameters = { pad = "left", gain = 1.1 }\n'
    )
    batch = open_batch(made(settings=settings))
    results = Results(batch.folder.default_results)
    ball, fruit = (fruit_task(batch, name, results) for name in ("ball", "F0"))
    assert ball.settings.pit.none
    assert (ball.category, ball.body.stem_and_suture) == ("phantom", False)
    assert ball.settings.poisson_ratio is None
    assert ball.prior.poisson_ratio == 0.48
    assert [effect.effect for effect in ball.settings.mismatch] == ["sensor_gain"]
    assert (fruit.category, fruit.settings.pit.none, fruit.settings.poisson_ratio) == (
        "nectarine", False, 0.42
    )  # fmt: skip
    assert [effect.effect for effect in fruit.settings.mismatch] == ["skin", "sensor_gain"]


def test_the_known_modulus_is_no_part_of_what_is_computed(made):
    """A certificate corrected later costs no second grading; another Poisson's ratio does."""
    keys = []
    for row in (BALL, BALL.replace("0.5,", "0.6,"), BALL.replace("0.48", "0.47")):
        batch = open_batch(made(FRUITS + row))
        keys.append(fruit_task(batch, "ball", Results(batch.folder.default_results)).key)
    assert keys[0] == keys[1] != keys[2]


def test_neither_fruit_nor_reference_is_held_against_the_other(made):
    sound = open_batch(made())
    assert {implausible(sound, row) for row in sound.rows} == {""}
    as_fruit = open_batch(made(FRUITS + "ball,9,,,,\n"))
    assert "a nectarine is 18 to 650 g" in implausible(as_fruit, as_fruit.row_of["ball"])


def test_a_reference_without_a_ratio_or_with_a_pit_is_refused(made):
    root = made(FRUITS + "ball,9,true,0.5,0.01,\n")
    with pytest.raises(BatchRefused, match='reference_poisson_ratio of "ball" is empty; expected'):
        open_batch(root)
    assert open_batch(made(FRUITS + "ball,9,true,0.5,0.01,\n", 'category = "phantom"\npoisson_ratio = 0.4\n'
                           '[pit]\nprior = "none"\n')).rows[-1].reference  # fmt: skip
    root = made()
    write_mesh(root / "fruits" / "ball" / "pit.ply", 3 * DIRECTIONS, FACES)
    with pytest.raises(
        BatchRefused, match=r"pit\.ply: gives a pit for a reference body, which must be solid"
    ):
        open_batch(root)


def test_check_has_nothing_against_a_reference_but_that_it_was_not_grasped(made):
    problems = [str(problem) for problem in check(made()) if "ball" in str(problem)]
    assert len(problems) == 1
    assert "needs at least one recording (.h5" in problems[0]


E_PER_C, E_PER_C_SD, PULP_C, REFERENCE_C = -0.012, 0.004, 8.0, 20.0
FACTOR = math.exp(E_PER_C * (REFERENCE_C - PULP_C))
SETTINGS = 'category = "nectarine"\nmeasured_on = 2026-08-10\npulp_temperature_C = 8\n'
TEMPERATURE = "[temperature]\nreference_C = 20\nE_per_C = -0.012\nE_per_C_sd = 0.004\n"
CLASSES = '[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.75\n[[grading.classes]]\nname = "firm"\n'
TABLE = (
    "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
    "A,,,,\nB,,,,\nR,true,0.5,0.05,0.48\n"
)


@pytest.fixture
def batch(tmp_path):
    root = batch_of_balls(tmp_path / "batch", "A", "B", "R", table=TABLE)
    (root / "batch.toml").write_text(SETTINGS + TEMPERATURE + CLASSES)
    return root


@pytest.fixture
def results(drupe, batch):
    body = graded("R", 0.5, reference=True, reference_E_MPa=0.5, reference_E_sd_MPa=0.05)
    out = results_of(batch / "results", [graded("A", 0.3), graded("B", 0.8), body])
    assert drupe("report", out).status == 0
    return out


def test_e_is_that_of_the_closed_form_and_the_measured_e_is_beside_it(results):
    for fruit_id, E_MPa in (("A", 0.3), ("B", 0.8)):
        row = rows(results)[fruit_id]
        at_reference = E_MPa * FACTOR
        ln_sd = math.hypot(0.05, E_PER_C_SD * (REFERENCE_C - PULP_C))
        assert float(row["E_MPa"]) == pytest.approx(at_reference, rel=1e-3)
        assert float(row["E_sd_MPa"]) == pytest.approx(at_reference * ln_sd, rel=5e-3)
        measured = float(row["E_at_pulp_MPa"]), float(row["E_at_pulp_sd_MPa"])
        assert measured == pytest.approx((E_MPa, 0.05 * E_MPa))
        relative = [float(row[f"{E}_sd_MPa"]) / float(row[f"{E}_MPa"]) for E in ("E", "E_at_pulp")]
        assert relative[0] > 1.2 * relative[1]


def test_grasps_and_their_frames_are_at_the_reference_temperature_too(batch):
    frame = FrameRecord(travel_mm=1.0, E_MPa=0.31, E_sd_MPa=0.02)
    grasp = GraspRecord(grasp="g1", E_MPa=0.3, E_sd_MPa=0.01, E_energy_MPa=0.29, frames=[frame])
    record = graded("A", 0.3).model_copy(update={"grasps": (grasp,)})
    (at,) = at_reference_temperature(record, read_settings(batch / "batch.toml")).grasps
    moduli = at.E_MPa, at.E_sd_MPa, at.E_energy_MPa, at.frames[0].E_MPa, at.frames[0].E_sd_MPa
    assert moduli == pytest.approx([FACTOR * E for E in (0.3, 0.01, 0.29, 0.31, 0.02)])


def test_class_and_history_are_at_the_reference_temperature(results):
    assert rows(results)["B"]["maturity"] == "soft"
    kept = {fruit.fruit_id: fruit.E_MPa for fruit in stored_batch(results).fruit}
    assert kept["B"] == pytest.approx(0.8 * FACTOR)
    assert kept["R"] == 0.5


def test_a_reference_body_stays_and_ranks_do_not_depend_on_the_coefficient(drupe, batch, results):
    body = rows(results)["R"]
    assert (body["E_MPa"], body["E_at_pulp_MPa"]) == ("0.5", "")
    with_it = {name: (row["rank"], row["p_softer_than_next"]) for name, row in rows(results).items()}
    (batch / "batch.toml").write_text(SETTINGS + CLASSES)
    assert drupe("report", results).status == 0
    without = rows(results)
    assert {name: (row["rank"], row["p_softer_than_next"]) for name, row in without.items()} == with_it
    shown = [without["B"][name] for name in ("E_MPa", "E_at_pulp_MPa", "maturity")]
    assert shown == ["0.8", "", "firm"]


def test_the_record_keeps_the_measured_modulus_and_the_report_shows_both(results):
    record = read_record(results / "fruits" / "A" / "record.json")
    assert record.modulus.E_MPa == 0.3
    assert record.temperature.E_MPa == pytest.approx(0.3 * FACTOR)
    page = (results / "report.html").read_text("utf-8").replace("\u00a0", " ").replace("\\u003c", "<")
    assert "At the temperature of the grasp E is 0.300 ± 0.015 MPa" in page
    assert "<dt>E at 8 °C, as measured</dt><dd>0.300 ± 0.015 MPa</dd>" in page
    error_bar = page.partition("<h4>Error bar</h4>")[2].partition("</dl>")[0]
    assert "<dt>Temperature coefficient</dt>" in error_bar


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (TEMPERATURE, '"temperature": needs pulp_temperature_C, at which the fruit were grasped'),
        ("calibration_days = 90\n", '"calibration_days": found 90; needs a date: add calibrated_on under'),
        ('[sensor]\nname = "x"\ncalibrated_on = "May"\n', "expected a date like 2026-08-14"),
    ],
)
def test_settings_that_lack_something_say_what(tmp_path, settings, says):
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n' + settings)
    with pytest.raises(BatchRefused) as refusal:
        read_settings(tmp_path / "batch.toml")
    assert says in str(refusal.value)


@pytest.mark.parametrize(
    ("calibrated_on", "says"),
    [
        (
            "2026-05-11",
            "too old: `calibrated_on` in batch.toml is 2026-05-11, 91 days before the grasps (2026-08-10), "
            "expected at most 90 days (calibration_days in batch.toml). Calibrate the sensor again",
        ),
        ("2026-05-12", None),
        ("2026-08-10", None),
        (
            "2026-08-11",
            "dated after the grasps: `calibrated_on` in batch.toml is 2026-08-11, expected at most "
            "2026-08-10. Correct it, or measured_on in batch.toml.",
        ),
    ],
)
def test_a_calibration_beyond_the_limit_is_a_warning(drupe, batch, results, calibrated_on, says):
    sensor = f'calibration_days = 90\n[sensor]\nname = "gel"\ncalibrated_on = {calibrated_on}\n'
    (batch / "batch.toml").write_text(SETTINGS + sensor)
    done = drupe("report", results)
    page = (results / "report.html").read_text("utf-8")
    assert done.status == 0
    if says is None:
        assert "The calibration of" not in done.out + page
    else:
        assert f"The calibration of the sensor is {says}" in done.out
        assert f"The calibration of the sensor is {says}" in page


def test_a_rig_s_own_date_counts(drupe, batch, results):
    curve = "force_N = [0, 1, 2]\ngive_mm = [0, 0.2, 0.35]\nsd_mm = [0, 0.01, 0.02]\n"
    (batch / "rig.toml").write_text(
        'format = "drupe-rig"\nversion = 1\nobject = "ball"\nshape = "ball"\nsize_mm = 40.0\n'
        f'made = "2026-01-01"\nsqueezes = 1\nleast_N = 0.2\n[travel]\n{curve}'
    )
    (batch / "batch.toml").write_text(SETTINGS + 'calibration_days = 200\nrig = "rig.toml"\n')
    old = "The calibration of the rig is too old: `made` in rig.toml is 2026-01-01, 221 days before the "
    assert old in drupe("report", results).out


UNDATED = '[sensor]\nname = "gel"\ncalibration = "C1"\n'
NO_DATE = {
    "en": "has no date: `{}` in {} is missing, but calibration_days",
    "de": "hat kein Datum: `{}` in {} fehlt, aber calibration_days",
    "es": "no tiene fecha: falta `{}` en {}, pero calibration_days",
}


def test_a_limit_on_a_named_calibration_without_a_date_or_a_rig_is_a_warning(drupe, batch, results):
    (batch / "batch.toml").write_text(f"{SETTINGS}calibration_days = 200\n{UNDATED}")
    done = drupe("report", results, status=0)
    assert "calibration of the sensor has no date: `calibrated_on` in batch.toml is missing" in done.out


@pytest.mark.parametrize("language", NO_DATE)
def test_a_limit_on_calibrations_without_a_date_is_a_warning(drupe, batch, results, language):
    curve = "force_N = [0, 1, 2]\ngive_mm = [0, 0.2, 0.35]\nsd_mm = [0, 0.01, 0.02]\n"
    (batch / "rig.toml").write_text(
        'format = "drupe-rig"\nversion = 1\nobject = "ball"\nshape = "ball"\nsize_mm = 40.0\n'
        f"squeezes = 1\nleast_N = 0.2\n[travel]\n{curve}"
    )
    (batch / "batch.toml").write_text(f'{SETTINGS}calibration_days = 200\nrig = "rig.toml"\n{UNDATED}')
    drupe("report", results, "--lang", language, status=0)
    page = (results / "report.html").read_text("utf-8")
    for key, file in (("calibrated_on", "batch.toml"), ("made", "rig.toml")):
        assert NO_DATE[language].format(key, file) in page


def test_a_new_date_temperature_or_column_grades_no_fruit_again(batch):
    def key(text):
        (batch / "batch.toml").write_text(text)
        return fruit_task(open_batch(batch), "A", Results(batch / "results")).key

    sensor = '[sensor]\nname = "gel"\n'
    before = key(SETTINGS + sensor)
    warmer = SETTINGS.replace("8\n", "9\n") + TEMPERATURE
    assert key(f"{warmer}{sensor}calibrated_on = 2026-01-01\n") == before
    assert key(SETTINGS + sensor + "pose_sd_mm = 0.7\n") != before
