"""ROS 2 bags and grasps without poses become recordings; a wrong bag is refused by name."""

import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ros_bags import DEFINITIONS, cloud, number, pose, rows, write_bag
from scipy.spatial.transform import Rotation
from small_batches import run as command

from tactile.readers.recording import Recording, read_recording

SENSOR = 'kind = "fields"\nname = "table"\n[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.1\n'
SENSOR += "[spread]\nforce = 0.05\ndisplacement = 0.02\n"
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


run = partial(command, "convert")


def converted(folder: Path, topics: dict, table: str = TOPICS, *options: object) -> tuple[int, str]:
    write_bag(folder / "grasp.mcap", topics)
    return convert(folder, table, *options)


def convert(folder: Path, table: str, *options: object) -> tuple[int, str]:
    (folder / "sensor.toml").write_text(SENSOR)
    (folder / "topics.toml").write_text(table)
    known = ("--sensor", folder / "sensor.toml", "--topics", folder / "topics.toml")
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
    table = TOPICS.replace('aperture = "/aperture"\n', "")
    converted(tmp_path, topics, table)
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
        code, said = convert(tmp_path, TOPICS)
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
    (tmp_path / "sensor.toml").write_text(SENSOR)
    (tmp_path / "topics.toml").write_text(TOPICS)
    words = ["convert", "grasp.mcap", "out.h5", "--sensor", "sensor.toml", "--topics", "topics.toml"]
    words = [str(tmp_path / word) if "." in word else word for word in words]
    code = (
        "from tactile.readers import ros_bag; from pipeline.cli import app; "
        f"ros_bag.MOST_MEMORY = 10_000_000; app({words!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
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
    (tmp_path / "sensor.toml").write_text(SENSOR)
    code, said = run(tmp_path / "grasp.mcap", tmp_path / "out.h5", "--sensor", tmp_path / "sensor.toml")
    assert code != 0
    assert "give --topics topics.toml" in said


def test_jaws_that_do_not_move_give_no_poses(tmp_path):
    rest = np.random.default_rng(3).normal(size=(MARKERS, 3))
    fields = {f"pads/{pad}/rest_mm": rest for pad in ("left", "right")}
    for pad in ("left", "right"):
        for name in ("displacement_mm", "force_N"):
            fields[f"pads/{pad}/{name}"] = np.zeros((FRAMES, MARKERS, 3))
    np.savez(tmp_path / "a.npz", time_s=np.arange(FRAMES), aperture_mm=np.full(FRAMES, 60.0), **fields)
    (tmp_path / "sensor.toml").write_text(SENSOR)
    options = ("--sensor", tmp_path / "sensor.toml", *JAWS)
    code, said = run(tmp_path / "a.npz", tmp_path / "out.h5", *options)
    assert code == 3
    assert "found an aperture that does not change" in said
