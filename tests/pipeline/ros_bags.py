"""ROS 2 bags of standard messages, written by the library."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

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
