"""Recordings and bags converted: what a name states, what is asked back, and what is refused."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from raw_folder import write_raw
from scipy.spatial.transform import Rotation
from small_batches import contents, python, said_with
from small_batches import run as command
from tac3d_folder import write_sensor

from pipeline.problem import BatchRefused
from pipeline.recordings.conversion import ConvertRequest, convert
from tactile.readers.field_tables import COLUMNS
from tactile.readers.recording import GelPad, IndenterPad, Recording, read_recording

LINE = "=" * 80
HEADER = f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
DEFINITIONS = {
    "std_msgs/msg/Float64": "float64 data\n",
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data\n"
    f"{LINE}\nMSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n"
    f"{LINE}\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n",
    "sensor_msgs/msg/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\n"
    f"bool is_dense\n{HEADER}{LINE}\nMSG: sensor_msgs/PointField\nstring name\nuint32 offset\n"
    "uint8 datatype\nuint32 count\n",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    f"{HEADER}{LINE}\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\n"
    f"geometry_msgs/Quaternion orientation\n{LINE}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\n"
    f"float64 z\n{LINE}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
"""Definitions of common_interfaces, without constants."""
NO_HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")


def number(value: float) -> tuple[str, Any]:
    return "std_msgs/msg/Float64", SimpleNamespace(data=float(value))


def rows(values: np.ndarray) -> tuple[str, Any]:
    layout = SimpleNamespace(dim=[], data_offset=0)
    return "std_msgs/msg/Float64MultiArray", SimpleNamespace(layout=layout, data=values.ravel().tolist())


def cloud(values: np.ndarray) -> tuple[str, Any]:
    """x, y, z in double precision behind four bytes of something else."""
    fields = [SimpleNamespace(name=n, offset=4 + 8 * k, datatype=8, count=1) for k, n in enumerate("xyz")]
    data = np.zeros((len(values), 28), dtype=np.uint8)
    data[:, 4:] = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(len(values), 24)
    return "sensor_msgs/msg/PointCloud2", SimpleNamespace(
        header=NO_HEADER,
        height=1,
        width=len(values),
        fields=fields,
        is_bigendian=False,
        point_step=28,
        row_step=28 * len(values),
        data=data.tobytes(),
        is_dense=True,
    )


def pose(place_m: Sequence[float], quaternion: Sequence[float]) -> tuple[str, Any]:
    return "geometry_msgs/msg/PoseStamped", SimpleNamespace(
        header=NO_HEADER,
        pose=SimpleNamespace(
            position=SimpleNamespace(**dict(zip("xyz", map(float, place_m), strict=True))),
            orientation=SimpleNamespace(**dict(zip("xyzw", map(float, quaternion), strict=True))),
        ),
    )


def write_bag(path: Path, topics: Mapping[str, Sequence[tuple[float, tuple[str, Any]]]]) -> Path:
    """Messages by topic, each with its time in s."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        schemas: dict[str, Any] = {}
        for topic, messages in topics.items():
            for time_s, (kind, message) in messages:
                if kind not in schemas:
                    schemas[kind] = writer.register_msgdef(kind, DEFINITIONS[kind])
                writer.write_message(topic, schemas[kind], message, log_time=round(1e9 * time_s))
        writer.finish()
    return path


run = partial(command, "convert")


SENSOR = 'kind = "fields"\nname = "table"\n[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.1\n'
SENSOR += "[spread]\nforce = 0.05\ndisplacement = 0.02\n"


def sensor(folder: Path, text: str = SENSOR) -> tuple[str, Path]:
    """The option that names a description with this text."""
    (folder / "sensor.toml").write_text(text)
    return "--sensor", folder / "sensor.toml"


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
    said = said_with(3, "convert", raw, out / "older.h5")
    assert "right/frame_000003.png: found a damaged picture" in said
    assert contents(out) == before


def test_a_tac3d_recording_becomes_a_press(tmp_path: Path) -> None:
    folder = write_sensor(tmp_path / "AD2", lost=(20,))
    said = said_with(0, "convert", folder, tmp_path / "out.h5", "--fruit", "f3", "--category", "plum")
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
    for kind in ("npz", "csv"):
        said_with(0, "convert", tmp_path / f"a.{kind}", tmp_path / f"{kind}.h5", *sensor(tmp_path))
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
    its_gel = sensor(tmp_path, SENSOR.replace("0.3", "0.22").replace("0.1", "0.055"))
    said_with(0, "convert", tmp_path / "a.npz", tmp_path / "a.h5", *its_gel)
    for pad, its in zip(read_recording(tmp_path / "a.h5").pads, stored.pads, strict=True):
        assert pad.name == its.name
        for name in FIELDS_OF_A_PAD:
            np.testing.assert_allclose(getattr(pad, name), getattr(its, name), rtol=1e-6)
    np.savez(tmp_path / "b.npz", **arrays | {"force_N": arrays["force_N"][:1]})
    said = said_with(3, "convert", tmp_path / "b.npz", tmp_path / "b.h5", *its_gel)
    assert "b.npz: force_N: found shape (1, 47, 400, 3), expected as many pads as rest_mm, 2" in said


