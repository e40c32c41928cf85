"""How far sound recordings are from each relation of tactile/consistency, in its own standard deviations.

    python benchmarks/field_spreads.py FOLDER [...] [--half even|odd] [--cheap N]

Folders as in field_mistakes.py; `--cheap N` takes N fruit drawn without a solver. One line a relation: root
mean square over recordings and pads (1 or less is expected), median, the least, the largest, and the share
that fails. Further lines have the quantities by which tactile/consistency tells faults, times, first touches
and gains, and how far given pits are from their category's, in their own units.
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from field_fruit import Fruit, cheap_fruit, fruits_in
from script import Half, run

from pipeline.fruit.input_doubts import against_category
from pipeline.fruit.sensor_scale import known_gels
from recon.pit.priors import load_prior
from tactile.consistency.faults import OF_PEAK, share_at_edge
from tactile.consistency.footprint import Footprint, footprint, mesh_misfits
from tactile.consistency.misfit import LIMIT, Situation
from tactile.consistency.of_recording import drift_of, pressed_share
from tactile.consistency.pressing import Pressing, noise_shares, pressing_of
from tactile.consistency.relations import gain_of, signal_misfits
from tactile.readers.recording import GelPad


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


def of_pad(press: Pressing) -> Iterator[tuple[str, float]]:
    """(quantity, value) of one pad, for the limits of faults, pressing, time_findings and gain."""
    use, top = press.touched, press.heaviest
    yield "share of frames in the air", float((~press.pressed.any(axis=1)).mean())
    weight = np.sqrt((press.force_N**2).sum(axis=(1, 2)))
    yield "frames above 90 % of the peak", float((weight > 0.9 * weight.max()).sum())
    for name, share in zip(("displacement", "force"), noise_shares(press), strict=True):
        yield f"{name}, noise over the most pressed markers", share
    for name, values in (("displacement", press.felt_mm), ("force", press.force_N)):
        normal = np.abs(values[:, :, 2])
        yield f"{name}, samples of the greatest value", float((normal >= normal.max() * (1 - 1e-6)).sum())
        size = np.abs(values[top, :, 2].mean(axis=0))
        around = np.median(size[press.near], axis=1)
        strong = around > OF_PEAK * np.quantile(size, 0.99)
        yield f"{name}, correlation with neighbours' median", float(np.corrcoef(size, around)[0, 1])
        yield f"{name}, least marker over its neighbours", float((size[strong] / around[strong]).min())
    if press.gel_mm is not None:
        felt, gel = (np.abs(u[:, use, 2].sum(axis=1)).max() for u in (press.felt_mm, press.gel_mm))
        yield "total displacement over the one by forces", float(felt / gel)
    if (gain := gain_of(press)) is not None:
        yield "|ln gain of the force|", abs(float(np.log(gain)))
    yield "outermost markers over the peak", share_at_edge(press)
    yield "first frame over the peak", pressed_share(press, 0)
    if (drift := drift_of(press)) is not None:
        change, noise, peak = drift
        yield "drift of the force over the peak", abs(change) / peak
        yield "drift of the force over its noise", abs(change) / max(noise, 1e-12)


def of_prints(prints: Sequence[Footprint]) -> Iterator[tuple[str, float]]:
    """(quantity, value) of both pads' first touches on the mesh, mm and radians."""
    yield from (("first touch against the mesh, mm", abs(imprint.ahead_mm)) for imprint in prints)
    if len(prints) == 2:
        yield "fruit moved along the jaws, mm", abs(prints[0].ahead_mm - prints[1].ahead_mm) / 2
    yield "tilt of the prints, radians", float(np.linalg.norm([np.nan_to_num(p.tilt) for p in prints]))


def main(
    folders: Annotated[list[Path] | None, typer.Argument()] = None, half: Half = "all", cheap: int = 0
) -> None:
    """Prints the table."""
    fruits = [*fruits_in(folders or [], half).values(), *map(cheap_fruit, range(cheap))]
    rows: list[tuple[str, float]] = []
    fails_above = 3.0 * float(np.sqrt(np.expm1(LIMIT / 5.0)))
    for fruit in fruits:
        rows += of_pit(fruit)
        for recording in fruit.recordings:
            pressings = [pressing_of(pad) for pad in recording.pads if isinstance(pad, GelPad)]
            rows += chain.from_iterable(map(of_pad, pressings))
            prints = [footprint(press, fruit.vertices, fruit.faces) for press in pressings]
            rows += of_prints([imprint for imprint in prints if imprint is not None])
            gels = known_gels(recording.sensor, None)
            compared = {"vertices": fruit.vertices, "faces": fruit.faces, "gels": tuple(gels)}
            situation = Situation(recording=recording, pressings=tuple(pressings), **compared)
            for misfit in (*signal_misfits(situation), *mesh_misfits(situation)):
                rows.append((" ".join(filter(None, (misfit.kind.value, misfit.field))), misfit.sds))
    print(f"{'':47s} {'rms':>9s} {'median':>9s} {'least':>9s} {'most':>9s} {'fails':>9s}")
    relations = pd.DataFrame(rows, columns=["relation", "value"]).groupby("relation", sort=False)["value"]
    for name, values in relations:
        rms, fails = np.sqrt(np.mean(np.square(values))), np.mean(values > fails_above)
        numbers = (rms, np.median(values), min(values), max(values), fails)
        shown = " ".join(f"{value:9.3g}" for value in numbers)
        print(f"{name:47s} {shown}  ({len(values)})")


if __name__ == "__main__":
    run(main)
