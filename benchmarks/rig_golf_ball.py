"""A gripper's own give from squeezes of a golf ball, and soft balls between the same jaws before and after.

    git clone https://github.com/GelSight-lab/EstimateModulus
    python benchmarks/rig_golf_ball.py EstimateModulus/example_data
    python benchmarks/rig_golf_ball.py --slopes FOLDER      # traces: CSV with a force and a position or
    travel

Of each day: the golf ball's squeezes and the rig from them; then E of every ball, taken as Hertz's contact
of a sphere with a flat on either side (half of the gap's change, half of the rig's give), without and with
the rig. The moduli of these balls are not in the repository; their names say the order. Widths are readings
of up to 0.3 s ago, which is what most of the rig's spread comes from. --slopes prints the contact's N/mm at
the upper half of the force, and how many traces are said to need a stiff rig.
"""

import argparse
import csv
import pickle
import re
from collections import defaultdict
from pathlib import Path

import numpy as np

from fem.fem_failure import FemFailure
from fem.indentation.account import account_for
from fem.indentation.ball import Ball
from fem.indentation.rank import modulus_of
from fem.indentation.rig_share import rig_share
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import Explanation
from tactile.rig.rig_curve import RigCurve
from tactile.rig.rig_fit import fit_rig
from tactile.rig.rigid_squeeze import RigidPress, rigid_squeezes
from tactile.tactile_failure import TactileFailure

FRAMES_PER_S = 30.0
"""Of the videos that the widths go with."""
BALL_MM = 42.67
"""A golf ball's diameter (R&A and USGA, Equipment Rules: at least 42.67 mm); the soft balls are about as
large."""
NU = 0.48
"""Of silicone and rubber. Assumed."""
RIGID = "golf_ball"
BALLS = ("golf_ball", "rigid_strawberry", "purple_ball_hardest", "green_ball_softer", "orange_ball_softest")


class _Arrays(pickle.Unpickler):
    """Reads numbers and arrays of them, and nothing else."""

    def find_class(self, module: str, name: str) -> object:
        """Only what makes an array."""
        if module.split(".")[0] == "numpy" and name in ("_reconstruct", "ndarray", "dtype", "scalar"):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name}")


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Force (N) and what the gap has closed by (mm)."""
    with path.open("rb") as file:
        force = np.asarray(_Arrays(file).load(), dtype=float)
    with path.with_name(path.name.replace("_forces", "_widths")).open("rb") as file:
        width = 1e3 * np.asarray(_Arrays(file).load(), dtype=float)
    return force, width[0] - width


def squeezes(folder: Path) -> list[RigidPress]:
    """Those of the golf ball, each printed."""
    found = []
    for path in sorted(folder.glob(f"{RIGID}*_forces.pkl")):
        force, travel = read(path)
        time = np.arange(len(force)) / FRAMES_PER_S
        name = path.name.removesuffix("_forces.pkl")
        try:
            own = rigid_squeezes(time, force, travel, part_mm=None, size_mm=BALL_MM, source=name)
        except TactileFailure as failure:
            print(f"{name:28} {failure}")
            continue
        for one in own:
            print(
                f"{name:28} {len(one.force_N):3d} readings to {one.largest_N:5.1f} N, "
                f"{np.ptp(one.travel_mm):5.2f} mm, lost {1 - one.held:4.0%}"
            )
        found += own
    return found


def trace(path: Path, rig: RigCurve | None) -> IndenterTrace:
    """One side of the ball, from 0.5 s before the touch to the peak: the way back is not read in time."""
    force, travel = read(path)
    force, peak = force - np.median(force[:5]), int(np.argmax(force))
    touch = int(np.argmax(force > 0.02 * force[peak]))
    part = slice(max(touch - 15, 0), max(peak + 1, touch + 20))
    force, travel = force[part], travel[part]
    give = sd = None
    if rig is not None:
        give, sd = rig.give(force) / 2, rig.sd(force) / 2
    side = travel / 2 if give is None else travel / 2 - give
    time = np.arange(len(force)) / FRAMES_PER_S
    return IndenterTrace(
        time_s=time,
        force_N=force,
        travel_mm=side - side[0],
        geometry=Ball(radius_mm=BALL_MM) / 2,
        rig_give_mm=give,
        rig_sd_mm=sd,
    )


def in_short(found: Explanation) -> str:
    """E, or why there is none."""
    if found.withheld is not None:
        least = re.search(r"at least ([\d.e-]+) MPa", found.withheld)
        return f">= {least[1]}" if least else "withheld"
    return f"{found.after.value:.3g} ± {found.after.sd:.2g}"


def day(folder: Path) -> None:
    """The rig of one day, and every ball of it without and with the rig."""
    print(f"\n{folder.name}")
    own = squeezes(folder)
    rig = fit_rig(own)
    print(
        f"rig: {rig.curve.give_mm[-1]:.2f} ± {rig.curve.sd_mm[-1]:.2f} mm at {rig.curve.largest_N:.1f} N; "
        f"from squeeze to squeeze {rig.repeat_mm:.2f}, ways in and out {rig.hysteresis_mm:.2f}, readings "
        f"off one curve {rig.readings_mm:.2f} mm"
    )
    at = np.linspace(0, rig.curve.largest_N, 6)[1:]
    knots = zip(at, rig.curve.give(at), rig.curve.sd(at), strict=True)
    print("  ".join(f"{f:.0f} N {g:.1f} ± {sd:.1f}" for f, g, sd in knots))
    print(f"{'object':28} {'E without, MPa':>34} {'E with rig, MPa':>34}  rig's share of the slope")
    for name in BALLS:
        for path in sorted(folder.glob(f"{name}*_forces.pkl")):
            without, _ = explained(path, None)
            less, share = explained(path, rig.curve)
            print(f"{path.name.removesuffix('_forces.pkl'):28} {without:>34} {less:>34}  {share}", flush=True)


def explained(path: Path, rig: RigCurve | None) -> tuple[str, str]:
    """E in short, and the rig's share of the slope over the upper half of the force."""
    try:
        one = trace(path, rig)
        rng = np.random.default_rng(0)
        account = account_for(one, thickness_mm=None, poisson_ratio=NU, rng=rng)
    except FemFailure as failure:
        return failure.problem.value, ""
    slopes_of = rig_share(one, rig_N_per_mm=None)
    whole = slopes_of.recorded_mm_per_N
    linear = modulus_of(account.linear)
    said = f"{in_short(account.explanation)} (linear {linear.value:.3g})"
    return said, f"{slopes_of.rig_mm_per_N / whole:.2f}" if whole else "no slope"


