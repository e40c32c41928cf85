"""The control chart of a reference body over batches: its rules, and how it is drawn."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from pipeline.history.lot_statistics import out_of_control
from reports.charts import control_chart
from reports.entries import RatioPoint, ReferenceBodyEntry

START = datetime(2026, 8, 14, 9, 30, tzinfo=UTC)


@pytest.mark.parametrize(
    ("z", "said"),
    [
        ([2.9], ""),
        ([-3.1], "more than 3"),
        ([3.5, 0.2], ""),  # said when it was the last
        ([2.1, 2.2], "two of the last three"),
        ([2.1, 0.0, 2.2], "two of the last three"),
        ([2.1, 0.0, 0.0, 2.2], ""),
        ([2.1, -2.2], ""),
    ],
)
def test_the_western_electric_rules(z, said):
    rules_broken = out_of_control(np.array(z))
    assert (said in rules_broken) if said else not rules_broken


def test_a_gripper_in_control_is_seldom_called_out_of_it():
    """Rule 1 alone has 0.0027; rule 2 adds about 2 (2 Phi(-2)^2) = 0.002: one batch in two hundred."""
    z = np.random.default_rng(3).standard_normal((20_000, 3))
    assert np.mean([bool(out_of_control(deviations)) for deviations in z]) == pytest.approx(
        0.0047, abs=0.0015
    )


@pytest.mark.parametrize("count", [1, 80])
def test_the_chart_draws_a_mark_a_batch_and_four_limits(count):
    history = tuple(
        RatioPoint(time_utc=START + timedelta(days=k), lot="<A>", ratio=1.0 + 0.001 * k, sd=0.02)
        for k in range(count)
    )
    body = ReferenceBodyEntry(
        fruit_id="ball", E_known_MPa=0.5, E_known_sd_MPa=0.01, E_found_MPa=0.5, E_found_sd_MPa=0.01,
        ratio=1.0, ratio_sd=0.02, history=history,
    )  # fmt: skip
    layers = control_chart(body)["layers"]
    assert sum(len(each["x"]) for each in layers if each["kind"] == "marks") == min(count, 60)
    lines = [each["y"] for each in layers if each["kind"] == "line"]
    sd = 0.02 / history[-60:][0].ratio
    assert [line[0] for line in lines] == pytest.approx(np.exp(sd * np.array([-3, -2, 2, 3])), rel=1e-4)
