"""A look-up of slopes from pictures of a ball of known radius pressed into the gel.

Inside the contact the face is the ball: at distance x from its centre the slope is x / sqrt(R^2 - x^2). The
centre is where the colours do not change (a linear fit in the middle of the print, repeated), the rim of the
contact where the fitted slope is greatest; what lies beyond 0.85 of that is not used. How deep the ball went
scales x by the perspective, two percent: the look-up's own depth at the centre says it, by repetition.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from tactile.gel.photometric import PhotometricDepth, SlopeLookup, fitted_lookup
from tactile.gel_camera import on_face, project
from tactile.sensors import GelCamera
from tactile.tactile_failure import TactileFailure, TactileProblem

INSIDE = 0.85
"""Share of the contact's radius that is used: at its rim the gel bends away from the ball."""
LEAST_CHANGE = 0.15
"""Relative change of brightness that shows a print. Set by hand."""
LIT = 0.2
"""Of the gel's brightness (its 95th percentile on the reference): darker blocks are beside the gel, where
relative changes are noise. The corners of eight real gels have 0.27 to 0.36."""
FEWEST_BLOCKS = 60
"""Blocks of 4 x 4 pixels that a print must cover: three for each of the look-up's 20 terms."""
LIKE_A_BALL = 0.85
"""Share of the colours' variance within the print that must go with the place as a ball's does (linear about
its centre): drawn balls have 0.994 and more, a soft stain that passes all else 0.70. Set by hand between."""
DEPTH_SHARES = (0.3, 3.0)
"""Depth by the look-up over that of a ball whose contact is so wide, which is contact^2 / 2R (the cap alone)
to contact^2 / R (Hertz): the first times the least, the second times the largest. Set by hand."""
ROUNDS = 6
"""Of centre and contact, each from the other. Set by hand."""
DEPTH_ROUNDS = 3
"""Of slope and depth: depth scales x by two percent, the second round by a fiftieth of that."""


@dataclass(frozen=True, kw_only=True)
class BallPrint:
    """One press: where the ball touched (mm, gel frame), contact radius, depth, and colours with slopes."""

    centre_mm: Float[np.ndarray, "2"]
    contact_mm: float
    depth_mm: float
    change: Float[np.ndarray, "m 3"]
    slopes: Float[np.ndarray, "m 2"]


