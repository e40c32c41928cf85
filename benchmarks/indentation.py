"""Explain measured indentation traces: a table, medians, a CSV file and plots.

    python benchmarks/indentation.py FOLDER [--out DIR] [--radius MM] [--poisson NU] [--match TEXT]

FOLDER holds one CSV file per trace: time_s, force_N, indentation_mm, tool_gap_mm; the gap in the first frame
is the specimen's thickness. No truth is known but that flesh and silicone relax in a hold. Held-out errors
are root mean squares over that of the force left out: `end` predicts the second half of the hold (or all of
unloading and recovery) from what came before, `blocks` every second tenth of the trace from the others. The
law is named on the whole trace; its parameters know nothing of the frames left out.
"""

import argparse
import csv
import time
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from fem.fem_failure import FemFailure
from fem.indentation.account import Account, account_for
from fem.indentation.ball import Ball
from fem.indentation.trace import IndenterTrace

#: a gap this much thinner than the travel allows was not zeroed: it is no thickness
THINNEST_OVER_TRAVEL = 1.2


def read_trace(path: Path, radius_mm: float) -> tuple[IndenterTrace, float | None]:
    """The trace and the thickness that its first gap states, None where that cannot be."""
    time_s, force_N, travel_mm, gap_mm = np.loadtxt(path, delimiter=",", skiprows=1).T
    trace = IndenterTrace(
        time_s=time_s, force_N=force_N, travel_mm=travel_mm, geometry=Ball(radius_mm=radius_mm)
    )
    thick = float(gap_mm[0])
    return trace, thick if thick > THINNEST_OVER_TRAVEL * np.ptp(travel_mm) else None


def row_of(name: str, trace: IndenterTrace, account: Account, seconds: float) -> dict[str, object]:
    """One line of the table."""
    said, top = account.explanation, account.explanation.ranking[0]
    relaxing = max(
        (c for c in said.ranking if "viscoelastic" in c.effect), key=lambda c: c.probability, default=top
    )
    g = [p.value for n, p in relaxing.parameters.items() if n.startswith("g")]
    tau = [p.value for n, p in relaxing.parameters.items() if n.startswith("tau")]
    relaxes = sum(c.probability for c in said.ranking if "viscoelastic" in c.effect)
    onset = top.parameters["onset_mm"]
    trace = account.trace
    end, blocks = account.end.rms(trace.force_N), account.blocks.rms(trace.force_N)
    verdict = said.verdict if isinstance(said.verdict, str) else " | ".join(said.verdict)
    return {
        "trace": name,
        "verdict": verdict,
        "p_relaxes": relaxes,
        "p_top": top.probability,
        "g": " ".join(f"{x:.2f}" for x in g),
        "tau_s": " ".join(f"{x:.3g}" for x in tau),
        "E_kPa": 1e3 * top.modulus.value if top.modulus else float("nan"),
        "onset_mm": onset.value,
        "onset_sd": onset.sd,
        "unexplained": account.named.share,
        "end_before": end[0],
        "end_after": end[1],
        "end_ratio": end[0] / end[1],
        "blocks_before": blocks[0],
        "blocks_after": blocks[1],
        "blocks_ratio": blocks[0] / blocks[1],
        "noise": said.heldout.noise_rms if said.heldout else float("nan"),
        "cpu_s": seconds,
    }


def plot(path: Path, name: str, trace: IndenterTrace, account: Account) -> None:
    """Force over time and over travel; measured, both laws, and what the end was predicted to be."""
    trace = account.trace
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    for axes, x in ((left, trace.time_s), (right, trace.travel_mm)):
        axes.plot(x, trace.force_N, ".", ms=3, color="0.6", label="measured")
        axes.plot(x, account.linear.force_N, "--", lw=1, color="tab:blue", label="linear elastic, fitted")
        axes.plot(x, account.named.force_N, lw=1, color="tab:red", label="named law, fitted")
        axes.plot(x, account.end.before_N, lw=2, color="tab:cyan", label="linear elastic, predicted")
        axes.plot(x, account.end.after_N, lw=2, color="tab:orange", label="named law, predicted")
    left.set(xlabel="time, s", ylabel="force, N", title=f"{name}: {account.named.law.name}")
    right.set(xlabel="travel, mm")
    left.legend(fontsize=7, frameon=False)
    figure.savefig(path)
    plt.close(figure)


def main() -> None:
    """Read, explain, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--radius", type=float, default=5.0, help="of the ball, mm")
    parser.add_argument("--poisson", type=float, default=0.49)
    parser.add_argument("--match", default="")
    chosen = parser.parse_args()
    mpl.use("svg")
    if chosen.out:
        chosen.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for path in sorted(chosen.folder.glob("*.csv")):
        if chosen.match not in path.name:
            continue
        start = time.process_time()
        try:
            trace, thickness = read_trace(path, chosen.radius)
            account = account_for(
                trace,
                thickness_mm=thickness,
                poisson_ratio=chosen.poisson,
                rng=np.random.default_rng(0),
            )
        except FemFailure as failure:
            print(f"{path.stem}: {failure.detail}")
            continue
        row = row_of(path.stem, trace, account, time.process_time() - start)
        rows.append(row)
        cells = (f"{v:.3g}" if isinstance(v, float) else str(v) for v in list(row.values())[1:])
        print(f"{path.stem:34s}", "  ".join(cells), flush=True)
        if chosen.out:
            plot(chosen.out / f"{path.stem}.svg", path.stem, trace, account)
    print("\n" + "  ".join(list(rows[0])[1:]))
    for kind in sorted({r["trace"].split("__")[1] for r in rows if "__" in str(r["trace"])} | {""}):  # type: ignore[attr-defined]
        some = [r for r in rows if kind in str(r["trace"])]
        middle = {
            k: float(np.median([r[k] for r in some]))  # type: ignore[arg-type]
            for k in ("p_relaxes", "end_before", "end_after", "end_ratio", "blocks_ratio", "noise", "cpu_s")
        }
        middles = "  ".join(f"{k} {v:.3g}" for k, v in middle.items())
        relaxes = sum(float(str(r["p_relaxes"])) > 0.5 for r in some)
        print(f"median of {len(some)} {kind or 'all'}: {middles}; relaxation in {relaxes}")
    if chosen.out:
        with (chosen.out / "traces.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
