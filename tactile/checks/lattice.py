"""The grid of markers: a pitch off, sites without a marker, another order, a contact beyond its edge."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, cKDTree

from tactile.checks.finding import LENGTH, Finding, FindingKind, FindingRank, shared
from tactile.checks.pressing import LOST_REFUSED, LOST_SAID, Pressing, heaviest, like_neighbours
from tactile.io.recording import marker_area_mm2
from tactile.markers.matching import UNSURE

REGULAR = 0.75
"""Share of the vectors between nearest markers that must be one of two steps for markers to be a grid: square
and hexagonal grids have 1.0, also with 30 % of their markers missing, places off by a tenth of the spacing
0.78, scattered ones 0.25 to 0.34 (drawn 20 x 20)."""
FEWEST_IN_GRID, FEWEST_ORDERED = 9, 20
"""Markers that show a grid (three by three), and pressed ones over which a correlation says something: its
standard deviation is 0.2 there."""
FACE_MM, USUAL_FACE_MM = (3.0, 150.0), (8.0, 60.0)
"""Longest side of a gel's markers: sensors have 10 to 60 mm (docs/formats and samples: 19 to 24 mm)."""
AT_EDGE = 0.6
"""Mean force of the outermost markers (the strongest tenth of them) over the peak; sound ones have up to 0.35
(benchmarks/field_spreads.py)."""
PUNCH, ALL_ROUND = 0.3, 0.7
"""A pad that is in contact all over presses as a flat punch: this share of the outermost markers carries this
share of the peak, and beyond them there is no gel."""
ORDERED = 0.5
"""Correlation of a marker with the mean of its neighbours at the peak; sound ones have 0.93 and more
(benchmarks/field_spreads.py), chance order 0.0."""

NEIGHBOURS = 1.25
"""Markers within so many median spacings are neighbours of the grid: between 1 and the 1.41 of a square's
diagonal. This and the five below are geometry, no measurement; sound grids, square and hexagonal, have no
missing site with them (benchmarks/field_spreads.py, "missing sites of the grid")."""
SAME_STEP, ONE_OF_TWO = 0.2, 0.25
"""Part of the spacing within which two steps between neighbours are the same one, and within which a step is
one of the grid's two."""
FEWEST_STEPS = 8
"""Steps that show two directions, four of each."""
NOT_ALONG = 0.87
"""Cosine of 30 degrees: the two steps of a hexagonal grid are 60 degrees apart, of a square one 90, so that
what lies nearer to the first is the first."""
INSIDE = 0.02
"""Of the spacing: a site beyond the outline of the markers by more is not inside it; rounding makes 1e-6."""
EMPTY = 0.45
"""Of the spacing: no marker is so near to a site without one; at half a marker is as near to the next."""
UNEVEN, DIAGONAL = 1.3, 0.8
"""A marker's area over its squared spacing, between a square grid's 1 and the 1.5 of every third marker of
one; least step along x or y over the other, between 0.58 of a hexagonal grid and the 1 of a diagonal."""
ROUNDS = 4
"""Rounds in which missing sites are found from sites beside them: a hole of eight by eight markers is found
whole, from both sides, of ten by ten 96; assumed to do, since LOST_REFUSED is passed long before."""
OUTERMOST = 0.3
"""Of the spacing: markers so near to the outline are on it, as places off by a tenth of it are."""
PEAK_SHARE = 0.98
"""Quantile over markers that is taken for the peak, so that no single one's noise is."""


def lattice_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """What is wrong with each pad's markers as a grid; what costs the recording is said once of both."""
    findings = [finding for press in pressings for finding in _pad(press)]
    return shared(findings) if all(finding.refused for finding in findings) else findings


def _finding(press: Pressing, kind: FindingKind, says: str, *, refused: bool = True, **more: Any) -> Finding:
    return Finding(kind, FindingRank.FIELD, says, pads=(press.pad.name,), refused=refused, **more)


def _pad(press: Pressing) -> Iterator[Finding]:
    """Findings on one pad's rest positions: unit, certainty, order of markers, missing markers."""
    rest = press.pad.rest_mm[:, :2]
    side = float(np.ptp(rest, axis=0).max())
    certainty = press.pad.certainty
    unsure = np.flatnonzero(certainty < UNSURE) if certainty is not None else np.zeros(0, dtype=int)
    if not FACE_MM[0] <= side <= FACE_MM[1]:
        low, high = USUAL_FACE_MM
        unit = " or ".join(name for times, name in LENGTH.items() if low <= side / times <= high)
        says = (
            f"rest_mm spans {side:.3g} mm{f', as if in {unit}' if unit else ''}; expected the positions of "
            "the markers on the gel in millimetres"
        )
        yield _finding(press, FindingKind.MARKERS_UNIT, says, detail=unit)
    elif press.pressed[unsure].any():
        says = (
            f"markers may be wrong by {press.spacing_mm:.2g} mm (a grid pitch) from frame {unsure[0]} on, "
            "because nearly all moved at once by much of a pitch. Close the jaws more slowly, or record at a "
            "higher frame rate"
        )
        yield _finding(press, FindingKind.MARKERS_PITCH_OFF, says)
    elif (order := _order(press)) is not None and order < ORDERED:
        says = (
            "markers are in another order (permuted) in rest_mm than in displacement and force: neighbours "
            f"on the gel have different signals (correlation {max(order, 0.0):.2f}, expected above 0.9)"
        )
        yield _finding(press, FindingKind.MARKERS_ORDER, says)
    elif press.touched.any() and len(sites := missing_sites(rest)):
        near = np.asarray(cKDTree(rest).query(sites, k=4)[1])
        lost = int((press.touched[near].mean(axis=1) >= 0.5).sum())
        places = lost + int(press.touched.sum())
        if (share := lost / places) > LOST_SAID:
            says = (
                f"marker grid has holes: {lost} of {places} places in the contact ({100 * share:.0f} %) have "
                "no marker in the arrays, so their force is missing"
            )
            refused = share > LOST_REFUSED
            yield _finding(press, FindingKind.MARKERS_MISSING, says, refused=refused, relative_sd=share)


