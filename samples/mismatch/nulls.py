"""Null cases: fruits to whom nothing happened that the model leaves out, many noisy records of each."""

from pathlib import Path

import numpy as np

from samples.gel_contact import Gel
from samples.mismatch.bodies import ElasticBody
from samples.mismatch.case_files import Label, answer, reveal, seal, write_case_files
from samples.mismatch.drawn_fruit import CATEGORIES, DrawnFruit, drawn_fruit, with_new_prior
from samples.mismatch.four_grasps import four_grasps
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of
from samples.sample_failure import NotInEquilibrium

NOTHING = Label(effect="none", parameters={})


def write_nulls(folder: Path, *, fruits: range, records: int, seed: int) -> None:
    """Fruits of all categories in turn; of each, `records` cases with all errors drawn anew."""
    for k in fruits:
        drawn, truths = _balanced(k, seed)
        for record in range(records):
            own = np.random.default_rng([seed, k, record, 1])
            seen = drawn if record == 0 else with_new_prior(drawn, own)
            case_id = f"null-{k + 1:02d}-{record + 1}"
            salt = own.bytes(16).hex()
            entry = answer(seen, NOTHING)
            seal(folder, case_id, entry, salt=salt)
            peaks = tuple(t.peak_force_N for t in truths)
            write_case_files(folder / case_id, seen, truths, peaks_N=peaks, rng=own)
            reveal(folder, case_id, entry, salt=salt)


def _balanced(k: int, seed: int, *, attempts: int = 3) -> tuple[DrawnFruit, tuple[TrueRecording, ...]]:
    """The first fruit of this number, of `attempts` drawn, whose grasps all find their balance."""
    for attempt in range(attempts):
        rng = np.random.default_rng([seed, k, attempt])
        drawn = drawn_fruit(f"null-{k + 1:02d}", category=CATEGORIES[k % len(CATEGORIES)], rng=rng)
        try:
            return drawn, elastic_truths(drawn, rng)
        except NotInEquilibrium:
            continue
    raise NotInEquilibrium(f"null fruit {k + 1} found no balance in {attempts} draws: take another seed")


def elastic_truths(drawn: DrawnFruit, rng: np.random.Generator) -> tuple[TrueRecording, ...]:
    """The four true recordings of a fruit of plain linear flesh."""
    grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
    truths = {}
    for mesh in range(3):
        here = [g for g in grasps if g.mesh == mesh]
        stands = meshed_fruit(drawn, here[0])
        body = ElasticBody(skin_compliance(stands.flesh.stiffness, stands.dofs))
        for grasp in here:
            truths[grasp.name] = grasped(grasp, grip_of(stands, gel=Gel()), body)
    return tuple(truths[g.name] for g in grasps)
