"""How far sound recordings are from each relation of tactile/consistency, in its own standard deviations.

    python benchmarks/field_spreads.py FOLDER [...] [--half even|odd] [--cheap N]

Folders as in field_mistakes.py; `--cheap N` takes N fruit drawn without a solver. One line a relation: root
mean square over recordings and pads (1 or less is expected), median, the largest, and the share that fails.
Then how far given pits are from their category's.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from field_fruit import Fruit, cheap_fruit, fruits_in

from pipeline.fruit.input_doubts import against_category
from pipeline.fruit.sensor_scale import known_gels
from recon.pit.priors import load_prior
from tactile.consistency.misfit import LIMIT
from tactile.consistency.of_recording import misfits_of


def of_pit(fruit: Fruit) -> Iterator[tuple[str, float]]:
    """(quantity, value) of a given pit against its category's; none without either."""
    pit = (
        None
        if fruit.pit is None
        else against_category(fruit.vertices, *fruit.pit, load_prior(fruit.category))
    )
    if pit is not None:
        yield "pit.ply from its category's place, half width", pit.off_mm / pit.half_mm
        yield "pit.ply, |ln size over its category's|", abs(pit.size)
        yield "pit.ply, spread of ln sides over its category's", float(np.ptp(pit.sides))


def main() -> None:
    """Prints the table."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--half", choices=("even", "odd", "all"), default="all")
    parser.add_argument("--cheap", type=int, default=0, help="fruit drawn without a solver")
    options = parser.parse_args()
    fruits = fruits_in(options.folders, options.half)
    fruits += [cheap_fruit(seed) for seed in range(options.cheap)]
    values_of: dict[str, list[float]] = defaultdict(list)
    fails_above = 3.0 * float(np.sqrt(np.expm1(LIMIT / 5.0)))
    for fruit in fruits:
        for name, value in of_pit(fruit):
            values_of[name].append(value)
        for recording in fruit.recordings:
            gels = known_gels(recording.sensor, None)
            for misfit in misfits_of(recording, fruit.vertices, fruit.faces, gels=gels):
                values_of[" ".join(filter(None, (misfit.kind.value, misfit.field)))].append(misfit.sds)
    sys.stdout.write(f"{'':47s} {'rms':>9s} {'median':>9s} {'most':>9s} {'fails':>9s}\n")
    for name, values in values_of.items():
        rms, fails = np.sqrt(np.mean(np.square(values))), np.mean(np.array(values) > fails_above)
        shown = " ".join(f"{value:9.3g}" for value in (rms, np.median(values), max(values), fails))
        sys.stdout.write(f"{name:47s} {shown}  ({len(values)})\n")


if __name__ == "__main__":
    main()
