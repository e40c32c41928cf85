"""Cases drawn as those of the sealed proof with their answers beside them: what can be worked on.

    python benchmarks/sealed/labelled_cases.py FOLDER --salt WORDS [--law linear|neo-hookean] [--count N]
    python benchmarks/sealed/labelled_cases.py FOLDER --revealed NUMBER...

Writes the first N (10) sound cases whose label names that law (both) from any words as salt, or the proof's
own cases of these numbers by today's samples/, and answers.json, as benchmarks/mismatch.py reads them; those
that are there are left alone. All flesh is simulated as Neo-Hookean. A case takes some minutes of one core.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sealed_draw import LAWS, SOUND, SealedCase, drawn_cases, sound_draw, truth_of
from sealed_proof import PROOF
from sealed_simulation import simulated
from sealing import SALT, read_salt

from samples.sample_failure import NotInEquilibrium

SOUND_COUNT = 10
"""Sound cases written unless another number is asked for: an hour of one core (set by hand)."""
DRAWN = 60
"""Sound cases drawn, of which the first are taken; another number draws others."""


def main() -> None:
    """One case after the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--salt")
    source.add_argument("--revealed", type=int, nargs="+", metavar="NUMBER")
    parser.add_argument("--law", choices=LAWS)
    parser.add_argument("--count", type=int)
    chosen = parser.parse_args()
    if chosen.revealed:
        if chosen.law is not None or chosen.count is not None:
            parser.error(
                "--law and --count choose among sound cases of a salt: leave them out with --revealed"
            )
        write_cases(chosen.folder, revealed_cases(chosen.revealed))
    else:
        count = SOUND_COUNT if chosen.count is None else chosen.count
        write_cases(chosen.folder, sound_cases(chosen.salt, chosen.law)[:count])


def sound_cases(salt: str, law: str | None) -> list[SealedCase]:
    """Sound fruit of this salt; None: of either law."""
    drawn = drawn_cases(salt, {SOUND: DRAWN})
    return [case for case in drawn if law in (None, sound_draw(case, 0)[1])]


def revealed_cases(numbers: Sequence[int]) -> list[SealedCase]:
    """The proof's cases of these numbers; SystemExit where it has no such case."""
    known = {case.case_id: case for case in drawn_cases(read_salt(PROOF / SALT))}
    wanted = [f"case-{number:03d}" for number in numbers]
    if missing := [name for name in wanted if name not in known]:
        raise SystemExit(f"{', '.join(missing)}: there is no such case; the proof has {len(known)}")
    return [known[name] for name in wanted]


def write_cases(folder: Path, cases: Sequence[SealedCase]) -> None:
    """Folders and answers of these cases, a line for each."""
    answers_file = folder / "answers.json"
    answers: dict[str, Any] = json.loads(answers_file.read_text()) if answers_file.exists() else {}
    folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        if case.case_id in answers:
            continue
        started = time.process_time()
        try:
            attempt, peaks_N = simulated(case, folder / case.case_id)
        except NotInEquilibrium as failure:
            print(failure, flush=True)
            continue
        answers[case.case_id] = truth = truth_of(case, attempt)
        answers_file.write_text(json.dumps(answers, indent=1) + "\n")
        forces = " ".join(f"{peak:.1f}" for peak in peaks_N)
        print(
            f"{case.case_id} {truth['effect']}, {truth['law']} flesh, E {truth['E_MPa']:.3f} MPa, "
            f"{forces} N, {time.process_time() - started:.0f} s of CPU",
            flush=True,
        )


if __name__ == "__main__":
    main()