def slopes(folder: Path) -> None:
    """Contact slopes of all traces in a folder, by the first word of their names."""
    found = defaultdict(list)
    for path in sorted(folder.rglob("*.csv")):
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        names = list(rows[0]) if rows else []
        force = next((n for n in names if "force" in n.lower() and "goal" not in n.lower()), None)
        travel = next((n for n in names if re.search("pos|travel|indentation", n, re.IGNORECASE)), None)
        if force is None or travel is None:
            continue
        try:
            values = np.array([[float(row[force]), float(row[travel])] for row in rows])
            way = np.sign(values[np.argmax(values[:, 0]), 1] - values[0, 1])
            one = IndenterTrace(
                time_s=np.arange(len(values)) / 100,
                force_N=values[:, 0],
                travel_mm=way * (values[:, 1] - values[0, 1]),
                geometry=Ball(radius_mm=5.0),
            )
        except (ValueError, TypeError, FemFailure):
            continue
        said = rig_share(one, rig_N_per_mm=None)
        found[re.split("[_0-9]+", path.name.lstrip("0123456789_"))[0]].append(
            (1 / said.recorded_mm_per_N if said.recorded_mm_per_N > 0 else np.nan, bool(said.notes))
        )
    for name, ones in found.items():
        slope, notes = np.array(ones).T
        low, middle, high = np.nanquantile(slope, [0.1, 0.5, 0.9])
        print(
            f"{name:12} {len(ones):3d} traces: {low:.2f} {middle:.2f} {high:.2f} N/mm (10, 50, 90 %), "
            f"said of {notes.sum():.0f}"
        )


def main() -> None:
    """Every day in the folder, or --slopes."""
    wanted = argparse.ArgumentParser(description="Rig and soft balls between a gripper's gels.")
    wanted.add_argument("folder", type=Path)
    wanted.add_argument("--slopes", action="store_true")
    given = wanted.parse_args()
    if given.slopes:
        slopes(given.folder)
        return
    for one in sorted(path for path in given.folder.iterdir() if path.is_dir()):
        if any(one.glob(f"{RIGID}*_forces.pkl")):
            day(one)


if __name__ == "__main__":
    main()
