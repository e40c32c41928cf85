"""`drupe convert`: converts a recording in another format to the HDF5 file that drupe reads."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import h5py

from fem.fem_failure import FemFailure
from pipeline.batch.scratch import scratch
from pipeline.batch.write_guard import require_file_apart, require_new_or_ours
from pipeline.files.whole_file import put
from pipeline.fruit.bare_traces import is_bare
from pipeline.fruit.input_doubts import expected_E_MPa
from pipeline.fruit.trace_geometry import OPTIONS, geometry_of
from pipeline.problem import refused
from pipeline.recordings.description_file import frame_progress
from recon.pit.priors import PitPrior, load_prior
from recon.recon_failure import ReconFailure
from tactile.consistency.of_recording import recording_findings
from tactile.contact import contact_said, find_contact
from tactile.from_frames import recording_of
from tactile.from_tac3d import recording_of_tac3d
from tactile.jaw_poses import Jaws, posed_by_jaws
from tactile.readers.field_tables import read_field_table
from tactile.readers.flange_table import read_flange_table
from tactile.readers.hdf5_file import opened
from tactile.readers.load_cell import TABLES, is_trace, read_trace, runs_in
from tactile.readers.pictures import PICTURES, VIDEOS
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import Converted, GelPad, Recording, read_recording, write_recording
from tactile.readers.rig_file import read_rig
from tactile.readers.robot_file import read_robot
from tactile.readers.sensor_file import read_sensor
from tactile.readers.specimen import PressedSpecimen
from tactile.readers.tac3d import read_tac3d, sensor_folders
from tactile.readers.trace_columns import TraceWords
from tactile.rig.rig_curve import without_rig
from tactile.robot.pad_poses import with_robot_poses
from tactile.tactile_failure import TactileFailure

TELL_EVERY = 50
"""Frames between two lines of progress: about every second or two at 30 to 45 frames/s (docs/validation.md,
Speed)."""
WRITTEN_BY = "drupe convert"
KINDS = (
    "a folder with grasp.toml (raw frames)",
    "a folder of Tac3D arrays",
    "a .npz or .csv of marker fields",
    "a ROS 2 bag (.mcap)",
    "a .csv, .txt, .tsv, .xls or .xlsx of a bare load cell",
)
"""Sources that `_of_any_kind` reads; docs/formats.md, Sources of `drupe convert`, has a row for each."""
WHAT_PRESSED = (
    "is a load cell's force-displacement curve. Give --indenter ball or flat with --radius-mm, "
    "or --indenter plates with the specimen (docs/formats.md, A load cell)."
)
FRAMES_ALONE = (
    "holds pictures or a video of a gel without sensor and times. Put them into a folder with "
    "grasp.toml, log.csv and the sensor's description (docs/formats.md, A raw grasp), and give "
    "that folder. drupe sensor writes the description."
)
SENSOR_NEEDED = "needs the sensor's description; give --sensor sensor.toml."
TOPICS_NEEDED = "needs the names of its topics; give --topics topics.toml (docs/formats.md, A ROS 2 bag)."
POSES_LACKING = "no motion."
"""End of the readers' notes on missing poses; drupe removes these notes if jaws or a robot give the poses."""
ANY_RATIO = 0.45
"""Poisson's ratio in the test whether a geometry has a law; `drupe explain` uses that of the flesh."""


@dataclass(frozen=True, kw_only=True)
class ConvertRequest:
    """Options of a conversion: values that the source does not state."""

    sensor: Path | None = None
    fruit_id: str = "unknown"
    category: str = "unknown"
    indenter: Literal["ball", "flat", "plate"] | None = None
    radius_mm: float | None = None
    specimen: PressedSpecimen = field(default_factory=PressedSpecimen)
    trace: TraceWords = field(default_factory=TraceWords)
    all_runs: bool = False
    rig: Path | None = None
    robot: Path | None = None
    flange: Path | None = None
    topics: Path | None = None
    jaws: Jaws | None = None


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """Sentences on a written recording.

    `doubts`, `refused`: findings of the checks that need no mesh; `drupe grade` refuses a recording with
    the latter.
    """

    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()


def convert_runs(
    source: Path, out: Path, wanted: ConvertRequest, *, report: Callable[[str], None]
) -> list[tuple[Path, Conversion | TactileFailure]]:
    """Does `convert`; with `all_runs`, writes each run of a table to OUT-1.h5, OUT-2.h5 and so on.

    Returns each path with the sentences on it, or with the failure of a run that drupe did not write. Raises
    as `convert`, but not for unusable runs of `all_runs`.
    """
    if not wanted.all_runs:
        return [(out, convert(source, out, wanted, report=report))]
    _require_table(source)
    runs = range(1, runs_in(source, words=wanted.trace) + 1)
    paths = [out.with_name(f"{out.stem}-{run}{out.suffix}") for run in runs]
    for path in paths:
        _require_writable(source, path, wanted)
    done: list[tuple[Path, Conversion | TactileFailure]] = []
    for run, path in zip(runs, paths, strict=True):
        try:
            converted = _read(source, replace(wanted, trace=replace(wanted.trace, run=run)), report)
            done.append((path, _written(converted, source, path, report)))
        except TactileFailure as failure:
            done.append((path, _with_earlier_file(failure) if path.exists() else failure))
    return done


