"""What drupe makes of traces that others recorded: names, moduli, and how well either predicts what it did
not see.

    python benchmarks/public_traces.py ball FOLDER [--jobs 2] [--out CSV]
    python benchmarks/public_traces.py gripper FOLDER [...]
    python benchmarks/public_traces.py cylinder FOLDER [...]

ball: the workbooks of github.com/SarahIaquinta/perineal_indentation
(indentation/experiments/zwick/raw_data), a sheet for each press of a ball of 5 mm on meat and silicone;
or such sheets as tables DAY__KIND__NAME.csv of time, force, travel and gap.
gripper: the tables of github.com/SheepLiu712/FruitRuptureEstimate (kiwi, mango, banana), jaws on
whole fruit to rupture; the fruit's size is not said, and the trace is taken as a ball's of 30 mm, so that E
is no flesh's modulus but orders the fruit. cylinder: the sheets of github.com/LivingMatterLab/CANN
(ARTMEAT/FungiSteak/mechanical-data/compression, ARTMEAT/LionsManeMushroomSteak/Mechanics/Compression),
cut cylinders of 8 mm between plates. Prints a line for
each trace and quantiles; held-out errors are root mean squares over that of the force left out, before
(linear elasticity) and after (the answer).
"""

import re
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from scipy.stats import spearmanr
from script import run

from fem.fem_failure import FemFailure
from fem.indentation.ball import Ball
from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.contact_curve import Geometry
from fem.indentation.explain_trace import explain_trace
from fem.indentation.trace import IndenterTrace
from tactile.trace_thinning import thin

NU = 0.49
"""Of flesh and silicone. Assumed."""
BALL_MM, FRUIT_MM, CYLINDER_MM = 5.0, 30.0, 8.0
"""Radius of the ball, radius that fruit are taken to have, diameter of the cylinders."""
THINNEST_OVER_TRAVEL = 1.2
"""A gap this much thinner than the travel allows was not zeroed: it is no thickness."""
GRIPPER_COLUMNS = {"time": "Time", "now_force": "Force", "now_pos": "Pos"}
"""Names in the mangoes' tables, and in the others'."""
RHEOMETER_COLUMNS = ("time", "axial", "gap")
"""Words in the names of the columns of a rheometer's tables: time, force, gap."""
SLOPE_UP_TO = 0.1
"""Greatest strain of the slope that is compared with what is published for cut cylinders."""


@dataclass(frozen=True)
class NamedTrace:
    """A trace by its name, with the thickness where it is known."""

    name: str
    trace: IndenterTrace
    thickness_mm: float | None = None


def of_ball(folder: Path) -> Iterator[NamedTrace]:
    """Sheets whose first column is a time of test, second a force, third a travel, fourth the tools' gap."""
    for name, (time_s, force_N, travel_mm, gap_mm) in ball_columns(folder):
        known = float(gap_mm[0]) if gap_mm[0] > THINNEST_OVER_TRAVEL * np.ptp(travel_mm) else None
        kept = np.r_[True, np.diff(time_s) > 0]
        trace = trace_of(time_s[kept], force_N[kept], travel_mm[kept], Ball(radius_mm=BALL_MM))
        yield NamedTrace(name, trace, known)


