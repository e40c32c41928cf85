"""A mistake of the field shows in table, page and exit status: E in doubt, or the fruit not graded."""

import json

import pandas as pd
import pytest
from sample_batches import drupe, first_fruit, ready_batch, scale_force


@pytest.mark.slow
def test_a_gain_puts_E_in_doubt_and_grams_refuse_it(tmp_path):
    batch = ready_batch(tmp_path / "batch", 1)
    grasp = first_fruit(batch) / "grasps" / "grasp-1.h5"
    scale_force(grasp, 1.25)
    doubted = drupe("grade", "--no-screen", batch, "--jobs", 1)
    assert doubted.status == 4, doubted.err
    row = pd.read_csv(batch / "results" / "ranking.csv").iloc[0]
    assert "both pads' force is 1.2" in row.doubts
    assert row.doubts in row.warnings
    assert 0.14 < row.E_sd_MPa / row.E_MPa < 0.2
    page = (batch / "results" / "report.html").read_text()
    assert "Graded, but in doubt: 1 of 1" in page
    assert "E is in doubt:" in page
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 4
    scale_force(grasp, 101.97 / 1.25)
    refused = drupe("grade", "--no-screen", batch, "--jobs", 1)
    assert refused.status == 3, refused.err
    row = pd.read_csv(batch / "results" / "ranking.csv").iloc[0]
    assert row.outcome == "implausible-recording"
    assert row.reason.startswith("grasp-1.h5: both pads' force is 10")
    assert "Cause: forces look like grams" in row.reason
    assert pd.isna(row.E_MPa)
