"""A batch of two grasps a fruit, one pad of which reads too much: screened, resumed, and left unscreened."""

import json
import shutil

import pandas as pd
import pytest
from sample_batches import SHIPPED, drupe, first_fruit, ready_batch, record_of, scale_force

from pipeline.exit_status import DONE, DOUBTED

pytestmark = pytest.mark.slow
GAIN = 1.06
FRUIT = 3


@pytest.fixture(scope="module")
def screened(tmp_path_factory):
    """A batch of one fruit and its results."""
    return graded(tmp_path_factory.mktemp("screened") / "batch", 1)


def graded(folder, count):
    """The batch, its left pad a gain too high in every recording, and its results."""
    batch = ready_batch(folder, count)
    for fruit in sorted((batch / "fruits").iterdir()):
        second = SHIPPED / "fruits" / fruit.name / "grasps" / "grasp-2.h5"
        shutil.copyfile(second, fruit / "grasps" / "grasp-2.h5")
        for path in sorted((fruit / "grasps").glob("*.h5")):
            scale_force(path, GAIN, "left")
    done = drupe("grade", batch, "--jobs", "1")
    assert done.status in {DONE, DOUBTED}, done.err  # the checks of inputs may doubt such a gain too
    return batch, done


@pytest.mark.proof
def test_the_pad_is_at_fault_in_the_whole_batch_and_that_is_said_once(tmp_path):
    """On numbers alone: tests/pipeline/test_doubts.py."""
    batch, done = graded(tmp_path / "batch", FRUIT)
    (fault,) = json.loads((batch / "results" / "batch.json").read_text())["faults"]
    assert (fault["effect"], fault["fruit"]) == ("sensor_gain", FRUIT)
    assert done.out.count("fault of the whole batch: ") == 1
    gain = 1 / (1 - fault["value"])
    truth = GAIN if fault["pad"] == "left" else 1 / GAIN
    assert gain == pytest.approx(truth, abs=0.03)


def test_every_fruit_has_a_p_its_time_and_the_amount_of_the_gain(screened):
    batch, _ = screened
    table = pd.read_csv(batch / "results" / "ranking.csv")
    assert (table.mismatch_by == "screen").all()
    assert table.screen_p.between(0, 1).all()
    for name in table.fruit_id:
        record = record_of(batch / "results", name)
        assert record["seconds"]["screen"] > 0
        left = next(amount for amount in record["screen"]["amounts"] if amount["effect"] == "sensor_gain")
        assert left["pad"] == "left"
        assert left["value"] == pytest.approx(1 - 1 / GAIN, abs=0.03)


def test_a_second_run_screens_nothing_and_says_the_same(screened):
    batch, first = screened
    again = drupe("grade", batch, "--jobs", "1")
    assert "1 of 1 fruit unchanged" in again.err
    assert ": screen" not in again.err
    assert again.out == first.out


@pytest.mark.proof
def test_without_the_screen_its_column_is_empty_and_E_is_that_of_another_mesh(screened, tmp_path):
    batch, _ = screened
    first = shutil.copytree(batch, tmp_path / "first", ignore=shutil.ignore_patterns("results"))
    (first / "fruits.csv").write_text(f"fruit_id\n{first_fruit(batch).name}\n")
    out = tmp_path / "plain"
    done = drupe("grade", first, "--out", out, "--jobs", "1", "--no-screen")
    assert done.status in {DONE, DOUBTED}
    assert ": screen" not in done.err
    plain, with_it = (pd.read_csv(folder / "ranking.csv") for folder in (out, batch / "results"))
    assert plain.screen.isna().all()
    assert plain.mismatch.isna().all()
    ratio = plain.set_index("fruit_id").E_MPa / with_it.set_index("fruit_id").E_MPa
    assert (ratio.dropna() - 1).abs().max() < 0.01  # two meshes of one fruit
    assert ratio.notna().sum() == 1
