"""Simulate the bank's fruit once, without noise, and draw mismatch cases with known answers from them.

    python benchmarks/mismatch_bank.py simulate TRUTHS [FRUIT] [--jobs J]
    python benchmarks/mismatch_bank.py draw TRUTHS CASES [FRUIT] [--records R]
    python benchmarks/mismatch_bank.py disturb BODIES CASES [--records R]
    python benchmarks/mismatch_bank.py reduce CASES ROUNDS [--jobs J]
    FRUIT: [--effect NAME --effect ...] [--first K] [--count N]

Without --effect both are about fruit without mismatch. `simulate` stores one file per fruit and mesh; its
effects need fruit of their own. `draw` writes one folder per case, and the
answers in answers.json. It takes the stored fruit that have the effects and adds those that need no fruit of
their own (sensor, gripper, pit, Poisson's ratio); those alone it adds to fruit without mismatch.
`disturb` makes cases without mismatch of BODIES: exact bodies of another simulator without noise
(`sealed/disturbed_bodies.py`).
`reduce` runs the finder's linear round of every case below CASES and stores its products in ROUNDS, one file
per case (`sealed/reduced_case.py`): what decides can then be tried on all cases within seconds.
Amplitudes are drawn log-uniformly over each effect's range. All commands leave
alone what is there: a command that was stopped goes on when it is given again.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated

from script import run
from typer import BadParameter, Option

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from cramer_rao import amplitude_bounds, information_of
from disturbed_bodies import disturbed
from reduced_case import ReducedCase, opened, reduced, store

from fem.fem_failure import FemFailure
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.result import NONE
from fem.mismatch.selection.screening import screened
from pipeline.batch.outcome import FruitEnded
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from samples.mismatch import bank
from samples.mismatch.bank import DRAWN, MESHES, SIMULATED, BankFruit
from samples.mismatch.injected import OUT_OF_CATALOGUE
from samples.sample_failure import SampleFailure
from tactile.tactile_failure import TactileFailure

REFUSED = (BatchRefused, FruitEnded, ReconFailure, TactileFailure, FemFailure)
"""Failures that cost one case, not the others."""


def simulate(
    truths: Path,
    effect: list[str] | None = None,
    first: int = 0,
    count: int = 1,
    jobs: int = 1,
    mesh: Annotated[int | None, Option(min=min(MESHES), max=max(MESHES), hidden=True)] = None,
) -> None:
    """Every fruit on every mesh, or on the one that is named, in this process."""
    fruits = bank_fruits(effect or [], first, count, known=SIMULATED)
    if mesh is None:
        each = product(range(first, first + count), MESHES)
        due = [("--first", str(number), "--count", "1", "--mesh", str(mesh)) for number, mesh in each]
        in_own_processes(due, jobs)
        return
    for fruit in fruits:
        start = time.process_time()
        with named(fruit.name, SampleFailure):
            bank.simulate(truths, fruit, mesh)
            print(f"{fruit.name}-m{mesh}: {time.process_time() - start:.0f} CPU-s", flush=True)


def draw(
    truths: Path,
    cases: Path,
    effect: list[str] | None = None,
    first: int = 0,
    count: int = 1,
    records: int = 1,
) -> None:
    """So many cases of each fruit."""
    added = tuple(name for name in sorted(set(effect or [])) if name in DRAWN)
    for fruit in bank_fruits(effect or [], first, count, known=SIMULATED + DRAWN):
        with named(fruit.name, SampleFailure):
            stored = bank.simulated(truths, fruit)
            for record in range(1, records + 1):
                print(bank.draw_case(cases, fruit, stored, added=added, record=record), flush=True)


def disturb(bodies: Path, cases: Path, records: int = 1) -> None:
    """`records` cases of each body below `cases`."""
    cases.mkdir(parents=True, exist_ok=True)
    for truth, record in product(sorted(bodies.glob("*/truth.json")), range(1, records + 1)):
        print(disturbed(truth.parent, cases, record=record), flush=True)


def bank_fruits(effects: list[str], first: int, count: int, *, known: Sequence[str]) -> list[BankFruit]:
    """Fruit with those of the effects that need fruit of their own."""
    if unknown := set(effects) - set(known):
        raise BadParameter(f"{', '.join(sorted(unknown))}: choose from {', '.join(known)}")
    if len(effects) > 1 and not set(OUT_OF_CATALOGUE).isdisjoint(effects):
        raise BadParameter(f"{' and '.join(OUT_OF_CATALOGUE)} come alone, without another effect")
    altered = tuple(name for name in sorted(set(effects)) if name in SIMULATED)
    return [BankFruit(number=k, effects=altered) for k in range(first, first + count)]


def reduce(
    cases: Path, rounds: Path, jobs: int = 1, case: Annotated[str | None, Option(hidden=True)] = None
) -> None:
    """Every case of the folder, or the one that is named, in this process, unless its file is there."""
    names = [case] if case else sorted(path.parent.name for path in cases.glob("*/case.toml"))
    due = [name for name in names if not (rounds / f"{name}.npz").exists()]
    if not case:
        in_own_processes([("--case", name) for name in due], jobs)
        return
    for name in due:
        start = time.process_time()
        with named(name, *REFUSED):
            problem = linear_problem(cases / name)
            rounds.mkdir(parents=True, exist_ok=True)
            store(rounds / f"{name}.npz", problem)
            print(f"{name}: {time.process_time() - start:.0f} CPU-s", flush=True)


@contextmanager
def named(name: str, *failures: type[Exception]) -> Iterator[None]:
    """A failure of this fruit or case is printed and costs no other."""
    try:
        yield
    except failures as failure:
        print(f"{name}: {failure}", flush=True)


def linear_problem(folder: Path) -> ReducedCase:
    """A case after the finder's linear round. Its facts hold the answer (answers.json beside the folder), and
    with an effect the least standard deviation of each effect's amplitude (Cramer and Rao).
    """
    model, recorded = opened(folder)
    linear = screened(model, recorded, EFFECTS)
    problem = reduced(model, recorded, linear)
    answers = json.loads((folder.parent / "answers.json").read_text(encoding="utf-8"))
    answer = answers[folder.name]
    E_MPa = model.modulus_scale / (model.compliance * (1 + float(linear.null.amounts[0])))
    facts = {"answer": answer, "E_MPa": E_MPa, "bounds": {}}
    if answer["effect"] != NONE:
        facts["bounds"] = amplitude_bounds(information_of(model, linear), problem, E_MPa=E_MPa)
    return replace(problem, facts=problem.facts | facts)


def in_own_processes(jobs: Sequence[tuple[str, ...]], count: int) -> None:
    """This command for each of the jobs, on one thread each, so many at once: a crash costs no other."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def run_one(job: tuple[str, ...]) -> None:
        subprocess.run([sys.executable, *sys.argv, *job], env=environment, check=False)

    with ThreadPoolExecutor(count) as pool:
        list(pool.map(run_one, jobs))


if __name__ == "__main__":
    run(simulate, draw, disturb, reduce)
