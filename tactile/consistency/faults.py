"""Values that no working sensor gives: dead, frozen, clipped or missing markers, markers shifted by a pitch,
zero and copied frames, and contact beyond the outermost markers.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from tactile.consistency.finding import MEANINGLESS, Field, Finding, FindingKind, doubted, shared
from tactile.consistency.pressing import Pressing, at_peak, gives_way, noise_shares
from tactile.markers.matching import UNSURE
from tactile.noise import noise_in_contact
from tactile.readers.recording import GelPad
from tactile.reference_print import SURE, WHAT_TO_DO

E_OF_A_PRINT = 0.5
"""Relative standard deviation of E if a reference may show an imprint: displacements then lack the imprint's,
which may be all of it. Set by hand."""
FORCE_BEYOND_NOISE = 8.0
"""Standard deviations of a pad's total normal force below which it measures none, as in tactile.contact."""
LEAST_PRINT_N = 0.05
"""Total normal force below which an imprint is invisible. Pressing a twentieth of a face of 300 mm2 of a gel
of 0.2 MPa in by a thirtieth of its thickness takes 0.1 N; this is half of it. Set by hand."""


def reference_findings(pads: Sequence[GelPad]) -> list[Finding]:
    """Imprints on references, and imprints without a force; both pads share one finding."""
    return shared([finding for pad in pads for finding in _print_findings(pad)])


def print_without_force(pad: GelPad) -> str | None:
    """Why a pad whose pictures show an imprint measures no force, with advice; None if that is not so."""
    shown = 0.0 if pad.print_shown is None else float(pad.print_shown.max())
    on_reference = pad.reference_print is not None and pad.reference_print >= 1.0
    if not on_reference and shown < SURE:
        return None
    total = pad.force_N[:, :, 2].sum(axis=1)
    noise = noise_in_contact(pad.force_N).sd * float(np.sqrt(len(pad.rest_mm)))
    if float(total.max()) > max(FORCE_BEYOND_NOISE * noise, LEAST_PRINT_N):
        return None
    if on_reference:
        cause = "the reference shows a contact imprint itself"
    elif pad.print_shown is not None and pad.print_shown[0] >= SURE:
        cause = "the gel is under load from frame 0 on, and the reference does not show this gel untouched"
    else:
        cause = (
            "the reference or the sensor's description is of another gel, or shear exceeds pressure "
            "(one camera measures no depth)"
        )
    pictured = f"pictures show a contact imprint ({shown:.1f} times the limit for an empty gel), yet its "
    shows = pictured if shown >= SURE else ""
    return f"{shows}force is at most {max(float(total.max()), 0.0):.2g} N: {cause}; {WHAT_TO_DO}"


def _print_findings(pad: GelPad) -> list[Finding]:
    if (contradiction := print_without_force(pad)) is not None:
        return [Finding(FindingKind.PRINT_WITHOUT_FORCE, contradiction, pads=(pad.name,), refused=True)]
    if pad.reference_print is None or pad.reference_print < 1.0:
        return []
    says = (
        f"reference shows a contact imprint ({pad.reference_print:.1f} times the limit for an empty gel), so "
        f"displacements are not relative to the untouched gel; {WHAT_TO_DO}"
    )
    return [
        Finding(
            FindingKind.REFERENCE_PRINT,
            says,
            pads=(pad.name,),
            refused=pad.reference_print >= SURE,
            relative_sd=E_OF_A_PRINT,
            hides_touch=True,
        )
    ]


