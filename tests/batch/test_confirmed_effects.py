"""`drupe grade` uses the effects that the settings confirm: E, its error bar and the report change."""

import numpy as np
import pytest
from sample_batches import first_fruit, graded_alone, ready_batch, scale_force

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


@pytest.fixture(scope="module")
def true_and_confirmed(tmp_path_factory):
    """A fruit graded as it is, and with a left pad that reads 25 % too much and settings that know it."""
    folder = tmp_path_factory.mktemp("confirmed")
    batch = ready_batch(folder / "batch", 1)
    true = graded_alone(batch, folder / "true")
    scale_force(first_fruit(batch) / "grasps" / "grasp-1.h5", 1.25, "left")
    with (batch / "batch.toml").open("a") as settings:
        settings.write(GAIN + TWO_ARMS)
    confirmed = graded_alone(batch, folder / "confirmed")
    assert not any(record["doubts"] for _, record in (true, confirmed))
    return true, confirmed, (folder / "confirmed" / "report.html").read_text()


def test_a_gain_that_the_settings_know_does_not_touch_E(true_and_confirmed):
    (true, _), (confirmed, _), _ = true_and_confirmed
    assert confirmed.E_MPa == pytest.approx(true.E_MPa, rel=2e-3)


def test_its_spread_is_in_the_error_bar_and_shared_by_all_fruit(true_and_confirmed):
    (_, true), (_, confirmed), _ = true_and_confirmed
    parts = confirmed["modulus"]["parts_sd_MPa"]
    # One pad of two reads 3 % otherwise: E moves by half of that.
    assert parts["confirmed effects"] == pytest.approx(0.015 * confirmed["modulus"]["E_MPa"], rel=0.3)
    assert np.linalg.norm(list(parts.values())) == pytest.approx(confirmed["modulus"]["E_sd_MPa"])
    assert confirmed["modulus"]["common_sd_MPa"] > true["modulus"]["common_sd_MPa"]
    assert "confirmed effects" not in true["modulus"]["parts_sd_MPa"]


def test_ranking_and_report_say_what_was_taken_into_account_and_what_was_not(true_and_confirmed):
    (true, _), (confirmed, record), page = true_and_confirmed
    assert (true.mismatch_by, confirmed.mismatch_by) == ("screen", "settings")
    assert true.mismatch.startswith("not screened: one recording alone cannot tell missing physics from")
    assert confirmed.mismatch == "sensor_gain"
    assert confirmed.screen == true.screen == true.mismatch
    assert "Taken into account" in page
    assert "sensor gain (taken into account)" in page
    (warning,) = [w for w in record["warnings"] if "batch.toml" in w]
    assert warning.startswith("batch.toml confirms viscoelastic with g_2")
