"""Marker fields, aperture and poses of a grasp from a ROS 2 bag (MCAP), by the topics that a TOML file names.

Fields are PointCloud2 (x, y, z) or Float64MultiArray, Float32MultiArray (x, y, z of each marker in turn).
Times are those at which one computer logged the messages. Lengths are metres in ROS (REP 103); the TOML file
(docs/formats.md) may state mm, except for poses.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.files.plain_file import NotReadable, not_plain, open_plain, size
from tactile.markers.gaps import at_times, poses_at
from tactile.readers.flange_table import NOT_ROTATION
from tactile.readers.limited_process import tried
from tactile.readers.pictures import unusable
from tactile.readers.toml_table import read_table
from tactile.tactile_failure import TactileFailure, TactileProblem

MOST_BYTES = 8_000_000_000
"""Largest bag. It may contain a camera's pictures: the reader decodes only topics that the file names."""
MOST_MEMORY, PATIENCE_S = 2_000_000_000, 300.0
"""Most bytes and seconds for decoding. Set by hand: two pads of 400 markers for a minute at 30 frames/s take
70 MB as numbers, several times that as objects."""
MM = {"m": 1000.0, "mm": 1.0}
"""Millimetres in each unit of length."""
FLOATS = {7: "f4", 8: "f8"}
"""NumPy's name of FLOAT32 and FLOAT64 in sensor_msgs/msg/PointField."""
_LIBRARY = "mcap-ros2-support, which is not installed: pip install 'drupe[ros]'"
FIELDS = ("rest", "displacement", "force", "pose")


@dataclass(frozen=True)
class TopicSeries:
    """Messages of a topic: seconds (t,) and values (t, ...)."""

    time_s: Float[np.ndarray, " t"]
    values: Float[np.ndarray, "t ..."]


def bag_fields(path: Path, topics: Path) -> dict[str, np.ndarray]:
    """The fields of tactile.readers.field_tables in the bag at `path`, at the first pad's times.

    Raises TactileFailure (unreadable-frames) that names the bag or `topics`, the topic and its fault.
    """
    top = read_table(
        topics, TactileProblem.UNREADABLE_FRAMES, what="the names of the topics (docs/formats.md)"
    )
    pads = ("tip",) if "tip" in top.values else ("left", "right")
    top.refuse_unknown({"aperture", "length", *pads})
    length = MM[top.choice("length", MM) if "length" in top.values else "m"]
    named: dict[str, str] = {}
    for pad in pads:
        table = top.table(pad, needed=True)
        table.refuse_unknown(FIELDS)
        wanted = [field for field in FIELDS if field != "pose" or field in table.values]
        named |= {f"{pad}.{field}": table.text(field) for field in wanted}
    if "aperture" in top.values:
        named["aperture"] = top.text("aperture")
    read = _series(path, set(named.values()))
    missing = sorted(set(named.values()) - read.keys())
    if missing:
        raise unusable(f"{path.name}: {missing[0]}", "no message", f"the topic that {topics.name} names")
    series = {key: read[topic] for key, topic in named.items()}
    moving = [signal for key, signal in series.items() if not key.endswith(".rest")]
    for key, topic in named.items():
        times = read[topic].time_s
        if not key.endswith(".rest") and (len(times) < 2 or (np.diff(times) <= 0).any()):
            fault = f"{len(times)} messages, not each later than the one before"
            raise unusable(f"{path.name}: {topic}", fault, "two or more messages, logged one after another")
    start, end = max(signal.time_s[0] for signal in moving), min(signal.time_s[-1] for signal in moving)
    when = series[f"{pads[0]}.displacement"].time_s
    when = when[(when >= start) & (when <= end)]
    if len(when) < 2:
        raise unusable(path.name, "topics that do not overlap in time", "messages of the same grasp")
    fields = {"time_s": when - when[0]}
    for pad in pads:
        fields[f"pads/{pad}/rest_mm"] = length * series[f"{pad}.rest"].values[0]
        for field, unit, scale in (("displacement", "mm", length), ("force", "N", 1.0)):
            signal = series[f"{pad}.{field}"]
            fields[f"pads/{pad}/{field}_{unit}"] = scale * at_times(when, signal.time_s, signal.values)
        if f"{pad}.pose" in series:
            fields[f"pads/{pad}/pose"] = _poses(path, named[f"{pad}.pose"], series[f"{pad}.pose"], when)
    if "aperture" in series:
        fields["aperture_mm"] = length * at_times(when, series["aperture"].time_s, series["aperture"].values)
    elif all(f"pads/{pad}/pose" in fields for pad in pads):
        fields["aperture_mm"] = _opening(fields[f"pads/{pads[0]}/pose"], fields.get("pads/right/pose"))
    return fields