def ball_print(
    camera: GelCamera,
    reference: UInt8[np.ndarray, "h w 3"],
    image: UInt8[np.ndarray, "h w 3"],
    *,
    radius_mm: float,
    source: str,
    gamma: float = 1.0,
) -> BallPrint:
    """Find the ball in `image`; `source` is how a failure names the picture.

    Raises TactileFailure (unreadable-frames) where no print is seen (nothing changed by 15 %), or what is
    seen is no ball's: wider than the ball, too small, without a ball's colours, or of a depth that its width
    contradicts.
    """
    uncalibrated = SlopeLookup(coefficients=np.zeros((1, 2)))
    shading = PhotometricDepth(camera, reference, uncalibrated, gamma=gamma)
    change = shading.change(image).reshape(-1, 3)
    face = on_face(camera, shading.pixels.reshape(-1, 2))[:, :2]
    lit = _lit(reference, shading)
    change_size = np.where(lit, np.linalg.norm(change, axis=1), 0.0)
    if change_size.max() < LEAST_CHANGE:
        raise TactileFailure(
            TactileProblem.UNREADABLE_FRAMES,
            f"{source}: colours change by at most {100 * change_size.max():.1f} %, expected a ball's "
            f"imprint of {radius_mm:g} mm; press deeper, or check that the reference is of the same "
            "sensor",
        )
    strong = change_size > 0.5 * change_size.max()
    centre = np.average(face[strong], axis=0, weights=change_size[strong])
    reach = 0.7 * float(np.sqrt(strong.sum() * _area(face, shading) / np.pi))
    contact = reach
    for _ in range(ROUNDS):
        arm = face - centre
        distance = np.linalg.norm(arm, axis=1)
        near = lit & (distance < reach)
        if near.sum() < FEWEST_BLOCKS:
            raise _no_ball(source, f"an imprint of {16 * near.sum()} pixels", radius_mm)
        basis = np.column_stack([arm, np.ones(len(arm)), distance**2])
        fit = np.linalg.lstsq(basis[near], change[near], rcond=None)[0]
        centre = centre - np.linalg.lstsq(fit[:2].T, fit[2], rcond=None)[0]
        towards = (change - distance[:, None] ** 2 * fit[3]) @ np.linalg.pinv(fit[:2])
        outward = (towards * arm).sum(axis=1) / np.maximum(distance, 1e-9)
        contact = _highest(distance[lit], outward[lit], within=4.0 * reach)
        reach = INSIDE * contact
    if not reach < radius_mm:
        raise TactileFailure(
            TactileProblem.UNREADABLE_FRAMES,
            f"{source}: found an imprint of {reach:.2f} mm, expected less than the ball's radius of "
            f"{radius_mm:g} mm; give the radius (not the diameter) in mm, and press less deeply",
        )
    near = lit & (distance < reach)
    explained = _explained(basis[near], change[near])
    if near.sum() < FEWEST_BLOCKS or explained < LIKE_A_BALL:
        fault = (
            f"an imprint of {16 * near.sum()} pixels whose colours explain only {explained:.0%} of a "
            "ball's slopes"
        )
        raise _no_ball(source, fault, radius_mm)
    deep, eye = contact**2 / radius_mm, camera.gel_from_camera[2, 3]
    middle = project(camera, np.append(centre, 0.0)[None])
    for _ in range(DEPTH_ROUNDS):
        height = deep - distance[near, None] ** 2 / (2.0 * radius_mm)
        x = (face[near] - centre) * (1.0 + height / eye)
        slopes = x / np.sqrt(radius_mm**2 - (x**2).sum(axis=1, keepdims=True))
        shading = PhotometricDepth(camera, reference, fitted_lookup(change[near], slopes), gamma=gamma)
        deep = -float(shading.at(image, middle)[0, 2])
    low, high = DEPTH_SHARES[0] * contact**2 / (2 * radius_mm), DEPTH_SHARES[1] * contact**2 / radius_mm
    if not low <= deep <= high:
        fault = (
            f"an imprint {2 * contact:.1f} mm wide and {deep:.2f} mm deep, where {low:.2f} to "
            f"{high:.2f} mm fit"
        )
        raise _no_ball(source, fault, radius_mm)
    return BallPrint(centre_mm=centre, contact_mm=contact, depth_mm=deep, change=change[near], slopes=slopes)


def ball_lookup(prints: Sequence[BallPrint]) -> SlopeLookup:
    """The look-up that several presses give together."""
    return fitted_lookup(
        np.concatenate([p.change for p in prints]), np.concatenate([p.slopes for p in prints])
    )


def _no_ball(source: str, fault: str, radius_mm: float) -> TactileFailure:
    return TactileFailure(
        TactileProblem.UNREADABLE_FRAMES,
        f"{source}: found {fault}, expected the imprint of a ball of {radius_mm:g} mm, fully within "
        "the picture; press one ball into the middle of the gel, under the lighting of the reference",
    )


def _lit(reference: UInt8[np.ndarray, "h w 3"], shading: PhotometricDepth) -> Bool[np.ndarray, " m"]:
    """The blocks that the gel fills: where a camera sees past it, the picture is dark."""
    rows, columns = shading.pixels.shape[:2]
    bright = cv2.resize(reference.max(axis=2), (columns, rows), interpolation=cv2.INTER_AREA).ravel()
    return np.asarray(bright > LIT * np.quantile(bright, 0.95))


def _explained(basis: Float[np.ndarray, "m k"], change: Float[np.ndarray, "m 3"]) -> float:
    """Share of the colours' variance that goes with the place."""
    left = change - basis @ np.linalg.lstsq(basis, change, rcond=None)[0]
    return 1.0 - float((left**2).sum() / max(((change - change.mean(axis=0)) ** 2).sum(), 1e-12))


def _area(face: Float[np.ndarray, "m 2"], shading: PhotometricDepth) -> float:
    rows, columns = shading.pixels.shape[:2]
    width, height = np.ptp(face, axis=0)
    return float(width * height) / float(rows * columns)


def _highest(distance: Float[np.ndarray, " m"], value: Float[np.ndarray, " m"], *, within: float) -> float:
    """The distance at which the ring's mean value is greatest."""
    edges = np.linspace(0.0, within, 41)
    ring = np.digitize(distance, edges) - 1
    mean = [value[ring == k].mean() if (ring == k).any() else -np.inf for k in range(40)]
    best = int(np.argmax(mean))
    return float((edges[best] + edges[best + 1]) / 2)
