"""Print how often error bars of modulus and pit hold the truth, and what each cause does against its part.

    python benchmarks/calibration.py [--fruit 10] [--draws 200] [--split 2] [--pit-offset-sd 0.5]
        [--pit-size-sd 0.03] [--seed 1] [--csv FILE] [--only-print]

Per draw a fruit of its own modulus (0.1 to 3 MPa), with pit, skin, pads' places and sensors off by the
budget's spreads, is solved on one mesh and estimated on another (tests/fem/drawn_grasps.py), from either of
two grasps alone (the pit at its prior) and from both. First table: share of 90 % intervals that hold the
truth with its binomial standard error; `z` is the root mean square of error over stated sd, one where error
bars are right; `mean z` their mean; `rms error` (relative for E); `prior` the prior's own on the same draws.
Second table, each cause alone, against the same grasp with nothing off: `found` is the root mean square of
ln E's change, `stated` that of the error bar's part. --split: draws of each cause per fruit.
Rows are written as they come; --only-print prints the tables of a file.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from sys import path

import numpy as np
import pandas as pd
from script import run

from fem.estimation.error_budget import PIT_PLACE, REGISTRATION, TACTILE, ErrorBudget
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.sensitivity import PIT, PIT_SIZE, POISSON_RATIO

path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from drawn_grasps import Fruit, Off, Sensor, World
from drawn_inference import Estimator, drawn_modulus_MPa, drawn_off

TRUTH_SIZES = {"edge_mm": 6.0, "refine_edge_mm": 2.0}
ESTIMATOR_SIZES = {"edge_mm": 6.0, "refine_edge_mm": 3.0}
RESULTS = Path(__file__).parent / "results" / "calibration.csv"
LEVEL, NINETY = 0.9, 1.6449
SILENT = Sensor(displacement_mm=0.0, force_N=0.0, gel_scale=0.0, force_scale=0.0)
ALONE, TOGETHER = "E, one grasp", "E, both grasps"
KNOWN = ErrorBudget(
    gel_scale_sd=ErrorBudget.gel_scale_sd,
    force_scale_sd=1e-6,
    pit_offset_sd_mm=0.0,
    pit_size_sd=0.0,
    surface_sd_mm=0.0,
    pose_sd_mm=0.0,
)


COLUMNS = ["cause", "fruit", "draw", "grasp", "quantity", "truth", "found", "sd", "prior_sd"]
"""Of a row, one error: of a quantity in a draw with everything off, or of ln E with one cause off."""
Row = tuple[str, int, int, int, str, float, float, float, float]


@dataclass(frozen=True)
class Cause:
    """One thing that is off; the budget that knows of nothing else, and the part that it makes."""

    budget: ErrorBudget
    part: str
    noisy: bool = False


def causes(budget: ErrorBudget) -> dict[str, Cause]:
    """Every cause of an error bar that can be drawn, by name."""
    return {
        "sensor noise": Cause(replace(KNOWN, force_scale_sd=budget.force_scale_sd), TACTILE, noisy=True),
        "pit offset": Cause(replace(KNOWN, pit_offset_sd_mm=budget.pit_offset_sd_mm), PIT_PLACE),
        "pit size": Cause(replace(KNOWN, pit_size_sd=budget.pit_size_sd), PIT_SIZE),
        "surface": Cause(replace(KNOWN, surface_sd_mm=budget.surface_sd_mm), REGISTRATION),
        "pose": Cause(replace(KNOWN, pose_sd_mm=budget.pose_sd_mm), REGISTRATION),
        "Poisson's ratio": Cause(replace(KNOWN, poisson_ratio_sd=0.02), POISSON_RATIO),
    }


def directions(rng: np.random.Generator) -> np.ndarray:
    """Of two grasps about 90 degrees apart, near the fruit's waist."""
    azimuth = rng.uniform(0, 2 * np.pi) + np.array([0, np.pi / 2]) + rng.normal(0, 0.1, 2)
    return np.column_stack([np.cos(azimuth), np.sin(azimuth), rng.normal(0, 0.2, 2)])