def ball_columns(folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Name and columns of each sheet, and of each table."""
    for path in sorted([*folder.rglob("*ndentation*.xlsx"), *folder.rglob("*ndentation*.xls")]):
        for sheet, table in pd.read_excel(path, sheet_name=None, header=None, engine="calamine").items():
            if table.shape[1] < 4 or len(table) < 30 or not str(table.iloc[1, 0]).startswith("Temps"):
                continue
            values = table.iloc[3:, :4].apply(pd.to_numeric, errors="coerce").dropna().to_numpy(dtype=float)
            yield f"{path.name[:6]} {'hold' if 'maintien' in path.name else 'relax'} {sheet}", values.T
    for path in sorted(folder.glob("*__*.csv")):
        yield path.stem.replace("__", " "), np.loadtxt(path, delimiter=",", skiprows=1).T


def of_gripper(folder: Path) -> Iterator[NamedTrace]:
    """Tables with a time, a force and the jaws' distance in mm or a position that grows as they close."""
    for path in sorted(folder.rglob("*.csv")):
        table = pd.read_csv(path).rename(columns=GRIPPER_COLUMNS)
        if not {"Time", "Force", "Pos"} <= set(table.columns):
            continue
        force_N, place = table["Force"].to_numpy(float), table["Pos"].to_numpy(float)
        time_s = table["Time"].to_numpy(float)
        time_s = time_s - time_s[0]
        kept = np.r_[True, np.diff(time_s) > 0]
        peak = int(np.argmax(force_N))
        closing = np.sign(place[peak] - place[0]) or 1.0
        travel = closing * (place - place[0])
        name = "_".join(path.relative_to(folder).parts)
        yield NamedTrace(name, trace_of(time_s[kept], force_N[kept], travel[kept], Ball(radius_mm=FRUIT_MM)))


def of_cylinder(folder: Path) -> Iterator[NamedTrace]:
    """Workbooks of a rheometer: a sheet for each step of one test, with a time, a normal force and a gap in
    the units of its third row.
    """
    for path in sorted(folder.rglob("*.xls*")):
        steps: list[np.ndarray] = []
        for table in pd.read_excel(path, sheet_name=None, header=None, engine="calamine").values():
            names = [str(cell).lower() for cell in table.iloc[1]] if len(table) > 30 else []
            at = [next((k for k, n in enumerate(names) if key in n), None) for key in RHEOMETER_COLUMNS]
            if None in at:
                continue
            step = table.iloc[3:, at].apply(pd.to_numeric, errors="coerce").dropna().to_numpy(dtype=float)
            before_s = steps[-1][-1, 0] if steps else 0.0
            step = step + np.array([before_s, 0.0, 0.0])
            steps.append(step)
        if not steps:
            continue
        time_s, force_N, gap = np.concatenate(steps).T
        gap_mm = gap / (1000.0 if np.median(gap) > 100 else 1.0)
        kept = np.r_[True, time_s[1:] > np.maximum.accumulate(time_s)[:-1]]
        size = Cylinder(height_mm=float(gap_mm[0]), diameter_mm=CYLINDER_MM, ends="bonded")
        trace = trace_of(time_s[kept], force_N[kept], gap_mm[0] - gap_mm[kept], size)
        yield NamedTrace(f"{path.parent.name} {path.stem}", trace)


def slope_kPa(trace: IndenterTrace) -> float:
    """Stress over strain of a cylinder's first loading up to 10 %, by a line through its first frame, as the
    authors of these recordings take it.
    """
    size = trace.geometry
    if not isinstance(size, Cylinder):
        return float("nan")
    strain = (trace.travel_mm - trace.travel_mm[0]) / size.height_mm
    first = np.arange(len(strain)) <= int(np.argmax(strain > SLOPE_UP_TO))
    stress_kPa = 1e3 * (trace.force_N - trace.force_N[0]) / (np.pi / 4 * size.diameter_mm**2)
    return float(strain[first] @ stress_kPa[first] / (strain[first] @ strain[first]))


def trace_of(
    time_s: np.ndarray, force_N: np.ndarray, travel_mm: np.ndarray, geometry: Geometry
) -> IndenterTrace:
    """Thinned as the product's reader does."""
    thinned = thin(time_s, travel_mm, force_N)
    kept = np.arange(len(time_s)) if thinned is None else thinned.kept
    return IndenterTrace(
        time_s=time_s[kept], force_N=force_N[kept], travel_mm=travel_mm[kept], geometry=geometry
    )


def explained(named_trace: NamedTrace) -> dict[str, object]:
    """One line of the table."""
    try:
        account = explain_trace(
            named_trace.trace,
            thickness_mm=named_trace.thickness_mm,
            poisson_ratio=NU,
            rng=np.random.default_rng(0),
        )
    except FemFailure as failure:
        return {"trace": named_trace.name, "verdict": f"refused: {failure.problem.value}"}
    said = account.explanation
    verdict = said.verdict if isinstance(said.verdict, str) else " | ".join(said.verdict)
    return {
        "trace": named_trace.name,
        "verdict": verdict,
        "top": said.ranking[0].effect,
        "E_before_kPa": 1e3 * said.before.value,
        "E_after_kPa": 1e3 * said.after.value,
        "withheld": said.withheld or "",
        "E_linear_kPa": 1e3 * float(np.exp(account.linear.scaled[0])),
        "slope_kPa": slope_kPa(named_trace.trace),
        "unexplained": account.named.share,
        "end_before": said.heldout.rms_before,
        "end_after": said.heldout.rms_after,
        "peak_N": float(named_trace.trace.force_N.max()),
        "ruptured": any("break" in note or "rupture" in note.lower() for note in said.notes),
    }


def summary(rows: pd.DataFrame) -> None:
    """Names, held-out errors; for whole fruit the order against the force of rupture."""
    done = rows.dropna(subset=["end_after"])
    named = done[~done["verdict"].isin(["none", "unknown"])]
    print(f"{len(rows)} traces, {len(done)} explained; verdicts:")
    print(rows["verdict"].value_counts().to_string())
    print("quartiles and greatest:")
    print(done[["end_before", "end_after", "unexplained"]].quantile([0.25, 0.5, 0.75, 1.0]).to_string())
    over = (named["end_after"] > 0.3).sum()
    print(f"named {len(named)}, of them with a held-out error above 30 %: {over}")
    print(f"E withheld in {(done['withheld'] != '').sum()}")
    for kind, of_kind in done.groupby(done["trace"].map(kind_of)):
        if len(of_kind) > 5:
            print(kind, of_kind[["slope_kPa", "E_linear_kPa"]].agg(["mean", "std"]).to_dict())
            rank = spearmanr(of_kind["E_linear_kPa"], of_kind["peak_N"]).statistic
            print(f"{kind}: {len(of_kind)}, Spearman of E (linear) with the peak force {rank:.2f}")


def kind_of(name: str) -> str:
    """Common to traces whose names differ in their numbers alone, or begin with the same word of a gripper's
    fruit.
    """
    return re.sub(r"[-_]?\d+$", "", name) if " " in name else name.split("_")[0]


def main(
    kind: Literal["ball", "gripper", "cylinder"], folder: Path, jobs: int = 1, out: Path | None = None
) -> None:
    """Read, explain, print."""
    read = {"ball": of_ball, "gripper": of_gripper, "cylinder": of_cylinder}[kind]
    done = []
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(explained, read(folder)):
            done.append(row)
            print(row["trace"], row["verdict"], row.get("top", ""), flush=True)
    rows = pd.DataFrame(done)
    summary(rows)
    if out is not None:
        rows.to_csv(out, index=False)


if __name__ == "__main__":
    run(main)