FIELDS_OF_A_PAD = ("rest_mm", "displacement_mm", "force_N", "pose")
GRASP = Path(__file__).parents[1] / "data" / "nectarine-grasp" / "grasp.h5"


@pytest.mark.parametrize(
    ("rows", "force_N", "reversed_sign"),
    [
        ("time_s,travel_mm,force_N\n0,0,0\n0.1,0.5,-1.5\n0.2,1,-4\n", [0, 1.5, 4], True),
        (
            "time_s,aperture_mm,z_mm,fx_N,fy_N,fz_N\n0,0,9,0,0,0\n0.1,0.5,8.5,0,0,1\n0.2,1,8,0,0,4\n",
            [0, 1, 4],
            False,
        ),
    ],
    ids=["bare", "three axes, and a machine that says its place"],
)
def test_a_load_cell_becomes_a_press(
    tmp_path: Path, rows: str, force_N: list[float], reversed_sign: bool
) -> None:
    table = tmp_path / "t.csv"
    table.write_text(rows)
    said = said_with(0, "convert", table, tmp_path / "out.h5", "--indenter", "ball", "--radius-mm", "4")
    assert ("drupe reversed its sign" in said) == reversed_sign
    pad = read_recording(tmp_path / "out.h5").pads[0]
    assert isinstance(pad, IndenterPad)
    np.testing.assert_array_equal(pad.force_z_N, force_N)
    assert "Give --indenter ball or flat with --radius-mm" in run(table, tmp_path / "other.h5")[1]


@pytest.mark.parametrize("lacking", ["marker", "pad"])
def test_a_marker_table_that_lacks_a_column_is_not_taken_for_a_load_cell(
    tmp_path: Path, lacking: str
) -> None:
    names = [name for name in COLUMNS if name != lacking]
    (tmp_path / "a.csv").write_text(f"{','.join(names)}\n{','.join('0' for _ in names)}\n")
    said = said_with(3, "convert", tmp_path / "a.csv", tmp_path / "out.h5", *sensor(tmp_path))
    assert f"a.csv: {lacking}: found the columns time_s" in said
    assert left_nothing(tmp_path)


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


TOPICS = """aperture = "/aperture"
[left]
rest = "/left/rest"
displacement = "/left/moved"
force = "/left/force"
pose = "/left/pose"
[right]
rest = "/right/rest"
displacement = "/right/moved"
force = "/right/force"
pose = "/right/pose"
"""
FRAMES, MARKERS, START_S = 12, 9, 1.7e9
JAWS = ("--jaws-centre-mm", 1, 2, 30, "--closing", 0, 1, 0)


@pytest.fixture
def truth():
    """Arrays of a grasp, and its topics: fields in metres, poses twice as often as frames."""
    pytest.importorskip("mcap_ros2")
    rng = np.random.default_rng(11)
    time_s = START_S + 0.1 * np.arange(FRAMES)
    held = {
        "rest": rng.normal(size=(2, MARKERS, 3)),
        "moved": rng.normal(size=(2, FRAMES, MARKERS, 3)),
        "force": rng.normal(size=(2, FRAMES, MARKERS, 3)),
        "aperture": 60 - 0.5 * np.arange(FRAMES),
    }
    topics = {"/aperture": [(t, number(a / 1000)) for t, a in zip(time_s, held["aperture"], strict=True)]}
    for k, pad in enumerate(("left", "right")):
        topics[f"/{pad}/rest"] = [(START_S, rows(held["rest"][k] / 1000))]
        topics[f"/{pad}/moved"] = [(t, rows(v / 1000)) for t, v in zip(time_s, held["moved"][k], strict=True)]
        topics[f"/{pad}/force"] = [(t, cloud(v)) for t, v in zip(time_s, held["force"][k], strict=True)]
        twice = START_S + 0.05 * np.arange(-1, 2 * FRAMES + 1)
        topics[f"/{pad}/pose"] = [(t, pose([0.01 * (t - START_S), k, 0], _turn(t))) for t in twice]
    return held, topics


def _turn(t: float) -> np.ndarray:
    """A turn about z at 0.5 rad/s."""
    return Rotation.from_rotvec([0, 0, 0.5 * (t - START_S)]).as_quat()


