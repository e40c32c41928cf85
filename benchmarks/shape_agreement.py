"""How well a mesh agrees with masks of its pictures: overlap, and the distance between the rims."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from public_sets import (
    View,
)

from recon.silhouettes.hull import drawn

Mesh = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class ShapeAgreement:
    """Mesh against masks: mean overlap, and the distance between their rims, px."""

    overlap: float
    median_px: float
    mean_px: float
    p95_px: float
    outward_px: float


def agreement(mesh: Mesh, views: Sequence[View]) -> ShapeAgreement:
    """Overlap in the mean of the views; rims both ways, all views' pixels together."""
    overlaps, away, signed = [], [], []
    for v in views:
        shadow = drawn(*mesh, v.window, v.camera)
        overlaps.append((shadow & v.mask).sum() / max((shadow | v.mask).sum(), 1))
        to_mask, to_shadow = _signed_px(v.mask), _signed_px(shadow)
        here, there = 0.5 - to_mask[_rim(shadow)], to_shadow[_rim(v.mask)] - 0.5
        away += [np.abs(here), np.abs(there)]
        signed += [here, there]
    every = np.concatenate(away)
    return ShapeAgreement(
        overlap=float(np.mean(overlaps)),
        median_px=float(np.median(every)),
        mean_px=float(every.mean()),
        p95_px=float(np.percentile(every, 95)),
        outward_px=float(np.concatenate(signed).mean()),
    )


def rims(name: str, mesh: Mesh, views: Sequence[View]) -> str:
    """A line that says so."""
    if not views:
        return f"{name:14}"
    a = agreement(mesh, views)
    return (
        f"{name:14} overlap {a.overlap:.4f}  rims {a.median_px:.2f} px, 95 % {a.p95_px:.2f}, "
        f"outward {a.outward_px:+.2f}"
    )


def _signed_px(mask: np.ndarray) -> np.ndarray:
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    outside = cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.where(mask, inside - 0.5, 0.5 - outside)


def _rim(mask: np.ndarray) -> np.ndarray:
    whole_px = mask.astype(np.uint8)
    return np.asarray((whole_px - cv2.erode(whole_px, np.ones((3, 3), np.uint8))) > 0)
