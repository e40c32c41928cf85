"""Is the mesh as large as staff measured, and as fruit of this kind grow? Each no is a sentence for staff."""

from collections.abc import Iterator
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import MeshRecord
from recon.pit.priors import STONE_FRUIT, PitBody, PitPrior
from recon.triangle_mesh import volume_mm3

CALLIPER_SD_MM = 0.2
"""Standard deviation, mm, of a diameter taken by calliper on soft skin (estimate)."""
LEAST_APART_MM = 0.7
"""mm: below it a stem or a leaning fruit explains the difference (estimate)."""
LEAST_APART = 0.02
"""Share of the measured size below which the same is so (estimate)."""


def size_doubts(
    given: Given,
    mesh: MeshRecord,
    prior: PitPrior | None,
    *,
    on_mat: bool,
    by_coin: bool = False,
    body: PitBody = STONE_FRUIT,
) -> list[str]:
    """Sentences where height, diameter or mass of fruits.csv, or the category, contradict the mesh.

    A length is contradicted where it differs by more than three standard deviations of calliper, surface and
    scale together, and by more than 2 % and 0.7 mm. What size rests on without a second source is said too.
    """
    wrong = [*_lengths(given, mesh, on_mat=on_mat), *_mass(given, mesh, body), *_kind(mesh, prior)]
    check = _what_to_check(given, mesh, on_mat=on_mat)
    return [*(f"{doubt}: {check}" for doubt in wrong), *_alone(given, mesh, on_mat or by_coin)]


def measured(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    source: Literal["photos", "fruit.ply"],
) -> MeshRecord:
    """Counts, size and volume of a surface (mm), with nothing known of its quality."""
    box = np.ptp(vertices, axis=0).tolist()
    return MeshRecord(
        source=source,
        vertices=len(vertices),
        faces=len(faces),
        volume_mm3=volume_mm3(vertices, faces),
        height_mm=box[2],
        box_mm=tuple(box),
    )


def _what_to_check(given: Given, mesh: MeshRecord, *, on_mat: bool) -> str:
    """What the mesh's size rests on, and the unit."""
    if mesh.source == "fruit.ply":
        return "check the units (mm, g), and that the mesh is in mm, with z up, and of this fruit."
    if on_mat:
        return (
            "check the units (mm, g), the photos of this fruit, and the mat. mat.json must describe the "
            "mat as it was printed (its 100 mm bar must measure 100 mm)."
        )
    return (
        f"check the units (mm, g), the photos of this fruit, and height_mm ({given.height_mm:g}), "
        "which scales the mesh."
    )


def _lengths(given: Given, mesh: MeshRecord, *, on_mat: bool) -> Iterator[str]:
    """A sentence for each length of fruits.csv from which the mesh is further than the tolerance."""
    checked = on_mat or mesh.source == "fruit.ply"
    wide = sorted(mesh.box_mm[:2])
    for name, measured, low, high, what in (
        ("height_mm", given.height_mm if checked else None, mesh.height_mm, mesh.height_mm, "high"),
        ("diameter_mm", given.diameter_mm, wide[0], wide[1], "wide"),
    ):
        if measured is None:
            continue
        apart = max(low - measured, measured - high, 0.0)
        if apart <= tolerance_mm(measured, mesh):
            continue
        mesh_length = f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"
        yield (
            f"The mesh is {mesh_length} mm {what}, but fruits.csv says {name} {measured:g} "
            f"({100 * apart / measured:.1f} % difference)"
        )


def tolerance_mm(measured_mm: float, mesh: MeshRecord) -> float:
    """How far a calliper and the mesh may differ before one of them is thought wrong."""
    scale_sd = mesh.scale_sd if mesh.scale_sd is not None and np.isfinite(mesh.scale_sd) else 0.0
    sd = np.sqrt(CALLIPER_SD_MM**2 + (mesh.surface_sd_mm or 0.0) ** 2 + (scale_sd * measured_mm) ** 2)
    return float(max(3 * sd, LEAST_APART_MM, LEAST_APART * measured_mm))


def _mass(given: Given, mesh: MeshRecord, body: PitBody) -> Iterator[str]:
    if given.mass_g is None:
        return
    density = 1000 * given.mass_g / mesh.volume_mm3
    least, most = body.density_g_per_cm3
    if not least <= density <= most:
        yield (
            f"The mesh holds {mesh.volume_mm3 / 1000:.1f} cm³ and fruits.csv says mass_g "
            f"{given.mass_g:g}: the density would be {density:.2f} g/cm³, expected {least:.2f} to "
            f"{most:.2f}"
        )


def _kind(mesh: MeshRecord, prior: PitPrior | None) -> Iterator[str]:
    if prior is None or prior.fruit_mm is None:
        return
    low, high = prior.fruit_mm
    size = float(np.cbrt(np.prod(mesh.box_mm)))
    if not low <= size <= high:
        yield (f"The mean size of the mesh is {size:.1f} mm; a {prior.category} has {low:g} to {high:g} mm")


def _alone(given: Given, mesh: MeshRecord, checked: bool) -> Iterator[str]:
    if mesh.source == "photos" and not checked and given.diameter_mm is None and given.mass_g is None:
        yield (
            f"The size depends on height_mm ({given.height_mm:g}) alone; an error of one percent "
            "changes the volume by three. To detect errors, fill diameter_mm or mass_g, use a coin "
            "([photos] coin), or use the mat."
        )
