"""The bank of cases: it simulates and stores fruit once without noise, and draws cases from them.

A fruit has no effect, or effects that change the flesh or the contact (SIMULATED). A draw adds noise, the
scan's error, the prior's error, and effects of sensor, gripper and prior (DRAWN). One seed determines all. A
case on disk has mesh, pit prior, settings and recordings.
"""

import fcntl
import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.surface.mesh_file import write_mesh
from samples.cubed_sphere import even_sphere
from samples.fruit import scanned_skin
from samples.gel_contact import Gel
from samples.graded_bricks import BrickGrading
from samples.mismatch.case_simulation import (
    CasePlan,
    as_recorded,
    planned,
    true_recordings,
    with_amount,
)
from samples.mismatch.drawn_fruit import DrawnFruit, seen_anew
from samples.mismatch.injected import (
    EFFECTS,
    OUT_OF_CATALOGUE,
    InjectedEffect,
    drawn_amplitude,
    drawn_parameters,
    label_of,
    named,
)
from samples.mismatch.true_recording import PadTruth, TrueRecording, as_measured
from samples.sample_failure import SampleFailure
from tactile.readers.recording import Recording, write_recording

FORMAT = 1
"""Format of the file; `stored_truths` refuses others."""


def store_truths(path: Path, truths: tuple[TrueRecording, ...]) -> None:
    """Write a fruit's grasps; an interrupted call leaves no file at `path`."""
    arrays: dict[str, np.ndarray] = {}
    words = []
    for k, truth in enumerate(truths):
        gel = {name: getattr(truth.gel, name) for name in Gel.__dataclass_fields__}
        words.append({"name": truth.name, "gel": gel})
        arrays[f"time_{k}"], arrays[f"aperture_{k}"] = truth.time_s, truth.aperture_mm
        arrays[f"rest_{k}"] = truth.rest_mm
        for side, pad in enumerate(truth.pads):
            arrays[f"pose_{k}_{side}"] = pad.pose
            arrays[f"displacement_{k}_{side}"] = pad.displacement_mm.astype(np.float32)
            arrays[f"force_{k}_{side}"] = pad.force_N.astype(np.float32)
    partial = path.with_suffix(".partial.npz")
    np.savez_compressed(partial, **arrays, words=np.array(json.dumps({"format": FORMAT, "grasps": words})))  # type: ignore[arg-type]
    partial.replace(path)


def stored_truths(path: Path) -> tuple[TrueRecording, ...]:
    """Read a fruit's grasps. Raises ValueError for another format."""
    with np.load(path, allow_pickle=False) as file:
        words = json.loads(str(file["words"]))
        if words["format"] != FORMAT:
            raise ValueError(f"{path} has another format; simulate the fruit anew")
        truths = []
        for k, grasp in enumerate(words["grasps"]):
            left, right = (
                PadTruth(
                    pose=file[f"pose_{k}_{side}"],
                    displacement_mm=file[f"displacement_{k}_{side}"].astype(float),
                    force_N=file[f"force_{k}_{side}"].astype(float),
                )
                for side in (0, 1)
            )
            truths.append(
                TrueRecording(
                    name=grasp["name"], time_s=file[f"time_{k}"], aperture_mm=file[f"aperture_{k}"],
                    rest_mm=file[f"rest_{k}"], gel=Gel(**grasp["gel"]), pads=(left, right),
                )
            )  # fmt: skip
    return tuple(truths)


MESH_CELLS = 33
"""Cells along each side of the cubed sphere's faces: triangles of 1.4 mm on a fruit of 30 mm radius."""

SETTINGS = """\
category = "{category}"
poisson_ratio = {nu}   # assumed
offset_sd_mm = 0.5        # expected spread of the pit prior
size_sd = 0.03
mesh_sd_mm = 0.1
"""
"""Text of case.toml."""


