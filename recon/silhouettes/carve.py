"""A first, coarse fruit: cells of a working volume that nearly all views take for fruit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from recon.cameras.camera import Camera
from recon.silhouettes.mask import Window

CELLS = 44
"""Along the longest side of the working volume: enough for a first place and size. Set by hand."""
AGREEMENT = 0.85
"""Share of the views that must take a cell for fruit: some may err. Set by hand."""


@dataclass(frozen=True)
class Block:
    """Cells of a box that are fruit: `filled[i, j, k]` at `low + (i + ½, j + ½, k + ½) cell`."""

    filled: Bool[np.ndarray, "a b c"]
    low_mm: Float[np.ndarray, "3"]
    cell_mm: float

    @property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """Centres of the filled cells."""
        return np.asarray(self.low_mm + (np.argwhere(self.filled) + 0.5) * self.cell_mm)

    def with_column(self, *, reach: int) -> "Block":
        """This block grown by `reach` cells, and everything straight below it, down to the box's floor."""
        wide = np.pad(self.filled, ((reach, reach), (reach, reach), (0, reach)))
        grown = ndimage.binary_dilation(wide, ndimage.generate_binary_structure(3, 1), iterations=reach)
        grown = np.flip(np.logical_or.accumulate(np.flip(grown, axis=2), axis=2), axis=2)
        low = self.low_mm - reach * self.cell_mm * np.array([1, 1, 0])
        return Block(np.asarray(grown), low, self.cell_mm)


def carve(
    masks: Sequence[Bool[np.ndarray, "_ _"]],
    windows: Sequence[Window],
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    agreement: float = AGREEMENT,
) -> Block:
    """The largest connected set of cells inside the masks of a share `agreement` of the views that show them.

    Voting instead of strict intersection keeps one bad mask from eating the fruit.
    """
    cell = float((high_mm - low_mm).max()) / CELLS
    shape = np.maximum(np.ceil((high_mm - low_mm) / cell).astype(int), 1)
    centres = low_mm + (np.indices(shape).reshape(3, -1).T + 0.5) * cell
    inside, asked = np.zeros(len(centres)), np.zeros(len(centres))
    for mask, window, camera in zip(masks, windows, cameras, strict=True):
        at = np.rint(window.into_small(camera.project(centres))).astype(int)
        ok = (at >= 0).all(1) & (at[:, 0] < mask.shape[1]) & (at[:, 1] < mask.shape[0])
        inside[ok] += mask[at[ok, 1], at[ok, 0]]
        asked += ok
    votes = (inside >= agreement * asked) & (asked >= max(3, 0.4 * len(cameras)))
    parts, count = ndimage.label(votes.reshape(shape))
    if count == 0:
        return Block(np.zeros(shape, bool), low_mm, cell)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    filled = ndimage.binary_fill_holes(parts == sizes.argmax())
    return Block(np.asarray(filled), low_mm, cell)
