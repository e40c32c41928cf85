"""Simulate the bank's fruit once, without noise, and draw mismatch cases with known answers from them.

    python benchmarks/mismatch_bank.py simulate TRUTHS [FRUIT] [--jobs J]
    python benchmarks/mismatch_bank.py draw TRUTHS CASES [FRUIT] [--records R]
    FRUIT: [--effect NAME ...] [--level L] [--first K] [--count N]

Without --effect both are about fruit without mismatch. `simulate` stores one file per fruit and mesh; its
effects need fruit of their own. `draw` writes one folder per case, a sealed label in manifest.json and the
answer in answers.json. It takes the stored fruit that have the effects and adds those that need no fruit of
their own (sensor, gripper, pit, Poisson's ratio); those alone it adds to fruit without mismatch.
--level is 0, 1, 2 (from just to be seen to plain) or 3 (amplitudes drawn log-uniformly). Both commands leave
alone what is there: a command that was stopped goes on when it is given again.
"""

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from samples.mismatch.bank import (
    DRAWN,
    MESHES,
    OUTSIDE,
    SIMULATED,
    WIDE,
    BankFruit,
    draw_case,
    simulate,
    simulated,
)
from samples.sample_failure import SampleFailure


def main() -> None:
    """Simulate or draw what is asked for; a fruit that fails is named and left out."""
    chosen = arguments()
    effects = sorted(set(chosen.effect))
    altered, added = (tuple(name for name in effects if name in kind) for kind in (SIMULATED, DRAWN))
    numbers = range(chosen.first, chosen.first + chosen.count)
    fruits = [BankFruit(number=k, effects=altered, level=chosen.level if altered else 0) for k in numbers]
    if chosen.command == "simulate" and chosen.mesh is None:
        with ThreadPoolExecutor(chosen.jobs) as pool:
            list(pool.map(in_own_process, [(fruit, mesh) for fruit in fruits for mesh in MESHES]))
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
                case = draw_case(chosen.cases, fruit, truths, added=added, level=chosen.level, record=record)
                print(case, flush=True)
        except SampleFailure as failure:
            print(f"{fruit.name}: {failure}", flush=True)


def in_own_process(job: tuple[BankFruit, int]) -> None:
    """Simulate one mesh of one fruit by this command, on one thread: a crash costs no other."""
    fruit, mesh = job
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, *sys.argv, "--first", str(fruit.number), "--count", "1", "--mesh", str(mesh)]
    subprocess.run(command, env=environment, check=False)


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("simulate", "draw"):
        command = commands.add_parser(name)
        command.add_argument("truths", type=Path, help="folder of the stored fruit")
        command.add_argument("--first", type=int, default=0, help="number of the first fruit")
        command.add_argument("--count", type=int, default=1, help="how many fruit")
        command.add_argument("--level", type=int, choices=range(WIDE + 1), default=1)
        command.add_argument(
            "--effect", nargs="+", default=[], choices=SIMULATED if name == "simulate" else SIMULATED + DRAWN
        )
        if name == "simulate":
            command.add_argument("--jobs", type=int, default=1, help="processes")
            command.add_argument("--mesh", type=int, choices=MESHES, help="this alone, in this process")
        else:
            command.add_argument("cases", type=Path, help="folder of the cases")
            command.add_argument("--records", type=int, default=1, help="cases of each fruit")
    chosen = parser.parse_args()
    if len(chosen.effect) > 1 and not set(OUTSIDE).isdisjoint(chosen.effect):
        parser.error(f"{' and '.join(OUTSIDE)} come alone, without another effect")
    return chosen


if __name__ == "__main__":
    main()
