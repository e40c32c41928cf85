"""Null cases: fruits to whom nothing happened that the model leaves out, many noisy records of each."""

import json
from pathlib import Path
from typing import Literal

import numpy as np

from samples.mismatch.bodies import ElasticBody, GrippedBody
from samples.mismatch.case_files import Label, answer, reveal, seal, write_case_files
from samples.mismatch.drawn_fruit import (
    CATEGORIES,
    DrawnFruit,
    drawn_fruit,
    seen_anew,
    seen_by_drawn_sensor,
)
from samples.mismatch.flesh_laws import Lame, StiffeningFlesh
from samples.mismatch.four_grasps import four_grasps
from samples.mismatch.meshed_fruit import CASE, NONLINEAR_CASE, MeshedFruit, meshed_fruit
from samples.mismatch.nonlinear_body import CONVERGED_MM, NonlinearBody
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of
from samples.mismatch.whole_fruit import whole_fruit
from samples.sample_failure import NotInEquilibrium

NOTHING = Label(effect="none", parameters={})
NullLaw = Literal["linear", "neo-hookean"]
LAWS: tuple[NullLaw, ...] = ("linear", "neo-hookean")


def write_nulls(folder: Path, *, fruits: range, records: int, seed: int) -> None:
    """Fruits of all categories in turn, flesh linear or Neo-Hookean as drawn; of each, `records` cases.

    Their errors are drawn anew for each case. A fruit whose cases are there already is left alone.
    Sensors and scans are drawn wide, the sensor's gel and markers once for each fruit.
    """
    for k in fruits:
        names = [f"null-{k + 1:02d}-{record + 1}" for record in range(records)]
        if all(_is_written(folder, name) for name in names):
            continue
        drawn, law, truths = _balanced(k, seed)
        for record, case_id in enumerate(names):
            own = np.random.default_rng([seed, k, record, 1])
            seen = drawn if record == 0 else seen_anew(drawn, own)
            salt = own.bytes(16).hex()
            entry = {**answer(seen, NOTHING), "law": law}
            seal(folder, case_id, entry, salt=salt)
            peaks = tuple(t.peak_force_N for t in truths)
            write_case_files(folder / case_id, seen, truths, peaks_N=peaks, rng=own)
            reveal(folder, case_id, entry, salt=salt)


def _is_written(folder: Path, case_id: str) -> bool:
    answers = folder / "answers.json"
    known = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    return case_id in known and (folder / case_id).exists()


def _balanced(
    k: int, seed: int, *, attempts: int = 3
) -> tuple[DrawnFruit, NullLaw, tuple[TrueRecording, ...]]:
    """The first fruit of this number, of `attempts` drawn, whose grasps all find their balance."""
    for attempt in range(attempts):
        rng = np.random.default_rng([seed, k, attempt])
        drawn = drawn_fruit(f"null-{k + 1:02d}", category=CATEGORIES[k % len(CATEGORIES)], rng=rng)
        drawn = seen_by_drawn_sensor(drawn, rng)
        law = LAWS[int(rng.integers(len(LAWS)))]
        try:
            return drawn, law, sound_truths(drawn, rng, law=law)
        except NotInEquilibrium:
            continue
    raise NotInEquilibrium(f"null fruit {k + 1} found no balance in {attempts} draws: take another seed")


def sound_truths(
    drawn: DrawnFruit, rng: np.random.Generator, *, law: NullLaw = "linear"
) -> tuple[TrueRecording, ...]:
    """The four true recordings of a fruit of plain flesh."""
    grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
    truths = {}
    for mesh in range(3):
        here = [g for g in grasps if g.mesh == mesh]
        stands = meshed_fruit(drawn, here[0], fineness=CASE if law == "linear" else NONLINEAR_CASE)
        body = sound_body(stands, law)
        for grasp in here:
            truths[grasp.name] = grasped(grasp, grip_of(stands, gel=drawn.sensor.gel), body)
    return tuple(truths[g.name] for g in grasps)


def sound_body(stands: MeshedFruit, law: NullLaw) -> GrippedBody:
    """Plain flesh of one mesh."""
    if law == "linear":
        return ElasticBody(skin_compliance(stands.flesh.stiffness, stands.dofs))
    return neo_hookean_body(stands)


def neo_hookean_body(stands: MeshedFruit, *, stop_mm: float = CONVERGED_MM) -> NonlinearBody:
    """Neo-Hookean flesh (the exponential law with b = 0); `stop_mm`: see NonlinearBody."""
    flesh = stands.flesh
    law = StiffeningFlesh(lame=Lame(mu=flesh.mu_MPa, lam=flesh.lam_MPa), b=0.0)
    return NonlinearBody(whole_fruit(flesh, flesh.stiffness, stands.dofs), law, stop_mm=stop_mm)