LOST_SAID, LOST_REFUSED, E_PER_LOST = 0.01, 0.05, 2.0
"""Share of a contact's markers or values that are lost, above which drupe reports it, and refuses the
recording. E loses 0.8 to 1.0 of that share: 27 to 28 % for 30 % of the markers, 34 % for a force clipped at
half (0.41 of the values). Doubled, since the lost values are unknown."""
DEAD = 0.02
"""A field is dead if its total is below this share of the other's prediction; valid ones have 0.94 to 1.06
(benchmarks/field_spreads.py)."""
FROZEN_FRAMES, FROZEN_SHARE, AROUND = 3, 0.25, 0.75
"""A marker is dead if it repeats itself exactly in this many frames and in this share of the eligible ones.
In these AROUND of its neighbours (half, with noise) are pressed, and most markers change: noise of 4 um in
steps of 0.1 um does so once in 1e5."""
FAINT, OF_PEAK, FAINT_SD = 0.25, 0.5, 8.0
"""So is a marker with less than this share of its neighbours' median, if that exceeds half the peak and this
multiple of the noise. In valid contacts none there has less than 0.48 (benchmarks/field_spreads.py)."""
LEAST_CORRELATION = 0.3
"""Correlation of a field with its neighbours' median above which neighbours predict a marker. In random order
it is within 0.16 of 0 (three standard deviations of 350 markers); valid contacts have 0.9 and more
(benchmarks/field_spreads.py)."""
FEWEST_LEVELS, CLIPPED_SAMPLES = 12, 12
"""Fewest distinct values of a field: below it coarse steps repeat values. Fewest samples exactly at a field's
maximum that count as clipped: valid recordings have up to eight (benchmarks/field_spreads.py)."""
NOISE: dict[Field, float] = {"displacement": 0.057, "force": 0.27}
"""Noise over the signal of the most pressed markers; valid recordings have up to 0.0545 and 0.249, on soft
gels (benchmarks/field_spreads.py)."""
NOISE_REFUSED = 0.1
"""The same of displacement for a refusal."""
E_PER_NOISE = (6.0, 1.0)
"""Relative error of E per share of noise in displacement and force, because noise delays detection of the
first touch. A share of 0.08 in displacement made E 47 % too small on one fruit
(benchmarks/field_mistakes.py)."""


def value_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings about single markers, values and frames, pad by pad."""
    dead = [finding for press in pressings for finding in _dead_field(press)]
    findings = shared(dead)
    for press in pressings:
        if any(press.pad.name in finding.pads for finding in dead):
            continue
        findings += _clipped(press)
        fields = (press.pad.displacement_mm, press.pad.force_N)
        if not press.pressed.any() or all(len(np.unique(f[:, :, 2])) >= FEWEST_LEVELS for f in fields):
            findings += [*_whole_frames(press), *_markers(press)]
    return findings


def lost_finding(press: Pressing, kind: FindingKind, says: str, share: float, **more: Any) -> Finding:
    """The finding that this share of a contact's markers or values is lost."""
    refused = share > LOST_REFUSED
    return Finding(kind, says, pads=press.pads, relative_sd=E_PER_LOST * share, refused=refused, **more)


