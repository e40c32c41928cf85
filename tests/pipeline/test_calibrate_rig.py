"""`drupe calibrate --rigid` and `drupe convert --rig`: a rig measured by closed forms is taken off again."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from series_springs import SeriesRig, press
from small_batches import run

from tactile.readers.recording import GelPad, Recording, write_recording
from tactile.readers.rig_file import read_rig
from tactile.tactile_failure import TactileFailure

RIG = SeriesRig(spring_N_per_mm=6.0, pads=12.0)
BALL_MM, NU = 5.0, 0.45
RIGID = ("--rigid", "ball", "--size-mm", "40")


def hertz_mm(E_MPa: float):
    """Approach of a ball of BALL_MM on a half-space under a force (Hertz)."""
    stiffness = 4 / 3 * E_MPa / (1 - NU**2) * np.sqrt(BALL_MM)
    return lambda force: (np.maximum(force, 0) / stiffness) ** (2 / 3)


def write_trace(path: Path, seed: int, *, rig=RIG, **how) -> Path:
    time, force, travel = press(np.random.default_rng(seed), rig, **how)
    rows = [f"{t:.4f},{d:.6f},{f:.6f}" for t, d, f in zip(time, travel, force, strict=True)]
    path.write_text("\n".join(["time_s,travel_mm,force_N", *rows]))
    return path


def calibrated(folder: Path, *more: str) -> tuple[int, str]:
    first, second, third = (write_trace(folder / f"s{k}.csv", k, scale=1 + 0.01 * k) for k in (0, 1, 2))
    again = ("--squeeze", second, "--squeeze", third)
    return run("calibrate", first, folder / "rig.toml", *RIGID, *again, *more)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    assert calibrated(folder)[0] == 0
    return folder / "rig.toml"


def test_squeezes_become_a_rig_that_says_what_was_squeezed(tmp_path: Path) -> None:
    code, said = calibrated(tmp_path, "--object", "steel ball")
    assert code == 0, said
    assert "3 squeezes of steel ball" in said
    rig = read_rig(tmp_path / "rig.toml")
    force = np.linspace(1, 19, 10)
    truth = RIG.give_mm(force) * 1.01
    np.testing.assert_allclose(rig.travel.give(force), truth, atol=0.02)  # the touch is known to 0.02 mm
    np.testing.assert_allclose(np.diff(rig.travel.give(force)), np.diff(truth), rtol=0.005)
    assert (rig.object_name, rig.shape, rig.size_mm, rig.jaws) == ("steel ball", "ball", 40.0, None)
    assert (tmp_path / "rig.toml").read_text().count("sha256") == 3


def test_a_rig_is_written_again_and_nobody_elses_file_is(tmp_path: Path) -> None:
    assert calibrated(tmp_path)[0] == 0
    assert calibrated(tmp_path)[0] == 0
    other_text = 'format = "drupe-rig"\n'
    (tmp_path / "rig.toml").write_text(other_text)
    code, said = calibrated(tmp_path)
    assert code != 0
    assert "is not a rig that drupe calibrate wrote" in said
    assert (tmp_path / "rig.toml").read_text() == other_text
    assert run("calibrate", tmp_path / "s0.csv", tmp_path / "s0.csv", *RIGID)[0] != 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rigid", "ball"), "--rigid calibrates a rig and needs --size-mm"),
        (("--size-mm", "40"), "add --rigid ball"),
        ((*RIGID, "--load-cell", "press"), "which calibrates a sensor"),
    ],
)
def test_options_of_rig_and_sensor_do_not_mix(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    code, output = run("calibrate", write_trace(tmp_path / "s.csv", 0), tmp_path / "rig.toml", *words)
    assert code != 0
    assert said in " ".join(output.replace("│", " ").split())


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ('"drupe-rig"', '"drupe-rigs"', "format: found 'drupe-rigs'"),
        ("version = 1", "version = 2", "version: found 2"),
        ("give_mm = [0.0,", "give_mm = [1.0,", "found a give that falls, or is not 0 without force"),
        ("force_N = [0.0,", "force_N = [9.0,", "forces that grow from 0"),
        ('shape = "ball"', 'shape = "egg"', "ball or block"),
    ],
)
def test_a_rig_that_was_edited_wrongly_is_refused_by_its_field(
    tmp_path: Path, rig: Path, right: str, wrong: str, said: str
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(rig.read_text().replace(right, wrong))
    with pytest.raises(TactileFailure) as failure:
        read_rig(path)
    assert said in str(failure.value)


def explained(folder: Path, *, more: str = "") -> str:
    case = f'category = "silicone"\npoisson_ratio = {NU}\nthickness_mm = 200\n{more}'
    (folder / "case.toml").write_text(case)
    code, said = run("explain", folder, "--json", folder.parent / f"{folder.name}.json")
    assert code == 0, said
    return said


def converted(folder: Path, trace: Path, *more: str | Path) -> str:
    folder.mkdir()
    code, said = run(
        "convert", trace, folder / "one.h5", "--indenter", "ball", "--radius-mm", f"{BALL_MM}", *more
    )
    assert code == 0, said
    return said


def modulus(path: Path) -> dict[str, float]:
    return json.loads(path.read_text())["E_MPa"]["after"]


@pytest.mark.slow
def test_E_comes_back_through_a_soft_rig_and_its_interval_knows_the_rig(tmp_path: Path, rig: Path) -> None:
    truth = 0.3
    trace = write_trace(tmp_path / "soft.csv", 9, own_mm=hertz_mm(truth), peak_N=4.0, frames=120, scale=1.01)
    converted(tmp_path / "bare", trace)
    said = converted(tmp_path / "less", trace, "--rig", rig)
    assert "belong to the rig (rig.toml); drupe subtracted them" in said
    with h5py.File(tmp_path / "less/one.h5") as file:
        assert file["rig_give_mm"][()].max() == pytest.approx(RIG.give_mm(4.0) * 1.01, rel=0.03)
    explained(tmp_path / "bare")
    explained(tmp_path / "less")
    bare, less = modulus(tmp_path / "bare.json"), modulus(tmp_path / "less.json")
    assert bare["value"] < 0.9 * truth
    assert abs(less["value"] - truth) < 2 * less["sd"]
    assert abs(less["value"] - truth) < 0.1 * truth


@pytest.mark.proof
def test_what_is_stiffer_than_the_rig_has_a_lower_bound(tmp_path: Path, rig: Path) -> None:
    truth = 200.0
    trace = write_trace(tmp_path / "hard.csv", 9, own_mm=hertz_mm(truth), peak_N=15.0, frames=120)
    converted(tmp_path / "bare", trace)
    assert "nothing says how stiff the rig is" in " ".join(explained(tmp_path / "bare").split())
    said = " ".join(explained(tmp_path / "bare", more="rig_N_per_mm = 6\n").split())
    assert "E: withheld, since it is at least" in said
    assert "N/mm were recorded on a rig of 6 N/mm" in said
    converted(tmp_path / "less", trace, "--rig", rig)
    said = " ".join(explained(tmp_path / "less").split())
    assert "E: withheld, since it is at least" in said
    least = float(said.split("it is at least ")[1].split()[0])
    assert 1.0 < least < truth
    assert np.isnan(modulus(tmp_path / "less.json")["value"] or np.nan)


def gel_squeeze(path: Path, seed: int) -> Path:
    """A ball of 40 mm between two gels (springs of 20 N/mm each) and jaws of 10 N/mm together."""
    rng = np.random.default_rng(seed)
    gel, jaws = 20.0, SeriesRig(spring_N_per_mm=10.0, pads=1e9)
    time, force, travel = press(rng, jaws, own_mm=lambda f: 2 * f / gel, peak_N=15.0, zero_N=0.0)
    x, y = np.meshgrid(np.arange(-8, 8.1, 1.0), np.arange(-6, 6.1, 1.0))
    rest = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    lower = 20.0 - np.sqrt(400.0 - rest[:, 0] ** 2 - rest[:, 1] ** 2)
    moved, pushed = np.zeros((2, len(time), len(rest), 3))
    moved[:, :, 2] = -np.maximum(np.maximum(force, 0)[:, None] / gel - lower, 0.0)
    under = moved[:, :, 2] < 0
    pushed[:, :, 2] = under * (force / np.maximum(under.sum(axis=1), 1))[:, None]
    pose = np.broadcast_to(np.eye(4), (len(time), 4, 4)).copy()
    motion = {"pose": pose, "rest_mm": rest, "displacement_mm": moved, "force_N": pushed}
    springs = {"gel_kn_MPa_per_mm": 0.1, "gel_kt_MPa_per_mm": 0.1}
    pads = tuple(GelPad(name=name, **motion, **springs) for name in ("left", "right"))
    how = {"fruit_id": "ball", "category": "phantom", "loading": "grasp", "support": "free", "sensor": "gel"}
    write_recording(path, Recording(**how, time_s=time, aperture_mm=42.0 - travel, pads=pads))
    return path


def test_of_a_squeeze_between_gels_the_jaws_part_is_told_from_the_gels(tmp_path: Path) -> None:
    first, second = gel_squeeze(tmp_path / "a.h5", 1), gel_squeeze(tmp_path / "b.h5", 2)
    out = tmp_path / "rig.toml"
    code, said = run("calibrate", first, out, "--squeeze", second, *RIGID)
    assert code == 0, said
    assert "mm belong to the gels, as their markers show" in said
    rig = read_rig(out)
    force = np.linspace(2, 14, 7)
    np.testing.assert_allclose(rig.jaws.give(force), force / 10.0, atol=0.02)
    np.testing.assert_allclose(rig.travel.give(force), force / 5.0, atol=0.03)
    bare = write_trace(tmp_path / "s.csv", 0)
    code, said = run("calibrate", first, tmp_path / "mixed.toml", "--squeeze", bare, *RIGID)
    assert code != 0
    assert "calibrate each kind" in said


def test_a_rig_is_of_bare_traces_alone_in_convert(tmp_path: Path, rig: Path) -> None:
    header = "time_s,aperture_mm,pad,marker,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm,fx_N,fy_N,fz_N"
    rows = [f"{t},50,0,{n},{n % 2},{n // 2},0,0,0,0,0,0,0" for t in range(3) for n in range(4)]
    (tmp_path / "m.csv").write_text("\n".join([header, *rows]))
    (tmp_path / "s.toml").write_text(
        'kind = "fields"\nname = "t"\n[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.1\n'
    )
    code, said = run(
        "convert", tmp_path / "m.csv", tmp_path / "m.h5", "--sensor", tmp_path / "s.toml", "--rig", rig
    )
    assert code != 0
    assert "name the rig in batch.toml" in said
    code, said = run(
        "convert", write_trace(tmp_path / "t.csv", 3, peak_N=60.0), tmp_path / "t.h5", "--indenter", "ball",
        "--radius-mm", "5", "--rig", rig,
    )  # fmt: skip
    assert code == 3
    assert "at most 1.25 times that" in said
    assert not (tmp_path / "t.h5").exists()