def converted(folder: Path, topics: dict, table: str = TOPICS, *options: object) -> tuple[int, str]:
    write_bag(folder / "grasp.mcap", topics)
    return convert_bag(folder, table, *options)


def convert_bag(folder: Path, table: str, *options: object) -> tuple[int, str]:
    (folder / "topics.toml").write_text(table)
    known = (*sensor(folder), "--topics", folder / "topics.toml")
    return run(folder / "grasp.mcap", folder / "out.h5", *known, *options)


def without_poses(table: str) -> str:
    return "\n".join(line for line in table.splitlines() if not line.startswith("pose"))


def fields_come_back(made: Recording, held: dict) -> None:
    np.testing.assert_allclose(made.aperture_mm, held["aperture"])
    np.testing.assert_allclose(made.time_s, 0.1 * np.arange(FRAMES), atol=1e-6)
    for pad, rest, moved, force in zip(made.pads, held["rest"], held["moved"], held["force"], strict=True):
        np.testing.assert_allclose(pad.rest_mm, rest, rtol=1e-12)
        np.testing.assert_allclose(pad.displacement_mm, moved, rtol=1e-6)
        np.testing.assert_allclose(pad.force_N, force, rtol=1e-6)


def test_fields_and_poses_of_a_bag_come_back_in_millimetres(tmp_path, truth):
    held, topics = truth
    code, said = converted(tmp_path, topics)
    assert (tmp_path / "out.h5").is_file(), (code, said)
    made = read_recording(tmp_path / "out.h5")
    fields_come_back(made, held)
    for k, pad in enumerate(made.pads):
        assert (pad.force_scale_sd, pad.displacement_scale_sd) == (0.05, 0.02)
        turn = Rotation.from_rotvec(0.5 * made.time_s[:, None] * [0, 0, 1]).as_matrix()
        np.testing.assert_allclose(pad.pose[:, :3, :3], turn, atol=1e-6)
        np.testing.assert_allclose(pad.pose[:, 0, 3], 10 * made.time_s, atol=1e-3)
        np.testing.assert_allclose(pad.pose[:, 1, 3], 1000 * k)


def test_without_poses_the_aperture_of_two_jaws_is_enough(tmp_path, truth):
    held, topics = truth
    code, said = converted(tmp_path, topics, without_poses(TOPICS), *JAWS)
    assert "poses follow from the aperture of two jaws" in said, code
    assert "no motion" not in said
    made = read_recording(tmp_path / "out.h5")
    fields_come_back(made, held)
    left, right = made.pads
    np.testing.assert_allclose(right.pose[:, 1, 3] - left.pose[:, 1, 3], held["aperture"])
    np.testing.assert_allclose((left.pose + right.pose)[:, :3, 3] / 2, [[1, 2, 30]] * FRAMES)
    assert "found poses, expected none" in converted(tmp_path, topics, TOPICS, *JAWS)[1]


def test_an_aperture_without_a_topic_is_that_of_the_poses(tmp_path, truth):
    _, topics = truth
    converted(tmp_path, topics, TOPICS.replace('aperture = "/aperture"\n', ""))
    assert (tmp_path / "out.h5").is_file()


def planar(messages: list) -> list:
    """The same arrays, whose layout says that all x come first."""
    made = []
    for time_s, (kind, message) in messages:
        dim = [SimpleNamespace(label="", size=n, stride=0) for n in (3, MARKERS)]
        layout = SimpleNamespace(dim=dim, data_offset=0)
        made.append((time_s, (kind, SimpleNamespace(**{**vars(message), "layout": layout}))))
    return made


def test_the_padding_of_a_clouds_rows_and_an_arrays_offset_are_left_out(tmp_path, truth):
    held, topics = truth
    for pad in ("left", "right"):
        for _, (_, message) in topics[f"/{pad}/force"]:
            message.height, message.width, message.row_step = 3, MARKERS // 3, 28 * MARKERS // 3 + 5
            rows_of = np.frombuffer(message.data, np.uint8).reshape(3, -1)
            message.data = np.pad(rows_of, [(0, 0), (0, 5)], constant_values=9).tobytes()
        _, (_, rest) = topics[f"/{pad}/rest"][0]
        rest.data, rest.layout.data_offset = [7.0, *rest.data], 1
    converted(tmp_path, topics)
    fields_come_back(read_recording(tmp_path / "out.h5"), held)


