"""What sound recordings show of each quantity that a check of tactile/checks has a limit for.

    python benchmarks/field_spreads.py FOLDER [...] [--half even|odd] [--cheap N] [--pits CACHE]

Folders as in field_mistakes.py; `--cheap N` takes N fruit drawn without a solver. One line a
quantity: its values over recordings, over the pads of all, or over fruit. `--pits CACHE` instead takes each
fruit of a category with a pit through the pipeline with the pit moved, scaled and turned (20 s of processor
time each, first recording; kept in CACHE): how E changes.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from field_changes import about_the_middle, pit
from field_fruit import Fruit, cheap_fruit, fruits_in
from field_mistakes import graded
from scipy.spatial import ConvexHull

from pipeline.fruit.input_doubts import against_category
from recon.pit.priors import load_prior
from tactile.checks.footprint import footprint, tilted
from tactile.checks.jaws import closing_mm
from tactile.checks.lattice import missing_sites
from tactile.checks.of_recording import other_arrangements
from tactile.checks.pressing import Pressing, heaviest, like_neighbours, noise_shares, pressing_of
from tactile.checks.relation import relation_of
from tactile.checks.time_order import drift_of, dropped_steps, release_less_touch_mm, roughness, turns_share
from tactile.io.recording import GelPad, Recording


def of_recording(
    recording: Recording, vertices: np.ndarray, faces: np.ndarray
) -> Iterator[tuple[str, float]]:
    """(quantity, value) of a recording, pad by pad where it is one of a pad."""
    pressings = [pressing_of(pad) for pad in recording.pads if isinstance(pad, GelPad)]
    yield "turns_share of jaws", turns_share(recording.aperture_mm)
    if (apart := release_less_touch_mm(recording, pressings)) is not None:
        yield "release less touch, mm", apart
    yield (
        "fastest closing, mm/s",
        float(np.abs(np.diff(recording.aperture_mm) / np.diff(recording.time_s)).max()),
    )
    steps = np.diff(recording.time_s)
    yield "time step over the median, greatest", float(steps.max() / np.median(steps))
    yield "time step over the median, smallest", float(steps.min() / np.median(steps))
    yield "time steps that are multiples of those beside", float(dropped_steps(recording.time_s))
    for pressing in pressings:
        yield from _of_pad(pressing, recording)
    prints = [footprint(pressing, vertices, faces) for pressing in pressings]
    both = [made for made in prints if made is not None]
    if len(both) == 2:
        yield "ahead, sum of two pads, mm", both[0].ahead_mm + both[1].ahead_mm
        yield "ahead, half of the difference, mm", (both[0].ahead_mm - both[1].ahead_mm) / 2
    for made in both:
        yield "ahead of a pad, mm", made.ahead_mm
        if np.isfinite(made.middle_mm).all():
            yield "middle of a print, mm, greatest part", float(np.abs(made.middle_mm).max())
            yield "tilt under it, radians, greatest part", float(np.abs(made.tilt).max())
    yield "tilts of a recording in their spread", tilted(both, 0.0)
    if len(both) == 2:
        for kind, there in other_arrangements(pressings, vertices, faces):
            if len(there) == 2 and all(np.isfinite(made.tilt).all() for made in there):
                better = tilted(both, 0.0) ** 2 - tilted(there, 0.0) ** 2
                yield f"squares of tilts less those of {kind}", better


def _of_pad(pressing: Pressing, recording: Recording) -> Iterator[tuple[str, float]]:
    displacement, force = noise_shares(pressing)
    yield "noise over peak, displacement", displacement
    yield "noise over peak, force", force
    yield "quiet frames, share", float(pressing.quiet.mean())
    for name, values in (("displacement", pressing.felt_mm), ("force", pressing.force_N)):
        normal = np.abs(values[:, :, 2])
        yield f"values at the greatest, {name}", float((normal >= normal.max() * (1 - 1e-6)).sum())
        yield (
            f"roughness, {name}",
            roughness(values[:, pressing.touched, 2].sum(axis=1), recording.aperture_mm),
        )
        if (similarity := like_neighbours(pressing, values)) is not None:
            yield f"correlation with neighbours, {name}", similarity
        yield f"first frame over peak, {name}", _first(values[:, pressing.touched, 2])
    top, use = heaviest(pressing), pressing.touched
    mean = np.abs(pressing.force_N[top][:, use].mean(axis=(0, 1)))
    yield "force across over force along z", float(mean[:2].max() / max(mean[2], 1e-30))
    total = pressing.force_N[:, use, 2].sum(axis=1)
    yield "frames above 90 % of the peak", float((total > 0.9 * total.max()).sum())
    yield "force in the last frame over peak", float(total[-1] / total.max())
    if (drift := drift_of(pressing)) is not None:
        yield "drift over peak", abs(drift[0]) / drift[2]
        yield "drift over its noise", abs(drift[0]) / max(drift[1], 1e-30)
    rest = pressing.pad.rest_mm[:, :2]
    yield "missing sites of the grid", float(len(missing_sites(rest)))
    hull = ConvexHull(rest).equations
    outermost = (rest @ hull[:, :2].T + hull[:, 2]).max(axis=1) > -0.3 * pressing.spacing_mm
    at = pressing.force_N[top, :, 2].mean(axis=0)
    few = max(3, int(outermost.sum()) // 10)
    yield "outermost markers over peak", float(np.sort(at[outermost])[-few:].mean() / np.quantile(at, 0.98))
    felt, closing = (
        float(np.quantile(np.abs(pressing.felt_mm[:, :, 2]).max(axis=0), 0.98)),
        closing_mm(pressing),
    )
    yield "gel's indentation over the pad's closing", felt / max(closing, 1e-30)
    relation = relation_of(pressing)
    if relation is not None:
        yield "|ln gain|", abs(float(np.log(relation.gain)))
        yield "correlation over time", relation.in_time
        yield "correlation over markers", relation.over_markers
        yield "saturation", relation.saturation
        axes = np.abs(relation.axes)
        other = max(axes[2, :2].max(), axes[:2, 2].max())
        yield "other axes' correlation less z's", float(other - axes[2, 2])


def _first(values: np.ndarray) -> float:
    total = np.abs(values.sum(axis=1))
    return float(total[0] / total.max())


def of_pit(fruit: Fruit) -> Iterator[tuple[str, float]]:
    """(quantity, value) of a given pit against its category's; none without either."""
    if fruit.pit is None:
        return
    deviation = against_category(fruit.vertices, *fruit.pit, load_prior(fruit.category))
    if deviation is not None:
        yield "pit.ply from its category's place, mm", deviation.off_mm
        yield "pit.ply from its category's place, half width", deviation.off_mm / deviation.half_mm
        yield "pit.ply, |ln size over its category's|", abs(deviation.size)
        yield "pit.ply, spread of ln sides over its category's", float(np.ptp(deviation.sides))


