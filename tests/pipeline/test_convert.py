"""`drupe convert` writes a recording that the readers take, or nothing at all and says why."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from raw_folder import write_raw
from small_batches import contents
from small_batches import run as command
from tac3d_folder import write_sensor

from pipeline.problem import BatchRefused
from pipeline.recordings.conversion import ConvertRequest, convert
from tactile.readers.field_tables import COLUMNS
from tactile.readers.recording import GelPad, IndenterPad, read_recording

FIELDS = 'kind = "fields"\nname = "table"\n[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.1\n'
run = partial(command, "convert")


def left_nothing(folder: Path) -> bool:
    return not [p for p in folder.iterdir() if p.suffix == ".h5" or p.name.startswith(".")]


def test_a_raw_grasp_becomes_a_recording(tmp_path: Path) -> None:
    code, said = run(write_raw(tmp_path / "g", frames=4), tmp_path / "out.h5")
    assert code == 3, said  # four frames: the press is too light for the noise of the drawn gel
    assert "drupe grade will refuse this recording: g: the left pad's displacement is mostly noise" in said
    recording = read_recording(tmp_path / "out.h5")
    assert recording.fruit_id == "f1"
    assert [pad.name for pad in recording.pads] == ["left", "right"]
    assert "left: 4 of 4 frames" in said


def test_a_fault_leaves_nothing_behind_and_an_older_recording_as_it_was(tmp_path: Path) -> None:
    raw, out = write_raw(tmp_path / "g", frames=4), tmp_path / "out"
    out.mkdir()
    run(raw, out / "older.h5")
    before = contents(out)
    assert "older.h5" in before
    (raw / "right/frame_000003.png").write_bytes(b"\x89PNG")
    code, said = run(raw, out / "older.h5")
    assert code == 3
    assert "right/frame_000003.png: found a damaged picture" in said
    assert contents(out) == before


def test_a_tac3d_recording_becomes_a_press(tmp_path: Path) -> None:
    folder = write_sensor(tmp_path / "AD2", lost=(20,))
    code, said = run(folder, tmp_path / "out.h5", "--fruit", "f3", "--category", "plum")
    assert code == 0, said
    assert "note: AD2: 1 of 40 frames are missing" in said
    assert read_recording(tmp_path / "out.h5").fruit_id == "f3"


def test_marker_fields_in_npz_and_csv_say_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    rest = rng.normal(size=(5, 3)).round(4)
    moved, pushed = rng.normal(size=(2, 6, 5, 3)).round(4)
    time_s, aperture_mm = np.arange(6) / 10, 50 - np.arange(6.0)
    arrays = {"pads/tip/rest_mm": rest, "pads/tip/displacement_mm": moved, "pads/tip/force_N": pushed}
    np.savez(tmp_path / "a.npz", time_s=time_s, aperture_mm=aperture_mm, **arrays)
    header = "time_s,aperture_mm,pad,marker,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm,fx_N,fy_N,fz_N"
    rows = [
        ",".join(f"{v:g}" for v in (time_s[t], aperture_mm[t], 0, n, *rest[n], *moved[t, n], *pushed[t, n]))
        for t in range(6)
        for n in range(5)
    ]
    (tmp_path / "a.csv").write_text("\n".join([header, *rng.permutation(rows)]))
    (tmp_path / "s.toml").write_text(FIELDS)
    for kind in ("npz", "csv"):
        code, said = run(tmp_path / f"a.{kind}", tmp_path / f"{kind}.h5", "--sensor", tmp_path / "s.toml")
        assert code == 0, said
        pad = read_recording(tmp_path / f"{kind}.h5").pads[0]
        assert isinstance(pad, GelPad)
        np.testing.assert_allclose(pad.rest_mm, rest, atol=1e-9)
        np.testing.assert_allclose(pad.displacement_mm, moved, rtol=1e-6)
        np.testing.assert_allclose(pad.force_N, pushed, rtol=1e-6)


def test_an_archive_with_the_pads_as_first_axis_is_read_as_python_reads_it(tmp_path: Path) -> None:
    stored = read_recording(GRASP)
    arrays = {name: np.array([getattr(pad, name) for pad in stored.pads]) for name in FIELDS_OF_A_PAD}
    arrays |= {"time_s": stored.time_s, "aperture_mm": stored.aperture_mm}
    np.savez(tmp_path / "a.npz", **arrays)
    its_gel = "gel_kn_MPa_per_mm = 0.22\ngel_kt_MPa_per_mm = 0.055\n"
    (tmp_path / "s.toml").write_text(f'kind = "fields"\nname = "gel"\n[gel]\n{its_gel}')
    code, said = run(tmp_path / "a.npz", tmp_path / "a.h5", "--sensor", tmp_path / "s.toml")
    assert code == 0, said
    for pad, its in zip(read_recording(tmp_path / "a.h5").pads, stored.pads, strict=True):
        assert pad.name == its.name
        for name in FIELDS_OF_A_PAD:
            np.testing.assert_allclose(getattr(pad, name), getattr(its, name), rtol=1e-6)
    np.savez(tmp_path / "b.npz", **arrays | {"force_N": arrays["force_N"][:1]})
    code, said = run(tmp_path / "b.npz", tmp_path / "b.h5", "--sensor", tmp_path / "s.toml")
    assert code != 0
    assert "b.npz: force_N: found shape (1, 47, 400, 3), expected as many pads as rest_mm, 2" in said


FIELDS_OF_A_PAD = ("rest_mm", "displacement_mm", "force_N", "pose")
GRASP = Path(__file__).parents[1] / "data" / "nectarine-grasp" / "grasp.h5"


def test_a_bare_load_cell_becomes_a_press(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time_s,travel_mm,force_N\n0,0,0\n0.1,0.5,-1.5\n0.2,1,-4\n")
    code, said = run(tmp_path / "t.csv", tmp_path / "out.h5", "--indenter", "ball", "--radius-mm", "4")
    assert code == 0, said
    assert "drupe reversed its sign" in said
    pad = read_recording(tmp_path / "out.h5").pads[0]
    assert isinstance(pad, IndenterPad)
    np.testing.assert_array_equal(pad.force_z_N, [0, 1.5, 4])
    assert (
        "Give --indenter ball or flat with --radius-mm" in run(tmp_path / "t.csv", tmp_path / "other.h5")[1]
    )


@pytest.mark.parametrize("lacking", ["marker", "pad"])
def test_a_marker_table_that_lacks_a_column_is_not_taken_for_a_load_cell(
    tmp_path: Path, lacking: str
) -> None:
    (tmp_path / "s.toml").write_text(FIELDS)
    names = [name for name in COLUMNS if name != lacking]
    (tmp_path / "a.csv").write_text(f"{','.join(names)}\n{','.join('0' for _ in names)}\n")
    code, said = run(tmp_path / "a.csv", tmp_path / "out.h5", "--sensor", tmp_path / "s.toml")
    assert code == 3
    assert f"a.csv: {lacking}: found the columns time_s" in said
    assert left_nothing(tmp_path)


def test_a_load_cell_of_three_axes_and_a_machine_that_says_its_place_are_still_traces(tmp_path: Path) -> None:
    rows = "time_s,aperture_mm,z_mm,fx_N,fy_N,fz_N\n0,0,9,0,0,0\n0.1,0.5,8.5,0,0,1\n0.2,1,8,0,0,4\n"
    (tmp_path / "t.csv").write_text(rows)
    code, said = run(tmp_path / "t.csv", tmp_path / "out.h5", "--indenter", "ball", "--radius-mm", "4")
    assert code == 0, said
    pad = read_recording(tmp_path / "out.h5").pads[0]
    assert isinstance(pad, IndenterPad)
    np.testing.assert_array_equal(pad.force_z_N, [0, 1, 4])


@pytest.mark.parametrize("name", ["clip.avi", "frame.png", "trial"])
def test_frames_without_a_description_are_told_what_they_need(tmp_path: Path, name: str) -> None:
    (tmp_path / "trial" / "left").mkdir(parents=True)
    for place in ("clip.avi", "frame.png", "trial/left/frame_000000.png"):
        (tmp_path / place).write_bytes(b"RIFF")
    with pytest.raises(BatchRefused) as refused:
        convert(tmp_path / name, tmp_path / "out.h5", ConvertRequest(), report=print)
    said = str(refused.value)
    assert "holds pictures or a video of a gel" in " ".join(said.split())
    assert "with grasp.toml, log.csv and the sensor's description" in " ".join(said.split())
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.parametrize("name", ["nothing", "notes.txt"])
def test_what_cannot_be_converted_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "notes.txt").write_text("?")
    code, _ = run(tmp_path / name, tmp_path / "out.h5")
    assert code != 0
    assert left_nothing(tmp_path)