def write_case_files(
    folder: Path,
    drawn: DrawnFruit,
    recordings: tuple[TrueRecording, ...],
    *,
    peaks_N: tuple[float, ...],
    rng: np.random.Generator,
) -> None:
    """Write the case's `folder`, which appears once it is complete. Noise and scan error come from `rng`.

    The case's frame has the prior's pit at its origin. `peaks_N`: true peak force of each recording.
    """
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    origin = np.array(drawn.prior.centre_mm)
    vertices, triangles = scanned_skin(
        drawn.fruit.skin, cells=MESH_CELLS, error_mm=drawn.mesh_error_mm, rng=rng
    )
    write_mesh(partial / "fruit.ply", vertices - origin, triangles)
    sphere = even_sphere(MESH_CELLS)
    write_mesh(partial / "pit.ply", drawn.prior.points_mm(sphere.directions) - origin, sphere.triangles())
    settings = SETTINGS.format(category=drawn.category, nu=drawn.stated_poisson_ratio)
    (partial / "case.toml").write_text(settings, encoding="utf-8")
    for truth, peak in zip(recordings, peaks_N, strict=True):
        recording = sensed(truth, drawn, fruit_id=folder.name, origin_mm=origin, peak_N=peak, rng=rng)
        write_recording(partial / f"{truth.name}.h5", recording)
    shutil.rmtree(folder, ignore_errors=True)
    partial.rename(folder)


def sensed(
    truth: TrueRecording,
    drawn: DrawnFruit,
    *,
    fruit_id: str,
    origin_mm: Float[np.ndarray, " 3"],
    peak_N: float,
    rng: np.random.Generator,
) -> Recording:
    """The recording with sensor noise, in the frame whose origin is at `origin_mm`."""
    rounded = replace(truth, time_s=np.round(truth.time_s, 3), aperture_mm=np.round(truth.aperture_mm, 4))
    return as_measured(
        rounded, gels=(truth.gel, truth.gel), noise=drawn.sensor.noise(peak_N), rng=rng, fruit_id=fruit_id,
        category=drawn.category, sensor=drawn.sensor.name, origin_mm=origin_mm,
    )  # fmt: skip


def answer(drawn: DrawnFruit, label: dict[str, Any]) -> dict[str, Any]:
    """One entry of answers.json, in the case's frame; `label`: effect and parameters."""
    centre = np.array(drawn.fruit.pit.centre_mm) - np.array(drawn.prior.centre_mm)
    return {
        **label,
        "E_MPa": drawn.fruit.E_MPa,
        "nu": drawn.fruit.poisson_ratio,
        "pit_semi_axes_mm": list(drawn.fruit.pit.semi_axes_mm),
        "pit_centre_mm": centre.tolist(),
        "category": drawn.category,
    }


def write_answer(folder: Path, case_id: str, entry: dict[str, Any]) -> None:
    """Add one case's answer to answers.json; a lock permits several processes at once."""
    path = folder / "answers.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        known[case_id] = entry
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        partial.replace(path)


def is_written(folder: Path, case_id: str) -> bool:
    """Whether a case and its answer exist."""
    answers = folder / "answers.json"
    known = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    return case_id in known and (folder / case_id).exists()


SEED = 2028
"""Seed of fruit and cases; any number serves. 2027 was the bank that stored its cases with their noise."""
MESH = BrickGrading(cells=3, layers=3)
"""Mesh of the bank's fruit, as in the comparison with another simulator (docs/validation.md, Solver)."""
MESHES = (0, 2, 1)
"""Meshes, stored one by one. Mesh 0 has two grasps and mesh 2 a shear leg: they take longest and go first."""
DRAWN = (
    "poisson_ratio", "pit_offset", "pit_size", "sensor_gain", "sensor_drift", "gripper_compliance",
    "pose_error", "sensor_nonlinear", "gel_creep", "gel_hysteresis", "thermal_drift",
)  # fmt: skip
"""Effects that need no new simulation: they change the recording or the prior."""
SIMULATED = (*(name for name in EFFECTS if name not in DRAWN), *OUT_OF_CATALOGUE)
"""Effects and physics that need a simulation: they cannot be added to a stored fruit."""
WIDE = 3
"""Part of names and seeds of fruit and cases whose amplitudes cover the effect's whole range."""