def of_fruit(fruit: int, budget: ErrorBudget, *, draws: int, split_draws: int, seed: int) -> Iterator[Row]:
    """All rows of one fruit."""
    rng = np.random.default_rng([seed, fruit])
    world = World.of(Fruit.drawn(rng), directions(rng), **TRUTH_SIZES)
    estimator = Estimator.of(world, **ESTIMATOR_SIZES)
    yield from causes_alone(fruit, split_draws, estimator, rng, budget)
    prior_sd = np.append(np.full(3, budget.pit_offset_sd_mm), budget.pit_size_sd)
    for draw in range(draws):
        E_MPa, off = drawn_modulus_MPa(rng), drawn_off(rng, budget)
        inference = estimator.both(world.solved(off), E_MPa=E_MPa, rng=rng, budget=budget)
        for k, estimate in enumerate(inference.grasps):
            yield "all", fruit, draw, k, ALONE, E_MPa, estimate.E_MPa, estimate.E_sd_MPa, 0.0
        whole = inference.modulus
        yield "all", fruit, draw, -1, TOGETHER, E_MPa, whole.E_MPa, whole.E_sd_MPa, 0.0
        place = np.append(whole.pit.offset_mm, whole.pit.ln_size)
        for name, *values in zip(PIT, off.pit, place, whole.pit.sd, prior_sd, strict=True):
            yield "all", fruit, draw, -1, name, *map(float, values)


def causes_alone(
    fruit: int, draws: int, estimator: Estimator, rng: np.random.Generator, budget: ErrorBudget
) -> Iterator[Row]:
    """ln E of each grasp with one cause off, against that with none."""
    for draw in range(draws):
        E_MPa = drawn_modulus_MPa(rng)
        options = {"E_MPa": E_MPa, "budget": budget}
        base = estimator.world.solved(Off())
        right = estimator.alone(base, rng=rng, sensor=SILENT, **options)
        for name, cause in causes(budget).items():
            truths = base if cause.noisy else estimator.world.solved(drawn_off(rng, cause.budget))
            sensor = Sensor() if cause.noisy else SILENT
            for k, estimate in enumerate(estimator.alone(truths, rng=rng, sensor=sensor, **options)):
                known = joint_modulus([estimate.evidence], budget=cause.budget, infer_pit=False)
                part = known.parts_sd_MPa[cause.part] / known.E_MPa
                change = float(np.log(estimate.E_MPa / right[k].E_MPa))
                yield name, fruit, draw, k, "ln E", 0.0, change, part, 0.0


def print_tables(rows: pd.DataFrame) -> None:
    """Both."""
    print(
        f"{'quantity':18s}{'draws':>6s}{'90 % hold':>13s}{'z':>7s}{'mean z':>8s}"
        f"{'rms error':>11s}{'prior':>9s}"
    )
    for quantity, group in rows[rows["cause"] == "all"].groupby("quantity", sort=False):
        error, known = group["found"] - group["truth"], group["prior_sd"].any()
        z, held = error / group["sd"], np.mean(error.abs() < NINETY * group["sd"])
        spread = np.sqrt(LEVEL * (1 - LEVEL) / len(z))
        of_prior = f"{_rms(group['truth']):9.4f}" if known else f"{'':9s}"
        relative = error if known else error / group["truth"]
        print(
            f"{quantity:18s}{len(z):6d}{100 * held:7.1f} ± {100 * spread:3.1f}{_rms(z):7.2f}{z.mean():8.2f}"
            f"{_rms(relative):11.4f}{of_prior}"
        )
    print(
        f"\n{'cause alone':18s}{'draws':>6s}{'found, %':>10s}{'stated, %':>11s}{'ratio':>7s}{'mean, %':>9s}"
    )
    for name, group in rows[rows["cause"] != "all"].groupby("cause", sort=False):
        change, part = _rms(group["found"]), _rms(group["sd"])
        print(
            f"{name:18s}{len(group):6d}{100 * change:10.3f}{100 * part:11.3f}"
            f"{change / part:7.2f}{100 * group['found'].mean():9.3f}"
        )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(
    fruit: int = 10,
    draws: int = 200,
    split: int = 2,
    pit_offset_sd: float = ErrorBudget.pit_offset_sd_mm,
    pit_size_sd: float = ErrorBudget.pit_size_sd,
    seed: int = 1,
    csv: Path = RESULTS,
    only_print: bool = False,
) -> None:
    """Draw, write, print."""
    if not only_print:
        budget = ErrorBudget(pit_offset_sd_mm=pit_offset_sd, pit_size_sd=pit_size_sd)
        for k, count in enumerate(np.diff(np.linspace(0, draws, fruit + 1).astype(int))):
            rows = of_fruit(k, budget, draws=int(count), split_draws=split, seed=seed)
            table = pd.DataFrame(rows, columns=COLUMNS)
            table.to_csv(csv, mode="a" if k else "w", header=not k, index=False)
            print(f"fruit {k + 1}: {time.process_time():.0f} CPU s", flush=True)
    print_tables(pd.read_csv(csv))


if __name__ == "__main__":
    run(main)
