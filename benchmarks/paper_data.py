"""The forward data of paper.py as the estimator gets them: markers with a place, a motion and a force.

The independent solver's patch nodes are halved by mirror planes and lie where its mesh has them. The planes
are undone, and every node's force goes to the markers of a regular grid over the patch, rim included, by the
grid's bilinear hat functions: total force and moment are kept to rounding, and a marker's force is the
traction times its cell, as a gel model with nodes at the markers gives it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fem.grasp_history import GraspHistory, PadHistory

HERE = Path(__file__).parent / "forward"
DISPLACEMENT_SD_MM, FORCE_SD_N = 5e-3, 1e-6
"""The data have no noise but the solver's rounding; the estimator wants a spread all the same."""


@dataclass(frozen=True, kw_only=True)
class Forward:
    """One solution: per pad its face's axis, centre, edge, motion at level 1, and node places and forces."""

    low_mm: np.ndarray
    high_mm: np.ndarray
    core: str
    core_size_mm: float
    core_centre_mm: np.ndarray
    base_fixed: bool
    levels: np.ndarray
    pads: tuple["PadData", ...]


@dataclass(frozen=True, kw_only=True)
class PadData:
    """The nodes of one patch, mirror planes undone: places (n, 3), forces (levels, n, 3)."""

    axis: int
    centre_mm: np.ndarray
    edge_mm: float
    move_mm: np.ndarray
    place_mm: np.ndarray
    force_N: np.ndarray


def forward(name: str) -> Forward:
    """The committed solution of that name."""
    with np.load(HERE / f"{name}.npz") as data:
        kept = {key: data[key] for key in data.files}
    pads = []
    for k, (axis, centre, edge, move) in enumerate(
        zip(kept["patch_axis"], kept["patch_centre_mm"], kept["patch_edge_mm"], kept["moves_mm"], strict=True)
    ):
        of_pad = kept["pad"] == k
        pads.append(
            PadData(
                axis=int(axis),
                centre_mm=centre,
                edge_mm=float(edge),
                move_mm=move,
                place_mm=kept["place_mm"][of_pad],
                force_N=kept["force_N"][:, of_pad].astype(float),
            )
        )
    for axis in kept["mirrors"]:
        pads = _mirrored(pads, np.where(np.arange(3) == axis, -1.0, 1.0))
    return Forward(
        low_mm=kept["low_mm"],
        high_mm=kept["high_mm"],
        core=str(kept["core"][0]),
        core_size_mm=float(kept["core_size_mm"]),
        core_centre_mm=kept["core_centre_mm"],
        base_fixed=name.startswith("press"),
        levels=kept["levels"],
        pads=tuple(pads),
    )


def _mirrored(pads: list[PadData], flip: np.ndarray) -> list[PadData]:
    """Each pad with its image; a pad that the plane cuts is completed, another one gets a twin."""
    mirrored = []
    for pad in pads:
        place, force = pad.place_mm * flip, pad.force_N * flip
        if np.allclose(pad.centre_mm * flip, pad.centre_mm):
            place, force = np.vstack([pad.place_mm, place]), np.concatenate([pad.force_N, force], axis=1)
            mirrored.append(replace(pad, place_mm=place, force_N=force))
        else:
            moved = {"centre_mm": pad.centre_mm * flip, "move_mm": pad.move_mm * flip}
            mirrored += [pad, replace(pad, place_mm=place, force_N=force, **moved)]
    return mirrored


