"""The control chart over batches: its rows, its rules, and what is refused."""

import csv
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from pipeline.batch.control_chart import (
    HEADER,
    ControlChart,
    Point,
    chart_path,
    history_of,
    out_of_control,
    read_chart,
    recordings_sha256,
    require_chart_place,
    update_chart,
)
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import open_batch
from pipeline.problem import BatchRefused
from pipeline.ranking.reference_ratio import Ratio, ReferenceFinding, drift, own_points
from pipeline.run.checking import check
from reports.charts import control_chart
from reports.entries import RatioPoint, ReferenceBodyEntry

START = datetime(2026, 8, 14, 9, 30, tzinfo=UTC)


def finding(ratio, name="ball"):
    ratio_found = Ratio(ratio=ratio, ln_sd=0.02)
    body = ReferenceBodyEntry(
        fruit_id=name, E_known_MPa=0.5, E_known_sd_MPa=0.005, E_found_MPa=0.5 * ratio,
        E_found_sd_MPa=0.01, ratio=ratio_found.ratio, ratio_sd=ratio_found.sd,
    )  # fmt: skip
    return ReferenceFinding(bodies=(body,), ratio=ratio_found, corrected=False, sentences=("read",))


def row(day, ratio, *, lot="A", sha="s"):
    inputs = {"fruits/ball/grasps/g.h5": f"{sha}{day}", "fruits/ball/photos/1.jpg": "p", "batch.toml": "t"}
    return own_points(finding(ratio), lot=lot, now=START + timedelta(days=day), inputs=inputs)


def test_rows_are_added_and_the_same_batch_takes_the_place_of_its_own(tmp_path):
    path = tmp_path / "gripper.csv"
    update_chart(path, row(0, 1.01, lot='A, "first"'))
    update_chart(path, row(1, 1.02))
    others = path.read_text().splitlines()
    update_chart(path, row(2, 1.05))
    again = own_points(
        finding(1.03), lot="A", now=START + timedelta(days=9),
        inputs={"fruits/ball/grasps/g.h5": "s1"},
    )  # fmt: skip
    chart = update_chart(path, again)
    lines = path.read_text().splitlines()
    assert lines[0] == HEADER
    assert lines[1] == others[1]
    assert [point.ratio for point in chart.points] == [1.01, 1.03, 1.05]
    assert chart.points[1].graded_at == START + timedelta(days=1)
    assert read_chart(path) == chart
    assert [p.name for p in tmp_path.iterdir()] == ["gripper.csv"]


def test_rows_of_others_stay_as_they_were_written(tmp_path):
    """Quoted cells and numbers in another form that mean the same."""
    path = tmp_path / "gripper.csv"
    other = '2026-08-01T07:00:00+00:00,"Z",ball,0.50,5.0e-1,1.000,.02,abc'
    path.write_text(f"{HEADER}\n{other}\n")
    update_chart(path, row(0, 1.01))
    assert path.read_text().splitlines()[1] == other


def test_a_batch_graded_again_alike_leaves_the_file_alone(tmp_path):
    path = tmp_path / "gripper.csv"
    update_chart(path, row(0, 1.01))
    before = path.stat()
    update_chart(path, row(0, 1.01))
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "its first line is"),
        ("fruit_id,height_mm\nA,50\n", 'its first line is "fruit_id,height_mm", expected "time_utc,lot,'),
        (f"{HEADER}\n2026-08-01T07:00:00Z,A,ball,0.5,0.5,1,0.02\n", "row 2 has 7 cells, expected 8"),
        (
            f"{HEADER}\n2026-08-01T07:00:00Z,A,ball,0.5,0.5,x,0.02,s\n",
            'row 2: ratio is "x", expected a number',
        ),
        (
            f"{HEADER}\n2026-08-01T07:00:00Z,A,ball,0.5,0.5,1,0,s\n",
            'row 2: ratio_sd is "0", expected a number',
        ),
        (
            f"{HEADER}\nAugust,A,ball,0.5,0.5,1,0.02,s\n",
            'row 2: time_utc is "August", expected a time such as',
        ),
        (f'{HEADER}\n2026-08-01T07:00:00Z,"A,ball,0.5,0.5,1,0.02,s\n', "damaged control chart"),
    ],
)
def test_a_file_that_is_no_control_chart_is_refused_and_kept(tmp_path, text, said):
    path = tmp_path / "gripper.csv"
    path.write_text(text)
    with pytest.raises(BatchRefused) as refused:
        update_chart(path, row(0, 1.0))
    assert said in str(refused.value)
    assert str(path) in str(refused.value)
    assert "[reference] chart" in str(refused.value)
    assert path.read_text() == text


def test_links_other_suffixes_and_missing_folders_are_refused(tmp_path):
    (tmp_path / "real.csv").write_text(HEADER + "\n")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    for name, said in (
        ("link.csv", "is a link"), ("chart.txt", 'ends in ".csv"'), ("no/chart.csv", "there is no folder")
    ):  # fmt: skip
        with pytest.raises(BatchRefused, match=re.escape(said)):
            read_chart(tmp_path / name)


def test_a_chart_is_no_input_and_lies_neither_among_fruit_nor_results(tmp_path):
    (tmp_path / "fruits" / "A").mkdir(parents=True)
    (tmp_path / "fruits.csv").write_text("fruit_id\nA\n")
    folder = BatchFolder(tmp_path)
    results = Results(folder.default_results)
    for name in ("fruits.csv", "fruits/A/chart.csv", "results/chart.csv"):
        with pytest.raises(BatchRefused, match=re.escape("[reference] chart")):
            require_chart_place(chart_path(folder, name), folder, results, [tmp_path / "fruits.csv"])
    for name in ("chart.csv", "../chart.csv"):
        require_chart_place(chart_path(folder, name), folder, results, [tmp_path / "fruits.csv"])


