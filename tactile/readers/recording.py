"""One tactile recording: poses of a gripper's or press's pads over time, with displacement and force.

The file is HDF5, version 1: root attributes `format`, `version`, `fruit_id`, `category`, `loading`, `sensor`
and optionally `support`; datasets `time_s`, `aperture_mm`, optionally `wrench_N`; one group per pad below
`pads`. Units are mm, N, MPa and s. A pose maps pad coordinates to fruit coordinates.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast

import h5py
import numpy as np
from jaxtyping import Float
from scipy.spatial import QhullError, Voronoi

from tactile.readers.hdf5_file import child_group, opened
from tactile.readers.recording_fields import ANY, GroupReader, Limit
from tactile.readers.specimen import PressedSpecimen, read_specimen, write_specimen
from tactile.tactile_failure import TactileFailure

FORMAT = "drupe-recording"
VERSION = 1
"""Of the file; docs/formats.md describes it."""
FEWEST_FOR_AREA = 9
"""Fewest markers that determine the area per marker: of three by three the middle Voronoi cell is closed."""
FEWEST_MARKERS = 3
"""Fewest markers that span an area, which a contact needs."""
LEAST_SPREAD = 0.01
"""Least ratio of the spread of a gel's markers across to that along (standard deviations). A row 20 mm long,
read to 0.2 mm, is below it; two rows of eleven have 0.16. Assumed."""
TIME = Limit(1e10, "seconds (since 1970 they are 1.8e9)")
APERTURE = Limit(2000.0, "millimetres (is it in m or µm?)")
WRENCH = Limit(1e7, "newtons and newton millimetres")
REST = Limit(500.0, "millimetres (is it in µm, or in pixels?)")
DISPLACEMENT = Limit(500.0, "millimetres (is it in µm, or in pixels?)")
FORCE = Limit(1e4, "newtons at a marker (is it in mN?)")
LOAD = Limit(1e6, "newtons (is it in mN?)")
STIFFNESS = Limit(1e4, "MPa per mm (is it in Pa or kPa?)", least=1e-6)
THICKNESS = Limit(200.0, "millimetres", least=0.01)
MODULUS = Limit(1e4, "MPa (is it in Pa or kPa?)", least=1e-5)
RATIO = Limit(0.4999, "", least=0.1)
RADIUS = Limit(1000.0, "millimetres", least=0.001)
SHARE = Limit(1.0, "(a share)")
SCALE_SD = Limit(2.0, "(a relative standard deviation)", least=1e-4)
POSE_SD = Limit(20.0, "mm", least=1e-3)
"""These are the largest values of each field in its unit, some hundred times those of sensors and grippers. A
larger number is wrong or in another unit, and its square may overflow. Quotients by values below the least
may overflow. The softest gel (1e-4 MPa, 30 mm) has a shear stiffness E / (2 (1 + nu) h) of 1.1e-6 MPa/mm."""
RIG_FIELDS = ("rig_give_mm", "rig_sd_mm")
"""Optional fields of a bare press that `drupe convert --rig` corrected: both or none."""
GEL_CONSTANTS = {
    "gel_kn_MPa_per_mm": ("gel_kn_MPa_per_mm", STIFFNESS),
    "gel_kt_MPa_per_mm": ("gel_kt_MPa_per_mm", STIFFNESS),
    "thickness_mm": ("thickness_mm", THICKNESS),
    "gel_E_MPa": ("E_MPa", MODULUS),
    "gel_nu": ("nu", RATIO),
    "force_scale_sd": ("force_scale_sd", SCALE_SD),
    "displacement_scale_sd": ("displacement_scale_sd", SCALE_SD),
}
"""Attribute of a gel pad and its limit, by field: both stiffnesses are needed, the others optional."""
GEL_KNOWN = {
    "certainty": ("t", SHARE),
    "reference_print": ("", ANY),
    "print_shown": ("t", ANY),
}
"""Optional datasets of a gel pad without negative values: one per frame (t), or one in all."""
TEXTS = ("fruit_id", "category", "loading", "support", "sensor")
SERIES = ("time_s", "aperture_mm", "wrench_N", *RIG_FIELDS)
"""Attributes of a file, and its fields beside the pads."""
PADS_OF_LOADING = {"grasp": ("left", "right"), "press": ("tip",)}

Loading: TypeAlias = Literal["grasp", "press"]
Support: TypeAlias = Literal["free", "base"]
PoseFrame: TypeAlias = Literal["fruit", "mat"]


@dataclass(frozen=True, kw_only=True)
class GelPad:
    """A gel with markers, all in the pad frame; z points out of the gel into the fruit.

    `displacement_mm` is from rest (negative z: pressed into the gel). `force_N` acts on the fruit at each
    marker (positive z: pushes the fruit). The rest surface may be a dome. `certainty` of each frame: 0 if
    every marker could as well be a pitch of their grid further, 1 if not; None without tracking in pictures.
    `reference_print`, `print_shown`: evidence of an imprint in the picture of the untouched gel and in each
    frame, over the detection limit (tactile.reference_print). `place_sd_mm`: standard deviation of the
    markers' rest positions, common to all frames, not stored in files. `force_scale_sd`,
    `displacement_scale_sd`: relative standard deviations of both scales, common to all markers and frames; 0
    if not stated.
    """

    name: str
    pose: Float[np.ndarray, "t 4 4"]
    rest_mm: Float[np.ndarray, "n 3"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    gel_kn_MPa_per_mm: float
    gel_kt_MPa_per_mm: float
    thickness_mm: float | None = None
    gel_E_MPa: float | None = None
    gel_nu: float | None = None
    certainty: Float[np.ndarray, " t"] | None = None
    reference_print: float | None = None
    print_shown: Float[np.ndarray, " t"] | None = None
    place_sd_mm: float = 0.0
    force_scale_sd: float = 0.0
    displacement_scale_sd: float = 0.0

    @property
    def marker_kn_N_per_mm(self) -> float | None:
        """Normal stiffness of the gel under one marker; None if too few markers determine its area."""
        area = marker_area_mm2(self.rest_mm)
        return None if area is None else self.gel_kn_MPa_per_mm * area


def marker_area_mm2(rest_mm: Float[np.ndarray, "n 3"]) -> float | None:
    """Area of the gel's face per marker: the median Voronoi cell; None below nine markers or on one line.

    >>> grid = np.array([[x, y, 0.0] for x in range(0, 8, 2) for y in range(0, 8, 2)])
    >>> marker_area_mm2(grid)
    4.0
    """
    return _cell_area_mm2(np.ascontiguousarray(rest_mm, dtype=np.float64).tobytes())


@lru_cache(maxsize=16)
def _cell_area_mm2(places: bytes) -> float | None:
    """The area for markers at these places, cached: checks of a recording ask for it many times."""
    rest_mm = np.frombuffer(places).reshape(-1, 3)
    if len(rest_mm) < FEWEST_FOR_AREA:
        return None
    try:
        cells = Voronoi(rest_mm[:, :2])
    except QhullError:  # all on a line
        return None
    regions = [cells.regions[k] for k in cells.point_region]
    whole = [corners for corners in regions if corners and -1 not in corners]
    if not whole:
        return None
    # Voronoi lists the corners of a plane cell in order around it.
    here, following = (
        cells.vertices[np.concatenate(ends)] for ends in (whole, [c[1:] + c[:1] for c in whole])
    )
    starts = np.cumsum([0, *map(len, whole[:-1])])
    twice = here[:, 0] * following[:, 1] - here[:, 1] * following[:, 0]
    return float(np.median(np.abs(np.add.reduceat(twice, starts)))) / 2


@dataclass(frozen=True, kw_only=True)
class IndenterPad:
    """A bare indenter with a load cell: one normal force per frame, no markers. `radius_mm`: of a ball or a
    flat punch; optional for a plate. `specimen`: stated facts about the pressed specimen.
    """

    name: str
    pose: Float[np.ndarray, "t 4 4"]
    force_z_N: Float[np.ndarray, " t"]
    indenter: Literal["ball", "flat", "plate"]
    radius_mm: float | None
    specimen: PressedSpecimen = field(default_factory=PressedSpecimen)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The contents of one file.

    `aperture_mm` is the jaws' distance (grasp) or the indenter's travel (press). `support`: "free" (only the
    pads hold the fruit) or "base" (every surface node within 0.2 mm of the lowest z is fixed). `wrench_N`:
    force (N) and torque (N·mm) of the machine's load cell, fruit frame. `rig_give_mm`: displacement of the
    rig subtracted from a bare press's travel, with standard deviation `rig_sd_mm`; None: nothing. `notes`:
    changes that the reader made, without full stops. `pose_frame`: target of the pads' poses, the fruit frame
    or the mat's (from a robot); grading shifts the latter to the fruit. `pose_sd_mm`: standard deviation of a
    pad's position per axis, if a robot's calibration states it.
    """

    fruit_id: str
    category: str
    loading: Loading
    support: Support
    sensor: str
    time_s: Float[np.ndarray, " t"]
    aperture_mm: Float[np.ndarray, " t"]
    pads: tuple[GelPad | IndenterPad, ...]
    wrench_N: Float[np.ndarray, "t 6"] | None = None
    rig_give_mm: Float[np.ndarray, " t"] | None = None
    rig_sd_mm: Float[np.ndarray, " t"] | None = None
    notes: tuple[str, ...] = ()
    pose_frame: PoseFrame = "fruit"
    pose_sd_mm: float | None = None


