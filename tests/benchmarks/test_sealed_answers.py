"""An answer's row, from a coarse fruit start to end: what it says is what the explanation says."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sealed_truths import put_on_path

put_on_path()
sys.path.append(str(Path(__file__).parents[1] / "fem"))
import sealed_answers  # noqa: E402
from cramer_rao import amplitude_bounds  # noqa: E402
from injected_mismatch import E_MPA, injected_case, on_pad  # noqa: E402
from mismatch_altered import LEFT_OUT, altered  # noqa: E402
from reduced_case import gains_of, store, stored  # noqa: E402
from sealed_answers import answered, captured, of_problem  # noqa: E402

from fem.mismatch import procedure  # noqa: E402
from fem.mismatch.catalogue import EFFECTS  # noqa: E402
from fem.mismatch.effects import clock_lag, pit_size, sensor_gain, skin  # noqa: E402
from fem.mismatch.mismatch_case import GradedCase  # noqa: E402
from fem.mismatch.model.marker_equations import DESIGN_EFFECT  # noqa: E402
from fem.mismatch.result import Modulus  # noqa: E402

PLAIN = Modulus(value=1.1 * E_MPA, sd=0.03 * E_MPA)
SHORT = tuple(module.EFFECT for module in (skin, pit_size, sensor_gain, clock_lag))


@pytest.fixture(scope="module")
def explained():
    """Of a catalogue of four: a pad that says a fifth too much; and what was kept on the way."""
    case = injected_case(on_pad("left", lambda pad: replace(pad, force_N=1.2 * pad.force_N)))
    with pytest.MonkeyPatch.context() as patch, captured() as kept:
        patch.setattr(procedure, "EFFECTS", SHORT)
        found = procedure.explain(case, graded=GradedCase(modulus=PLAIN))
    return found, kept


@pytest.mark.slow
def test_the_row_is_plain_json_and_says_what_the_explanation_says(explained):
    found, kept = explained
    row = json.loads(json.dumps(answered(found) | of_problem(kept.case)))
    assert row["verdict"] == ["sensor_gain"]
    assert row["p"] == found.p_value
    assert row["E_after"]["value"] == found.after.value
    assert row["E_after"]["interval"][1] - row["E_after"]["value"] == pytest.approx(1.645 * found.after.sd)
    gain = row["ranking"][0]["parameters"]["gain"]
    assert gain["interval"][0] < gain["value"] < gain["interval"][1]
    assert row["catalogue"] == ["clock_lag", "pit_size", "sensor_gain", "skin"]
    assert row["chi2"] > 10 * row["chi2_usual"]


@pytest.mark.slow
def test_the_linear_round_replays_from_the_file_to_the_same_gains(explained, tmp_path):
    _, kept = explained
    store(tmp_path / "x.npz", kept.case)
    assert gains_of(stored(tmp_path / "x.npz").linear()) == pytest.approx(kept.case.facts["gains"], abs=1e-6)


@pytest.mark.slow
def test_a_bound_counts_every_sample_of_the_markers_and_the_balance_once(explained):
    """Not so many of the markers' as one, as in the linear round, nor the balance as often as they."""
    _, kept = explained
    thinned = np.zeros_like(kept.information)
    for rows, products in zip(kept.case.rows, kept.case.products, strict=True):
        thinned[np.ix_(rows, rows)] += products[1:, 1:]
    exact, thin, thick = (
        amplitude_bounds(information, kept.case, E_MPa=E_MPA)
        for information in (kept.information, thinned, DESIGN_EFFECT * thinned)
    )
    assert all(thick[name] < exact[name] < thin[name] for name in exact)
    assert exact["sensor_gain"] > 2 * thick["sensor_gain"]


def test_an_effect_that_is_left_out_is_not_in_the_finders_catalogue():
    with altered(LEFT_OUT, "skin+slip"):
        names = {one.spec.name for one in procedure.EFFECTS}
    assert not names & {"skin", "slip"}
    assert len(names) == len(EFFECTS) - 2
    assert procedure.EFFECTS == EFFECTS


def test_a_folder_that_is_no_case_is_a_row_with_its_failure(tmp_path):
    row, problem = sealed_answers.explained(tmp_path, tmp_path, ablation="whole", jobs=1)
    assert row["failure"]
    assert problem is None