def test_a_batch_whose_chart_is_another_table_is_refused_before_any_work(tmp_path):
    (tmp_path / "fruits.csv").write_text("fruit_id\nA\n")
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n[reference]\nchart = "fruits.csv"\n')
    with pytest.raises(BatchRefused, match="is not a control chart of drupe"):
        open_batch(tmp_path)


@pytest.mark.parametrize(
    "named", ["ABOVE/x.csv", "../../x.csv", "../other/x.csv", "link/x.csv", "/etc/x.csv"]
)
def test_a_chart_elsewhere_is_refused_by_its_key_unless_its_folder_is_allowed(tmp_path, monkeypatch, named):
    root = tmp_path / "days" / "monday"
    (root / "fruits").mkdir(parents=True)
    (tmp_path / "days" / "other").mkdir()
    (root / "link").symlink_to(tmp_path)
    (root / "fruits.csv").write_text("fruit_id\nA\n")
    named = named.replace("ABOVE", str(tmp_path))
    (root / "batch.toml").write_text(f'category = "nectarine"\n[reference]\nchart = "{named}"\n')
    with pytest.raises(
        BatchRefused, match=r'batch\.toml: "reference\.chart": found .*; expected a file in'
    ) as refused:
        open_batch(root)
    assert "DRUPE_CHARTS" in str(refused.value)
    place = (root / named).parent.resolve()
    folder = BatchFolder(root)
    assert chart_path(folder, named, environment={"DRUPE_CHARTS": f"/none:{place}"}) == root / named


def test_check_reports_a_chart_elsewhere_and_all_other_problems(tmp_path):
    (tmp_path / "fruits" / "B").mkdir(parents=True)
    (tmp_path / "fruits.csv").write_text("fruit_id,height_mm\nA,55.9\n")
    (tmp_path / "scan.stl").touch()
    settings = 'category = "nectarine"\npoisson_ratio = 0.3\n[reference]\nchart = "/usr/x.csv"\n'
    (tmp_path / "batch.toml").write_text(settings)
    said = [str(problem).replace(f"{tmp_path}/", "") for problem in check(tmp_path)]
    for words in (
        'batch.toml: "reference.chart": found',
        "fruits/A: does not exist",
        "fruits/B: is not in fruits.csv",
        "scan.stl is not used",
        "Every E will be in doubt",
    ):
        assert sum(words in line for line in said) == 1, (words, said)


@pytest.mark.parametrize("named", ["gripper.csv", "charts/gripper.csv", "../gripper.csv"])
def test_a_chart_in_the_batch_or_beside_its_folder_is_allowed(tmp_path, named):
    assert chart_path(BatchFolder(tmp_path / "monday"), named, environment={}) == tmp_path / "monday" / named


@pytest.mark.parametrize("lot", ["=1+1", "7;=cmd|' /C calc'!A0", "a, -1+cmd", '";=HYPERLINK(1)'])
def test_the_lot_starts_no_formula_and_its_row_is_found_again(tmp_path, lot):
    path = tmp_path / "gripper.csv"
    for ratio in (1.01, 1.02):
        update_chart(path, row(0, ratio, lot=lot))
    assert len(read_chart(path).points) == 1
    for separator in (",", ";"):
        for line in csv.reader(path.read_text().splitlines(), delimiter=separator):
            assert not any(cell.lstrip(' "').startswith(("=", "+", "-", "@")) for cell in line)


def test_several_recordings_have_one_hash_whatever_their_order():
    single = {"fruits/ball/grasps/a.h5": "x"}
    two = {**single, "fruits/ball/grasps/b.h5": "y", "fruits/ball-2/grasps/c.h5": "z"}
    assert recordings_sha256(single, "ball") == "x"
    assert recordings_sha256(two, "ball") == recordings_sha256(dict(reversed(two.items())), "ball")
    assert recordings_sha256(two, "ball") not in {"x", "y", "z"}


@pytest.mark.parametrize(
    ("z", "said"),
    [
        ([0.0], ""),
        ([2.9], ""),
        ([-3.1], "more than 3"),
        ([3.5, 0.2], ""),  # said when it was the last
        ([2.1, 2.2], "two of the last three"),
        ([2.1, 0.0, 2.2], "two of the last three"),
        ([-2.1, 0.0, -2.2], "two of the last three"),
        ([2.1, 0.0, 0.0, 2.2], ""),
        ([2.1, -2.2], ""),
        ([2.1, 2.2, 0.0], ""),
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


def test_a_slow_drift_is_said_with_the_body_and_a_steady_gripper_is_not():
    def chart(*ratios):
        return ControlChart(points=tuple(p for k, r in enumerate(ratios) for p in row(k, r)))

    steady = drift(chart(1.0, 1.01, 0.99), finding(0.99))
    assert steady.sentences == ("read",)
    assert not steady.drifts
    drifting = drift(chart(1.0, 1.045, 1.05), finding(1.05))
    assert drifting.alarm
    assert "The control chart of ball is out of control: two of the last three" in drifting.sentences[1]


def test_points_are_drawn_oldest_first_whatever_their_order_in_the_file():
    points = tuple(p for k in (2, 0, 1) for p in row(k, 1.0 + 0.01 * k))
    past = history_of(ControlChart(points=points), "ball")
    assert [point.ratio for point in past] == [1.0, 1.01, 1.02]
    assert history_of(ControlChart(points=points), "other") == []
    assert past[2].z == pytest.approx(np.log(1.02) / 0.02, rel=1e-4)
    assert isinstance(past[0], Point)


@pytest.mark.parametrize("count", [1, 2, 80])
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