@dataclass(frozen=True, kw_only=True)
class BankFruit:
    """One fruit of the bank: its simulated effects (or none), and its number among fruit with the same."""

    number: int
    effects: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of its files."""
        if not self.effects:
            return f"null-{self.number:03d}"
        return f"{'+'.join(self.effects)}-{WIDE}-{self.number}"

    @property
    def seed(self) -> tuple[int, ...]:
        """Seed of all random properties of the fruit."""
        if not self.effects:
            return (SEED, 0, self.number)
        return (SEED, 1, sum(map(ord, "+".join(self.effects))), WIDE, self.number)

    def plan(self) -> CasePlan:
        """The fruit, its grasps and its effects."""
        rng = np.random.default_rng([*self.seed, 1])
        effects = tuple((effect, drawn_amplitude(effect, rng)) for effect in self.effects)
        return planned(self.name, effects, seed=self.seed)


def simulate(folder: Path, fruit: BankFruit, mesh: int) -> None:
    """Store the grasps of one mesh of a fruit, unless the file exists.

    Raises NotInEquilibrium if a grasp does not converge.
    """
    path = folder / f"{fruit.name}-m{mesh}.npz"
    if path.exists():
        return
    plan = fruit.plan()
    grasps = tuple(grasp for grasp in plan.grasps if grasp.mesh == mesh)
    folder.mkdir(parents=True, exist_ok=True)
    store_truths(path, true_recordings(replace(plan, grasps=grasps), fineness=MESH))


def simulated(folder: Path, fruit: BankFruit) -> tuple[TrueRecording, ...]:
    """The four stored grasps, by name. Raises SampleFailure unless all meshes are stored."""
    paths = [folder / f"{fruit.name}-m{mesh}.npz" for mesh in MESHES]
    if not all(path.exists() for path in paths):
        raise SampleFailure(f"not every mesh of {fruit.name} is simulated: run `simulate` first")
    return tuple(
        sorted((truth for path in paths for truth in stored_truths(path)), key=lambda truth: truth.name)
    )


def draw_case(
    cases: Path, fruit: BankFruit, truths: tuple[TrueRecording, ...], *, added: tuple[str, ...] = (),
    record: int,
) -> str:  # fmt: skip
    """Write one case below `cases`, unless it exists, and return its name; the answer comes last.

    `truths`: the fruit's grasps; `added`: effects of DRAWN. Another `record` has other parameters of `added`,
    other noise, another scan and another prior.
    """
    effects = (*fruit.effects, *added)
    case_id = f"{'+'.join(effects)}-{WIDE}-{fruit.number}-{record}" if effects else f"{fruit.name}-{record}"
    if is_written(cases, case_id):
        return case_id
    plan, peaks = fruit.plan(), tuple(truth.peak_force_N for truth in truths)
    extra, rng = added_effects(case_id, added)
    drawn, stated = as_stated(plan.drawn, extra, rng)
    injected = tuple(with_amount(injection, max(peaks), truths) for injection in (*plan.injected, *stated))
    origin = {"fruit": fruit.name, "fruit_seed": fruit.seed, "added": added, "seed": SEED}
    entry = answer(drawn, label_of(injected)) | {"drawn_from": origin}
    rng.bytes(16)  # keeps the draws of earlier banks, which drew a salt here
    recordings = tuple(as_recorded(truth, injected) for truth in truths)
    write_case_files(cases / case_id, drawn, recordings, peaks_N=peaks, rng=rng)
    write_answer(cases, case_id, entry)
    return case_id


def added_effects(
    case_id: str, added: tuple[str, ...]
) -> tuple[tuple[InjectedEffect, ...], np.random.Generator]:
    """A case's effects of DRAWN, and the generator for all its other draws."""
    rng = np.random.default_rng([SEED, 2, *case_id.encode()])
    effects = tuple(
        InjectedEffect(effect=name, parameters=drawn_parameters(name, drawn_amplitude(name, rng), rng))
        for name in added
    )
    return effects, rng


def as_stated(
    drawn: DrawnFruit, added: tuple[InjectedEffect, ...], rng: np.random.Generator
) -> tuple[DrawnFruit, tuple[InjectedEffect, ...]]:
    """The fruit as another record states it, and the effects with their labels' parameters.

    The truth stays: the prior's pit moves or scales the other way. The case states the Poisson's ratio of the
    draw, and its label holds the true one.
    """
    offset, size, ratio = (named(added, effect) for effect in ("pit_offset", "pit_size", "poisson_ratio"))
    seen = seen_anew(
        drawn,
        rng,
        pit_shift_mm=None if offset is None else np.array(offset.parameters["offset_mm"]),
        pit_scale=1.0 if size is None else size.number("scale"),
    )
    if ratio is None:
        return seen, added
    true = replace(ratio, parameters={"nu": drawn.fruit.poisson_ratio})
    seen = replace(seen, stated_poisson_ratio=ratio.number("nu"))
    return seen, tuple(true if injection is ratio else injection for injection in added)