MOVED_MM, SCALED = 6.0, 1.3
TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def of_pit_graded(fruit: Fruit, cache: Path) -> Iterator[tuple[str, float]]:
    """(quantity, value): how E changes where the pit is given elsewhere, in another size, turned."""
    if load_prior(fruit.category).axis_ratios is None:
        return
    single_grasp = replace(fruit, recordings=fruit.recordings[:1])

    def E_MPa(name: str, change: Callable[[np.ndarray], np.ndarray]) -> float:
        made = pit(change)(single_grasp, single_grasp, np.random.default_rng(0))
        record = graded(made, cache / name / fruit.name)
        return record.modulus.E_MPa if record.graded and record.modulus is not None else float("nan")

    sound = E_MPa("given", lambda v: v)
    x, y, z = MOVED_MM * np.eye(3)
    for name, way in (("x", x), ("y", y), ("z", z), ("xy", (x + y) / np.sqrt(2.0))):
        moved = E_MPa(f"moved-{name}", lambda v, way=way: v + way)
        yield "|ln E| per mm of the pit's offset", abs(float(np.log(moved / sound))) / MOVED_MM
    for times in (SCALED, 1 / SCALED):
        scaled = E_MPa(f"scaled-{times:.2f}", about_the_middle(lambda v, times=times: times * v))
        yield "|ln E| per ln of the pit's size", abs(float(np.log(scaled / sound)) / np.log(times))
    for name, turn in (("turned", TURN_90), ("on-its-side", TILT_90)):
        turned = E_MPa(name, about_the_middle(lambda v, turn=turn: v @ turn))
        yield "|ln E| where the pit is turned", abs(float(np.log(turned / sound)))


def main() -> None:
    """Prints the table."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--half", choices=("even", "odd", "all"), default="all")
    parser.add_argument("--cheap", type=int, default=0, help="fruit drawn without a solver")
    parser.add_argument("--pits", type=Path, help="grade with pits that are moved, scaled, turned")
    options = parser.parse_args()
    fruits = fruits_in(options.folders, options.half)
    fruits += [cheap_fruit(seed) for seed in range(options.cheap)]
    values_of: dict[str, list[float]] = defaultdict(list)
    for fruit in fruits:
        for name, value in of_pit_graded(fruit, options.pits) if options.pits else of_pit(fruit):
            if np.isfinite(value):
                values_of[name].append(value)
        for recording in () if options.pits else fruit.recordings:
            for name, value in of_recording(recording, fruit.vertices, fruit.faces):
                values_of[name].append(value)
    sys.stdout.write(f"{'':47s} {'least':>9s} {'1 %':>9s} {'median':>9s} {'99 %':>9s} {'most':>9s}\n")
    for name, values in values_of.items():
        shown = " ".join(f"{value:9.3g}" for value in np.quantile(values, [0, 0.01, 0.5, 0.99, 1]))
        sys.stdout.write(f"{name:47s} {shown}  ({len(values)})\n")


if __name__ == "__main__":
    main()