def convert(source: Path, out: Path, wanted: ConvertRequest, *, report: Callable[[str], None]) -> Conversion:
    """Writes the recording in `source` to `out`; `report` receives lines of progress.

    `out` appears only when complete: drupe first writes a draft elsewhere and reads it back. Raises
    TactileFailure for an unusable source. Raises BatchRefused for a missing or inapplicable option, or a
    source of unknown kind. It also does so if `out` is an input or a file that drupe convert did not write.
    """
    _require_writable(source, out, wanted)
    return _written(_read(source, wanted, report), source, out, report)


def _with_earlier_file(failure: TactileFailure) -> TactileFailure:
    """The failure of a run in whose place an earlier conversion left a file, which grading would use."""
    what = failure.detail.removesuffix(".")
    return TactileFailure(failure.problem, f"{what}. The file there is of an earlier conversion; remove it.")


def _written(converted: Converted, source: Path, out: Path, report: Callable[[str], None]) -> Conversion:
    """Writes the recording after its draft was read back, and returns the findings of the checks."""
    with scratch() as folder:
        draft = folder / "draft.h5"
        write_recording(draft, converted.recording)
        with h5py.File(draft, "a") as file:
            file.attrs["written_by"] = WRITTEN_BY
        try:
            read_recording(draft)
        except TactileFailure as failure:
            detail = failure.detail.removeprefix(f"{draft.name}: ")
            raise TactileFailure(failure.problem, f"{source.name}: {detail}") from failure
        put(out, draft.read_bytes())
    frames = len(converted.recording.time_s)
    report(
        f"wrote {out}: {frames} frames, "
        f"{converted.recording.time_s[-1] - converted.recording.time_s[0]:.2f} s"
    )
    for line in _contact(converted.recording, out.name):
        report(line)
    if is_bare(converted.recording):
        return Conversion(notes=converted.notes)
    limits = expected_E_MPa(_prior(converted.recording.category))
    findings = recording_findings(converted.recording, None, None, E_range_MPa=limits)
    said = [(finding, f"{source.name}: {finding.sentence}.") for finding in findings]
    return Conversion(
        notes=(*converted.notes, *(sentence for finding, sentence in said if finding.remark)),
        doubts=tuple(sentence for finding, sentence in said if not (finding.refused or finding.remark)),
        refused=tuple(sentence for finding, sentence in said if finding.refused),
    )


def _prior(category: str) -> PitPrior | None:
    """The category's prior; None if drupe ships none."""
    try:
        return load_prior(category)
    except ReconFailure:
        return None


def _require_writable(source: Path, out: Path, wanted: ConvertRequest) -> None:
    """Raises BatchRefused if `out` is or lies in an input, or is a file that drupe convert did not write."""
    named = source, wanted.sensor, wanted.rig, wanted.robot, wanted.flange, wanted.topics
    inputs = [path for path in named if path is not None]
    require_file_apart(out, inputs=inputs, folders=[source] if source.is_dir() else [])
    require_new_or_ours(out, _is_converted, "a recording that drupe convert wrote")


def _is_converted(path: Path) -> bool:
    try:
        with opened(path) as file:
            said = file.attrs.get("written_by")
            return isinstance(said, str) and said == WRITTEN_BY
    except (TactileFailure, TypeError, ValueError):  # h5py does not read all types of HDF5
        return False


def _contact(recording: Recording, name: str) -> list[str]:
    """A line on the contact of each pad, or the reason why drupe finds none; empty for a bare indenter."""
    if not all(isinstance(pad, GelPad) for pad in recording.pads):
        return []
    try:
        contact = find_contact(recording, source=name)
    except TactileFailure as failure:
        return [str(failure)]
    return contact_said(contact)


def _read(source: Path, wanted: ConvertRequest, report: Callable[[str], None]) -> Converted:
    """The recording in a source of any kind, with poses. Raises BatchRefused for --rig without a load cell's
    table, or --topics without a ROS 2 bag.
    """
    converted = _of_any_kind(source, wanted, report)
    if wanted.rig is not None and converted.recording.rig_give_mm is None:
        what = (
            "is not a load cell's table; --rig corrects only such tables. For a batch's recordings, "
            "name the rig in batch.toml."
        )
        raise refused(source, what)
    if wanted.topics is not None and source.suffix.lower() != ".mcap":
        raise refused(source, "is not a ROS 2 bag; --topics applies only to a .mcap.")
    return _with_poses(converted, source, wanted)


