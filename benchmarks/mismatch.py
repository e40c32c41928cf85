"""Explain folders of mismatch cases whose answers are known, and count what comes out.

    python benchmarks/mismatch.py FOLDER... [--out CSV] [--limit N] [--ablation NAME ...] [--work DIR]
                                  [--again] [--jobs N]

FOLDER holds one folder per case and answers.json, or is one case with answers.json beside it. One JSON line
per case is kept beside the CSV as soon as the case is done: a run that was stopped goes on where it was.
Ablations: whole (the default), load-only (no hold, no unloading), no-grasp-4 (the fruit never turned),
effect-left-out (the true effect is not in the catalogue: right is "unknown"; sound cases are passed over),
noise-2, noise-4, noise-8 (that many times the noise).
"""

import argparse
import json
import resource
import tempfile
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

from mismatch_altered import ABLATIONS, LEFT_OUT, WHOLE, altered
from mismatch_score import score
from mismatch_summary import summary, table

from fem.fem_failure import FemFailure
from fem.mismatch.result import NONE, UNKNOWN
from pipeline.batch.cache import code_version
from pipeline.batch.outcome import FruitEnded
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import finding
from pipeline.fruit.stage_log import StageLog
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from tactile.tactile_failure import TactileFailure

REFUSED = (BatchRefused, FruitEnded, ReconFailure, TactileFailure, FemFailure)
BROKEN = (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError, AttributeError)
"""A defect in one case must not cost the others; it is counted as a case without an answer."""
ROOMS = ("fem", "tactile", "recon", "pipeline")


def cases_in(folder: Path) -> list[tuple[Path, dict[str, Any]]]:
    """Cases with their answers."""
    alone = (folder / "case.toml").is_file()
    folders = [folder] if alone else sorted(path.parent for path in folder.glob("*/case.toml"))
    answers = json.loads(((folder.parent if alone else folder) / "answers.json").read_text())
    return [(path, answers[path.name]) for path in folders if path.name in answers]


def explained(folder: Path, truth: dict[str, Any], ablation: str, work: Path, jobs: int) -> dict[str, Any]:
    """One case through the reading of `drupe explain`, scored."""
    forget_peak()
    started, busy = time.perf_counter(), time.process_time()
    try:
        with altered(ablation, truth["effect"]):
            case = open_case(folder.resolve(), fruit_id=None, work=work, out=None)
            found = finding(case, StageLog(str), jobs=jobs).explanation
        row = score(found, {**truth, "effect": UNKNOWN} if ablation == LEFT_OUT else truth)
    except REFUSED as failure:
        row = {"truth": truth["effect"], "failure": " ".join(str(failure).split())}
    except BROKEN as defect:
        row = {"truth": truth["effect"], "failure": f"{type(defect).__name__}: {defect}"}
    return row | {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_s": round(time.process_time() - busy, 2),
        "peak_MiB": round(peak_MiB()),
        "code": code_version(ROOMS)[:12],
    }


def forget_peak() -> None:
    """From here on the peak is that of one case (Linux; elsewhere it is the whole run's)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_MiB() -> float:
    """The largest resident memory since then."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memoised(path: Path) -> dict[tuple[str, str, str], dict[str, Any]]:
    """Cases that are done; the last line of a run that was killed may be half a line."""
    done = {}
    for line in path.read_text().splitlines() if path.is_file() else ():
        with suppress(json.JSONDecodeError):
            row = json.loads(line)
            done[row["folder"], row["case"], row["ablation"]] = row
    return done


def keep_line(path: Path, row: dict[str, Any]) -> None:
    """Added at the end, on a line of its own whatever the last run left."""
    with path.open("a+") as file:
        file.seek(0)
        before = file.read()
        file.write(("" if before.endswith("\n") or not before else "\n") + json.dumps(row) + "\n")


def line_of(row: dict[str, Any]) -> str:
    """One case in a line."""
    if "failure" in row:
        return f"{row['case']} {row['truth']}: no answer: {row['failure']} ({row['seconds']:.0f} s)"
    parameters = table([row])["parameters"][0]
    heldout = [row[f"heldout_{name}"] for name in ("before", "after", "noise")]
    proof = " / ".join("-" if x is None else f"{x:.4f}" for x in heldout)
    return (
        f"{row['case']} {row['truth']}: {' | '.join(row['verdict'])}, p {row['p_value']:.2g}, E "
        f"{row['E_before_error']:+.1%} -> {row['E_after_error']:+.1%}, held out {proof}, "
        f"{row['seconds']:.0f} s, {row['peak_MiB']} MiB" + (f"\n    {parameters}" if parameters else "")
    )


def main() -> None:
    """Run what is not yet done, then write the table and print what it comes to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("mismatch.csv"))
    parser.add_argument("--limit", type=int, default=None, help="at most so many cases")
    parser.add_argument("--ablation", nargs="+", choices=ABLATIONS, default=[WHOLE])
    parser.add_argument("--work", type=Path, default=None, help="keep meshes here between runs")
    parser.add_argument("--again", action="store_true", help="forget the cases that are done")
    parser.add_argument(
        "--jobs", type=int, default=2, help="as of drupe explain; there one per core, at most 4"
    )
    chosen = parser.parse_args()
    lines = chosen.out.with_suffix(".jsonl")
    if chosen.again:
        lines.unlink(missing_ok=True)
    done = memoised(lines)
    cases = [case for folder in chosen.folders for case in cases_in(folder)][: chosen.limit]
    rows = []
    for number, (folder, truth) in enumerate(cases, start=1):
        keep = nullcontext(chosen.work / folder.name) if chosen.work else tempfile.TemporaryDirectory()
        with keep as work:
            for ablation in chosen.ablation:
                if ablation == LEFT_OUT and truth["effect"] == NONE:
                    continue
                key = (folder.resolve().parent.name, folder.resolve().name, ablation)
                if key not in done:
                    row = dict(zip(("folder", "case", "ablation"), key, strict=True))
                    row |= explained(folder, truth, ablation, Path(work), chosen.jobs)
                    keep_line(lines, row)
                    done[key] = row
                    print(f"[{number}/{len(cases)}] {ablation}: {line_of(row)}", flush=True)
                rows.append(done[key])
    if not rows:
        raise SystemExit("no case with an answer in answers.json")
    table(rows).to_csv(chosen.out, index=False)
    for ablation in chosen.ablation:
        print(f"\n== {ablation} ==")
        print("\n".join(summary([row for row in rows if row["ablation"] == ablation])))
    print(f"\n{chosen.out}, {lines}")


if __name__ == "__main__":
    main()