def read_recording(path: Path) -> Recording:
    """The recording in `path`, checked field by field.

    Raises TactileFailure (unreadable-recording) with file, field, found and expected value, and advice.
    Causes are a missing or truncated file, a wrong format or version, and a missing field. Others are a wrong
    shape or type, values that are not finite, times that do not increase, and poses that are not rigid.
    """
    with opened(path) as file:
        root = GroupReader(path=path, group=file)
        root.choice("format", {FORMAT})
        root.version("version", VERSION)
        loading = root.choice("loading", set(PADS_OF_LOADING))
        default = "free" if loading == "grasp" else "base"
        time_s = root.time("time_s", limit=TIME)
        frames = len(time_s)
        pads_group = root.child("pads")
        scale_sd = root.optional_positive("force_scale_sd", limit=SCALE_SD) or 0.0
        return Recording(
            fruit_id=root.text("fruit_id"),
            category=root.text("category"),
            loading=cast(Loading, loading),
            support=cast(Support, root.choice("support", {"free", "base"}, default=default)),
            sensor=root.text("sensor"),
            time_s=time_s,
            aperture_mm=root.array("aperture_mm", (frames,), limit=APERTURE),
            wrench_N=root.array("wrench_N", (frames, 6), limit=WRENCH) if "wrench_N" in root else None,
            **_rig_fields(root, frames),
            pose_frame=cast(PoseFrame, root.choice("pose_frame", {"fruit", "mat"}, default="fruit")),
            pose_sd_mm=root.optional_positive("pose_sd_mm", limit=POSE_SD),
            pads=tuple(
                _read_pad(pads_group.child(name), name, frames=frames, scale_sd=scale_sd)
                for name in PADS_OF_LOADING[loading]
            ),
        )


