"""`drupe calibrate` of a gel and of a rig, and `drupe sensor`."""

import json
import tomllib
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from series_springs import SeriesRig, press
from small_batches import run as command
from small_batches import said_with
from test_camera_from_dots import dots, eye, picture

from fem.estimation.joint_inference import FruitModulus
from pipeline.files.toml_text import as_toml
from pipeline.fruit.elasticity import SENSOR, modulus_record
from pipeline.fruit.sensor_scale import COMMON_SD, E_PER_PICTURE, PICTURE_SD, SensorScale, sensor_scale
from samples.gel_images import Field, GelLook, gel_image
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import GelPad, Recording, read_recording, write_recording
from tactile.readers.rig_file import read_rig
from tactile.readers.sensor_file import read_sensor
from tactile.readers.sensor_model import model_names, read_model
from tactile.sensors import GelCamera, marker_grid
from tactile.tactile_failure import TactileFailure

DRAFT = """
kind = "markers-stereo"
name = "rendered"

[gel]
thickness_mm = 4.0
E_MPa = 0.2
nu = 0.48

[markers]
rows = 7
columns = 10
pitch_mm = [1.2, 1.2]
"""
DOTS = marker_grid(7, 10, pitch_mm=(1.2, 1.2), first_mm=None)
TURNS_RAD = {"camera": 0.3, "second_camera": -0.3}


def bump(depth_mm: float) -> Field:
    def field(at: np.ndarray) -> np.ndarray:
        r = np.minimum(np.linalg.norm(at, axis=1) / 2.4, 1.0)
        return np.outer((1 - r**2) ** 1.5, [0.0, 0.0, -depth_mm])

    return field


def camera_table(turn_rad: float) -> dict[str, object]:
    """22 mm behind the middle of the gel, turned about y."""
    c, s = float(np.cos(turn_rad)), float(np.sin(turn_rad))
    pose = [[c, 0.0, s, -22.0 * s], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, -22.0 * c], [0.0, 0.0, 0.0, 1.0]]
    return {
        "image_px": [320, 240],
        "focal_px": [460.0, 461.0],
        "centre_px": [161.0, 118.0],
        "distortion": [-0.12, 0.03, 0.001, -0.001, 0.0],
        "gel_from_camera": pose,
    }


def draw(camera: GelCamera, path: Path, field: Field, rng: np.random.Generator) -> None:
    image = gel_image(camera, (), GelLook(rest_mm=DOTS, dot_mm=0.4), field, rng)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1])


@pytest.fixture
def draft(tmp_path: Path) -> Path:
    path = tmp_path / "draft.toml"
    cameras = {name: camera_table(turn) for name, turn in TURNS_RAD.items()}
    path.write_text(as_toml(tomllib.loads(DRAFT) | cameras))
    return path


