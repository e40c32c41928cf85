"""Recordings from arrays and from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from drupe.numbers import PerPad, numbers, per_pad
from drupe.refusal import DrupeError, refusals
from pipeline.batch.scratch import scratch
from pipeline.files.whole_file import put
from tactile.jaw_poses import jaw_poses as poses_of_jaws
from tactile.readers.field_tables import PADS
from tactile.readers.recording import GelPad, Recording
from tactile.readers.recording import read_recording as read_h5
from tactile.readers.recording import write_recording as write_h5

WRITTEN = (".h5", ".hdf5")
"""Suffixes of written recordings. MATLAB's `load` cannot open HDF5 in a .mat file without MATLAB's header."""


def jaw_poses(
    aperture_mm: ArrayLike,
    *,
    centre_mm: ArrayLike,
    closing: ArrayLike = (1.0, 0.0, 0.0),
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> tuple[Float[np.ndarray, "t 4 4"], Float[np.ndarray, "t 4 4"]]:
    """Poses (T, 4, 4) of both pads of a gripper that closes in a straight line, from its aperture (T,) in mm.

    `centre_mm` (3,): the point halfway between the jaws, in the mesh's frame. `closing` (3,): direction from
    the left jaw to the right jaw. `up` (3,): the y axis of both pads. Lengths of directions do not matter.

    Raises DrupeError if the directions are parallel or a shape is wrong.

    >>> left, right = jaw_poses([60.0, 58.0], centre_mm=[0, 0, 30])
    >>> left[:, :3, 3]
    array([[-30.,   0.,  30.],
           [-29.,   0.,  30.]])
    """
    with refusals():
        return poses_of_jaws(
            numbers("aperture_mm", aperture_mm, (None,)),
            centre_mm=numbers("centre_mm", centre_mm, (3,)),
            closing=numbers("closing", closing, (3,)),
            up=numbers("up", up, (3,)),
        )


def recording(
    *,
    time_s: ArrayLike,
    aperture_mm: ArrayLike,
    rest_mm: PerPad,
    displacement_mm: PerPad,
    force_N: PerPad,
    pose: PerPad,
    gel_stiffness_MPa_per_mm: tuple[float, float],
    fruit_id: str = "unknown",
    category: str = "unknown",
    sensor: str = "unknown",
    force_scale_sd: float = 0.0,
    displacement_scale_sd: float = 0.0,
) -> Recording:
    """A recording of T frames from arrays: a grasp between two pads, or a press with a single pad.

    `time_s` (T,), seconds, increasing. `aperture_mm` (T,): distance of the two undeformed gel faces; in a
    press, the travel. The next four are sequences with an array per pad, left then right, in the pad's frame,
    whose z points into the fruit. `rest_mm` (N, 3): markers on the undeformed gel. `displacement_mm`
    (T, N, 3): from rest, negative z into the gel. `force_N` (T, N, 3): of the gel on the fruit, positive z
    pushes the fruit. `pose` (T, 4, 4): pad frame to the mesh's frame; see `jaw_poses`.
    `gel_stiffness_MPa_per_mm`: normal and shear stiffness of the gel per area. `force_scale_sd` and
    `displacement_scale_sd`: relative standard deviations of scales that all markers and frames share.

    Include ten frames or more before the first touch: they measure the sensor's noise. Displacement and force
    have single precision, as in the file of `write_recording`. Raises DrupeError, which names the array, the
    value found and the expected one.

    >>> rest, still = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.zeros((2, 3, 3, 3))
    >>> held = recording(
    ...     time_s=[0.0, 0.1, 0.2],
    ...     aperture_mm=[60, 59, 58],
    ...     rest_mm=[rest, rest],
    ...     displacement_mm=still,
    ...     force_N=still,
    ...     pose=jaw_poses([60, 59, 58], centre_mm=(0, 0, 30)),
    ...     gel_stiffness_MPa_per_mm=(0.3, 0.1),
    ... )
    >>> held.loading, [pad.name for pad in held.pads]
    ('grasp', ['left', 'right'])
    """
    given = {"rest_mm": rest_mm, "displacement_mm": displacement_mm, "force_N": force_N, "pose": pose}
    of_pads = {name: per_pad(name, arrays) for name, arrays in given.items()}
    count = len(of_pads["rest_mm"])
    if count not in PADS:
        raise DrupeError(f"rest_mm: found {count} pads, expected 2 (a grasp) or 1 (a press)")
    for name, arrays in of_pads.items():
        if len(arrays) != count:
            raise DrupeError(f"{name}: found {len(arrays)} pads, expected {count}, as in rest_mm")
    times = numbers("time_s", time_s, (None,))
    frames = len(times)
    kn, kt = numbers("gel_stiffness_MPa_per_mm", gel_stiffness_MPa_per_mm, (2,)).tolist()
    pads = []
    for k, name in enumerate(PADS[count]):
        rest = numbers(f"rest_mm[{k}]", of_pads["rest_mm"][k], (None, 3))
        field, poses = (frames, len(rest), 3), (frames, 4, 4)
        pads.append(
            GelPad(
                name=name,
                pose=numbers(f"pose[{k}]", of_pads["pose"][k], poses),
                rest_mm=rest,
                displacement_mm=numbers(f"displacement_mm[{k}]", of_pads["displacement_mm"][k], field),
                force_N=numbers(f"force_N[{k}]", of_pads["force_N"][k], field),
                gel_kn_MPa_per_mm=kn,
                gel_kt_MPa_per_mm=kt,
                force_scale_sd=force_scale_sd,
                displacement_scale_sd=displacement_scale_sd,
            )
        )
    return as_in_a_file(
        Recording(
            fruit_id=fruit_id,
            category=category,
            loading="grasp" if count == 2 else "press",
            support="free" if count == 2 else "base",
            sensor=sensor,
            time_s=times,
            aperture_mm=numbers("aperture_mm", aperture_mm, (frames,)),
            pads=tuple(pads),
        )
    )


def as_in_a_file(held: Recording) -> Recording:
    """The recording after a round trip through a file. Raises DrupeError if a check of the reader fails."""
    with refusals(), scratch() as folder:
        write_h5(folder / "recording", held)
        return read_h5(folder / "recording")


def write_recording(path: str | Path, held: Recording) -> None:
    """Writes a recording to `path` (.h5 or .hdf5), for `drupe grade` and `read_recording`.

    The file stores displacement and force in single precision. Raises DrupeError for another suffix, if
    `path` exists (drupe never overwrites your file), if drupe cannot write there, or if `held` is no
    recording.
    """
    if not isinstance(held, Recording):
        raise DrupeError(f"held: found {type(held).__name__}, expected what `recording` returns")
    path = Path(path)
    if path.suffix.lower() not in WRITTEN:
        raise DrupeError(f'{path}: found the ending "{path.suffix}", expected {" or ".join(WRITTEN)}')
    if path.exists() or path.is_symlink():
        raise DrupeError(f"{path}: exists already; give another name, or move the file away")
    with refusals(), scratch() as folder:
        write_h5(folder / "recording", held)
        put(path, (folder / "recording").read_bytes())


def read_recording(path: str | Path) -> Recording:
    """The recording in an .h5 file. Raises DrupeError, which names the file, the field and the fault.

    `drupe convert` writes such files from other formats. `time_s`, `aperture_mm` and `pads` of the recording,
    and `name`, `rest_mm`, `displacement_mm`, `force_N` and `pose` of a pad, are the arrays that `recording`
    takes.
    """
    with refusals():
        return read_h5(Path(path))
