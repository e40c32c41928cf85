"""`rig` in batch.toml: what the jaws give is taken out of every recording, and its spread is in E."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from sample_batches import drupe, first_fruit, graded_alone, ready_batch
from series_springs import SeriesRig

JAWS = SeriesRig(spring_N_per_mm=12.0, pads=40.0)
"""What both jaws together give."""
RIG = """# rig, written by drupe calibrate
format = "drupe-rig"
version = 1
object = "steel ball"
shape = "ball"
size_mm = 40.0
[travel]
force_N = {force}
give_mm = {give}
sd_mm = {sd}
"""


def write_rig(batch: Path, *, share: float, largest_N: float = 60.0) -> None:
    """The true give with a standard deviation of this share."""
    force = largest_N * np.linspace(0, 1, 60) ** 1.5
    give = JAWS.give_mm(force)
    sd = share * give
    shown = {
        name: [float(x) for x in values] for name, values in (("force", force), ("give", give), ("sd", sd))
    }
    (batch / "rig.toml").write_text(RIG.format(**shown))
    settings = batch / "batch.toml"
    if "rig =" not in settings.read_text():
        settings.write_text(f'rig = "rig.toml"\n{settings.read_text()}')


def soften(batch: Path) -> None:
    """The first fruit's recordings as jaws that give way would have made them."""
    for path in (first_fruit(batch) / "grasps").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            total = np.zeros(len(file["time_s"]))
            for name in ("left", "right"):
                force = file[f"pads/{name}/force_N"][...].astype(float)[:, :, 2].sum(axis=1)
                gave = JAWS.give_mm(force) / 2
                pose = file[f"pads/{name}/pose"][...]
                pose[:, :3, 3] += gave[:, None] * pose[:, :3, 2]
                file[f"pads/{name}/pose"][...] = pose
                total += gave
            file["aperture_mm"][...] = file["aperture_mm"][...] - total
            assert total.max() > 0.1


@pytest.fixture(scope="module")
def true_and_rid_of_the_rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    batch = ready_batch(folder / "batch", 1)
    true = graded_alone(batch, folder / "true", "--no-screen")
    soften(batch)
    write_rig(batch, share=0.05)
    return true, graded_alone(batch, folder / "rid", "--no-screen"), batch


@pytest.mark.slow
def test_the_rig_of_jaws_that_give_way_makes_E_right(true_and_rid_of_the_rig):
    (true, _), (rid, record), _ = true_and_rid_of_the_rig
    E = true.E_MPa
    assert rid.E_MPa == pytest.approx(E, rel=0.01)
    assert 0.001 * E < record["modulus"]["parts_sd_MPa"]["confirmed effects"] < 0.2 * E


@pytest.mark.proof
def test_jaws_that_give_way_make_fruit_soft_where_their_rig_is_not_known(true_and_rid_of_the_rig, tmp_path):
    (true, _), _, batch = true_and_rid_of_the_rig
    without = shutil.copytree(batch, tmp_path / "without")
    settings = without / "batch.toml"
    settings.write_text(settings.read_text().replace('rig = "rig.toml"\n', ""))
    soft, _ = graded_alone(without, tmp_path / "soft", "--no-screen")
    assert soft.E_MPa < 0.9 * true.E_MPa


@pytest.mark.proof
def test_a_fruit_within_the_rigs_spread_is_said_to_be(true_and_rid_of_the_rig, tmp_path):
    *_, batch = true_and_rid_of_the_rig
    vague = tmp_path / "vague"
    shutil.copytree(batch, vague)
    write_rig(vague, share=0.9)
    ran = drupe("check", vague, status=4)
    assert "it is too stiff for this rig, and E is a lower bound" in ran.out + ran.err
    row, _ = graded_alone(vague, tmp_path / "out", "--no-screen")
    assert "E is a lower bound" in row.doubts
    assert row.E_sd_MPa > 0.3 * row.E_MPa
    write_rig(vague, share=0.05, largest_N=3.0)
    ran = drupe("check", vague, status=2)
    assert "the rig calibration ends at 3 N, expected at most 1.25 times that" in ran.out + ran.err
    (vague / "rig.toml").write_text("format = 3\n")
    ran = drupe("check", vague, status=2)
    assert '"rig": rig.toml: format' in ran.out + ran.err