def _hats(places: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Bilinear hat functions of the grid over `line` in both directions, at each of the places (n, 2)."""
    hat = np.maximum(0.0, 1 - np.abs(places[:, :, None] - line) / (line[1] - line[0]))
    return np.einsum("na,nb->nab", hat[:, 0], hat[:, 1]).reshape(len(places), -1)


def marker_grid(pad: PadData, *, cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Markers on a grid of so many cells along an edge: flat coordinates, places, forces (levels, n, 3)."""
    across = [k for k in range(3) if k != pad.axis]
    line = np.linspace(-pad.edge_mm / 2, pad.edge_mm / 2, cells + 1)
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    place = np.tile(pad.centre_mm, (len(flat), 1))
    place[:, across] += flat
    weight = _hats((pad.place_mm - pad.centre_mm)[:, across], line)
    return flat, place, np.einsum("nm,lnx->lmx", weight, pad.force_N)


def grasp_history(data: Forward, *, cells: int, levels: np.ndarray | slice = slice(None)) -> GraspHistory:
    """A frame at first touch, without load, and one per chosen level; the positions are exact."""
    steps = np.concatenate([[0.0], data.levels[levels]])
    pads = []
    for number, pad in enumerate(data.pads):
        flat, place, force = marker_grid(pad, cells=cells)
        pads.append(
            PadHistory(
                name=f"pad {number + 1}",
                rest_mm=np.column_stack([flat, np.zeros(len(flat))]),
                surface_mm=place,
                position_mm=place + steps[:, None, None] * pad.move_mm,
                gel_displacement_mm=np.zeros((len(steps), *place.shape)),
                force_N=np.concatenate([np.zeros((1, *place.shape)), force[levels]]),
                episode=np.zeros((len(steps), len(place)), dtype=np.int64),
                displacement_sd_mm=DISPLACEMENT_SD_MM,
                force_sd_N=FORCE_SD_N,
                lag1=0.0,
            )
        )
    return GraspHistory(time_s=np.arange(len(steps)) * 0.1, phase=("load",) * len(steps), pads=tuple(pads))


@dataclass(frozen=True, kw_only=True)
class Plates:
    """A ball between two plates: largest contact radius, one plate's approach and force, the markers."""

    radius_mm: float
    contact_mm: float
    approach_mm: float
    force_N: float
    history: GraspHistory


def between_plates(*, cells: int, angles: int = 64) -> Plates:
    """Markers on a square grid over the largest contact, so many cells from its middle to its rim.

    A marker's contact begins with the level whose circle reaches it. Forces on rings are spread over so many
    places around, then over the grid as above.
    """
    rows = np.loadtxt(HERE / "ball-between-plates.csv", delimiter=",", skiprows=1)
    levels = [rows[rows[:, 0] == contact] for contact in np.unique(rows[:, 0])]
    contact_mm, radius_mm = float(rows[:, 0].max()), float(rows[:, 3].max())
    line = np.arange(-cells - 1, cells + 2) * contact_mm / cells
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    r = np.linalg.norm(flat, axis=1)
    outward = flat / np.maximum(r, 1e-9)[:, None]
    turn = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    ways = np.column_stack([np.cos(turn), np.sin(turn)])
    place = np.column_stack([flat, np.sqrt(radius_mm**2 - r**2)])
    position, force, touching = [], [], []
    for level in levels:
        out, up = (np.interp(r, level[:, 2], level[:, k]) for k in (4, 5))
        position.append(place + np.column_stack([out[:, None] * outward, up]))
        seen = (level[:, 2, None, None] * ways).reshape(-1, 2)
        down = _hats(seen, line).T @ np.repeat(level[:, 7] / angles, angles)
        force.append(np.column_stack([np.zeros_like(flat), down]))
        touching.append(np.where(r < level[0, 0] + 1e-9, 0, -1))
    pads = tuple(
        PadHistory(
            name=name,
            rest_mm=np.column_stack([flat, np.zeros(len(flat))]),
            surface_mm=place * mirror,
            position_mm=np.stack(position) * mirror,
            gel_displacement_mm=np.zeros((len(levels), *place.shape)),
            force_N=np.stack(force) * mirror,
            episode=np.stack(touching),
            displacement_sd_mm=DISPLACEMENT_SD_MM / 5,
            force_sd_N=FORCE_SD_N,
            lag1=0.0,
        )
        for name, mirror in (("above", np.array([1.0, 1.0, 1.0])), ("below", np.array([1.0, 1.0, -1.0])))
    )
    phase = ("load",) * len(levels)
    return Plates(
        radius_mm=radius_mm,
        contact_mm=contact_mm,
        approach_mm=float(levels[-1][0, 1]),
        force_N=-float(levels[-1][:, 7].sum()),
        history=GraspHistory(time_s=np.arange(len(levels)) * 0.1, phase=phase, pads=pads),
    )