def _of_any_kind(source: Path, wanted: ConvertRequest, report: Callable[[str], None]) -> Converted:
    report_pad = frame_progress(report, every=TELL_EVERY)
    if (source / "grasp.toml").is_file():
        raw = read_raw_grasp(source, sensor=wanted.sensor)
        return recording_of(raw, progress=report_pad)
    if folders := sensor_folders(source):
        sensors = [read_tac3d(folder) for folder in folders]
        described = None if wanted.sensor is None else read_sensor(wanted.sensor)
        kn = None if described is None else described.gel_kn_MPa_per_mm
        kt = None if described is None else described.gel_kt_MPa_per_mm
        return recording_of_tac3d(
            sensors,
            fruit_id=wanted.fruit_id,
            category=wanted.category,
            stiffness=None if kn is None or kt is None else (kn, kt),
            scale_sd=(0.0, 0.0) if described is None else (described.force_sd, described.displacement_sd),
        )
    kind = source.suffix.lower() if source.is_file() else ""
    if kind in (".h5", ".hdf5"):
        recording = read_recording(source)
        if wanted.robot is not None:
            return Converted(recording=recording, notes=recording.notes)
        raise refused(source, "is a recording already and needs no conversion.")
    of_table = wanted.trace != TraceWords()
    if kind in TABLES and (of_table or is_trace(source, sensor_given=wanted.sensor is not None)):
        return _without_rig(_trace(source, wanted), source, wanted.rig)
    if of_table:
        _require_table(source)
    if kind in (".npz", ".csv", ".mcap"):
        sensor = read_sensor(_needed(source, wanted.sensor, SENSOR_NEEDED))
        topics = _needed(source, wanted.topics, TOPICS_NEEDED) if kind == ".mcap" else None
        return read_field_table(
            source, fruit_id=wanted.fruit_id, category=wanted.category, sensor=sensor, topics=topics
        )
    below = [*source.glob("*"), *source.glob("*/*")] if source.is_dir() else [source] * source.is_file()
    if any(path.suffix.lower() in (*VIDEOS, *PICTURES) for path in below):
        raise refused(source, FRAMES_ALONE)
    there = "is not a format that drupe converts" if source.exists() else "does not exist"
    raise refused(source, f"{there}; give {', '.join(KINDS[:-1])}, or {KINDS[-1]}.")


def _require_table(source: Path) -> None:
    """Raises BatchRefused if the source is no table, because the options apply to tables only."""
    if not source.is_file() or source.suffix.lower() not in TABLES:
        what = "is not a load cell's table; --columns, --units, --sheet and --run apply only to such tables."
        raise refused(source, what)


def _without_rig(converted: Converted, source: Path, rig: Path | None) -> Converted:
    if rig is None:
        return converted
    corrected = without_rig(converted.recording, read_rig(rig).machine, source=source.name, named=rig.name)
    return Converted(recording=corrected.recording, notes=(*converted.notes, *corrected.notes))


def _with_poses(converted: Converted, source: Path, wanted: ConvertRequest) -> Converted:
    """The recording with its pads' poses from the jaws or the robot that the options name."""
    lacking = replace(
        converted, notes=tuple(note for note in converted.notes if not note.endswith(POSES_LACKING))
    )
    if wanted.jaws is not None:
        return posed_by_jaws(lacking, wanted.jaws, source=source.name)
    if wanted.robot is None or wanted.flange is None:
        return converted
    robot, table = read_robot(wanted.robot), read_flange_table(wanted.flange)
    recording, spreads = with_robot_poses(
        converted.recording, robot, table, source=source.name, named=wanted.flange.name
    )
    notes = [
        f"pads/{pad.name}: standard deviation of its place, per axis: {pad.sd_mm:.2g} mm "
        f"({pad.calibration_mm:.2g} calibration, {pad.flange_mm:.2g} flange, {pad.gripper_mm:.2g} gripper)."
        for pad in spreads
    ]
    return replace(lacking, recording=recording, notes=(*lacking.notes, *notes))


def _trace(source: Path, wanted: ConvertRequest) -> Converted:
    """A load cell's force-displacement curve. Raises BatchRefused if no law gives E for the geometry."""
    round_tip = wanted.indenter != "plate"
    converted = read_trace(
        source,
        fruit_id=wanted.fruit_id,
        category=wanted.category,
        indenter=wanted.indenter or "ball",
        radius_mm=(wanted.radius_mm or 1.0) if round_tip else None,
        specimen=wanted.specimen,
        words=wanted.trace,
    )
    if wanted.indenter is None or (round_tip and wanted.radius_mm is None):
        raise refused(source, WHAT_PRESSED)
    if not round_tip and wanted.radius_mm is not None:
        said = "--radius-mm is the radius of a ball or punch; remove it, or give --indenter flat for a punch."
        raise refused(source, said)
    try:
        known = geometry_of(
            wanted.indenter, wanted.radius_mm, wanted.specimen, source=str(source), name_of=OPTIONS
        )
        known.geometry.curve(thickness_mm=known.thickness_mm, poisson_ratio=ANY_RATIO)
    except FemFailure as failure:
        raise refused(source, failure.detail) from None
    return converted


def _needed(source: Path, given: Path | None, sentence: str) -> Path:
    if given is None:
        raise refused(source, sentence)
    return given
