"""The bank of cases: it simulates and stores fruit once without noise, and draws cases from them.

A fruit has no effect, or effects that change the flesh or the contact (SIMULATED). A draw adds noise, the
scan's error, the prior's error, and effects of sensor, gripper and prior (DRAWN). One seed determines all.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from samples.graded_bricks import BrickGrading
from samples.mismatch.case_files import (
    answer,
    is_written,
    store_truths,
    stored_truths,
    write_answer,
    write_case_files,
)
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
from samples.mismatch.true_recording import TrueRecording
from samples.sample_failure import SampleFailure

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
