"""Sound fruit drawn as those of the sealed proof, from any words as salt, with their answers beside them.

    python benchmarks/sealed/sound_cases.py FOLDER --salt WORDS [--law linear|neo-hookean] [--count N]

Writes the first N sound cases of that law (both) and answers.json, as benchmarks/mismatch.py reads them;
those that are there are left alone. A case of linear flesh takes some minutes of one core, one of Neo-Hookean
flesh four to eight.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))
from sealed_draw import SOUND, drawn_cases, sound_draw, truth_of
from sealed_simulation import simulated

from samples.mismatch.nulls import LAWS
from samples.sample_failure import NotInEquilibrium

DRAWN = 60
"""Cases drawn, of which the first are taken; another number draws others."""


def main() -> None:
    """One case after the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--salt", required=True)
    parser.add_argument("--law", choices=LAWS)
    parser.add_argument("--count", type=int, default=10)
    chosen = parser.parse_args()
    cases = [
        case
        for case in drawn_cases(chosen.salt, {SOUND: DRAWN})
        if chosen.law in (None, sound_draw(case, 0)[1])
    ]
    answers_file = chosen.folder / "answers.json"
    answers: dict[str, Any] = json.loads(answers_file.read_text()) if answers_file.exists() else {}
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for case in cases[: chosen.count]:
        if case.case_id in answers:
            continue
        started = time.process_time()
        try:
            attempt, peaks_N = simulated(case, chosen.folder / case.case_id)
        except NotInEquilibrium as failure:
            print(failure, flush=True)
            continue
        answers[case.case_id] = truth = truth_of(case, attempt)
        answers_file.write_text(json.dumps(answers, indent=1) + "\n")
        forces = " ".join(f"{peak:.1f}" for peak in peaks_N)
        print(
            f"{case.case_id} {truth['law']}, E {truth['E_MPa']:.3f} MPa, {forces} N, "
            f"{time.process_time() - started:.0f} s of CPU",
            flush=True,
        )


if __name__ == "__main__":
    main()
