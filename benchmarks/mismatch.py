"""Answers mismatch cases by `drupe explain` and by other methods, and scores the answers.

    python benchmarks/mismatch.py answer CASES ANSWERS ROUNDS
    python benchmarks/mismatch.py baselines CASES ANSWERS ROUNDS NULLS NULL_CASES
    python benchmarks/mismatch.py score ANSWERS LABELS [--manifest MANIFEST] [--csv FILE] [--figure PNG]

`answer` explains every case below CASES once, as `drupe explain CASE --json FILE` does. Each case has
a process of its own. It writes ANSWERS/CASE.json and one line per case in ANSWERS/runs.jsonl: exit status,
refusal, state of the code, CPU seconds, peak memory. ROUNDS gets the finder's linear problem of each case for
the other methods. A run that was stopped goes on where it stopped.
`baselines` writes the answers of other methods (`sealed/baselines.py`) into ANSWERS/baselines.json. NULLS
holds rounds of fruit without mismatch (`mismatch_bank.py reduce`), NULL_CASES their folders. The other
methods get the finder's share of false alarms on them.
`score` prints all tables. LABELS is answers.json of labelled cases, or labels.json of concealed ones, whose
labels it compares with the hashes of MANIFEST. Its exit status is 1 if a hash is wrong, a label is missing,
or the answers come from several states of the code.
"""

import contextlib
import io
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from jaxtyping import Float
from script import run

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from cramer_rao import amplitude_bounds, amplitudes_of, information_of
from reduced_case import gains_of, opened, reduced, store, stored
from score_figure import score_figure
from sealed_report import amplitude_over_bound, case_table, report
from sealed_scores import NINETY, RELATIVES, scored
from sealing import broken_seals

from fem.estimation.sensitivity import mean_normal, tangents
from fem.mismatch import procedure
from fem.mismatch.catalogue import SPECS
from fem.mismatch.procedure import detected
from fem.mismatch.result import NONE
from fem.mismatch.selection.decision import DETECTION_P, MISFIT
from fem.mismatch.selection.screening import screened
from pipeline.batch.cache import code_version
from pipeline.cli import main as drupe
from reports.figures import png_of

ROOMS = ("fem", "tactile", "recon", "pipeline")
"""Packages whose state decides an answer."""
RUNS, BASELINES = "runs.jsonl", "baselines.json"
RELATIVES_FILE = Path(__file__).parent / "sealed" / "other-simulator" / "relatives.csv"
PER_GRASP = 250
"""Residuals of a grasp that the Gaussian process gets: it inverts a matrix of all of them."""
MIB = 1024
"""KiB, as Linux counts the memory of a process."""


@contextlib.contextmanager
def captured() -> Iterator[SimpleNamespace]:
    """While it holds, the first linear round is kept: `case`, and the `information` in it; None before."""
    kept = SimpleNamespace(case=None, information=None)

    def screening(model: Any, recorded: Any, effects: Any, **more: Any) -> Any:
        linear = screened(model, recorded, effects, **more)
        if kept.case is None:
            kept.case = reduced(model, recorded, linear)
            kept.information = information_of(model, linear)
        return linear

    with patch.object(procedure, "screened", screening):
        yield kept


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
        cost = (
            json.loads(ended.stdout.splitlines()[-1])
            if ended.returncode == 0
            else {"exit_status": ended.returncode, "said": ended.stderr[-2000:]}
        )
        with (answers / RUNS).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"case": folder.name} | cost) + "\n")
        print(f"{folder.name}: {cost.get('cpu_s', float('nan')):.0f} CPU-s", flush=True)


def explain(case: Path, answers: Path, rounds: Path) -> None:
    """One case by the product's own command in this process; prints what it cost."""
    started = time.perf_counter()
    said = io.StringIO()
    target = answers / f"{case.name}.json"
    command = ["drupe", "explain", str(case), "--json", str(target), "--jobs", "1"]
    status: Any = 0
    with captured() as kept, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            with patch.object(sys, "argv", command):
                drupe()
        except SystemExit as ended:
            status = ended.code
    used = resource.getrusage(resource.RUSAGE_SELF)
    cost: dict[str, Any] = {
        "exit_status": int(status or 0),
        "code": code_version(ROOMS)[:12],
        "cpu_s": round(used.ru_utime + used.ru_stime, 1),
        "wall_s": round(time.perf_counter() - started, 1),
        "peak_MiB": round(used.ru_maxrss / MIB),
    }
    if not target.is_file():
        cost["said"] = " ".join(said.getvalue().split())[-2000:]
    elif kept.case is not None:
        before = json.loads(target.read_text(encoding="utf-8"))["E_MPa"]["before"]
        linear = kept.case.linear()
        cost |= {
            "chi2": linear.null.chi2,
            "chi2_usual": kept.case.count * MISFIT,
            "catalogue": sorted(gains_of(linear)),
            "bounds": amplitude_bounds(kept.information, kept.case, E_MPa=before["value"]),
        }
        problem = replace(kept.case, facts=kept.case.facts | {"E_MPa": [before["value"], before["sd"]]})
        store(rounds / f"{case.name}.npz", problem)
    print(json.dumps(cost))