def test_a_load_cell_gives_the_modulus_of_the_gel(draft: Path, tmp_path: Path) -> None:
    """The cell reads 1.3 times what the gel reads with the modulus of its description."""
    press, rng = tmp_path / "press", np.random.default_rng(1)
    depths = np.concatenate([np.zeros(4), np.linspace(0.08, 0.5, 7)])
    sensor = read_sensor(draft)
    for camera, folder in ((sensor.camera, press / "tip"), (sensor.second_camera, press / "tip-b")):
        draw(camera, folder / "reference.png", bump(0.0), rng)
        for k, depth in enumerate(depths):
            draw(camera, folder / f"frame_{k:06d}.png", bump(depth), rng)
    (press / "grasp.toml").write_text(
        'fruit_id = "flat"\ncategory = "calibration"\nloading = "press"\npose_aperture_mm = 0.0\n[pads.tip]\n'
        "pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )

    def write_log(cell_N: np.ndarray) -> None:
        rows = [
            f"{k / 30:.4f},{d:.4f},0,0,{f:.5f},0,0,0"
            for k, (d, f) in enumerate(zip(depths, cell_N, strict=True))
        ]
        header = "time_s,aperture_mm,fx_N,fy_N,fz_N,tx_Nmm,ty_Nmm,tz_Nmm"
        (press / "log.csv").write_text("\n".join([header, *rows]) + "\n")

    write_log(depths)
    pad = recording_of(read_raw_grasp(press, sensor=draft)).recording.pads[0]
    write_log(1.3 * pad.force_N[:, :, 2].sum(axis=1))
    out = tmp_path / "made" / "sensor.toml"
    said_with(0, "calibrate", draft, out, "--load-cell", press)
    assert read_sensor(out).E_MPa == pytest.approx(1.3 * 0.2, rel=0.01)


def test_a_description_is_written_as_it_was_read() -> None:
    values = tomllib.loads(DRAFT + 'note = "a \\"quoted\\" \\\\ word"\n')
    values["recordings"] = [{"name": "a.csv", "force_N": [1.0, 0.0]}] * 3
    assert tomllib.loads(as_toml(values)) == values


@pytest.mark.parametrize("name", ["Brix (%)", "a.b", "", 'a "b"', "Größe"])
def test_a_name_that_is_no_bare_key_is_quoted_everywhere(name: str) -> None:
    values = {name: 1, "table": {name: {name: 2}}, "tables": [{name: [{name: 3}]}], "inline": [[{name: 4}]]}
    assert tomllib.loads(as_toml(values)) == values


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
    return command("calibrate", first, folder / "rig.toml", *RIGID, *again, *more)


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
    assert command("calibrate", tmp_path / "s0.csv", tmp_path / "s0.csv", *RIGID)[0] != 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rigid", "ball"), "--rigid calibrates a rig and needs --size-mm"),
        (("--size-mm", "40"), "add --rigid ball"),
        ((*RIGID, "--load-cell", "press"), "which calibrates a sensor"),
        ((), "For a sensor give --load-cell. For a rig give --rigid"),
    ],
)
def test_options_of_rig_and_sensor_do_not_mix_and_one_is_needed(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    code, output = command("calibrate", write_trace(tmp_path / "s.csv", 0), tmp_path / "rig.toml", *words)
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
    return said_with(0, "explain", folder, "--json", folder.parent / f"{folder.name}.json")


def converted(folder: Path, trace: Path, *more: str | Path) -> str:
    folder.mkdir()
    return said_with(
        0, "convert", trace, folder / "one.h5", "--indenter", "ball", "--radius-mm", f"{BALL_MM}", *more
    )


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
    assert 1.0 < float(said.split("it is at least ")[1].split()[0]) < truth
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
    said = said_with(0, "calibrate", first, out, "--squeeze", second, *RIGID)
    assert "mm belong to the gels, as their markers show" in said
    rig = read_rig(out)
    force = np.linspace(2, 14, 7)
    np.testing.assert_allclose(rig.jaws.give(force), force / 10.0, atol=0.02)
    np.testing.assert_allclose(rig.travel.give(force), force / 5.0, atol=0.03)
    bare = write_trace(tmp_path / "s.csv", 0)
    code, said = command("calibrate", first, tmp_path / "mixed.toml", "--squeeze", bare, *RIGID)
    assert code != 0
    assert "calibrate each kind" in said


def test_a_rig_is_of_bare_traces_alone_in_convert(tmp_path: Path, rig: Path) -> None:
    header = "time_s,aperture_mm,pad,marker,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm,fx_N,fy_N,fz_N"
    rows = [f"{t},50,0,{n},{n % 2},{n // 2},0,0,0,0,0,0,0" for t in range(3) for n in range(4)]
    (tmp_path / "m.csv").write_text("\n".join([header, *rows]))
    (tmp_path / "s.toml").write_text(
        'kind = "fields"\nname = "t"\n[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.1\n'
    )
    code, said = command(
        "convert", tmp_path / "m.csv", tmp_path / "m.h5", "--sensor", tmp_path / "s.toml", "--rig", rig
    )
    assert code != 0
    assert "name the rig in batch.toml" in said
    code, said = command(
        "convert", write_trace(tmp_path / "t.csv", 3, peak_N=60.0), tmp_path / "t.h5", "--indenter", "ball",
        "--radius-mm", "5", "--rig", rig,
    )  # fmt: skip
    assert code == 3
    assert "at most 1.25 times that" in said
    assert not (tmp_path / "t.h5").exists()


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    path = tmp_path / "empty.png"
    cv2.imwrite(str(path), picture(eye(), dots()))
    return path


def test_sensors_are_listed_with_what_has_to_be_given() -> None:
    said = said_with(0, "sensor")
    assert "gelsight-mini: GelSight Mini, marked gel." in said
    assert "mono-gel" in said
    assert "--thickness-mm, --E-MPa, --pitch-mm" in said
    assert "digit: DIGIT, with printed dots. No published values exist for --pitch-mm; measure them" in said
    assert said.count("DIGIT") == 1


@pytest.mark.parametrize("name", model_names())
def test_every_value_that_is_shipped_has_a_source_and_a_spread(name: str) -> None:
    model = read_model(name)
    values = [*model.gel.values(), model.pitch_mm, model.distance_mm, *model.fields.values()]
    known = [published for published in values if published is not None]
    assert known
    assert all(published.sd > 0 and len(published.source) > 10 for published in known)


def test_a_picture_of_the_dots_makes_a_mini_of_ones_own(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    said = said_with(0, "sensor", "gelsight-mini", out, "--picture", empty)
    assert "63 dots of a grid of 7 x 9" in said
    sensor = read_sensor(out)
    assert sensor.camera.focal_px[0] == pytest.approx(222.0, rel=0.01)
    assert sensor.force_sd == pytest.approx(np.linalg.norm([0.09 / 0.435, 0.1 / 4, 0.45 * 4 / 16]), abs=0.02)
    assert sensor.rest_mm[0, 2] < -0.2
    assert "# E_MPa 0.435 ± 0.09 (6 C10" in out.read_text()
    assert command("sensor", "gelsight-mini", out, "--picture", empty)[0] == 0


def test_what_is_given_takes_the_place_of_what_is_published(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    given = ("--E-MPa", "0.3", "--distance-mm", "17", "--known-to", "0.02")
    assert command("sensor", "gelsight-mini", out, "--picture", empty, *given)[0] == 0
    sensor = read_sensor(out)
    assert sensor.E_MPa == 0.3
    assert 0.05 < sensor.force_sd < 0.07  # the dots' distance is still what is published
    measured = tmp_path / "own.toml"
    assert (
        command("sensor", "gelsight-mini", measured, "--picture", empty, *given, "--pitch-mm", "2.4", "2.36")[
            0
        ]
        == 0
    )
    assert read_sensor(measured).force_sd < 0.05


def test_a_gel_of_ones_own_needs_its_numbers(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "own.toml"
    said = said_with(3, "sensor", "mono-gel", out, "--picture", empty)
    assert "no published values exist for --thickness-mm, --E-MPa, --pitch-mm" in " ".join(said.split())
    numbers = ("--thickness-mm", "4", "--E-MPa", "0.2", "--pitch-mm", "2.4", "2.36")
    assert command("sensor", "mono-gel", out, "--picture", empty, *numbers)[0] == 0
    assert read_sensor(out).outline is None


def test_a_refused_picture_is_named_once(tmp_path: Path) -> None:
    no_picture = tmp_path / "empty.csv"
    no_picture.write_text("1,2")
    said = said_with(3, "sensor", "gelsight-mini", tmp_path / "mini.toml", "--picture", no_picture)
    assert said.count("empty.csv") == 1


def test_what_cannot_be_is_said(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    assert "is not a sensor that drupe knows; known: digit," in command("sensor", "gelsight", out)[1]
    assert "found no picture of the untouched gel" in command("sensor", "gelsight-mini", out)[1]
    assert "Name the description file to write" in command("sensor", "gelsight-mini")[1]
    out.write_text('kind = "fields"\n')
    said = command("sensor", "gelsight-mini", out, "--picture", empty)[1]
    assert "a description that drupe sensor wrote" in said
    assert out.read_text() == 'kind = "fields"\n'


def grasp(force_sd: float, displacement_sd: float) -> Recording:
    """Jaws that close by 2 mm; each gel is compressed by 0.25 mm."""
    time_s = np.arange(5.0)
    share = np.linspace(0, 1, 5)
    rest = np.column_stack([*(axis.ravel() for axis in np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1])), np.zeros(9)])
    pressed = share[:, None, None] * np.tile([0, 0, 1.0], (9, 1))
    fields = {"rest_mm": rest, "displacement_mm": -0.25 * pressed, "force_N": 0.5 * pressed}
    known = {"pose": np.tile(np.eye(4), (5, 1, 1)), "gel_kn_MPa_per_mm": 1.0, "gel_kt_MPa_per_mm": 0.1}
    spread = {"force_scale_sd": force_sd, "displacement_scale_sd": displacement_sd}
    pads = tuple(GelPad(name=name, **fields, **known, **spread) for name in ("left", "right"))
    return Recording(
        fruit_id="f", category="nectarine", loading="grasp", support="free", sensor="s", time_s=time_s,
        aperture_mm=60.0 - np.r_[0, np.linspace(0, 2, 4)], pads=pads,
    )  # fmt: skip


def test_the_spread_of_the_scales_is_kept_and_goes_into_e(tmp_path: Path) -> None:
    write_recording(tmp_path / "g.h5", grasp(0.2, 0.03))
    pad = read_recording(tmp_path / "g.h5").pads[0]
    assert isinstance(pad, GelPad)
    assert (pad.force_scale_sd, pad.displacement_scale_sd) == (0.2, 0.03)
    unknown, stated = sensor_scale([grasp(0.0, 0.0)], None), sensor_scale([grasp(0.2, 0.03)], None)
    assert (unknown.common, unknown.pictures) == pytest.approx((COMMON_SD, E_PER_PICTURE * PICTURE_SD))
    assert (stated.common, stated.pictures) == pytest.approx((0.2, E_PER_PICTURE * 0.03))


def test_the_common_scale_is_beside_the_error_bar_and_all_fruit_share_that_of_pictures_and_gain() -> None:
    modulus = FruitModulus(
        E_MPa=0.5, E_sd_MPa=0.02, parts_sd_MPa={"tactile noise": 0.02}, pit=None, grasps=1, warnings=()
    )
    plain = modulus_record(modulus)
    wide = modulus_record(modulus, sensor=SensorScale(common=0.1, pictures=0.2))
    gained = modulus_record(modulus, sensor=SensorScale(gain=0.2, own_gain=0.1))
    assert gained.common_sd_MPa == pytest.approx(np.hypot(plain.common_sd_MPa, 0.2 * plain.E_MPa))
    assert gained.E_sd_MPa == pytest.approx(np.hypot(gained.common_sd_MPa, np.hypot(0.02, 0.1 * plain.E_MPa)))
    assert wide.E_sd_MPa == pytest.approx(np.hypot(plain.E_sd_MPa, 0.2 * plain.E_MPa))
    assert wide.common_sd_MPa == pytest.approx(np.hypot(plain.common_sd_MPa, 0.2 * plain.E_MPa))
    assert wide.parts_sd_MPa[SENSOR] == pytest.approx(0.2 * plain.E_MPa)
    assert wide.scale_sd_MPa == pytest.approx(0.1 * plain.E_MPa)
    assert SENSOR not in plain.parts_sd_MPa
