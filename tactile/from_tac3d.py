"""Tac3D recordings of one grasp or press, in the canonical form, with notes for their reader."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactile.markers.gaps import at_times
from tactile.readers.pictures import gaps_said
from tactile.readers.recording import Converted, GelPad, Recording, marker_area_mm2
from tactile.readers.tac3d import Tac3D
from tactile.tactile_failure import TactileProblem

APART_S = 0.5
"""Two fingers whose clocks differ by more have two clocks."""
LAGS_S = np.arange(-1.0, 1.0001, 0.01)
"""Lags tried between two clocks, s: up to a second, in steps of a hundredth. Set by hand."""
LOADED = 0.5
"""Markers with more than this share of the greatest force determine the gel's stiffness."""


def recording_of_tac3d(
    sensors: Sequence[Tac3D],
    *,
    fruit_id: str,
    category: str,
    stiffness: tuple[float, float] | None = None,
    scale_sd: tuple[float, float] = (0.0, 0.0),
) -> Converted:
    """One sensor becomes a press with the pad `tip`, two a grasp with `left` and `right`, in the given order.

    Displacements stay; forces change sign (here they are those of the gel on the fruit); the origin moves to
    the middle of the gel face. The recorder knows neither aperture nor pose: aperture is written as zero,
    poses as no motion, with a note. `stiffness`: normal and shear, MPa/mm; without it the loaded markers
    determine it. `scale_sd`: relative standard deviations of force and displacement, which all markers share.

    Raises TactileFailure (unreadable-recording) if times of one sensor do not increase, or if there are more
    sensors than two.
    """
    if not 1 <= len(sensors) <= 2:
        raise TactileProblem.UNREADABLE_RECORDING.failure(
            f"found recordings of {len(sensors)} sensors, expected one (a press) or two (a grasp).",
        )
    names = ("tip",) if len(sensors) == 1 else ("left", "right")
    notes: list[str] = []
    for sensor in sensors:
        _refuse_time(sensor)
        notes += _said_of(sensor)
    times = [sensor.send_s - sensors[0].send_s[0] for sensor in sensors]
    if len(sensors) == 2:
        times[1], said = _second_clock(sensors[0], sensors[1])
        notes.append(said)
    start, end = max(t[0] for t in times), min(t[-1] for t in times)
    when = times[0][(times[0] >= start) & (times[0] <= end)]
    if len(sensors) == 2 and len(when) < len(times[0]):
        notes.append(
            f"{len(times[0]) - len(when)} frames of {sensors[0].serial} are outside the other "
            "sensor's time range."
        )
    pads = []
    for sensor, name, time_s in zip(sensors, names, times, strict=True):
        kn, kt = stiffness or _stiffness(sensor)
        if stiffness is None:
            notes.append(
                f"{sensor.serial}: gel stiffness {kn:.3f} and {kt:.3f} MPa/mm, from its loaded markers."
            )
        rest = rest_of(sensor)
        pads.append(
            GelPad(
                name=name,
                pose=np.broadcast_to(np.eye(4), (len(when), 4, 4)).copy(),
                rest_mm=rest - _origin(rest),
                displacement_mm=at_times(when, time_s, sensor.displacement_mm),
                force_N=-at_times(when, time_s, sensor.force_N),
                gel_kn_MPa_per_mm=kn,
                gel_kt_MPa_per_mm=kt,
                force_scale_sd=scale_sd[0],
                displacement_scale_sd=scale_sd[1],
            )
        )
    notes.append(
        "there is no aperture and no pose, because the gripper has them; drupe writes zero "
        "aperture and no motion."
    )
    return Converted(
        recording=Recording(
            fruit_id=fruit_id,
            category=category,
            loading="press" if len(sensors) == 1 else "grasp",
            support="base" if len(sensors) == 1 else "free",
            sensor="Tac3D " + " ".join(sensor.serial for sensor in sensors),
            time_s=when,
            aperture_mm=np.zeros(len(when)),
            pads=tuple(pads),
        ),
        notes=tuple(notes),
    )


def rest_of(sensor: Tac3D) -> Float[np.ndarray, "n 3"]:
    """Each marker's place without load: the median over the frames of position minus displacement."""
    return np.asarray(np.median(sensor.position_mm - sensor.displacement_mm, axis=0))