def write_recording(path: Path, recording: Recording) -> None:
    """Write `recording` so that `read_recording` returns it, but for `notes` and `place_sd_mm`.

    Marker displacement and force are stored in single precision (6e-8 relative), the rest in double.
    """
    with h5py.File(path, "w") as file:
        attributes = {name: getattr(recording, name) for name in TEXTS}
        file.attrs.update({"format": FORMAT, "version": VERSION, **attributes})
        if recording.pose_frame != "fruit":
            file.attrs["pose_frame"] = recording.pose_frame
        if recording.pose_sd_mm is not None:
            file.attrs["pose_sd_mm"] = recording.pose_sd_mm
        _write_fields(file, recording, SERIES)
        for pad in recording.pads:
            group = file.create_group(f"pads/{pad.name}")
            if isinstance(pad, GelPad):
                _write_gel(group, pad)
            else:
                _write_fields(group, pad, ("pose", "force_z_N"))
                group.attrs["indenter"] = pad.indenter
                if pad.radius_mm is not None:
                    group.attrs["radius_mm"] = pad.radius_mm
                write_specimen(group.attrs, pad.specimen)


def is_of_bare_indenter(path: Path) -> bool:
    """Whether the pads in the file have one force and no markers; False if the file is no recording."""
    try:
        with opened(path) as file:
            pads = child_group(file, "pads")
            held = [child_group(pads, name) for name in pads or ()]
            return bool(held) and all(
                pad is not None and "force_z_N" in pad and "rest_mm" not in pad for pad in held
            )
    except TactileFailure:
        return False


def _read_pad(pad: GroupReader, name: str, *, frames: int, scale_sd: float) -> GelPad | IndenterPad:
    """One pad of a recording: a gel's fields, or the force of an indenter.

    `scale_sd`: the recording's `force_scale_sd`, for a pad that states none.
    """
    pose = pad.poses("pose", frames)
    if "force_z_N" in pad and "rest_mm" not in pad:
        indenter = pad.choice("indenter", {"ball", "flat", "plate"})
        of_radius = pad.optional_positive if indenter == "plate" else pad.positive
        return IndenterPad(
            name=name,
            pose=pose,
            force_z_N=pad.array("force_z_N", (frames,), limit=LOAD),
            indenter=cast(Literal["ball", "flat", "plate"], indenter),
            radius_mm=of_radius("radius_mm", limit=RADIUS),
            specimen=read_specimen(pad),
        )
    rest_mm = pad.array("rest_mm", (None, 3), limit=REST)
    pad.refuse("rest_mm", _no_face(rest_mm))
    markers = len(rest_mm)
    return GelPad(
        name=name,
        pose=pose,
        rest_mm=rest_mm,
        displacement_mm=pad.array("displacement_mm", (frames, markers, 3), limit=DISPLACEMENT),
        force_N=pad.array("force_N", (frames, markers, 3), limit=FORCE),
        **_gel_constants(pad, scale_sd),
        **{name: _known(pad, name, frames) for name in GEL_KNOWN},
    )


