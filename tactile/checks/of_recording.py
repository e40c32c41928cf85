"""All checks of one recording, in the order in which a cause explains what follows from it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from tactile.checks.channels import channel_findings, noise_findings
from tactile.checks.finding import Finding, FindingKind
from tactile.checks.footprint import (
    OTHERWISE,
    Footprint,
    better_otherwise,
    footprint,
    footprint_findings,
    tilted,
)
from tactile.checks.gel_findings import gel_findings, reference_findings
from tactile.checks.jaws import closing_mm, indentation_findings, jaw_findings
from tactile.checks.lattice import edge_findings, lattice_findings
from tactile.checks.pressing import Pressing, pressing_of
from tactile.checks.relation import axis_findings, relation_findings
from tactile.checks.time_order import time_findings
from tactile.io.recording import GelPad, Recording
from tactile.io.sensor_model import PublishedGel
from tactile.registration import depth_along

QUARTERS = np.array(
    [
        turn
        for turned in ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
                       [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        for turn in (turned, np.transpose(turned))
    ],
    dtype=float,
)  # fmt: skip
"""Turns by 90 degrees about x, y and z, both ways: what a mesh in another frame is likeliest turned by."""


def recording_findings(
    recording: Recording,
    vertices: Float[np.ndarray, "v 3"] | None,
    faces: Int[np.ndarray, "f 3"] | None,
    *,
    E_range_MPa: tuple[float, float] | None = None,
    surface_sd_mm: float = 0.0,
    gels: Sequence[PublishedGel] = (),
) -> list[Finding]:
    """What cannot be right in `recording` of the fruit with this mesh, the likeliest cause first.

    After a finding that refuses the recording nothing of a lower rank is looked for. A bare indenter's trace
    is not checked. Without a mesh (None) only the recording itself is checked: its fields pad by pad, and
    whether the contact runs over the edge of the markers.

    `E_range_MPa`: moduli that the category can have; `surface_sd_mm`: the mesh's error; `gels`: what is known
    of the sensor's gels.
    """
    pads = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    if len(pads) != len(recording.pads):
        return []
    pressings = [pressing_of(pad) for pad in pads]
    findings: list[Finding] = []

    def if_touch_is_seen(check: Callable[[], list[Finding]]) -> list[Finding]:
        return [] if any(finding.hides_touch for finding in findings) else check()

    stages: list[Callable[[], list[Finding]]] = [
        lambda: reference_findings(pads),
        lambda: [*lattice_findings(pressings), *channel_findings(pressings)],
        lambda: axis_findings(pressings),
        lambda: time_findings(recording, pressings),
        lambda: [finding for known in gels for finding in gel_findings(pads, known)],
        lambda: relation_findings(
            pressings, closing_mm=[closing_mm(press) for press in pressings], E_range_MPa=E_range_MPa
        ),
        lambda: noise_findings(pressings),
    ]
    edges = partial(if_touch_is_seen, lambda: edge_findings(pressings))
    if vertices is None or faces is None:
        stages.append(edges)
    else:
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        size = float(np.ptp(vertices, axis=0).mean())
        stages += [
            lambda: jaw_findings(recording, pressings, centre_mm=centre, size_mm=size),
            partial(if_touch_is_seen, lambda: indentation_findings(pressings)),
            edges,
            partial(if_touch_is_seen, lambda: _on_the_fruit(pressings, vertices, faces, surface_sd_mm)),
        ]
    for stage in stages:
        findings += stage()
        if any(finding.refused for finding in findings):
            break
    return sorted(findings, key=lambda finding: (not finding.refused, finding.rank))


def _on_the_fruit(
    pressings: Sequence[Pressing],
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    surface_sd_mm: float,
) -> list[Finding]:
    """Findings of the pads' footprints on the mesh, or that another arrangement fits better."""
    prints = _prints(pressings, vertices, faces)
    if len(prints) < len(pressings):
        return []
    width = _width_mm(pressings, vertices, faces) if len(pressings) == 2 else None
    findings = footprint_findings(prints, width_mm=width, surface_sd_mm=surface_sd_mm)
    if len(pressings) != 2 or any(finding.kind is not FindingKind.PRINT_ASIDE for finding in findings):
        return findings
    if tilted(prints, surface_sd_mm) ** 2 < OTHERWISE:  # no arrangement can fit that much better
        return findings
    others = other_arrangements(pressings, vertices, faces)
    better = better_otherwise(prints, others, surface_sd_mm=surface_sd_mm)
    return findings if better is None else [better]


def _prints(
    pressings: Sequence[Pressing], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> list[Footprint]:
    """Of the pads that touch what they look at."""
    prints = [footprint(press, vertices, faces) for press in pressings]
    return [pad_print for pad_print in prints if pad_print is not None]


def other_arrangements(
    pressings: Sequence[Pressing], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> list[tuple[FindingKind, list[Footprint]]]:
    """The prints with each pad at the other's place, and on the mesh turned by a quarter about each axis."""
    left, right = pressings
    exchanged = (
        replace(left, pad=replace(left.pad, pose=right.pad.pose)),
        replace(right, pad=replace(right.pad, pose=left.pad.pose)),
    )
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    turned = [centre + (vertices - centre) @ turn for turn in QUARTERS]
    return [
        (FindingKind.PADS_EXCHANGED, _prints(exchanged, vertices, faces)),
        *((FindingKind.MESH_TURNED, _prints(pressings, places, faces)) for places in turned),
    ]


def _width_mm(
    pressings: Sequence[Pressing], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> float:
    """The mesh between the two pads: their distance in the first frame less what stands ahead of each."""
    poses = [pressing.pad.pose[0] for pressing in pressings]
    apart = float((poses[1][:3, 3] - poses[0][:3, 3]) @ poses[0][:3, 2])
    for press, pose in zip(pressings, poses, strict=True):
        places = press.pad.rest_mm[press.touched] @ pose[:3, :3].T + pose[:3, 3]
        apart -= float(np.nanmin(depth_along(places, pose[:3, 2], vertices[faces])))
    return apart