def runs_in(answers: Path) -> list[dict[str, Any]]:
    """The lines of the runs so far."""
    path = answers / RUNS
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return [json.loads(line) for line in lines]


def baselines(cases: Path, answers: Path, rounds: Path, nulls: Path, null_cases: Path) -> None:
    """The other methods' answers to all cases that have a round."""
    from baselines import Forest, gaussian_process, sparse_regression, threshold_of

    null_paths = sorted(nulls.glob("*.npz"))
    without = [stored(path).with_shipped_model_error().linear() for path in null_paths]
    false_alarms = float(np.mean([detected(linear).p_value < DETECTION_P for linear in without]))
    threshold = threshold_of(without, false_alarms=false_alarms)
    forest = Forest.grown(without, false_alarms=false_alarms)
    processes = [
        gaussian_process(residual_samples(null_cases / path.stem), (1.0, 0.0), least_gain=0.0)
        for path in null_paths
    ]
    least_gain = float(np.quantile([process["gain"] for process in processes], 1 - false_alarms))
    print(
        f"{len(without)} null rounds, false alarms {false_alarms:.1%}: threshold {threshold:.1f} sd, gain of "
        f"the process {least_gain:.0f}",
        flush=True,
    )
    by_case = {}
    for path in sorted(rounds.glob("*.npz")):
        case = stored(path)
        linear, E = case.linear(), tuple(case.facts["E_MPa"])
        by_case[path.stem] = {
            "modulus alone": {"verdict": [NONE], "order": [], "E": list(E)},
            "Gaussian process": gaussian_process(
                residual_samples(cases / path.stem), E, least_gain=least_gain
            ),
            "sparse regression": sparse_regression(linear, E, threshold=threshold),
            "random forest": forest.answer(linear, E),
        }
        print(path.stem, {name: said["verdict"] for name, said in by_case[path.stem].items()}, flush=True)
    facts = {
        "null_rounds": len(without),
        "false_alarms": false_alarms,
        "threshold_sd": threshold,
        "least_gain": least_gain,
    }
    (answers / BASELINES).write_text(json.dumps({"facts": facts, "answers": by_case}, indent=1) + "\n")


def residual_samples(folder: Path) -> Float[np.ndarray, "s 6"]:
    """Markers and frames in contact drawn at random: place on the patch twice (mm), share of the peak load,
    time (s), the plain model's residual and the response to 1/E along the pad's normal (mm).
    """
    model, recorded = opened(folder)
    linear = screened(model, recorded, ())
    rng = np.random.default_rng(0)
    samples = []
    for k, equations in enumerate(recorded):
        recording = equations.recording
        residual = linear.products.marker_residual(k, linear.null)
        response = equations.markers.residual(model.compliance * recording.tracks.unit_displacement)
        frames, markers = np.nonzero(recording.touching)
        chosen = np.sort(rng.choice(len(frames), min(PER_GRASP, len(frames)), replace=False))
        place = recording.tracks.place_mm
        for frame, marker in zip(frames[chosen], markers[chosen], strict=True):
            pad = int(recording.pad_of_marker[marker])
            normals = recording.links[pad].place.normal
            normal = mean_normal(normals)
            x, y = tangents(normals) @ (place[marker] - place[recording.pad_of_marker == pad].mean(axis=0))
            along = (residual[frame, marker] @ normal, response[frame, marker] @ normal)
            samples.append((x, y, recording.load[frame], recording.time_s[frame], *along))
    return np.array(samples, dtype=float).reshape(-1, 6)


def score(
    answers: Path,
    labels: Path,
    manifest: Path | None = None,
    csv: Path | None = None,
    figure: Path | None = None,
) -> int:
    """All tables of the answers against the labels; the exit status."""
    published = json.loads(labels.read_text(encoding="utf-8"))
    wrong = []
    if manifest is not None:
        wrong = broken_seals(
            json.loads(manifest.read_text(encoding="utf-8")),
            {case: sealed_text(entry) for case, entry in published.items()},
        )
    runs = runs_in(answers)
    codes = sorted({str(run["code"]) for run in runs if "code" in run})
    if len(codes) > 1:
        wrong.append(f"answers of several states of the code: {', '.join(codes)}")
    wrong += [f"{case}: no answer" for case in sorted(set(published) - {run["case"] for run in runs})]
    seals = f", all with the hashes of {manifest}" if manifest and not wrong else ""
    print("\n".join([*wrong, f"{len(published)} labels{seals}"]))
    relatives = relatives_in(RELATIVES_FILE)
    labelled = {case: scored_label(entry.get("label", entry), relatives) for case, entry in published.items()}
    rows = [row_of(run, answers) for run in runs if run["case"] in labelled]
    print("\n".join([*report(rows, labelled), *cost_lines(rows)]))
    if csv is not None:
        pd.DataFrame(case_table(rows, labelled)).to_csv(csv, index=False)
    if figure is not None:
        cases = [scored(row, labelled[row["case"]]) for row in rows if "failure" not in row]
        singles = [(case, amplitude_over_bound(case)) for case in cases if case.kind == "single"]
        known = [(case, amplitude) for case, amplitude in singles if amplitude is not None]
        seen = [[case.detected for case, _ in known], [case.named_first for case, _ in known]]
        words = "amplitude over its Cramér-Rao bound (noise alone)"
        figure.write_bytes(png_of(score_figure([amplitude for _, amplitude in known], seen, cases, words)))
    return int(bool(wrong))


