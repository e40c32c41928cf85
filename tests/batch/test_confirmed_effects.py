"""`drupe grade` uses the effects that the settings confirm: E, its error bar and the report change."""

import h5py
import numpy as np
import pandas as pd
import pytest
from sample_batches import drupe, first_fruit, ready_batch, record_of

pytestmark = pytest.mark.slow

GAIN = """
[[mismatch]]
effect = "sensor_gain"
parameters = { pad = "left", gain = 1.25 }
sd = { gain = 0.03 }
"""
TWO_ARMS = """
[[mismatch]]
effect = "viscoelastic"
parameters = { g = 0.2, tau_s = 1.0, g_2 = 0.1, tau_2_s = 9.0 }
"""


def graded(batch, out):
    ran = drupe("grade", batch, "--out", out, "--jobs", 1)
    assert ran.status == 0, ran.err
    row = pd.read_csv(out / "ranking.csv").iloc[0]
    return row, record_of(out, row.fruit_id), (out / "report.html").read_text()


@pytest.fixture(scope="module")
def true_and_confirmed(tmp_path_factory):
    """A fruit graded as it is, and with a left pad that reads 25 % too much and settings that know it."""
    folder = tmp_path_factory.mktemp("confirmed")
    batch = ready_batch(folder / "batch", 1)
    true = graded(batch, folder / "true")
    with h5py.File(first_fruit(batch) / "grasps" / "grasp-1.h5", "r+") as file:
        force = file["pads/left/force_N"]
        force[...] = (1.25 * force[...].astype(float)).astype(np.float32)
    with (batch / "batch.toml").open("a") as settings:
        settings.write(GAIN + TWO_ARMS)
    return true, graded(batch, folder / "confirmed")


def test_a_gain_that_the_settings_know_does_not_touch_E(true_and_confirmed):
    (true, _, _), (confirmed, _, _) = true_and_confirmed
    assert confirmed.E_MPa == pytest.approx(true.E_MPa, rel=2e-3)


def test_its_spread_is_in_the_error_bar_and_shared_by_all_fruit(true_and_confirmed):
    (_, true, _), (_, confirmed, _) = true_and_confirmed
    parts = confirmed["modulus"]["parts_sd_MPa"]
    # One pad of two reads 3 % otherwise: E moves by half of that.
    assert parts["confirmed effects"] == pytest.approx(0.015 * confirmed["modulus"]["E_MPa"], rel=0.3)
    assert np.linalg.norm(list(parts.values())) == pytest.approx(confirmed["modulus"]["E_sd_MPa"])
    assert confirmed["modulus"]["common_sd_MPa"] > true["modulus"]["common_sd_MPa"]
    assert "confirmed effects" not in true["modulus"]["parts_sd_MPa"]


def test_ranking_and_report_say_what_was_taken_into_account_and_what_was_not(true_and_confirmed):
    (true, _, _), (confirmed, record, page) = true_and_confirmed
    assert (true.mismatch_by, confirmed.mismatch_by) == ("screen", "settings")
    assert true.mismatch.startswith("not screened: one recording alone cannot tell missing physics from")
    assert confirmed.mismatch == "sensor_gain"
    assert confirmed.screen == true.screen == true.mismatch
    assert "Taken into account" in page
    assert "sensor gain (taken into account)" in page
    (warning,) = [w for w in record["warnings"] if "batch.toml" in w]
    assert warning.startswith("batch.toml confirms viscoelastic with g_2")
