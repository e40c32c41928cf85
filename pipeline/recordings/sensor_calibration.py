"""`drupe calibrate`: what presses say of a sensor goes into its description."""

import datetime
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.batch.scratch import scratch
from pipeline.batch.write_guard import require_file_apart, require_new_or_ours
from pipeline.files.plain_file import NotReadable, read_text, toml_of
from pipeline.files.toml_text import as_toml
from pipeline.files.whole_file import put
from pipeline.problem import refused
from pipeline.recordings.description_file import MOST_BYTES, DescriptionKind, frame_progress
from tactile.from_frames import recording_of
from tactile.gel.ball_press import ball_lookup, ball_print
from tactile.gel.fields import layer_of
from tactile.gel.press_modulus import GelGain, gel_gain
from tactile.gel.shading_file import write_lookup
from tactile.gel.slab import SpringBed
from tactile.io.pictures import read_picture
from tactile.io.raw_grasp import read_raw_grasp
from tactile.io.recording import GelPad
from tactile.io.sensor_file import read_sensor
from tactile.sensors import GelCamera

LEAST_KNOWN_TO = 1e-3
"""Relative standard deviation of a force's scale that no press undercuts (set by hand)."""
CALIBRATED = DescriptionKind("# written by drupe calibrate", "a description that drupe calibrate wrote")


@dataclass(frozen=True, kw_only=True)
class Presses:
    """What was pressed: a ball (radius, the untouched gel, pictures), and a raw press with a load cell."""

    ball_mm: float | None = None
    reference: Path | None = None
    ball: tuple[Path, ...] = ()
    load_cell: Path | None = None


def calibrate(
    sensor: Path, out: Path, presses: Presses, *, today: datetime.date, report: Callable[[str], None]
) -> tuple[str, ...]:
    """Write `out`, the description `sensor` with what the presses say, and return that in words.

    A ball gives the photometric look-up (beside `out`, `.npz`), a press with a load cell the gel's E_MPa, or
    its normal stiffness per area where springs are stated. Raises TactileFailure where a picture or press
    cannot be used, BatchRefused where options do not go together, or `out` or the look-up beside it is one of
    the inputs or a file that drupe calibrate did not write. Both appear whole or not at all, and `out` holds
    the look-up's digest, so that one of another run is noticed.
    """
    if (presses.ball_mm is None) != (not presses.ball) or (presses.reference is None) != (not presses.ball):
        raise refused(sensor, "a ball calibration needs --ball-mm, --reference and at least one --press.")
    if not presses.ball and presses.load_cell is None:
        what = (
            "there is nothing to calibrate with. For a sensor give --press or --load-cell. For a rig "
            "give --rigid and --size-mm."
        )
        raise refused(sensor, what)
    described = _described(sensor)
    described["calibrated_on"] = today.isoformat()
    kept = described.get("calibration_file") if not presses.ball else None
    look_up = None if kept is None else _look_up(sensor, kept)
    _require_apart(sensor, out, described, presses)
    with scratch() as folder:
        stage, shading = folder / out.name, folder / out.with_suffix(".npz").name
        said: list[str] = []
        if presses.ball:
            said += _ball(sensor, shading, described, presses, report)
        elif look_up is not None:
            shading.write_bytes(look_up.read_bytes())
        if shading.exists():
            described["calibration_file"] = shading.name
            described["calibration_sha256"] = hashlib.sha256(shading.read_bytes()).hexdigest()
        stage.write_text(as_toml(described), encoding="utf-8")
        read_sensor(stage)
        if presses.load_cell is not None:
            said += _stiffness(stage, described, presses.load_cell, report)
            stage.write_text(as_toml(described), encoding="utf-8")
            read_sensor(stage)
        # The description first: where a run is killed between the two, it names a look-up by its digest that
        # is not there, which its reader says and the next run overwrites.
        put(out, f"{CALIBRATED.first_line}\n{stage.read_text(encoding='utf-8')}".encode())
        if shading.exists():
            put(out.parent / shading.name, shading.read_bytes())
    said.append(
        f"dated {today}: write calibrated_on = {today} under [sensor] in batch.toml, where calibration_days "
        "limits its age"
    )
    return tuple(said)


def _require_apart(sensor: Path, out: Path, described: dict[str, Any], presses: Presses) -> None:
    """What is read stays as it is, and so does what somebody else wrote."""
    if out.is_dir():
        raise refused(out, "is a folder; give the name of a file that ends in .toml.")
    look_up = out.with_suffix(".npz")
    if out == look_up:
        raise refused(out, "is TOML; give a name that ends in .toml.")
    named = [sensor.parent / str(described["calibration_file"])] if "calibration_file" in described else []
    others = [path for path in (presses.reference, presses.load_cell) if path is not None]
    folders = [presses.load_cell] if presses.load_cell is not None and presses.load_cell.is_dir() else []
    for target in (out, look_up) if presses.ball or named else (out,):
        require_file_apart(target, inputs=[sensor, *named, *others, *presses.ball], folders=folders)
    require_new_or_ours(out, CALIBRATED.is_ours, CALIBRATED.called)
    if presses.ball or named:
        require_new_or_ours(
            look_up, lambda path: _names(out, path), f"the look-up of a {out.name} that drupe calibrate wrote"
        )


