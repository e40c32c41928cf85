"""What printed tags tell of a photo's optics: how far edges are smeared, and how bright the paper is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from recon.picture_values import sampled

STEPS = 33
"""Places across an edge, a sixteenth of the side before it to one behind: a few tenths of a pixel apart."""
ROWS = 9
"""Profiles along the middle half of an edge that are averaged against noise. Set by hand."""
LEAST_CONTRAST = 10.0
"""Grey levels between paper and print, of 255, from which an edge's width can be told. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class TagOptics:
    """Smear of edges (standard deviation, px), and median grey of the paper beside the tags (0 to 255)."""

    blur_px: float
    white: float


def tag_optics(grey: UInt8[np.ndarray, "h w"], corners: Float[np.ndarray, "t 4 2"]) -> TagOptics | None:
    """Edges from paper to a tag's black border, read across; None where no edge has contrast.

    A step smeared by a Gaussian of standard deviation s has its steepest slope (white - black) / (s sqrt(2
    pi)). The way across reaches a sixteenth of the tag's side, half of the narrowest printed cell, to each
    side; a smear of more than about half of that is read too small.
    """
    middle = corners.mean(axis=1, keepdims=True)
    a, b = corners, np.roll(corners, -1, axis=1)
    side = np.linalg.norm(b - a, axis=2, keepdims=True)
    out = (a + b) / 2 - middle
    out = out / np.linalg.norm(out, axis=2, keepdims=True)
    along = np.linspace(0.25, 0.75, ROWS)[:, None]
    across = np.linspace(-1, 1, STEPS)
    at = (a + 0 * b)[:, :, None, None] + along[..., None] * (b - a)[:, :, None, None]
    at = at + (across[:, None] * (side / 16)[:, :, None] * out[:, :, None])[:, :, None]
    profile = sampled(grey.astype(np.float32), at).reshape(-1, ROWS, STEPS).mean(axis=1)
    white, black = np.percentile(profile, [95, 5], axis=1)
    good = white - black > LEAST_CONTRAST
    if not good.any():
        return None
    step = side.reshape(-1) / 16 * (across[1] - across[0])
    slope = np.abs(np.diff(profile, axis=1)).max(axis=1) / step
    smear = (white - black)[good] / (slope[good] * np.sqrt(2 * np.pi))
    return TagOptics(blur_px=float(np.median(smear)), white=float(np.median(white[good])))
