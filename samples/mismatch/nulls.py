"""Null cases: fruits to whom nothing happened that the model leaves out, many noisy records of each."""

import json
from pathlib import Path

import numpy as np

from samples.mismatch.case_files import Label, answer, reveal, seal, write_case_files
from samples.mismatch.drawn_fruit import (
    CATEGORIES,
    DrawnFruit,
    drawn_fruit,
    seen_anew,
    seen_by_drawn_sensor,
)
from samples.mismatch.four_grasps import four_grasps
from samples.mismatch.injected import plain_flesh
from samples.mismatch.meshed_fruit import MeshedFruit, meshed_fruit
from samples.mismatch.nonlinear_body import CONVERGED_MM, NonlinearBody
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of
from samples.mismatch.whole_fruit import whole_fruit
from samples.sample_failure import NotInEquilibrium

NOTHING = Label(effect="none", parameters={})


def write_nulls(folder: Path, *, fruits: range, records: int, seed: int) -> None:
    """Fruits of all categories in turn; of each, `records` cases.

    Their errors are drawn anew for each case. A fruit whose cases are there already is left alone.
    Sensors and scans are drawn wide, the sensor's gel and markers once for each fruit.
    """
    for k in fruits:
        names = [f"null-{k + 1:02d}-{record + 1}" for record in range(records)]
        if all(_is_written(folder, name) for name in names):
            continue
        drawn, truths = _balanced(k, seed)
        for record, case_id in enumerate(names):
            own = np.random.default_rng([seed, k, record, 1])
            seen = drawn if record == 0 else seen_anew(drawn, own)
            salt = own.bytes(16).hex()
            entry = answer(seen, NOTHING)
            seal(folder, case_id, entry, salt=salt)
            peaks = tuple(t.peak_force_N for t in truths)
            write_case_files(folder / case_id, seen, truths, peaks_N=peaks, rng=own)
            reveal(folder, case_id, entry, salt=salt)


def _is_written(folder: Path, case_id: str) -> bool:
    answers = folder / "answers.json"
    known = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    return case_id in known and (folder / case_id).exists()


def _balanced(k: int, seed: int, *, attempts: int = 3) -> tuple[DrawnFruit, tuple[TrueRecording, ...]]:
    """The first fruit of this number, of `attempts` drawn, whose grasps all find their balance."""
    for attempt in range(attempts):
        rng = np.random.default_rng([seed, k, attempt])
        drawn = drawn_fruit(f"null-{k + 1:02d}", category=CATEGORIES[k % len(CATEGORIES)], rng=rng)
        drawn = seen_by_drawn_sensor(drawn, rng)
        try:
            return drawn, sound_truths(drawn, rng)
        except NotInEquilibrium:
            continue
    raise NotInEquilibrium(f"null fruit {k + 1} found no balance in {attempts} draws: take another seed")


def sound_truths(drawn: DrawnFruit, rng: np.random.Generator) -> tuple[TrueRecording, ...]:
    """The four true recordings of a fruit of plain flesh."""
    grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
    truths = {}
    for mesh in range(3):
        here = [g for g in grasps if g.mesh == mesh]
        stands = meshed_fruit(drawn, here[0])
        body = sound_body(stands)
        for grasp in here:
            truths[grasp.name] = grasped(grasp, grip_of(stands, gel=drawn.sensor.gel), body)
    return tuple(truths[g.name] for g in grasps)


def sound_body(stands: MeshedFruit, *, stop_mm: float = CONVERGED_MM) -> NonlinearBody:
    """Plain flesh of one mesh; `stop_mm`: see NonlinearBody."""
    whole = whole_fruit(stands.flesh, stands.dofs)
    return NonlinearBody(whole, plain_flesh(stands.flesh), stop_mm=stop_mm)
