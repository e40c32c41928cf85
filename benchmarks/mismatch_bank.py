"""Write the bank of mismatch cases with known answers: nulls, single effects, pairs, what no catalogue has.

    python benchmarks/mismatch_bank.py FOLDER null|single|pair|outside [--first K] [--count N] [--records R]
                                                                           [--jobs J]

Below FOLDER: one folder per case, manifest.json (a sealed label per case, written before the case) and
answers.json. A case that is there already is left alone. Jobs are processes of their own, one thread each,
that take the cases in turn; a started bank can be gone on with by the same command.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from samples.mismatch.bank import SEED, outsiders, pairs, singles, write_bank_case
from samples.mismatch.nulls import write_nulls
from samples.sample_failure import SampleFailure

NULL_FRUITS, RECORDS = 40, 5
"""Sound fruits of the bank and records of each: 200 cases."""


def main() -> None:
    """Write what is asked for, in several processes if wanted."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("kind", choices=["null", "single", "pair", "outside"])
    parser.add_argument("--first", type=int, default=0, help="number of the first fruit or case")
    parser.add_argument("--count", type=int, default=None, help="how many fruits or cases")
    parser.add_argument("--records", type=int, default=RECORDS, help="noisy records of each null fruit")
    parser.add_argument("--seed", type=int, default=SEED, help="of null fruits")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--job", type=int, default=0, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.jobs > 1 and "--job" not in sys.argv:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        workers = [
            subprocess.Popen([sys.executable, *sys.argv, "--job", str(j)], env=environment)
            for j in range(chosen.jobs)
        ]
        sys.exit(max(worker.wait() for worker in workers))
    if chosen.kind == "null":
        last = chosen.first + (chosen.count or NULL_FRUITS)
        for k in range(chosen.first + chosen.job, last, chosen.jobs):
            write = lambda k=k: write_nulls(  # noqa: E731
                chosen.folder, fruits=range(k, k + 1), records=chosen.records, seed=chosen.seed
            )
            timed(f"fruit {k + 1}", write)
        return
    cases = {"single": singles, "pair": pairs, "outside": outsiders}[chosen.kind]()
    last = len(cases) if chosen.count is None else chosen.first + chosen.count
    for case in cases[chosen.first + chosen.job : last : chosen.jobs]:
        if not (chosen.folder / case.case_id).exists():
            timed(case.case_id, lambda case=case: write_bank_case(chosen.folder, case))


def timed(name: str, write: Callable[[], None]) -> None:
    """Write and say how long it took; a case that cannot be balanced is reported and left out."""
    start = time.process_time()
    try:
        write()
    except SampleFailure as failure:
        print(f"{name}: {failure}", flush=True)
        return
    print(f"{name}: {time.process_time() - start:.0f} CPU-s", flush=True)


if __name__ == "__main__":
    main()