def cost_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sizes of verdicts, the held-out residual with the named effect over the one without, and the cost."""
    answered = [row for row in rows if "failure" not in row]
    named = [row["heldout"] for row in answered if row["detected"] and row["heldout"]["before"]]
    ratios = [residuals["after"] / residuals["before"] for residuals in named]
    lines = [f"names of a verdict: mean {np.mean([len(row['verdict']) for row in answered]):.2f}"]
    if ratios:
        lines.append(f"held-out residual, with over without an effect: median {np.median(ratios):.2f}")
    for name, unit in (("cpu_s", "CPU s"), ("wall_s", "s"), ("peak_MiB", "MiB")):
        values = [row[name] for row in rows if name in row]
        if values:
            lines.append(f"a case takes {np.median(values):.0f} {unit} (median), {max(values):.0f} at most")
    return lines


def sealed_text(entry: Mapping[str, Any]) -> str:
    """What was hashed: the salt, then the label as JSON with sorted keys and no blanks."""
    return str(entry["salt"]) + json.dumps(entry["label"], sort_keys=True, separators=(",", ":"))


def relatives_in(path: Path) -> dict[str, tuple[str, ...]]:
    """Answers that count as relatives, by each name of physics outside the catalogue."""
    table = pd.read_csv(path, keep_default_na=False)
    return {
        name: tuple(relatives.split())
        for outside, relatives in zip(table["outside"], table["relatives"], strict=True)
        for name in outside.split()
    }


def scored_label(label: Mapping[str, Any], relatives: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """A published label as the tables take it."""
    effects = str(label["effect"]).split("+")
    inside = all(effect in SPECS for effect in effects)
    kind = "sound" if effects == [NONE] else "outside" if not inside else "pair" if effects[1:] else "single"
    parameters = label["parameters"]
    truth = dict(label) | {
        "effect": "+".join(sorted(effects)),
        "amplitudes": amplitudes_of(effects, parameters) if inside else {},
        "parameters": dict(parameters) | ({"physics": label["effect"]} if kind == "outside" else {}),
    }
    known = relatives.get(str(label["effect"]), RELATIVES.get(str(label["effect"]), ()))
    return {"kind": kind, "attempts": [truth], "relatives": known}


def row_of(run: Mapping[str, Any], answers: Path) -> dict[str, Any]:
    """One case's answer as the tables take it. A drift's bound is in N/s, as its label."""
    row = dict(run) | {"attempt": 0, "peaks_N": [1.0]}
    path = answers / f"{run['case']}.json"
    if not path.is_file():
        return row | {"failure": run.get("said", "no answer")}
    said = json.loads(path.read_text(encoding="utf-8"))
    others = answers / BASELINES
    known = json.loads(others.read_text(encoding="utf-8"))["answers"] if others.is_file() else {}
    verdict = [said["verdict"]] if isinstance(said["verdict"], str) else said["verdict"]
    return row | {
        "detected": said["detected"],
        "verdict": ["+".join(sorted(name.split("+"))) for name in verdict],
        "p": said["p_value"],
        "ranking": [
            {
                "effect": "+".join(sorted(hypothesis["effect"].split("+"))),
                "probability": hypothesis["probability"],
                "refitted": hypothesis["refitted"],
                "parameters": {
                    name: parameter | {"interval": parameter.get("interval_90")}
                    for name, parameter in hypothesis["parameters"].items()
                },
            }
            for hypothesis in said["ranking"]
        ],
        "E_before": with_interval(said["E_MPa"]["before"]),
        "E_after": with_interval(said["E_MPa"]["after"]),
        "heldout": {"before": said["fit"]["heldout_rms_before"], "after": said["fit"]["heldout_rms_after"]},
        "baselines": known.get(run["case"], {}),
    }


def with_interval(modulus: Mapping[str, float]) -> dict[str, Any]:
    """A modulus with its 90 % interval."""
    spread = NINETY * modulus["sd"]
    return {**modulus, "interval": [modulus["value"] - spread, modulus["value"] + spread]}


if __name__ == "__main__":
    run(answer, explain, baselines, score)
