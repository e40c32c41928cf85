"""Errors of the tests that `drupe firmness` simulates: finer elements, large deformation, true fruit.

    python benchmarks/firmness_readings.py [--results OUT]

Balls of 60 mm between plates: force over that of axisymmetric elements (tests/fem/compressed_solid.py), which
share nothing with fem/, at small strain and for neo-Hookean flesh, for several meshes. With --results, the
results of `drupe grade` on the sample nectarines: readings by drupe's shape and pit against those of the true
ones. Both have the true E, so that the difference is the method's; so is its standard deviation.
"""

import json
import sys
from pathlib import Path

import numpy as np
from script import run

from fem.firmness import simulated_presses as presses
from fem.firmness.trade_tests import reading, trade_tests
from pipeline.batch.layout import Results
from pipeline.batch.records import read_record
from pipeline.run.trade_numbers import fruit_presses
from samples.fruit import fruits_of_seed, skin_mesh

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from compressed_solid import linear, neo_hookean, spheroid
from fem_shapes import ball

ANSWERS = Path(__file__).parents[1] / "samples" / "data" / "nectarines" / "answers.json"
SHARES = (0.0025, 0.005, 0.01, 0.02, 0.05)
SURE = {"poisson_ratio_sd": 0.0, "pit_size_sd": 0.0}


def balls(nu=0.45, radius=30.0):
    """Rows: pit, degrees of freedom, and force over both truths at each share of the diameter."""
    for share in (0.0, 0.4, 0.6):
        truths = []
        for law in (linear, neo_hookean):
            solid = spheroid(nu=nu, pit_share=share, round_=34, out=10, law=law)
            truths.append(radius**2 * np.array([solid.force_at(1 - x) for x in SHARES]))
        fruit = ball(4000, semi_axes_mm=np.full(3, radius))
        pit = ball(1200, semi_axes_mm=np.full(3, share * radius)) if share else None
        for limit in (20_000, 30_000, 45_000, 60_000):
            presses.DOF_LIMIT = limit
            plates = presses.simulated_presses(fruit, pit, poisson_ratio=nu, **SURE)[0].plates
            force_N_per_MPa = np.array([plates.force_N_per_MPa(2 * radius * x) for x in SHARES])
            small, large = (100 * (force_N_per_MPa / truth - 1) for truth in truths)
            yield share, limit, *small.round(2), *large.round(2)


def nectarines(results):
    """Rows: fruit, test, reading of the true fruit and of drupe's, difference and sd in %, and in sd."""
    folders = sorted(path.parent.name for path in results.glob("fruits/*/record.json"))
    seed = json.loads(ANSWERS.read_text())["seed"]
    for fruit in fruits_of_seed(len(folders), seed=seed):
        folder = Results(results).fruit(fruit.fruit_id)
        by_drupe = fruit_presses(read_record(folder.record), folder)
        pit = ball(3000, semi_axes_mm=fruit.pit.semi_axes_mm, centre_mm=fruit.pit.centre_mm)
        true = presses.simulated_presses(
            skin_mesh(fruit.skin, cells=48), pit, poisson_ratio=fruit.poisson_ratio, **SURE
        )[0]
        for test in trade_tests():
            truth = test.read(true, fruit.E_MPa)[0]
            value, sd = reading(test, by_drupe, E_MPa=fruit.E_MPa, E_sd_MPa=0.0)
            shares = (f"{100 * x / truth:.2f}" for x in (value - truth, sd))
            readings = f"{truth:.4g}", f"{value:.4g}"
            yield fruit.fruit_id, test.name, *readings, *shares, f"{(value - truth) / sd:.2f}"


def main(results: Path | None = None) -> None:
    """Prints a line for each comparison."""
    for line in nectarines(results) if results else balls():
        print(*line, sep="\t", flush=True)


if __name__ == "__main__":
    run(main)
