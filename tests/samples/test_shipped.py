import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from samples.fruit import fruits_of_seed
from samples.grasp_plan import planned_grasps, straight
from samples.sample_batch import true_grasp
from samples.sample_failure import SampleFailure
from samples.shipped import shipped_batches, write_shipped
from tactile.readers.recording import GelPad, read_recording

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


@pytest.mark.slow
def test_a_shipped_recording_is_what_the_simulator_gives() -> None:
    # it was made by another contact solver, on the nodes of the same bricks
    answers = json.loads((DATA / "nectarines/answers.json").read_text())
    fruit = fruits_of_seed(4, seed=answers["seed"])[0]
    assert fruit.E_MPa == answers["fruits"]["N01"]["E_MPa"]
    plan = planned_grasps(fruit, count=1)[0]
    first_press = slice(9, 16)
    way = straight(plan.motion.time_s[first_press], plan.motion.travel_mm[first_press])
    simulated = true_grasp(fruit, replace(plan, motion=way))
    shipped = read_recording(DATA / "nectarines/fruits/N01/grasps/grasp-1.h5")
    for true, pad in zip(simulated.pads, shipped.pads, strict=True):
        assert isinstance(pad, GelPad)
        assert true.force_N[-1, :, 2].sum() == pytest.approx(pad.force_N[15, :, 2].sum(), rel=0.02)
        miss_mm = true.displacement_mm[-1] - pad.displacement_mm[15]
        assert np.sqrt((miss_mm**2).mean()) < 0.006  # the sensor's noise is 0.0045
