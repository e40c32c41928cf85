"""The flesh in pieces small enough for a processor's cache.

A law of the flesh is evaluated in all frames of a few hundred elements at once: its history (a plastic set, a
damage) is then an array of that piece alone. Frames are the last axis, so that operations on a component of a
tensor run over all of them together. Single precision is a thousand times finer than the iterations need.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.materials.strain_path import PathLaw, TangentLaw, Tensors
from fem.parallel_map import parallel_map
from fem.solid.strain_field import FleshStrain

ELEMENTS = 200
"""Elements in a piece."""


@dataclass(frozen=True, kw_only=True)
class Piece:
    """`tets`: mesh nodes of each element; `nodes`: all of them; `gather` sums elements' forces there."""

    tets: Int[np.ndarray, "m 10"]
    nodes: Int[np.ndarray, " n"]
    slope: Float[np.ndarray, "m 12 10"]
    weighted: Float[np.ndarray, "m 10 12"]
    volume_mm3: Float[np.ndarray, "m 4"]
    gather: csr_array

    def gradient(self, displacement: Float[np.ndarray, "n d"], frames: int) -> Tensors:
        """Of nodal displacements, with x, y and z in all frames side by side."""
        return np.asarray((self.slope @ displacement[self.tets]).reshape(len(self.tets), 4, 3, 3, frames))

    @np.errstate(over="ignore", invalid="ignore")
    def forces(self, stress: Tensors) -> Float[np.ndarray, "n d"]:
        """On `nodes`; not finite if the iteration for the displacement has diverged."""
        by_element = self.weighted @ stress.reshape(len(stress), 12, -1)
        return np.asarray(self.gather @ by_element.reshape(-1, by_element.shape[2]))


@dataclass(frozen=True, kw_only=True)
class FleshPieces:
    """Pieces of a mesh of `n_nodes`, evaluated by so many threads."""

    n_nodes: int
    pieces: tuple[Piece, ...]
    workers: int

    @classmethod
    def of(cls, points: FleshStrain, *, workers: int = 1) -> "FleshPieces":
        """All elements of a mesh."""
        elements = np.arange(len(points.mesh.tets))
        parts = np.array_split(elements, -(-len(elements) // ELEMENTS))
        return cls(
            n_nodes=points.n_nodes, pieces=tuple(_piece(points, part) for part in parts), workers=workers
        )

    def forces(
        self,
        displacement: Float[np.ndarray, "f n 3"],
        law: PathLaw,
        *,
        weight: Float[np.ndarray, "m 4"] | None = None,
    ) -> Float[np.ndarray, "f n 3"]:
        """On all nodes, from the law's stress times the points' `weight` (None: one)."""
        flat = _frames_last(displacement)
        weights = [None] * len(self.pieces) if weight is None else self._split(weight)

        def of_piece(number: int) -> Float[np.ndarray, "n d"]:
            piece, share = self.pieces[number], weights[number]
            stress = law(piece.gradient(flat, len(displacement)))
            return piece.forces(stress if share is None else share[:, :, None, None, None] * stress)

        return self._summed(of_piece, len(displacement))

    def tangent(
        self, displacement: Float[np.ndarray, "f n 3"], law: TangentLaw
    ) -> Callable[[Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]:
        """Derivative of a law's nodal forces at a displacement, as a function of the direction."""
        frames, at = len(displacement), _frames_last(displacement)
        maps = parallel_map(lambda piece: law(piece.gradient(at, frames)), self.pieces, workers=self.workers)

        def forces(direction: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
            along = _frames_last(direction)

            def of_piece(number: int) -> Float[np.ndarray, "n d"]:
                piece = self.pieces[number]
                return piece.forces(maps[number](piece.gradient(along, frames)))

            return self._summed(of_piece, frames)

        return forces

    def _summed(
        self, of_piece: Callable[[int], Float[np.ndarray, "_n _d"]], frames: int
    ) -> Float[np.ndarray, "f n 3"]:
        """Forces of all pieces on the mesh's nodes."""
        total = np.zeros((self.n_nodes, 3 * frames), dtype=np.float32)
        forces = parallel_map(of_piece, range(len(self.pieces)), workers=self.workers)
        with np.errstate(over="ignore", invalid="ignore"):
            for piece, force in zip(self.pieces, forces, strict=True):
                total[piece.nodes] += force
        return np.ascontiguousarray(np.moveaxis(total.reshape(-1, 3, frames), 2, 0), dtype=np.float64)

    def _split(self, weight: Float[np.ndarray, "m 4"]) -> list[Float[np.ndarray, "_m 4"]]:
        """By pieces, in single precision."""
        ends = np.cumsum([len(piece.tets) for piece in self.pieces])[:-1]
        return np.split(weight.astype(np.float32), ends)

    @property
    def volume_mm3(self) -> Float[np.ndarray, "m 4"]:
        """Of the points of all pieces, one after the other."""
        return np.concatenate([piece.volume_mm3 for piece in self.pieces])

    def measured(
        self,
        displacement: Float[np.ndarray, "f n 3"],
        measure: Callable[[Tensors], Float[np.ndarray, "m 4 f"]],
    ) -> Float[np.ndarray, "m 4 f"]:
        """A measure of the displacement gradient at the points of all pieces."""
        frames, flat = len(displacement), _frames_last(displacement)
        return np.concatenate(
            parallel_map(
                lambda piece: measure(piece.gradient(flat, frames)), self.pieces, workers=self.workers
            )
        )


def _piece(points: FleshStrain, elements: Int[np.ndarray, " m"]) -> Piece:
    """The arrays of one piece, its own elements given; slopes and weights in single precision."""
    tets = points.mesh.tets[elements]
    nodes, local = np.unique(tets, return_inverse=True)
    slope = points.slope[elements].astype(np.float32)
    volume = points.volume_mm3[elements]
    weighted = (slope * volume[..., None, None].astype(np.float32)).reshape(-1, 12, 10)
    ones = np.ones(tets.size, dtype=np.float32)
    return Piece(
        tets=tets,
        nodes=nodes,
        slope=slope.reshape(-1, 12, 10),
        weighted=np.ascontiguousarray(np.swapaxes(weighted, 1, 2)),
        volume_mm3=volume,
        gather=csr_array((ones, (local.ravel(), np.arange(tets.size))), shape=(len(nodes), tets.size)),
    )


def _frames_last(displacement: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "n d"]:
    return np.ascontiguousarray(np.moveaxis(displacement, 0, 2), dtype=np.float32).reshape(
        displacement.shape[1], -1
    )


def exceeded_by(
    share: float, values: Float[np.ndarray, "m 4"], volume_mm3: Float[np.ndarray, "m 4"]
) -> float:
    """The value that this share of the volume exceeds."""
    order = np.argsort(-values, axis=None)
    filled = np.cumsum(volume_mm3.ravel()[order])
    return float(values.ravel()[order][np.searchsorted(filled, share * filled[-1])])