def _names(description: Path, look_up: Path) -> bool:
    """Whether `description` is one of ours and has its look-up in the file `look_up`."""
    if not CALIBRATED.is_ours(description):
        return False
    return _described(description).get("calibration_file") == look_up.name


def _look_up(sensor: Path, name: object) -> Path:
    """The description's look-up, which must be there to be kept."""
    path = sensor.parent / str(name)
    if not path.is_file():
        said = (
            f"calibration_file: found no file {name} beside it; put it there, or press a ball with --press."
        )
        raise refused(sensor, said)
    return path


def _described(sensor: Path) -> dict[str, Any]:
    """The description as it stands; a photometric one may lack lights and look-up until it is calibrated."""
    if not sensor.is_file():
        raise refused(sensor, "does not exist; give the sensor's description.")
    try:
        return toml_of(read_text(sensor, most_bytes=MOST_BYTES))
    except NotReadable as cause:
        raise refused(sensor, f"{cause}; correct the description.") from cause


def _camera(sensor: Path, described: dict[str, Any]) -> tuple[GelCamera, float]:
    """The camera and its gamma, of a description that has no lights yet."""
    if described.get("kind") != "photometric":
        what = f"has the kind {described.get('kind')}; a ball press calibrates only photometric sensors."
        raise refused(sensor, what)
    left_out = ("lights", "calibration_file", "calibration_sha256", "kind")
    bare = {"kind": "markers-mono"} | {k: v for k, v in described.items() if k not in left_out}
    with scratch() as folder:
        stage = folder / sensor.name
        stage.write_text(as_toml(bare), encoding="utf-8")
        read = read_sensor(stage)
    if read.camera is None:
        raise refused(sensor, "has no [camera].")
    return read.camera, read.gamma


def _ball(
    path: Path, file: Path, described: dict[str, Any], presses: Presses, report: Callable[[str], None]
) -> list[str]:
    """Writes the look-up made of prints of a ball to `file`; what was found in each, if there are any."""
    camera, gamma = _camera(path, described)
    if presses.reference is None or presses.ball_mm is None:
        return []
    untouched = read_picture(presses.reference)
    prints, said = [], []
    for picture in presses.ball:
        imprint = ball_print(
            camera,
            untouched,
            read_picture(picture),
            radius_mm=presses.ball_mm,
            source=str(picture),
            gamma=gamma,
        )
        prints.append(imprint)
        x, y = imprint.centre_mm
        said.append(
            f"{picture.name}: ball {imprint.depth_mm:.2f} mm deep at x {x:.2f}, y {y:.2f} mm, contact radius "
            f"{imprint.contact_mm:.2f} mm"
        )
        report(said[-1])
    write_lookup(file, ball_lookup(prints))
    steepest = max(float(np.linalg.norm(p.slopes, axis=1).max()) for p in prints)
    return [*said, f"look-up of slopes up to {steepest:.2f} written to {file.name}"]


def _stiffness(
    path: Path, described: dict[str, Any], press: Path, report: Callable[[str], None]
) -> list[str]:
    """The gel's table for sensor.toml, its stiffness scaled to the load cell's force; raises BatchRefused."""
    recording = recording_of(read_raw_grasp(press, sensor=path), progress=frame_progress(report)).recording
    pad = recording.pads[0]
    if recording.wrench_N is None or not isinstance(pad, GelPad):
        raise refused(press, "has no load cell; log fx_N, fy_N and fz_N in log.csv.")
    normal = pad.pose[:, :3, 2]
    cell = np.einsum("ti,ti->t", recording.wrench_N[:, :3], normal)
    gain = gel_gain(cell, pad.force_N[:, :, 2].sum(axis=1), source=str(press))
    if "spread" in described:
        known_to = float(np.hypot(gain.sd / gain.value, gain.residual))
        described["spread"]["force"] = round(max(known_to, LEAST_KNOWN_TO), 4)
    return [_scaled(described["gel"], gain, springs=isinstance(layer_of(read_sensor(path)), SpringBed))]


def _scaled(gel: dict[str, Any], gain: GelGain, *, springs: bool) -> str:
    """Scale what the force was proportional to: springs' normal stiffness, or the slab's modulus."""
    name = "gel_kn_MPa_per_mm" if springs else "E_MPa"
    gel[name] = float(f"{gel[name] * gain.value:.5g}")
    left = (
        "; gel_kt_MPa_per_mm does not change, because a normal press does not measure it" if springs else ""
    )
    return (
        f"{name} {gel[name]:.4g} +- {gel[name] * gain.sd / gain.value:.2g}{left} "
        f"({gain.value:.3f} times the description's; load cell and gel agree within "
        f"{100 * gain.residual:.1f} % of the peak)"
    )
