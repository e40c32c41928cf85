"""Errors of the tests that `drupe firmness` simulates: finer elements, large deformation, true fruit.

    python benchmarks/firmness_readings.py [--results OUT]

Balls of 60 mm between plates: force over that of axisymmetric elements (tests/fem/compressed_solid.py), which
share nothing with fem/, at small strain and for neo-Hookean flesh, for several meshes. With --results, the
results of `drupe grade` and `drupe firmness` of samples/data/nectarines: each reading against the one of the
true shape, pit and E, in standard deviations.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from fem.indentation import simulated_presses as presses
from fem.indentation.trade_tests import trade_tests
from samples.fruit import fruits_of_seed, skin_mesh

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from compressed_solid import linear, neo_hookean, spheroid
from fem_shapes import ball

ANSWERS = Path(__file__).parents[1] / "samples" / "data" / "nectarines" / "answers.json"
SHARES = (0.01, 0.02, 0.05)
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
    """Rows: fruit, test, reading of the true fruit, reading found, and their difference in sd."""
    readings = pd.read_csv(results / "firmness.csv").set_index("fruit_id")
    seed = json.loads(ANSWERS.read_text())["seed"]
    for fruit in fruits_of_seed(len(readings), seed=seed):
        pit = ball(3000, semi_axes_mm=fruit.pit.semi_axes_mm, centre_mm=fruit.pit.centre_mm)
        true = presses.simulated_presses(
            skin_mesh(fruit.skin, cells=48), pit, poisson_ratio=fruit.poisson_ratio, **SURE
        )[0]
        for test in trade_tests():
            truth, row = test.read(true, fruit.E_MPa)[0], readings.loc[fruit.fruit_id]
            off = (row[test.name] - truth) / row[f"{test.name}_sd"]
            yield fruit.fruit_id, test.name, f"{truth:.4g}", row[test.name], round(off, 2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path)
    asked = parser.parse_args()
    for line in nectarines(asked.results) if asked.results else balls():
        print(*line, sep="\t", flush=True)
