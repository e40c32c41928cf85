"""Answers concealed cases of another simulator, and scores the answers once the labels are published.

    python benchmarks/sealed/other_simulator.py answer CASES ANSWERS ROUNDS

`answer` explains every case below CASES once, as `drupe explain CASE --json FILE` does. Each case has
a process of its own. It writes ANSWERS/CASE.json and one line per case in ANSWERS/runs.jsonl: exit status,
refusal, state of the code, CPU seconds, peak memory. ROUNDS gets the finder's linear problem of each case for
the other methods. A run that was stopped goes on where it stopped.
"""

import argparse
import contextlib
import io
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from cramer_rao import amplitude_bounds
from reduced_case import store
from sealed_answers import ROOMS, captured, of_problem

from pipeline.batch.cache import code_version
from pipeline.cli import main as drupe

RUNS = "runs.jsonl"
HELP = {
    "cases": "folder of the cases; of explain: one case",
    "answers": "folder of the answers",
    "rounds": "folder of the linear problems",
}
MIB = 1024
"""KiB, as Linux counts the memory of a process."""


def answer(cases: Path, answers: Path, rounds: Path) -> None:
    """Every case that has no line in the runs yet, each in a process of its own on one thread."""
    answers.mkdir(parents=True, exist_ok=True)
    rounds.mkdir(parents=True, exist_ok=True)
    done = {run["case"] for run in runs_in(answers)}
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for folder in sorted(path.parent for path in cases.glob("*/case.toml")):
        if folder.name in done:
            continue
        command = [sys.executable, __file__, "explain", str(folder), str(answers), str(rounds)]
        ended = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
        sys.stderr.write(ended.stderr)
        run = (
            json.loads(ended.stdout.splitlines()[-1])
            if ended.returncode == 0
            else {"exit_status": ended.returncode, "said": ended.stderr[-2000:]}
        )
        with (answers / RUNS).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"case": folder.name} | run) + "\n")
        print(f"{folder.name}: {run.get('cpu_s', float('nan')):.0f} CPU-s", flush=True)


def explain(folder: Path, answers: Path, rounds: Path) -> dict[str, Any]:
    """One case by the product's own command in this process, and what it cost."""
    started = time.perf_counter()
    said = io.StringIO()
    target = answers / f"{folder.name}.json"
    command = ["drupe", "explain", str(folder), "--json", str(target), "--jobs", "1"]
    status: Any = 0
    with captured() as kept, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            with patch.object(sys, "argv", command):
                drupe()
        except SystemExit as ended:
            status = ended.code
    used = resource.getrusage(resource.RUSAGE_SELF)
    run: dict[str, Any] = {
        "exit_status": int(status or 0),
        "code": code_version(ROOMS)[:12],
        "cpu_s": round(used.ru_utime + used.ru_stime, 1),
        "wall_s": round(time.perf_counter() - started, 1),
        "peak_MiB": round(used.ru_maxrss / MIB),
    }
    if not target.is_file():
        run["said"] = " ".join(said.getvalue().split())[-2000:]
    elif kept.case is not None and kept.information is not None:
        before = json.loads(target.read_text(encoding="utf-8"))["E_MPa"]["before"]
        run |= of_problem(kept.case) | {
            "bounds": amplitude_bounds(kept.information, kept.case, E_MPa=before["value"]),
        }
        problem = replace(kept.case, facts=kept.case.facts | {"E_MPa": [before["value"], before["sd"]]})
        store(rounds / f"{folder.name}.npz", problem)
    return run


def runs_in(answers: Path) -> list[dict[str, Any]]:
    """The lines of the runs so far."""
    path = answers / RUNS
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return [json.loads(line) for line in lines]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("answer", "explain"):
        command = commands.add_parser(name)
        for place in ("cases", "answers", "rounds"):
            command.add_argument(place, type=Path, help=HELP[place])
    chosen = parser.parse_args()
    if chosen.command == "answer":
        answer(chosen.cases, chosen.answers, chosen.rounds)
    else:
        print(json.dumps(explain(chosen.cases.resolve(), chosen.answers.resolve(), chosen.rounds.resolve())))


if __name__ == "__main__":
    main()
