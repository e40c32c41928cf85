"""The border to pytetwild: closed surfaces in, well-shaped straight tetrahedra between them out.

pytetwild and PyVista are imported when they are called: only what meshes a fruit needs them.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from functools import cache
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.tetrahedra import compact, pieces, signed_volumes_mm3


def simplified(
    vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, edge_mm: float
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]]:
    """The surface with fewer triangles, about edge_mm wide, its volume kept (quadric error, VTK).

    The mesher respects every input triangle, so a scan's thousands would cost ten times as much.
    """
    a, b, c = np.moveaxis(vertices_mm[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    wanted = max(area / (edge_mm**2 * np.sqrt(3) / 4), 64)
    if wanted >= len(faces):
        return vertices_mm, faces
    with _signals_wait():
        import pyvista

    surface = pyvista.PolyData.from_regular_faces(vertices_mm, faces)
    small = surface.decimate(1 - wanted / len(faces), volume_preservation=True)
    return np.asarray(small.points, dtype=float), np.asarray(small.regular_faces, dtype=np.int64)


def fill(
    surfaces: list[tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]]],
    *,
    edge_mm: float,
    envelope_mm: float,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 4"]]:
    """Tetrahedra, positively oriented, of the region that the surfaces bound together.

    The normals of an inner surface point into its hole, so that winding numbers leave the hole empty.
    The mesher shuffles with a seed from the machine's entropy, so two runs differ in their elements (by less
    than the discretisation error), not in their shape. Ctrl-C comes when it is done, within seconds. Raises
    FemFailure where nothing comes back.
    """
    vertices = np.vstack([v for v, _ in surfaces])
    start = np.cumsum([0, *(len(v) for v, _ in surfaces[:-1])])
    faces = np.vstack([f + at for (_, f), at in zip(surfaces, start, strict=True)]).astype(np.int32)
    diagonal_mm = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    _prepare_mesher()
    try:
        nodes, tets = _tetrahedralize(
            vertices,
            np.ascontiguousarray(faces),
            edge_length_abs=edge_mm,
            epsilon=envelope_mm / diagonal_mm,
            stop_energy=10.0,
        )
    except RuntimeError as error:
        raise FemFailure(
            FemProblem.MESHING_FAILED,
            f"the tetrahedral mesher failed on the surfaces: {error}; repair the mesh",
        ) from error
    if len(tets) == 0:
        raise FemFailure(
            FemProblem.MESHING_FAILED,
            "the tetrahedral mesher found no inside; check that the surface is closed",
        )
    backward = signed_volumes_mm3(nodes, tets) < 0
    tets[backward] = tets[backward][:, [0, 2, 1, 3]]
    nodes, tets = compact(nodes, tets)
    piece = pieces(tets, len(nodes))
    volume = np.bincount(piece, weights=signed_volumes_mm3(nodes, tets))
    if volume.max() < 0.999 * volume.sum():
        loose = int(np.argsort(volume)[-2])
        where = ", ".join(f"{x:.1f}" for x in nodes[np.unique(tets[piece == loose])].mean(axis=0))
        raise FemFailure(
            FemProblem.DISCONNECTED_FLESH,
            f"the flesh consists of {len(volume)} pieces (the largest has "
            f"{volume.max() / volume.sum():.1%} of the volume, the next {volume[loose]:.3g} mm3 "
            f"around ({where}) mm). "
            "Check for a pit that cuts through the fruit, or loose parts in the scan",
        )
    return compact(nodes, tets[piece == volume.argmax()])


def _prepare_mesher() -> None:
    """Import pytetwild and make its first call of this process on one tetrahedron (0.1 s).

    That call takes Ctrl-C away from Python, which is mended after it: if it were the one that meshes a fruit,
    Ctrl-C would end the run without a word meanwhile. Only the main thread can mend it.
    """
    with _signals_wait():
        import pytetwild  # noqa: F401
    if _in_main_thread():
        _first_call()


@cache
def _first_call() -> None:
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
    corners = np.vstack([np.zeros(3), np.eye(3)])
    _tetrahedralize(corners, sides, edge_length_abs=0.2, epsilon=0.1, simplify=False, optimize=False)


def _tetrahedralize(
    vertices: np.ndarray, faces: np.ndarray, **settings: float
) -> tuple[np.ndarray, np.ndarray]:
    """In a working directory to throw away: the mesher leaves a file in it."""
    import pytetwild

    with TemporaryDirectory() as scratch, chdir(scratch), _ctrl_c_kept():
        nodes, tets = pytetwild.tetrahedralize(vertices, faces, num_threads=1, quiet=True, **settings)
    return np.asarray(nodes, dtype=float), np.asarray(tets, dtype=np.int64)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def _ctrl_c_kept() -> Iterator[None]:
    """Python's own handler of SIGINT installed again afterwards; only the main thread may."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if _in_main_thread() and before is not None:
            signal.signal(signal.SIGINT, before)


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Signals that Python answers, while VTK is imported, come afterwards: an exception in the middle of it
    crashes the process.
    """
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    answered = [number for number in ends if _in_main_thread() and callable(signal.getsignal(number))]
    came: list[int] = []
    before = {number: signal.signal(number, lambda arrived, _: came.append(arrived)) for number in answered}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
