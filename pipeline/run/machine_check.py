"""`drupe doctor`: checks what a run needs of the machine, and a small computation with a known result."""

import importlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from fem.mesh.flesh_mesh import tetrahedralise
from fem.mesh.surface_points import skin_quadrature
from fem.solid.closed_forms import cored_sphere_shrinkage_mm
from fem.solid.linear_solid import UnitModulusSolid
from pipeline.batch.provenance import versions
from pipeline.files.limited_memory import free_memory_MiB
from pipeline.run.memory import LEAST_MIB, PER_FRUIT_MIB
from pipeline.system_libraries import missing_libraries
from recon.silhouettes.hull import ball

IMPORTED = ("cv2", "open3d", "manifold3d", "pytetwild", "onnxruntime", "h5py")
"""Libraries with native code, which may lack a shared library that they load."""
OPTIONAL = {
    "pycolmap": "photos without a mat then need a textured ground; photos with the mat need no pycolmap.",
    "pymeshlab": "Open3D then repairs and decimates surfaces; they differ by micrometres.",
    "pymetis": "sparse factorisations then take 1.3 to 2.5 times as long; results are the same.",
}
"""Libraries that some computers have no wheel for, and what their absence costs. Times: cubes of 14,000 and
148,000 unknowns, CPU seconds of one thread (docs/decisions/0002-our-own-sparse-solver.md)."""
SKIN_MM, CORE_MM, RATIO, EDGE_MM = 25.0, 10.0, 0.45, 7.0
"""Ball of the computation: radii of its skin and of its rigid core, Poisson's ratio, edges of elements."""
WITHIN = 0.01
"""Accepted relative error of the computation; the facets alone cause half a per cent."""
LEAST_DISK_MB = 500.0
"""Free disk below which drupe warns: stages of one fruit take 20 MB, photos' scratch files 200. Assumed."""


def parts_check(folder: Path, *, cores: int, missing: list[str]) -> Iterator[str]:
    """Lines on libraries, threads, memory, and the disks of `folder` and of temporary files; `missing` gets a
    sentence for each thing that is missing.
    """
    yield ", ".join(f"{name} {value}" for name, value in versions().items())
    missing += missing_libraries()
    for name in IMPORTED:
        try:
            importlib.import_module(name)
        except Exception as error:  # noqa: BLE001 - whatever a native wheel raises where it cannot be loaded
            missing.append(f"{name} does not load ({error}); install drupe again in a new environment.")
    for name, cost in OPTIONAL.items():
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            yield f"optional library {name} does not load ({error}): {cost}"
    pools = sorted({f"{pool['internal_api']} {pool['num_threads']}" for pool in threadpool_info()})
    yield f"cores: {cores}; threads of libraries: {', '.join(pools) or 'not known'}"
    free_MiB, need_MiB = free_memory_MiB(), PER_FRUIT_MIB["photos"]
    if free_MiB is None:
        yield "memory: unknown on this system"
    else:
        yield f"memory: {free_MiB:.0f} MiB free; one fruit with photos needs {need_MiB:.0f} MiB"
        if free_MiB < LEAST_MIB:
            missing.append(f"memory: {free_MiB:.0f} MiB free, expected at least {LEAST_MIB:.0f}.")
    for what, wanted in (("results", folder), ("temporary files", Path(tempfile.gettempdir()))):
        place = next(path for path in (wanted.absolute(), *wanted.absolute().parents) if path.is_dir())
        free_MB = shutil.disk_usage(place).free / 1e6
        yield f"disk for {what} ({place}): {free_MB / 1e3:.1f} GB free"
        if free_MB < LEAST_DISK_MB:
            missing.append(f"disk for {what} ({place}): only {free_MB:.0f} MB free; free some space.")
        if not os.access(place, os.W_OK):
            missing.append(f"permission to write into {place} (for {what}); choose another folder.")


def computation_check() -> tuple[str, str]:
    """The result of a small computation, and a sentence on what is wrong with it; empty: nothing."""
    began = time.perf_counter()
    off = known_answer_error()
    line = (
        f"test problem (ball with a rigid core under uniform pressure): deviation {100 * off:+.2f} % "
        f"from the closed form, in {time.perf_counter() - began:.1f} s"
    )
    if abs(off) < WITHIN:
        return line, ""
    return line, (
        f"finite elements deviate by {100 * off:+.1f} % from a closed form, expected less than "
        f"{100 * WITHIN:g} %. Install drupe again in a new environment, and report it if the error remains."
    )


def known_answer_error() -> float:
    """Relative error of the shrinkage of a ball round a rigid core against Lame's closed form, with TetWild's
    mesh and the multifrontal solver.
    """
    (skin, skin_faces), (core, core_faces) = ball(3), ball(2)
    mesh = tetrahedralise(SKIN_MM * skin, skin_faces, CORE_MM * core, core_faces, edge_mm=EDGE_MM)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=RATIO, support="free")
    points, area_mm2 = skin_quadrature(mesh)
    moved = solid.displacement(points.point_load((-area_mm2[:, None] * points.normal)[None]))
    inward = -(points.sample(moved)[0] * points.normal).sum(axis=1)
    exact = cored_sphere_shrinkage_mm(
        E_MPa=1.0, poisson_ratio=RATIO, core_radius_mm=CORE_MM, radius_mm=SKIN_MM, pressure_MPa=1.0
    )
    return float(np.average(inward, weights=area_mm2) / exact - 1.0)
