"""E at a reference temperature by the user's coefficient, and calibrations that are too old."""

import math

import pytest
from graded_results import graded, results_of, rows
from small_batches import batch_of_balls

from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import read_record
from pipeline.batch.settings_file import read_settings
from pipeline.batch.task import fruit_task
from pipeline.history.stored_batch import stored_batch
from pipeline.problem import BatchRefused
from pipeline.ranking.reference_temperature import at_reference_temperature
from reports.grasp_record import FrameRecord, GraspRecord

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
    assert "<dt>temperature coefficient</dt>" in error_bar


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
        ("2026-05-11", "dated 2026-05-11, 91 days before the grasps (2026-08-10); the limit is 90 days"),
        ("2026-05-12", None),
        ("2026-08-11", "dated 2026-08-11, after the grasps (2026-08-10)"),
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
    assert "The calibration of the rig is dated 2026-01-01, 221 days before" in drupe("report", results).out


def test_a_new_date_temperature_or_column_grades_no_fruit_again(batch):
    def key(text):
        (batch / "batch.toml").write_text(text)
        return fruit_task(open_batch(batch), "A", Results(batch / "results")).key

    sensor = '[sensor]\nname = "gel"\n'
    before = key(SETTINGS + sensor)
    warmer = SETTINGS.replace("8\n", "9\n") + TEMPERATURE
    assert key(f"{warmer}{sensor}calibrated_on = 2026-01-01\n") == before
    assert key(SETTINGS + sensor + "pose_sd_mm = 0.7\n") != before
