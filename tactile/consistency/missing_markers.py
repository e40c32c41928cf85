"""The grid of markers: places without one, markers that may be a pitch off, a contact beyond its edge."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from tactile.consistency.faults import LOST_SAID, lost_finding
from tactile.consistency.finding import MEANINGLESS, Finding, FindingKind, doubted, shared
from tactile.consistency.pressing import Pressing, at_peak
from tactile.markers.matching import UNSURE

HOLE, UNEVEN, REGULAR = 1.6, 0.25, 0.7
"""Area of a triangle between nearest markers over half of a cell from which a marker is missing there (one
left out of a grid makes 2); in a grid REGULAR of these areas are whole numbers but for UNEVEN."""
AT_EDGE = 0.6
"""Mean force of the outermost markers (the strongest tenth of them) over the peak; sound ones have up to 0.35
(benchmarks/field_spreads.py)."""
PUNCH = 0.3
"""A pad that is in contact all over presses as a flat punch: most of the outermost markers carry this share
of the peak, and beyond them there is no gel."""
OUTERMOST = 0.3
"""Of the spacing: markers so near to the outline are on it, as places off by a tenth of it are."""


def missing_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Places without a marker, and markers a pitch off; what refuses the recording is said once of both
    pads."""
    findings = [finding for press in pressings for finding in (*_missing(press), *_pitch_off(press))]
    return shared(findings) if all(finding.refused for finding in findings) else findings


def missing_markers(rest_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 4"]:
    """Holes of a grid, a row each: the three markers around it and how many are missing there.

    A grid is cut into triangles of half a cell (Delaunay). A triangulation of n points gains two triangles
    for each point that is put inside it, so that a triangle of area A lacks (A / (half a cell) - 1) / 2
    markers. No rows where the triangles are too unlike for a grid.
    """
    triangles = Delaunay(rest_mm).simplices
    first, second, third = rest_mm[triangles].transpose(1, 2, 0)
    edges = second - first, third - first
    area = np.abs(edges[0][0] * edges[1][1] - edges[0][1] * edges[1][0]) / 2
    inner = area > 0.2 * np.median(area)  # slivers along the outline are not
    triangles, area = triangles[inner], area[inner]
    middles = rest_mm[triangles].mean(axis=1)
    near = np.asarray(cKDTree(middles).query(middles, k=min(24, len(middles)))[1])
    area = area / np.quantile(area[near], 0.3, axis=1)  # a lens changes the cell over the face
    if float((np.abs(area - np.round(area)) < UNEVEN).mean()) < REGULAR:
        return np.empty((0, 4))
    holes = area > HOLE
    return np.column_stack([triangles[holes], (area[holes] - 1) / 2])


def _missing(press: Pressing) -> Iterator[Finding]:
    if not press.touched.any():
        return
    holes = missing_markers(press.pad.rest_mm[:, :2])
    around = press.touched[holes[:, :3].astype(int)].mean(axis=1) > 0.5
    lost = round(float(holes[around, 3].sum()))
    places = lost + int(press.touched.sum())
    if (share := lost / places) > LOST_SAID:
        says = (
            f"marker grid has holes: {lost} of {places} places in the contact ({100 * share:.0f} %) have no "
            "marker in the arrays, so their force is missing. Write all markers"
        )
        yield lost_finding(press, FindingKind.MARKERS_MISSING, says, share)


def _pitch_off(press: Pressing) -> Iterator[Finding]:
    certainty = press.pad.certainty
    unsure = np.flatnonzero(certainty < UNSURE) if certainty is not None else np.zeros(0, dtype=int)
    if press.pressed[unsure].any():
        says = (
            f"markers may be wrong by {press.spacing_mm:.2g} mm (a grid pitch) from frame {unsure[0]} on, "
            "because nearly all moved at once by much of a pitch. Close the jaws more slowly, or record at a "
            "higher frame rate"
        )
        kind, pads = FindingKind.MARKERS_PITCH_OFF, (press.pad.name,)
        yield doubted(kind, says, relative_sd=MEANINGLESS, pads=pads)


def edge_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Contacts that are strong at the outermost markers, past which nothing is measured; of both pads
    once."""
    return shared([finding for press in pressings for finding in _edge(press)])


def _edge(press: Pressing) -> Iterator[Finding]:
    rest = press.pad.rest_mm[:, :2]
    hull = ConvexHull(rest).equations
    outermost = (rest @ hull[:, :2].T + hull[:, 2]).max(axis=1) > -OUTERMOST * press.spacing_mm
    force = at_peak(press, press.force_N)[0][:, 2]
    peak = float(np.quantile(force, 0.98))
    if peak <= 0 or not outermost.any() or not press.touched.any():
        return
    share = float(np.sort(force[outermost])[-max(3, int(outermost.sum()) // 10) :].mean()) / peak
    if share >= AT_EDGE and float((force[outermost] > PUNCH * peak).mean()) <= 0.7:
        says = (
            f"contact extends beyond the markers (the outermost carry {100 * share:.0f} % of the peak), so "
            "some force is missing; markers are missing, or the fruit was not in the pad's middle"
        )
        kind, pads = FindingKind.OVER_EDGE, (press.pad.name,)
        yield doubted(kind, says, relative_sd=MEANINGLESS, pads=pads)