def noise_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings of signals that hardly exceed their noise."""
    findings = []
    for press in pressings:
        shares = noise_shares(press)
        for (name, most), share in zip(NOISE.items(), shares, strict=True):
            if share > most and press.pressed.any() and (name == "force" or gives_way(press)):
                says = (
                    f"{name} is mostly noise: {100 * share:.0f} % of the signal of the most loaded markers, "
                    f"expected below {100 * most:.0f} %; press harder, or check the sensor"
                )
                refused, sd = shares[0] > NOISE_REFUSED, float(np.dot(E_PER_NOISE, shares))
                findings.append(
                    Finding(
                        FindingKind.NOISE,
                        says,
                        pads=press.pads,
                        field=name,
                        refused=refused,
                        relative_sd=sd,
                        hides_touch=True,
                    )
                )
                break
    return findings


def _dead_field(press: Pressing) -> Iterator[Finding]:
    """A field that stays within its noise while the other field predicts a signal."""
    use = press.touched
    if press.gel_mm is None or not use.any():
        return
    totals = [float(np.abs(field[:, use, 2].sum(axis=1)).max()) for field in (press.felt_mm, press.gel_mm)]
    fields: tuple[tuple[Field, np.ndarray, float], ...] = (
        ("displacement", press.felt_mm, press.felt_sd_mm),
        ("force", press.force_N, press.force_sd_N),
    )
    for k, (name, values, noise) in enumerate(fields):
        size = float(np.sqrt((values[:, use] ** 2).mean(axis=(1, 2))).max())
        if size < max(2 * noise, 1e-9) and totals[k] < DEAD * totals[1 - k]:
            says = (
                f"{name} is dead: it does not rise above its noise while the other field does, so the sensor "
                "or its tracking failed; record the grasp again"
            )
            yield doubted(FindingKind.DEAD_FIELD, says, relative_sd=MEANINGLESS, pads=press.pads, field=name)


def dead_markers(press: Pressing) -> Bool[np.ndarray, " n"]:
    """Markers in the contact that are dead: too weak, or frozen.

    Neighbours show both, and only in a field in which neighbours are correlated.
    """
    asked_where = press.pressed[:, press.near].mean(axis=2) >= (AROUND if press.felt_sd_mm == 0 else 0.5)
    dead = np.zeros(len(press.touched), dtype=bool)
    for values in (press.pad.displacement_mm, press.pad.force_N):
        mean, sd = at_peak(press, values - np.median(values[press.quiet], axis=0))
        size = np.abs(mean[:, 2])
        around = np.median(size[press.near], axis=1)
        if not size.std() * around.std() > 0 or np.corrcoef(size, around)[0, 1] <= LEAST_CORRELATION:
            continue
        repeats = (values[1:] == values[:-1]).all(axis=2)
        asked = asked_where[1:] & (repeats.mean(axis=1) < 0.5)[:, None]
        same = (repeats & asked).sum(axis=0)
        dead |= (same >= FROZEN_FRAMES) & (same >= FROZEN_SHARE * asked.sum(axis=0))
        strong = around > max(OF_PEAK * float(np.quantile(size, 0.99)), FAINT_SD * sd)
        dead |= strong & (size < FAINT * around)
    return dead


def _markers(press: Pressing) -> Iterator[Finding]:
    dead = dead_markers(press)
    contact = press.touched | dead
    share = float(dead.sum() / max(contact.sum(), 1))
    if share > LOST_SAID:
        says = (
            f"markers are dead: {int(dead.sum())} of the {int(contact.sum())} in the contact "
            f"({100 * share:.0f} %) are zero or frozen. Their force is missing; clean or replace the gel"
        )
        yield lost_finding(press, FindingKind.DEAD_MARKERS, says, share)


def _whole_frames(press: Pressing) -> Iterator[Finding]:
    """Frames that are all zero in a field that has noise, and frames copied from the one before."""
    fields: dict[Field, np.ndarray] = {"displacement": press.pad.displacement_mm, "force": press.pad.force_N}
    pressed = np.asarray(press.pressed.any(axis=1))
    adjacent = np.zeros_like(pressed)
    adjacent[1:-1] = pressed[:-2] | pressed[2:]
    for (name, values), noise in zip(fields.items(), (press.felt_sd_mm, press.force_sd_N), strict=True):
        lost = np.asarray((values == 0).all(axis=(1, 2))) & adjacent
        if noise > 0 and lost.any():
            says = (
                f"{name} is zero at every marker in {int(lost.sum())} frames during the contact (first: "
                f"frame {int(np.argmax(lost))}), so frames are missing and filled with zeros"
            )
            yield doubted(FindingKind.ZERO_FRAMES, says, relative_sd=MEANINGLESS, pads=press.pads, field=name)
    copied = pressed[1:] & np.all([(v[1:] == v[:-1]).all(axis=(1, 2)) for v in fields.values()], axis=0)
    if press.felt_sd_mm > 0 and copied.sum() > 1:
        says = (
            f"frames are duplicated: {int(copied.sum())} in the contact repeat the frame before (first: "
            f"frame {int(np.argmax(copied)) + 1}); E does not depend on them"
        )
        yield Finding(FindingKind.COPIED_FRAMES, says, pads=press.pads, remark=True)


def _clipped(press: Pressing) -> Iterator[Finding]:
    """Fields with more samples at their maximum than a quarter of those within 5 % below it."""
    for name, values in (("displacement", press.pad.displacement_mm), ("force", press.pad.force_N)):
        normal = np.abs(values[:, :, 2])
        top = float(normal.max())
        clipped = normal >= top * (1 - 1e-6)
        below = (normal > 0.95 * top) & ~clipped
        many = len(np.unique(normal)) >= FEWEST_LEVELS and clipped.sum() >= CLIPPED_SAMPLES
        if top > 0 and press.pressed.any() and many and clipped.sum() > 0.25 * below.sum():
            share = float(clipped.sum() / press.pressed.sum())
            says = (
                f"{name} is clipped: {int(clipped.sum())} values are exactly {top:.3g} "
                f"{'mm' if name == 'displacement' else 'N'}, the maximum; the sensor saturates, so press less"
            )
            yield lost_finding(press, FindingKind.CLIPPED, says, share, field=name)


HOLE, UNEVEN, REGULAR = 1.6, 0.25, 0.7
"""Area of a triangle between nearest markers, over half a cell, above which a marker is missing there (one
missing marker makes 2). In a grid the share REGULAR of these areas is within UNEVEN of a whole number."""
AT_EDGE = 0.6
"""Mean force of the outermost markers (the strongest tenth of them) over the peak; valid recordings have up
to 0.44 (benchmarks/field_spreads.py)."""
PUNCH = 0.3
"""A pad in contact over its whole face presses as a flat punch: most of the outermost markers carry this
share of the peak, and the gel ends beyond them."""
OUTERMOST = 0.3
"""Share of the spacing: markers this near to the outline are on it, since places may be off by a tenth."""


def missing_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings of missing markers and of markers shifted by a pitch; both pads share one finding if all
    refuse the recording."""
    findings = [finding for press in pressings for finding in (*_missing(press), *_pitch_off(press))]
    return shared(findings) if all(finding.refused for finding in findings) else findings


