import csv
import json
from pathlib import Path

import numpy as np
import pytest

from samples.sample_failure import SampleFailure
from samples.shipped import shipped_batches, write_shipped
from tactile.io.recording import GelPad, read_recording

DATA = Path("samples/data")


def test_the_main_batch_and_the_tiny_one_are_shipped() -> None:
    assert shipped_batches() == ("nectarines", "two-fruits")


@pytest.mark.parametrize("name", ["nectarines", "two-fruits"])
def test_a_shipped_batch_is_copied_whole(name: str, tmp_path: Path) -> None:
    write_shipped(name, tmp_path / "copy")
    listed = [sorted(p.relative_to(f) for p in f.rglob("*")) for f in (DATA / name, tmp_path / "copy")]
    assert listed[0] == listed[1]
    with pytest.raises(SampleFailure, match="not an empty folder"):
        write_shipped(name, tmp_path / "copy")


def test_an_unknown_batch_is_refused_with_the_known_names(tmp_path: Path) -> None:
    with pytest.raises(SampleFailure, match="there are: nectarines, two-fruits"):
        write_shipped("cherries", tmp_path / "copy")


@pytest.mark.parametrize("name", ["nectarines", "two-fruits"])
def test_every_shipped_recording_reads_and_is_loaded(name: str) -> None:
    for path in sorted((DATA / name).glob("fruits/*/grasps/*.h5")):
        recording = read_recording(path)
        assert recording.fruit_id == path.parent.parent.name
        for pad in recording.pads:
            assert isinstance(pad, GelPad)
            assert pad.force_N[27, :, 2].sum() > 2.0


def test_nectarines_differ_in_ripeness_and_their_order_is_not_that_of_their_names() -> None:
    answers = json.loads((DATA / "nectarines/answers.json").read_text())["fruits"]
    with (DATA / "nectarines/fruits.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["fruit_id"] for row in rows] == list(answers)
    moduli = np.array([answer["E_MPa"] for answer in answers.values()])
    assert len(moduli) >= 4
    assert np.all(np.diff(np.sort(moduli)) / np.sort(moduli)[:-1] > 0.2)
    assert list(np.argsort(moduli)) not in ([0, 1, 2, 3], [3, 2, 1, 0])
    hardness = np.array([float(row["shore_oo"]) for row in rows])
    assert np.corrcoef(hardness, np.log(moduli))[0, 1] > 0.9


def test_photos_and_data_stay_within_their_budget() -> None:
    photos = sum(p.stat().st_size for p in DATA.rglob("*.jpg"))
    everything = sum(p.stat().st_size for p in DATA.rglob("*") if p.is_file())
    assert photos < 12e6
    assert everything < 18e6