def missing_sites(rest_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Places of the markers' grid inside its outline that have no marker; none where markers are no grid."""
    none = np.empty((0, 2))
    if len(rest_mm) < FEWEST_IN_GRID:
        return none
    tree = cKDTree(rest_mm)
    spacing = float(np.median(np.asarray(tree.query(rest_mm, k=[2])[0])))
    pairs = tree.query_pairs(NEIGHBOURS * spacing, output_type="ndarray")
    steps = rest_mm[pairs[:, 1]] - rest_mm[pairs[:, 0]]
    steps = np.where((steps @ [1.0, 1e-3] < 0)[:, None], -steps, steps)
    basis = _basis(steps, spacing)
    if basis is None:
        return none
    hull = ConvexHull(rest_mm).equations
    moves = np.concatenate([basis, -basis])
    filled, missing = rest_mm, none
    for _ in range(ROUNDS):
        sites = (filled[:, None] + moves[None]).reshape(-1, 2)
        inside = (sites @ hull[:, :2].T + hull[:, 2]).max(axis=1) < INSIDE * spacing
        away = np.asarray(cKDTree(filled).query(sites)[0]) > EMPTY * spacing
        new = sites[inside & away]
        if not len(new):
            break
        new = new[np.unique(np.round(new / (EMPTY * spacing)), axis=0, return_index=True)[1]]
        kept: list[np.ndarray] = []
        for site in new:
            if all(np.linalg.norm(site - other) > EMPTY * spacing for other in kept):
                kept.append(site)
        missing = np.vstack([missing, *kept])
        filled = np.vstack([filled, *kept])
    return missing


def is_thinned(rest_mm: Float[np.ndarray, "n 2"]) -> bool:
    """Whether markers may be every second, third or fourth one of a grid: their spacing is not the same both
    ways, or they stand along the diagonals.

    Of a square grid the area of a marker is the square of its spacing, of a hexagonal one 0.87 of it; where
    rows are left out it is two or more, and where every second marker is, in turns, neighbours are diagonal.
    """
    area_mm2 = marker_area_mm2(np.column_stack([rest_mm, np.zeros(len(rest_mm))]))
    if area_mm2 is None:
        return False
    away, nearest = cKDTree(rest_mm).query(rest_mm, k=[2])
    step = np.abs(rest_mm[np.asarray(nearest)[:, 0]] - rest_mm)
    diagonal = float((step.min(axis=1) > DIAGONAL * step.max(axis=1)).mean())
    return bool(area_mm2 > UNEVEN * np.median(away) ** 2 or diagonal > REGULAR)


def _basis(steps: Float[np.ndarray, "p 2"], spacing: float) -> Float[np.ndarray, "2 2"] | None:
    """The two commonest steps between nearest markers; None where others are as common."""
    if len(steps) < FEWEST_STEPS:
        return None
    tree = cKDTree(steps)
    groups = tree.query_ball_point(steps, r=SAME_STEP * spacing)
    first = max(range(len(steps)), key=lambda k: len(groups[k]))
    first_step = steps[groups[first]].mean(axis=0)
    angle = np.abs(steps @ first_step) / np.linalg.norm(steps, axis=1) / np.linalg.norm(first_step)
    others = [k for k in range(len(steps)) if angle[k] < NOT_ALONG]
    if not others:
        return None
    second = max(others, key=lambda k: len(groups[k]))
    second_step = steps[groups[second]].mean(axis=0)
    third = np.array([first_step - second_step, first_step + second_step])
    fits = [
        np.minimum(np.linalg.norm(steps - v, axis=1), np.linalg.norm(steps + v, axis=1))
        < ONE_OF_TWO * spacing
        for v in (first_step, second_step, *third)
    ]
    return np.stack([first_step, second_step]) if np.any(fits, axis=0).mean() > REGULAR else None


def _order(press: Pressing) -> float | None:
    """Correlation of each marker with its neighbours at the peak, in the field where that is greater."""
    if press.touched.sum() < FEWEST_ORDERED:
        return None
    values = [like_neighbours(press, field) for field in (press.felt_mm, press.force_N)]
    known = [value for value in values if value is not None]
    return max(known) if len(known) == len(values) else None


def edge_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Contacts that run over the edge of the markers; of both pads said once."""
    return shared([finding for press in pressings for finding in _edge(press)])


def _edge(press: Pressing) -> Iterator[Finding]:
    """A contact that is strong at the outermost markers reaches past them, where nothing is measured."""
    rest = press.pad.rest_mm[:, :2]
    hull = ConvexHull(rest).equations
    outermost = (rest @ hull[:, :2].T + hull[:, 2]).max(axis=1) > -OUTERMOST * press.spacing_mm
    mean = press.force_N[heaviest(press), :, 2].mean(axis=0)
    peak = float(np.quantile(mean, PEAK_SHARE))
    if peak <= 0 or not outermost.any() or not press.touched.any():
        return
    share = float(np.sort(mean[outermost])[-max(3, int(outermost.sum()) // 10) :].mean()) / peak
    if share >= AT_EDGE and float((mean[outermost] > PUNCH * peak).mean()) <= ALL_ROUND:
        says = (
            f"contact extends beyond the markers (the outermost carry {100 * share:.0f} % of the peak), so "
            "some force is missing; markers are missing, or the fruit was not in the pad's middle"
        )
        yield _finding(press, FindingKind.OVER_EDGE, says)