def test_options_that_would_be_ignored_are_refused(tmp_path):
    table, out = tmp_path / "a.npz", tmp_path / "out.h5"
    assert "--closing and --up need --jaws-centre-mm" in run(table, out, "--closing", 0, 1, 0)[1]
    both = "--robot", tmp_path / "robot.toml", "--flange", tmp_path / "flange.csv"
    assert "remove one of them" in run(table, out, *both, *JAWS)[1]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda topics: topics.pop("/left/force"), "grasp.mcap: /left/force: found no message"),
        (lambda topics: topics.update({"/left/force": topics["/aperture"]}), "force_N: found shape (12,)"),
        (lambda topics: topics.update({"/left/pose": topics["/aperture"]}), "/left/pose: found no poses"),
        (
            lambda topics: topics["/left/pose"].append((START_S + 9, pose([0, 0, 0], [0, 0, 0, 0.5]))),
            "/left/pose: found orientations of length 0.5 to 1, expected unit quaternions",
        ),
        (lambda topics: topics["/aperture"].__delitem__(slice(1, None)), "/aperture: found 1 messages"),
        (lambda topics: topics.update({"/left/moved": planar(topics["/left/moved"])}), "not the last axis"),
        (
            lambda topics: topics["/left/force"].append((START_S + 9, rows(np.zeros((4, 3))))),
            "found a damaged bag or unequal messages",
        ),
    ],
)
def test_a_wrong_bag_is_named_and_leaves_nothing(tmp_path, truth, change, sentence):
    topics = {topic: list(messages) for topic, messages in truth[1].items()}
    change(topics)
    code, said = converted(tmp_path, topics)
    assert sentence in said
    assert (code, (tmp_path / "out.h5").exists()) == (3, False)


def test_a_cut_bag_and_another_file_are_refused(tmp_path, truth):
    write_bag(tmp_path / "grasp.mcap", truth[1])
    whole = (tmp_path / "grasp.mcap").read_bytes()
    for content in (whole[: len(whole) // 2], b"no bag"):
        (tmp_path / "grasp.mcap").write_bytes(content)
        code, said = convert_bag(tmp_path, TOPICS)
        assert (code, (tmp_path / "out.h5").exists()) == (3, False)
        assert "found a damaged bag" in said


def test_a_small_bag_that_unpacks_to_too_much_is_given_up(tmp_path):
    """Zeros that compress to a thousandth; the limit is lowered so that the test is fast.

    In a process of its own: one that has freed memory before holds the message without new addresses.
    """
    writer = pytest.importorskip("mcap.writer").Writer(str(tmp_path / "grasp.mcap"))
    writer.start()
    kind = "std_msgs/msg/Float64MultiArray"
    schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
    channel = writer.register_channel("/left/moved", "cdr", schema)
    count = 8_000_000
    head = bytes([0, 1, 0, 0]) + bytes(8) + count.to_bytes(4, "little") + bytes(4)
    writer.add_message(channel, 0, head + bytes(8 * count), 0)
    writer.finish()
    assert (tmp_path / "grasp.mcap").stat().st_size < count / 100
    (tmp_path / "topics.toml").write_text(TOPICS)
    files = (
        tmp_path / "grasp.mcap",
        tmp_path / "out.h5",
        *sensor(tmp_path),
        "--topics",
        tmp_path / "topics.toml",
    )
    words = ["convert", *map(str, files)]
    code = (
        "from tactile.readers import ros_bag; from pipeline.cli import app; "
        f"ros_bag.MOST_MEMORY = 10_000_000; app({words!r})"
    )
    done = python(code)
    assert done.returncode == 3
    assert "messages that take more than 10 MB of memory to decode" in done.stderr


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (TOPICS.replace("rest =", "rast ="), "left.rast: found a key that is not known"),
        ('length = "inch"\n' + TOPICS, "length: found 'inch', expected m or mm"),
        ("[left]\n", "left: found nothing"),
    ],
)
def test_a_wrong_table_of_topics_is_named(tmp_path, truth, table, sentence):
    code, said = converted(tmp_path, truth[1], table)
    assert code == 3
    assert sentence in said


def test_topics_are_asked_for(tmp_path):
    (tmp_path / "grasp.mcap").write_bytes(b"")
    said = said_with(1, "convert", tmp_path / "grasp.mcap", tmp_path / "out.h5", *sensor(tmp_path))
    assert "give --topics topics.toml" in said


def test_jaws_that_do_not_move_give_no_poses(tmp_path):
    rest = np.random.default_rng(3).normal(size=(MARKERS, 3))
    fields = {f"pads/{pad}/rest_mm": rest for pad in ("left", "right")}
    for pad in ("left", "right"):
        for name in ("displacement_mm", "force_N"):
            fields[f"pads/{pad}/{name}"] = np.zeros((FRAMES, MARKERS, 3))
    np.savez(tmp_path / "a.npz", time_s=np.arange(FRAMES), aperture_mm=np.full(FRAMES, 60.0), **fields)
    said = said_with(3, "convert", tmp_path / "a.npz", tmp_path / "out.h5", *sensor(tmp_path), *JAWS)
    assert "found an aperture that does not change" in said
