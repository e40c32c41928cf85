"""The null reference is read to the last digit, refuses what is not as written, and is written as read."""

import hashlib
import importlib.util
import json
from datetime import date
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from fem.mismatch.selection.detection import null_gain, null_gain_in_full, null_statistic, p_values
from fem.mismatch.selection.null_reference import null_reference, parse_null_reference

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "mismatch_nulls.py"
STATISTICS = (
    "# why\nfruit,best single,best pair,what is left\n0,1,2,0.05\n0,1,2,0.05\n1,1,2,0.05\n1,1,2,0.05\n"
)
QUANTILES = "effect,quantile\nskin,0.185\n"


def test_the_shipped_numbers_are_those_that_were_written():
    """Digests of statistics and fruits as of 2026-11-26."""
    known = null_reference()
    assert hashlib.sha256(known.statistics.tobytes()).hexdigest().startswith("eb5d07ac7f22f61e29c88f95")
    assert hashlib.sha256(known.fruits.astype("<i8").tobytes()).hexdigest().startswith("42d671355e2c4dc465")
    assert known.quantiles["stiffening"] == 1.31
    assert known.quantiles["soft_spot"] == 2.64
    assert len(known.quantiles) == 21


def test_detection_comes_out_as_it_did_with_those_numbers():
    p, each = p_values({"best single": 20.0, "best pair": 25.0, "what is left": 0.06})
    assert p == pytest.approx(0.00010451088779844582, rel=1e-12)
    assert each["best pair"] == pytest.approx(0.002596815017747277, rel=1e-12)
    assert null_statistic("what is left") == np.median(null_reference().statistics[:, 2])
    assert null_gain("soft_spot", 2.0) == 5.28
    assert null_gain("unheard of", 2.0) == 0
    assert null_gain_in_full(["slip"], 2.0) == 0.452
    assert null_gain_in_full(["skin", "soft_spot"], 1.0) == 2.64


def test_each_file_says_where_its_numbers_come_from():
    for name in ("null_reference.csv", "null_quantiles.csv"):
        text = (files("fem.mismatch.selection") / name).read_text("utf-8")
        head = "".join(line for line in text.splitlines() if line.startswith("#"))
        assert "200 cases of 48 fruits" in head
        assert "benchmarks/mismatch_nulls.py" in head


@pytest.mark.parametrize(
    ("statistics", "quantiles", "message"),
    [
        (STATISTICS.replace("best pair", "pair"), QUANTILES, "columns are fruit,best single,pair"),
        ("", QUANTILES, "columns are nothing"),
        (STATISTICS.replace("0,1,2,0.05\n0", "0,1,0.05\n0"), QUANTILES, "line 3: 3 cells, 4 are expected"),
        (STATISTICS.replace("0.05", "0,05"), QUANTILES, "line 3: 5 cells, 4 are expected"),
        (STATISTICS.replace("0.05", "nan"), QUANTILES, "line 3: 'nan' is no finite number"),
        (STATISTICS.replace("\n1,", "\nplum,"), QUANTILES, "line 5: 'plum' is no fruit's number"),
        (STATISTICS.replace("\n1,", "\n0,"), QUANTILES, "has 1 fruits"),
        (STATISTICS + "2,1,2,0.05\n", QUANTILES, "the least recorded of them 1 times"),
        ("fruit,best single,best pair,what is left\n", QUANTILES, "has 0 fruits"),
        (STATISTICS, QUANTILES + "skin,0\n", "null_quantiles.csv, line 3: effect is 'skin'"),
        (STATISTICS, QUANTILES + ",0\n", "line 3: effect is ''"),
        (STATISTICS, QUANTILES + "slip,much\n", "line 3: 'much' is no finite number"),
    ],
)
def test_what_is_not_as_written_is_refused(statistics: str, quantiles: str, message: str):
    with pytest.raises(ValueError, match=message) as refusal:
        parse_null_reference(statistics, quantiles)
    assert str(refusal.value).endswith("Write both files anew with benchmarks/mismatch_nulls.py --write.")


def test_what_the_benchmark_writes_is_read_again():
    spec = importlib.util.spec_from_file_location("mismatch_nulls", BENCHMARK)
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    rows = [
        {
            "case": f"bank/null-{fruit}-{record}",
            "best pair": 3.0 + record,
            "what is left": 0.05,
            "softness": 2.0,
            "shown": {"skin": {"gain": 4.0 * fruit}, "slip": {"gain": -1.0}},
        }
        for fruit in (1, 2)
        for record in (1, 2)
    ]
    texts = benchmark.files_of(json.loads(json.dumps(rows)), date(2026, 11, 22))
    known = parse_null_reference(texts["null_reference.csv"], texts["null_quantiles.csv"])
    assert known.fruits.tolist() == [0, 0, 1, 1]
    assert known.quantiles == {"skin": 4.0, "slip": 0.0}
    assert known.statistics[:, 0].tolist() == [
        -0.5,
        -0.5,
        2,
        2,
    ]  # the slip's, beyond none; 4 less the other's 2
    assert known.statistics[:, 1].tolist() == [4, 5, 4, 5]
    assert "4 cases of 2 fruits" in texts["null_reference.csv"]
    assert "2026-11-22" in texts["null_quantiles.csv"]