def _rig_fields(root: GroupReader, frames: int) -> dict[str, Any]:
    """The rig's displacement in the travel and its standard deviation; empty if both are missing."""
    if not any(name in root for name in RIG_FIELDS):
        return {}
    values = {name: root.array(name, (frames,), limit=APERTURE) for name in RIG_FIELDS}
    for name in RIG_FIELDS:
        advice = "convert the trace again with --rig"
        root.refuse_negative(name, values[name], expected="0 mm or more", advice=advice)
    return values


def _gel_constants(pad: GroupReader, scale_sd: float) -> dict[str, Any]:
    """The constants by field; missing spreads of scales are `scale_sd` (force) and 0 (displacement)."""
    said = {
        field: (pad.positive if limit is STIFFNESS else pad.optional_positive)(name, limit=limit)
        for field, (name, limit) in GEL_CONSTANTS.items()
    }
    known = {"force_scale_sd": scale_sd, "displacement_scale_sd": 0.0}
    return said | {name: said[name] or default for name, default in known.items()}


def _known(pad: GroupReader, name: str, frames: int) -> Any:
    """An optional field of a gel; None if it is missing."""
    if name not in pad:
        return None
    axis, limit = GEL_KNOWN[name]
    values = pad.array(name, (frames,) if axis else (), limit=limit)
    pad.refuse_negative(name, values, expected="0 to 1" if limit is SHARE else "0 or more")
    return values if axis else float(values)


def _no_face(rest_mm: Float[np.ndarray, "n 3"]) -> tuple[str, str, str] | None:
    """What was found, expected and advised if the markers span no area; None if they do."""
    expected = f"at least {FEWEST_MARKERS} that are not on one line"
    if len(rest_mm) < FEWEST_MARKERS:
        fault = f"{len(rest_mm)} marker{'' if len(rest_mm) == 1 else 's'}"
        return fault, expected, "record all markers of the gel"
    places = rest_mm[:, :2] - rest_mm[:, :2].mean(axis=0)
    along, across = np.linalg.svd(places, compute_uv=False)
    if across > LEAST_SPREAD * along:
        return None
    fault = f"{len(rest_mm)} markers {'in one place' if along == 0 else 'on one line'} in x and y"
    return fault, expected, "write each marker's own x, y, z"


def _write_fields(group: Any, record: Recording | GelPad | IndenterPad, names: Sequence[str]) -> None:
    """Writes the fields that the record has, in double precision."""
    for name in names:
        if (values := getattr(record, name)) is not None:
            group[name] = np.asarray(values, dtype=np.float64)


def _write_gel(group: Any, pad: GelPad) -> None:
    """Writes one gel pad's fields into its HDF5 group, forces and displacements in single precision."""
    _write_fields(group, pad, ("pose", "rest_mm", *GEL_KNOWN))
    for name in ("displacement_mm", "force_N"):
        values = getattr(pad, name).astype(np.float32)
        group.create_dataset(name, data=values, compression="gzip", shuffle=True)
    group.attrs.update({name: said for f, (name, _) in GEL_CONSTANTS.items() if (said := getattr(pad, f))})


@dataclass(frozen=True, kw_only=True)
class Converted:
    """A recording in the canonical form; `notes`: sentences for users."""

    recording: Recording
    notes: tuple[str, ...]


def recording_digest(recording: Recording) -> str:
    """SHA-256 of all pads' displacements and forces; two recordings share it only if every value agrees.

    Values count in single precision, as `write_recording` stores them, and pads in any order. A file that was
    written again has the same digest, even with other attributes or with its pads' names exchanged.
    """
    pads = []
    for pad in recording.pads:
        felt = (pad.displacement_mm, pad.force_N) if isinstance(pad, GelPad) else (pad.force_z_N,)
        digest = hashlib.sha256()
        for values in felt:
            digest.update(repr(values.shape).encode())
            digest.update((np.ascontiguousarray(values, dtype=np.float32) + np.float32(0)).tobytes())
        pads.append(digest.digest())
    return hashlib.sha256(b"".join(sorted(pads))).hexdigest()
