"""Write the bank of mismatch cases with known answers: nulls, single effects, pairs, what no catalogue has.

    python benchmarks/mismatch_bank.py FOLDER null|single|pair|outside [--first K] [--count N] [--records R]

Below FOLDER: one folder per case, manifest.json (a sealed label per case, written before the case) and
answers.json. A case that is there already is left alone.
"""

import argparse
import time
from pathlib import Path

from samples.mismatch.bank import SEED, outsiders, pairs, singles, write_bank_case
from samples.mismatch.nulls import write_nulls
from samples.sample_failure import SampleFailure


def main() -> None:
    """Write what is asked for; a case that cannot be balanced is reported and left out."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("kind", choices=["null", "single", "pair", "outside"])
    parser.add_argument("--first", type=int, default=0, help="number of the first fruit or case")
    parser.add_argument("--count", type=int, default=None, help="how many fruits or cases")
    parser.add_argument("--records", type=int, default=8, help="noisy records of each null fruit")
    parser.add_argument("--seed", type=int, default=SEED, help="of null fruits")
    chosen = parser.parse_args()
    if chosen.kind == "null":
        for k in range(chosen.first, chosen.first + (chosen.count or 15)):
            start = time.process_time()
            write_nulls(chosen.folder, fruits=range(k, k + 1), records=chosen.records, seed=chosen.seed)
            print(f"fruit {k + 1}: {time.process_time() - start:.0f} CPU-s", flush=True)
        return
    cases = {"single": singles, "pair": pairs, "outside": outsiders}[chosen.kind]()
    last = None if chosen.count is None else chosen.first + chosen.count
    for case in cases[chosen.first : last]:
        if (chosen.folder / case.case_id).exists():
            continue
        start = time.process_time()
        try:
            write_bank_case(chosen.folder, case)
        except SampleFailure as failure:
            print(f"{case.case_id}: {failure}", flush=True)
            continue
        print(f"{case.case_id}: {time.process_time() - start:.0f} CPU-s", flush=True)


if __name__ == "__main__":
    main()
