"""Simulate the bank's fruit once, without noise, and draw mismatch cases with known answers from them.

    python benchmarks/mismatch_bank.py simulate TRUTHS [FRUIT] [--jobs J]
    python benchmarks/mismatch_bank.py draw TRUTHS CASES [FRUIT] [--records R]
    python benchmarks/mismatch_bank.py reduce CASES ROUNDS [--jobs J]
    FRUIT: [--effect NAME ...] [--first K] [--count N]

Without --effect both are about fruit without mismatch. `simulate` stores one file per fruit and mesh; its
effects need fruit of their own. `draw` writes one folder per case, and the
answers in answers.json. It takes the stored fruit that have the effects and adds those that need no fruit of
their own (sensor, gripper, pit, Poisson's ratio); those alone it adds to fruit without mismatch.
`reduce` runs the finder's linear round of every case below CASES and stores its products in ROUNDS, one file
per case (`sealed/reduced_case.py`): what decides can then be tried on all cases within seconds.
Amplitudes are drawn log-uniformly over each effect's range. All commands leave
alone what is there: a command that was stopped goes on when it is given again.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from cramer_rao import amplitude_bounds, information_of
from reduced_case import ReducedCase, reduced, store

from fem.fem_failure import FemFailure
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.procedure import case_model
from fem.mismatch.result import NONE
from fem.mismatch.selection.screening import screened
from pipeline.batch.outcome import FruitEnded
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from samples.mismatch.bank import (
    DRAWN,
    MESHES,
    SIMULATED,
    BankFruit,
    draw_case,
    simulate,
    simulated,
)
from samples.mismatch.injected import OUT_OF_CATALOGUE
from samples.sample_failure import SampleFailure
from tactile.tactile_failure import TactileFailure

REFUSED = (BatchRefused, FruitEnded, ReconFailure, TactileFailure, FemFailure)
"""Failures that cost one case, not the others."""


def main() -> None:
    """Simulate, draw or reduce what is asked for; what fails is named and left out."""
    chosen = arguments()
    if chosen.command == "reduce":
        reduce_cases(chosen)
        return
    effects = sorted(set(chosen.effect))
    altered, added = (tuple(name for name in effects if name in kind) for kind in (SIMULATED, DRAWN))
    numbers = range(chosen.first, chosen.first + chosen.count)
    fruits = [BankFruit(number=k, effects=altered) for k in numbers]
    if chosen.command == "simulate" and chosen.mesh is None:
        jobs = [
            ("--first", str(fruit.number), "--count", "1", "--mesh", str(mesh))
            for fruit in fruits
            for mesh in MESHES
        ]
        in_own_processes(jobs, chosen.jobs)
        return
    for fruit in fruits:
        start = time.process_time()
        try:
            if chosen.command == "simulate":
                simulate(chosen.truths, fruit, chosen.mesh)
                print(f"{fruit.name}-m{chosen.mesh}: {time.process_time() - start:.0f} CPU-s", flush=True)
                continue
            truths = simulated(chosen.truths, fruit)
            for record in range(1, chosen.records + 1):
                case = draw_case(chosen.cases, fruit, truths, added=added, record=record)
                print(case, flush=True)
        except SampleFailure as failure:
            print(f"{fruit.name}: {failure}", flush=True)


def reduce_cases(chosen: Namespace) -> None:
    """Every case of the folder, or the one that is named, unless its file is there."""
    names = (
        [chosen.case]
        if chosen.case
        else sorted(path.parent.name for path in chosen.cases.glob("*/case.toml"))
    )
    due = [name for name in names if not (chosen.rounds / f"{name}.npz").exists()]
    if not chosen.case:
        in_own_processes([("--case", name) for name in due], chosen.jobs)
        return
    for name in due:
        start = time.process_time()
        try:
            case = linear_problem(chosen.cases / name)
        except REFUSED as failure:
            print(f"{name}: {failure}", flush=True)
            continue
        chosen.rounds.mkdir(parents=True, exist_ok=True)
        store(chosen.rounds / f"{name}.npz", case)
        print(f"{name}: {time.process_time() - start:.0f} CPU-s", flush=True)


def linear_problem(folder: Path) -> ReducedCase:
    """A case after the finder's linear round. Its facts hold the answer (answers.json beside the folder), and
    with an effect the least standard deviation of each effect's amplitude (Cramer and Rao).
    """
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder.resolve(), fruit_id=None, work=Path(work), out=None)
        model, _ = case_model(mismatch_case(case, grasped_fruit(case.task, StageLog(str))))
    recorded = [GraspEquations.of(model, recording) for recording in model.grasps]
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

    def run(job: tuple[str, ...]) -> None:
        subprocess.run([sys.executable, *sys.argv, *job], env=environment, check=False)

    with ThreadPoolExecutor(count) as pool:
        list(pool.map(run, jobs))


def arguments() -> Namespace:
    """Of the command line."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("simulate", "draw"):
        command = commands.add_parser(name)
        command.add_argument("truths", type=Path, help="folder of the stored fruit")
        command.add_argument("--first", type=int, default=0, help="number of the first fruit")
        command.add_argument("--count", type=int, default=1, help="how many fruit")
        command.add_argument(
            "--effect", nargs="+", default=[], choices=SIMULATED if name == "simulate" else SIMULATED + DRAWN
        )
        if name == "simulate":
            command.add_argument("--jobs", type=int, default=1, help="processes")
            command.add_argument("--mesh", type=int, choices=MESHES, help="this alone, in this process")
        else:
            command.add_argument("cases", type=Path, help="folder of the cases")
            command.add_argument("--records", type=int, default=1, help="cases of each fruit")
    command = commands.add_parser("reduce")
    command.add_argument("cases", type=Path, help="folder of cases, with answers.json")
    command.add_argument("rounds", type=Path, help="folder of the reduced cases")
    command.add_argument("--jobs", type=int, default=1, help="processes")
    command.add_argument("--case", help="this alone, in this process")
    chosen = parser.parse_args()
    if chosen.command == "reduce":
        return chosen
    if len(chosen.effect) > 1 and not set(OUT_OF_CATALOGUE).isdisjoint(chosen.effect):
        parser.error(f"{' and '.join(OUT_OF_CATALOGUE)} come alone, without another effect")
    return chosen


if __name__ == "__main__":
    main()