def _series(path: Path, topics: set[str]) -> dict[str, TopicSeries]:
    """The decoded messages of these topics; a separate process with limits decodes them first."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise unusable(path.name, "a ROS 2 bag", _LIBRARY) from None
    if wrong := not_plain(path):
        raise unusable(path.name, f"that it {wrong}", "a ROS 2 bag (.mcap)")
    if (length := path.stat().st_size) > MOST_BYTES:
        raise unusable(path.name, size(length), f"at most {size(MOST_BYTES)}; record fewer topics")

    def read() -> dict[str, TopicSeries]:
        held: dict[str, list[tuple[float, np.ndarray]]] = {}
        with open_plain(path) as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for schema, channel, message, decoded in reader.iter_decoded_messages(topics=topics):
                name = "" if schema is None else schema.name
                if name not in VALUES:
                    where = f"{path.name}: {channel.topic}"
                    raise unusable(where, f"messages of type {name[:100]}", "one of " + ", ".join(VALUES))
                held.setdefault(channel.topic, []).append((1e-9 * message.log_time, VALUES[name](decoded)))
        return {
            topic: TopicSeries(np.array([time for time, _ in rows]), np.array([value for _, value in rows]))
            for topic, rows in held.items()
        }

    exceeded = tried(lambda _: read(), patience_s=PATIENCE_S, most_bytes=MOST_MEMORY).exceeded
    if exceeded:
        fault = f"messages that take more than {exceeded} to decode"
        raise unusable(path.name, fault, "a recording of one grasp; cut the bag to it")
    try:
        return read()
    except (TactileFailure, NotReadable):
        raise
    except Exception as cause:  # a broken bag makes the libraries raise many kinds of errors
        said = f"{type(cause).__name__}: {cause}"[:120]
        raise unusable(path.name, f"a damaged bag or unequal messages ({said})", "a whole bag") from cause


def _number(message: Any) -> np.ndarray:
    return np.array(float(message.data))


def _rows(message: Any) -> np.ndarray:
    """x, y, z of each marker; raises ValueError for an array with another layout."""
    sizes = [axis.size for axis in message.layout.dim]
    if len(sizes) > 1 and sizes[-1] != 3:
        raise ValueError(f"a layout of {sizes}, x, y, z are not the last axis")
    values = np.array(message.data, dtype=np.float64)[message.layout.data_offset :]
    return values.reshape(-1, 3)


def _cloud(message: Any) -> np.ndarray:
    """x, y, z of a point cloud of any layout; raises KeyError or ValueError if it lacks them."""
    at = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + FLOATS[at[name].datatype] for name in "xyz"],
            "offsets": [at[name].offset for name in "xyz"],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, -1)  # may end in padding
    points = np.frombuffer(rows[:, : message.width * message.point_step].tobytes(), layout)
    return np.stack([points[name] for name in "xyz"], axis=1).astype(np.float64)


def _pose(message: Any) -> np.ndarray:
    place, turn = message.pose.position, message.pose.orientation
    return np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w], dtype=np.float64)


VALUES: dict[str, Callable[[Any], np.ndarray]] = {
    "std_msgs/msg/Float32": _number,
    "std_msgs/msg/Float64": _number,
    "std_msgs/msg/Float32MultiArray": _rows,
    "std_msgs/msg/Float64MultiArray": _rows,
    "sensor_msgs/msg/PointCloud2": _cloud,
    "geometry_msgs/msg/PoseStamped": _pose,
}
"""Function that returns the numbers of a message, by the message's type."""


def _poses(
    path: Path, topic: str, series: TopicSeries, when: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "t 4 4"]:
    """Rigid transforms in mm at the times `when`; raises TactileFailure for messages that are no poses."""
    if series.values.shape[1:] != (7,):
        raise unusable(f"{path.name}: {topic}", "no poses", "geometry_msgs/msg/PoseStamped")
    lengths = np.linalg.norm(series.values[:, 3:], axis=1)
    if not (np.abs(lengths - 1) < NOT_ROTATION).all():
        fault = f"orientations of length {lengths.min():.3g} to {lengths.max():.3g}"
        raise unusable(f"{path.name}: {topic}", fault, "unit quaternions")
    pose = np.tile(np.eye(4), (len(lengths), 1, 1))
    pose[:, :3, :3] = Rotation.from_quat(series.values[:, 3:]).as_matrix()
    pose[:, :3, 3] = MM["m"] * series.values[:, :3]
    return poses_at(when, series.time_s, pose)


def _opening(
    first: Float[np.ndarray, "t 4 4"], right: Float[np.ndarray, "t 4 4"] | None
) -> Float[np.ndarray, " t"]:
    """Distance of the faces along the left pad's normal, mm; for a press the tip's travel along its z."""
    ahead = first[:, :3, 2]
    way = first[:, :3, 3] - first[0, :3, 3] if right is None else right[:, :3, 3] - first[:, :3, 3]
    return np.asarray(np.einsum("ti,ti->t", way, ahead))