def _origin(rest_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The middle of the face: the markers' mean in the plane, the height of the nearest ones."""
    middle = rest_mm[:, :2].mean(axis=0)
    near = np.argsort(np.linalg.norm(rest_mm[:, :2] - middle, axis=1))[:4]
    return np.array([*middle, rest_mm[near, 2].mean()])


def _said_of(sensor: Tac3D) -> list[str]:
    """Notes on one sensor's frames: lost ones, a deadband."""
    name, frames = sensor.serial, len(sensor.index)
    notes = []
    step = np.diff(sensor.index)
    missing = int((step - 1).clip(min=0).sum())
    if missing:
        notes.append(
            f"{name}: {missing} of {missing + frames} frames are missing ({int((step > 1).sum())} "
            "gaps in the index)."
        )
    else:
        notes += gaps_said(sensor.send_s - sensor.send_s[0], name)
    if (step <= 0).any():
        notes.append(f"{name}: the index stops or decreases {int((step <= 0).sum())} times.")
    silent = (sensor.force_N == 0).all(axis=(1, 2)) & (sensor.displacement_mm == 0).all(axis=(1, 2))
    if silent.any():
        notes.append(
            f"{name}: {int(silent.sum())} frames are exactly zero (a deadband), so frames in air show "
            "no noise and the smallest forces are missing."
        )
    return notes


def _refuse_time(sensor: Tac3D) -> None:
    back = np.flatnonzero(np.diff(sensor.send_s) <= 0)
    if len(back):
        k = int(back[0])
        raise TactileProblem.UNREADABLE_RECORDING.failure(
            f"{sensor.serial}/sendTimestamp.npy: found {sensor.send_s[k + 1]:g} s in frame {k + 1} after "
            f"{sensor.send_s[k]:g} s, expected strictly increasing times; drop the repeated frames.",
        )


def _second_clock(first_sensor: Tac3D, second_sensor: Tac3D) -> tuple[Float[np.ndarray, " t"], str]:
    """The second sensor's times on the first one's clock (which starts at zero), and how they were found.

    Receiving times are one computer's clock. Without them, starts more than half a second apart mean two
    clocks. Both recorders are then assumed to start together, up to the lag at which the two normal forces
    correlate best.
    """
    if first_sensor.receive_s is not None and second_sensor.receive_s is not None:
        shift = float(
            np.median(second_sensor.receive_s - second_sensor.send_s)
            - np.median(first_sensor.receive_s - first_sensor.send_s)
        )
        said = (
            f"{second_sensor.serial}: its clock is {-shift:.3f} s ahead of {first_sensor.serial}'s "
            "(receiving times)."
        )
        return second_sensor.send_s + shift - first_sensor.send_s[0], said
    apart = float(second_sensor.send_s[0] - first_sensor.send_s[0])
    if abs(apart) < APART_S:
        return second_sensor.send_s - first_sensor.send_s[0], (
            f"drupe assumes that {first_sensor.serial} and {second_sensor.serial} share one clock."
        )
    first, second = (
        first_sensor.send_s - first_sensor.send_s[0],
        second_sensor.send_s - second_sensor.send_s[0],
    )
    pushes = [-s.force_N.sum(axis=1)[:, 2] for s in (first_sensor, second_sensor)]
    likeness = np.array([_likeness(first, pushes[0], second + lag, pushes[1]) for lag in LAGS_S])
    best = int(likeness.argmax())
    if likeness[best] > 0.8:
        lag, how = float(LAGS_S[best]), f"their normal forces agree best (correlation {likeness[best]:.2f})"
    else:
        lag, how = 0.0, "they start together (their forces are too steady for a better match)"
    said = (
        f"the time stamps of {first_sensor.serial} and {second_sensor.serial} differ by {abs(apart):.2f} s "
        f"(two clocks); drupe shifts the second so that {how}."
    )
    return second + lag, said


def _likeness(
    time_a: Float[np.ndarray, " a"],
    a: Float[np.ndarray, " a"],
    time_b: Float[np.ndarray, " b"],
    b: Float[np.ndarray, " b"],
) -> float:
    """Correlation of two signals where they overlap."""
    within = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    if within.sum() < len(time_a) / 2:
        return -1.0
    x, y = a[within], np.interp(time_a[within], time_b, b)
    return float(np.corrcoef(x, y)[0, 1]) if x.std() * y.std() > 0 else -1.0


def _stiffness(sensor: Tac3D) -> tuple[float, float]:
    """Force over displacement over area of the most pressed markers (least squares), along z and across."""
    pressed = -sensor.force_N[..., 2]
    loaded = pressed > LOADED * pressed.max()
    area = marker_area_mm2(rest_of(sensor)) or 1.0
    moved, pushed = sensor.displacement_mm[loaded], sensor.force_N[loaded]

    def slope(axes: list[int]) -> float:
        return abs(float((moved[:, axes] * pushed[:, axes]).sum() / max((moved[:, axes] ** 2).sum(), 1e-12)))

    return max(slope([2]) / area, 1e-6), max(slope([0, 1]) / area, 1e-6)
