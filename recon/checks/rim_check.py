"""Does every photo show the mesh where it should? Colour steps are sought about the mesh's own rim, anew."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.cameras.camera import Camera
from recon.picture_values import sampled
from recon.silhouettes.outline import resampled
from recon.wording import listed

SAMPLES = 180
"""Places along the rim: every two degrees."""
REACH = 0.1
"""Reach of the search about the rim, over the fruit's width; meshes farther off are refused. By hand."""
STEP_PX = 0.5
"""px between the places looked at: half a pixel."""
LEAST_STEP = 6.0
"""CIE Lab units of a step that counts: above noise and grain of a blurred photo. Set by hand."""
FEWEST_STEPS = 40
"""Of SAMPLES: below it a photo tells nothing of the mesh. Set by hand."""
NEAR_PX = 2.5
"""px within which a step belongs to the shifted rim. Set by hand."""
APART = 0.01
"""Over the fruit's width, from where on a photo disagrees: 0.6 mm on 60. Set by hand."""
LEAST_PX = 1.5
"""And px at least, as rims are found to about one. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class RimOffset:
    """A photo's fruit: moved by `shift_px`, larger in radius by `growth_px`; `apart` in diameters."""

    name: str
    shift_px: float
    growth_px: float
    apart: float


def rim_offset(
    image: UInt8[np.ndarray, "h w 3"], camera: Camera, vertices: Float[np.ndarray, "n 3"]
) -> RimOffset | None:
    """The rim's shift and growth that bring it onto the photo's colour steps; None for too few steps.

    The rim is the convex hull of the projected vertices. On its normals, within a tenth of its diameter,
    steps of colour (CIE Lab) are sought; their offsets s are fitted by s = n . shift + growth, once from the
    strongest steps, once from those near the rim, with Cauchy's weights; the fit that more normals hold to
    counts, so that tags, shadows and highlights do not. The camera has no distortion.
    """
    hull = cv2.convexHull(camera.project(vertices).astype(np.float32))[:, 0].astype(float)
    rim, length_px = resampled(hull, SAMPLES)
    ahead = np.roll(rim, -2, 0) - np.roll(rim, 2, 0)
    normal = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
    normal *= np.sign(np.sum(normal * (rim - rim.mean(0)), axis=1).mean())
    size = length_px / np.pi
    reach = max(REACH * size, 4.0)
    offsets = np.arange(-reach, reach + STEP_PX, STEP_PX)
    place = rim[:, None] + offsets[:, None] * normal[:, None]
    low = np.floor(place.min((0, 1))).astype(int) - 4
    high = np.ceil(place.max((0, 1))).astype(int) + 5
    if (low < 0).any() or (high > [camera.width_px, camera.height_px]).any():
        return None
    part = image[low[1] : high[1], low[0] : high[0]].astype(np.float32) / 255
    colours = cv2.GaussianBlur(cv2.cvtColor(part, cv2.COLOR_BGR2Lab), (0, 0), 1.0)
    profile = sampled(colours, place - low)
    steps = np.asarray(np.linalg.norm(profile[:, 4:] - profile[:, :-4], axis=2), float)
    columns = np.column_stack([normal, np.ones(SAMPLES)])
    tried = [_held(np.zeros(3), steps, offsets[2:-2], columns), _held(None, steps, offsets[2:-2], columns)]
    fit, held = max(tried, key=lambda pair: pair[1])
    if held < FEWEST_STEPS:
        return None
    shift, growth = float(np.linalg.norm(fit[:2])), float(fit[2])
    return RimOffset(
        name=camera.name, shift_px=shift, growth_px=growth, apart=max(shift, 2 * abs(growth)) / size
    )


def _held(
    start: Float[np.ndarray, "3"] | None,
    steps: Float[np.ndarray, "n k"],
    offsets: Float[np.ndarray, " k"],
    columns: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3"], int]:
    """A fit from `start` or the strongest steps, and how many normals have a step within a pixel."""
    if start is None:
        best = steps.argmax(axis=1)
        clear = steps[np.arange(len(steps)), best] > LEAST_STEP
        fit, weight = np.zeros(3), clear.astype(float)
        for _ in range(12):
            fit = np.linalg.lstsq(columns * weight[:, None], offsets[best] * weight, rcond=None)[0]
            away = np.abs(offsets[best] - columns @ fit)
            scale = max(1.5 * float(np.median(away[clear])) if clear.any() else 0.5, 0.5)
            weight = clear / np.sqrt(1 + (away / scale) ** 2)
    else:
        fit = start
    held = 0
    for _ in range(6):
        near = np.abs(offsets - (columns @ fit)[:, None]) <= NEAR_PX
        best = np.where(near, steps, -1).argmax(axis=1)
        away = np.abs(offsets[best] - columns @ fit)
        good = (steps[np.arange(len(steps)), best] > LEAST_STEP) & (away < NEAR_PX)
        held = int((good & (away < 1)).sum())
        if good.sum() < FEWEST_STEPS:
            break
        weight = good / np.sqrt(1 + away**2)
        fit = np.linalg.lstsq(columns * weight[:, None], offsets[best] * weight, rcond=None)[0]
    return fit, held


def rim_doubts(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    cameras: Sequence[Camera],
    vertices: Float[np.ndarray, "n 3"],
) -> tuple[str, ...]:
    """A sentence that names the photos whose fruit lies elsewhere, or is of another size, than the mesh.

    What counts is more than 1 % of the diameter and 1.5 px.
    """
    offsets = (rim_offset(i, c, vertices) for i, c in zip(images, cameras, strict=True))
    largest = float(np.ptp(vertices, axis=0).max())
    odd = [
        o
        for o in offsets
        if o is not None and o.apart > APART and max(o.shift_px, abs(o.growth_px)) > LEAST_PX
    ]
    odd.sort(key=lambda o: -o.apart)
    if not odd:
        return ()
    misses = listed([f"{o.name} by {o.apart * largest:.1f} mm" for o in odd])
    noun = "1 photo" if len(odd) == 1 else f"{len(odd)} photos"
    return (
        f"In {noun} the fruit has another position or size than in the other photos ({misses}). "
        "Somebody moved or changed the fruit, an object hides its edge, or the zoom changed. "
        "Photograph it again without touching it.",
    )