def missing_markers(rest_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 4"]:
    """Holes of a grid, a row each: the three markers around it and how many are missing there.

    Delaunay triangulation cuts a grid into triangles of half a cell. Each point that is added inside adds two
    triangles, so that a triangle of area A lacks (A / (half a cell) - 1) / 2 markers. There are no rows if
    the triangles are too irregular for a grid.
    """
    triangles = Delaunay(rest_mm).simplices
    first, second, third = rest_mm[triangles].transpose(1, 2, 0)
    edges = second - first, third - first
    area = np.abs(edges[0][0] * edges[1][1] - edges[0][1] * edges[1][0]) / 2
    inner = area > 0.2 * np.median(area)  # drops slivers along the outline
    triangles, area = triangles[inner], area[inner]
    middles = rest_mm[triangles].mean(axis=1)
    near = np.asarray(cKDTree(middles).query(middles, k=min(24, len(middles)))[1])
    area = area / np.quantile(area[near], 0.3, axis=1)  # a lens varies the cell over the face
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
        yield doubted(FindingKind.MARKERS_PITCH_OFF, says, relative_sd=MEANINGLESS, pads=press.pads)


def edge_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings of contacts that are strong at the outermost markers, beyond which nothing is measured; both
    pads share one."""
    return shared([finding for press in pressings for finding in _edge(press)])


def share_at_edge(press: Pressing) -> float:
    """Mean force of the outermost markers (the strongest tenth of them) over the peak.

    It is 0 if the whole outline is pressed, as by a flat punch, or if nothing is.
    """
    rest = press.pad.rest_mm[:, :2]
    hull = ConvexHull(rest).equations
    outermost = (rest @ hull[:, :2].T + hull[:, 2]).max(axis=1) > -OUTERMOST * press.spacing_mm
    force = at_peak(press, press.force_N)[0][:, 2]
    peak = float(np.quantile(force, 0.98))
    at_edge = np.sort(force[outermost])
    if peak <= 0 or not len(at_edge) or not press.touched.any() or (at_edge > PUNCH * peak).mean() > 0.7:
        return 0.0
    return float(at_edge[-max(3, len(at_edge) // 10) :].mean()) / peak


def _edge(press: Pressing) -> Iterator[Finding]:
    share = share_at_edge(press)
    if share >= AT_EDGE:
        says = (
            f"contact extends beyond the markers (the outermost carry {100 * share:.0f} % of the peak), so "
            "some force is missing; markers are missing, or the fruit was not in the pad's middle"
        )
        yield doubted(FindingKind.OVER_EDGE, says, relative_sd=MEANINGLESS, pads=press.pads)
