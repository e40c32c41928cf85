"""Where, when and in which component a mismatch sits: from what a fit leaves beyond noise.

What is left of every marker, frame and component is squared and counted in units of its noise. What exceeds
MARKER_EXCESS, which sound recordings leave too, is added up by pad, by place on the fruit, by phase and by
component. A fault of a jaw stays with its pad whatever place it touches; a fault of the flesh stays with its
place whichever pad touches it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.adjoint_maps import fruit_map
from fem.mismatch.explanation import FruitMap, Where
from fem.mismatch.ground import Ground
from fem.mismatch.normal import MARKER_EXCESS
from fem.mismatch.spot_search import RADIUS_MM, best_spots, patch_centres

SAME_PLACE_MM = 10.0
"""Patches whose middles are closer than this touch the same place."""
MOST = 0.7
"""A share of the excess above which one pad, place, phase or component has it."""
SURE = 20.0
"""Standard score of the best soft spot above which its centre is given."""
PHASES = ("load", "hold", "unload")


@dataclass(frozen=True, kw_only=True)
class Located:
    """The words of an answer's `where`, `when` and `component`, and the maps."""

    where: Where
    when: str
    component: str
    maps: FruitMap


@dataclass(frozen=True, kw_only=True)
class Excess:
    """What is left beyond noise, in units of its variance: (recordings, pads, phases, normal and shear).

    `count`: over how many numbers each is the sum.
    """

    amount: Float[np.ndarray, "g p 3 2"]
    count: Float[np.ndarray, "g p 3 2"]


def located(ground: Ground, residual: Sequence[Float[np.ndarray, "f n 3"]]) -> Located:
    """`residual`: what a fit leaves of the markers' positions per recording, mm; motions may be in it."""
    excess = excess_of(ground, residual)
    numbers = ground.sight.seen(residual)
    return Located(
        where=_where(ground, excess, numbers),
        when=_when(excess),
        component=_component(excess),
        maps=fruit_map(ground, numbers),
    )


def excess_of(ground: Ground, residual: Sequence[Float[np.ndarray, "f n 3"]]) -> Excess:
    """The sums that where, when and component are read from."""
    grasps = ground.base.grasps
    shape = (len(grasps), max(len(seen.links) for seen in grasps), len(PHASES), 2)
    amount, count = np.zeros(shape), np.zeros(shape)
    for k, (seen, sight, field) in enumerate(zip(grasps, ground.sight.grasps, residual, strict=True)):
        left = sight.equations.left(field) / seen.tracks.sd_mm[:, None]
        touching = seen.tracks.episode >= 0
        normal = np.einsum("tnx,nx->tn", left, seen.tracks.normal) ** 2
        shear = (left**2).sum(axis=2) - normal
        phase = np.array(seen.case.history.phase)[seen.used]
        for pad in range(len(seen.links)):
            for at, name in enumerate(PHASES):
                chosen = touching & (seen.pad_of_marker == pad) & (phase == name)[:, None]
                samples = float(chosen.sum())
                for component, (squares, each) in enumerate(((normal, 1.0), (shear, 2.0))):
                    count[k, pad, at, component] = each * samples
                    amount[k, pad, at, component] = (
                        float(squares[chosen].sum()) - MARKER_EXCESS * each * samples
                    )
    return Excess(amount=np.maximum(amount, 0.0), count=count)


def _where(ground: Ground, excess: Excess, numbers: Float[np.ndarray, " k"]) -> Where:
    by_pad = excess.amount.sum(axis=(2, 3))
    total = max(float(by_pad.sum()), np.finfo(float).tiny)
    place = _places(ground)
    by_place = np.bincount(place.ravel(), by_pad.ravel()) / total
    pad = by_pad.sum(axis=0) / total
    if by_place.max() > max(MOST, pad.max() - 0.1) and len(by_place) > 2:
        spots = best_spots(ground, numbers)
        best = max(spots, key=lambda spot: spot.score, default=None)
        if best is not None and best.score > SURE:
            x, y, z = map(float, best.centre_mm)
            return Where(region="flesh", centre_mm=(x, y, z), radius_mm=RADIUS_MM)
        return Where(region="flesh")
    if pad.max() > MOST and len(pad) > 1:
        return Where(region=f"pad {ground.base.grasps[0].pad_names[int(pad.argmax())]}")
    return Where(region="both")


def _places(ground: Ground) -> Int[np.ndarray, "g p"]:
    """A number for each place on the fruit that the pads of the recordings touch."""
    known: list[np.ndarray] = []
    numbers = []
    for seen in ground.base.grasps:
        for middle in patch_centres(seen):
            near = [k for k, other in enumerate(known) if np.linalg.norm(middle - other) < SAME_PLACE_MM]
            if not near:
                known.append(middle)
            numbers.append(near[0] if near else len(known) - 1)
    return np.array(numbers).reshape(len(ground.base.grasps), -1)


def _when(excess: Excess) -> str:
    """The phase that has most of the excess, all of them standing equally long."""
    count = excess.count.sum(axis=(0, 1, 3))
    each = excess.amount.sum(axis=(0, 1, 3)) / np.maximum(count, 1.0)
    share = each / max(float(each.sum()), np.finfo(float).tiny)
    return PHASES[int(share.argmax())] if share.max() > MOST else "all"


def _component(excess: Excess) -> str:
    normal, shear = excess.amount.sum(axis=(0, 1, 2))
    total = max(normal + shear, np.finfo(float).tiny)
    if normal / total > MOST:
        return "normal"
    return "shear" if shear / total > MOST else "both"
