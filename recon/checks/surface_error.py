"""Error of the mesh's skin at each vertex, by what the photos show beside its rims."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.checks.ground_check import RimEvidence
from recon.silhouettes.tangent import RIM_SD_PX
from recon.surface.ray_mesh import SEEN_BY, RayMesh
from recon.triangle_mesh import Faces, Vertices, facing, smoothed, vertex_areas, vertex_normals

HEIGHTS_DEG = (-75.0, -45.0, -15.0, 15.0)
"""Bounds of the rim's bands, degrees above the horizontal: shadows lie low; the bottom has no sides."""
FEWEST_SAMPLES = 30
"""Least samples on each side of a band: a photo has 8 of its 96 there, so four photos suffice."""
NOTICED_PX = 0.5
"""Left-right difference that counts, px of the downscaled photo: up to 0.3 without a flash, 1.5 with one."""


def left_right_px(evidence: RimEvidence) -> Float[np.ndarray, " b"]:
    """Median offset of the edge on the left less that on the right, px, by band over all photos.

    Only known samples count; 0 if either side has fewer than FEWEST_SAMPLES.
    """
    right = np.cos(evidence.turn) > 0
    offset_px = evidence.offset_mm / evidence.pixel_mm
    band = _band(evidence)
    apart = np.zeros(len(HEIGHTS_DEG) - 1)
    for k in range(len(apart)):
        here = evidence.known & (band == k)
        sides = offset_px[here & ~right], offset_px[here & right]
        if min(map(len, sides)) >= FEWEST_SAMPLES:
            apart[k] = np.median(sides[0]) - np.median(sides[1])
    return apart


def in_camera_shadow(evidence: RimEvidence) -> Bool[np.ndarray, " k"]:
    """Samples whose edge may be a shadow's: the further side of differing bands, and all below the bands."""
    apart = left_right_px(evidence)
    noticed = np.where(np.abs(apart) > NOTICED_PX, np.sign(apart), 0.0)
    by_band = np.concatenate([noticed, [0.0, 0.0]])  # above the bands, and below them (band -1)
    band = _band(evidence)
    left = np.where(np.cos(evidence.turn) > 0, -1.0, 1.0)
    return np.asarray((by_band[band] * left > 0) | ((band == -1) & noticed.any()))


def camera_shadow_px(evidence: RimEvidence) -> float:
    """Largest left-right difference, px (positive: left is further out); 0 up to NOTICED_PX."""
    apart = left_right_px(evidence)
    worst = float(apart[np.abs(apart).argmax()])
    return worst if abs(worst) > NOTICED_PX else 0.0


def shadow_sd_mm(evidence: RimEvidence) -> Float[np.ndarray, " k"]:
    """Uncertainty at each sample by a shadow that the mesh may include, mm.

    In every band that differs, and below the bands, it is the largest left-right difference.
    """
    worst_px = abs(camera_shadow_px(evidence))
    noticed = np.abs(left_right_px(evidence)) > NOTICED_PX
    by_band = np.concatenate([noticed, [False, noticed.any()]])
    return np.asarray(worst_px * by_band[_band(evidence)] * evidence.pixel_mm)


def _band(evidence: RimEvidence) -> Int[np.ndarray, " k"]:
    """The band of each sample; -1 below the lowest, the number of bands above the highest."""
    height_deg = np.degrees(np.arcsin(np.clip(np.sin(evidence.turn), -1, 1)))
    return np.asarray(np.searchsorted(HEIGHTS_DEG, height_deg, side="right") - 1)


SPREADING = 8
"""Smoothing rounds that spread a rim sample over the skin: about 0.07 diameters."""
OUTLIER = 2.5
"""Scale of Cauchy's weight, in robust spreads: 1 % of normal samples exceed 2.5. Set by hand."""
ROBUST_ROUNDS = 4
"""Rounds of reweighting. Set by hand."""
INDEPENDENT, LEAST_HELD = 3.0, 0.3
"""Independent samples per unit of weight at a vertex (photos are independent, neighbours are not), and the
least weight. With 1 instead of 3, 1.5 times as many wrong meshes passed."""
HALF_KNOWN = 0.03
"""Weight of rim samples at a vertex at which they count as much as geometry alone."""
UNKNOWN_RIM = 0.007
"""Standard deviation per diameter at rims without ground behind them in other photos."""
NEVER_GRAZED = 0.06
"""Standard deviation per diameter and per squared angle (rad) to the nearest rim, without rim samples."""
BRIDGED = 0.008
"""Standard deviation per diameter where outlines may bridge a hollow of unknown depth. Measured: 0.005 to
0.012 on eleven sets, against 0.002 where the surface is round."""


def sd_on_patch_mm(
    points: Float[np.ndarray, "p 3"], vertices: Vertices, faces: Faces, sd_mm: Float[np.ndarray, " n"]
) -> float:
    """Root mean square of a surface's `sd_mm` (per vertex) over the points of the mesh nearest to `points`.

    sqrt(mean over p of sd(x_p)²), sd linear within each triangle. Evenly spaced points on a contact patch
    give the root mean square over its area.
    """
    corners, shares = RayMesh(vertices, faces).nearest(points)
    return float(np.sqrt(np.mean(np.sum(shares * sd_mm[corners], axis=1) ** 2)))


@dataclass(frozen=True, kw_only=True)
class SurfaceError:
    """Error of each vertex along the normal.

    `sd_mm`: standard deviation. `offset_mm`: the offset that the rims measured (positive: fruit outside the
    mesh), shrunk where they disagree. `rms_mm`: root mean square of `sd_mm` over the skin that two cameras or
    more saw.
    """

    sd_mm: Float[np.ndarray, " n"]
    offset_mm: Float[np.ndarray, " n"]
    rms_mm: float


def surface_error(
    evidence: RimEvidence,
    vertices: Vertices,
    faces: Faces,
    places: Float[np.ndarray, "v 3"],
    views: Int[np.ndarray, " n"],
    *,
    bridged: Float[np.ndarray, " n"] | None = None,
) -> SurfaceError:
    """Offsets measured at rims, spread over the skin: sd² = mean² + spread² / count + (pixel floor)².

    Every known sample counts at its edge's two ends, by 1 / (sd² + floor²) and Cauchy's weight about the
    local mean. Away from any rim sd rises to NEVER_GRAZED D δ², δ the angle from the skin to the nearest
    grazing line of sight. A hull of diameter D stands off by up to D δ² / 4 there. Hollows that outlines may
    bridge (`bridged`, 0 to 1) and shadows that move with the camera add their uncertainty in squares.
    """
    count = len(vertices)
    diameter = float(np.ptp(vertices, axis=0).max())

    e = evidence
    known = e.known & ~in_camera_shadow(e)
    a, b, t, offset = e.a[known], e.b[known], e.t[known], e.offset_mm[known]
    floor = RIM_SD_PX * e.pixel_mm[known]
    trust = (np.median(floor) ** 2 if len(floor) else 1.0) / (e.sd_mm[known] ** 2 + floor**2)

    def onto(
        values: Sequence[Float[np.ndarray, " k"]], some: Bool[np.ndarray, " s"]
    ) -> Float[np.ndarray, "c n"]:
        a, b, t = e.a[some], e.b[some], e.t[some]
        columns = [np.bincount(a, (1 - t) * v, count) + np.bincount(b, t * v, count) for v in values]
        return smoothed(np.stack(columns, axis=1), faces, SPREADING).T

    def at(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        return np.asarray((1 - t) * values[a] + t * values[b])

    all_samples = np.ones(len(known), bool)
    masses = [(~known).astype(float), all_samples.astype(float), shadow_sd_mm(e) ** 2]
    unknown, every, shaded = onto(masses, all_samples)
    weight = trust
    mean, scatter, held = np.zeros(count), np.zeros(count), np.zeros(count)
    for _ in range(ROBUST_ROUNDS):
        held, weighted = onto([weight, weight * offset], known)
        mean = weighted / np.maximum(held, 1e-9)
        off = offset - at(mean)
        (squares,) = onto([weight * off**2], known)
        scatter = squares / np.maximum(held, 1e-9)
        scale = OUTLIER * np.maximum(np.sqrt(at(scatter)), floor) if len(floor) else floor
        weight = trust / (1 + (off / scale) ** 2)
    floor_mm = float(np.median(floor)) if len(floor) else 0.0
    agreed = mean**2 / (mean**2 + scatter / (INDEPENDENT * np.maximum(held, LEAST_HELD)) + 1e-12)
    rim = mean**2 + scatter / np.maximum(held, 1.0) + floor_mm**2
    known_share = held / np.maximum(held + unknown, 1e-9)
    rim = known_share * rim + (1 - known_share) * (UNKNOWN_RIM * diameter) ** 2
    normals = vertex_normals(vertices, faces)
    graze = np.min([np.arcsin(np.clip(np.abs(facing(vertices, normals, p)), 0, 1)) for p in places], axis=0)
    blind = (NEVER_GRAZED * diameter * graze**2) ** 2 + floor_mm**2
    share = (held + unknown) / (held + unknown + HALF_KNOWN)
    hollow = 0.0 if bridged is None else (BRIDGED * diameter * bridged) ** 2
    sd = np.sqrt(share * rim + (1 - share) * blind + shaded / np.maximum(every, 1e-9) + hollow)
    seen = vertex_areas(vertices, faces) * (views >= SEEN_BY)
    rms = float(np.sqrt(np.sum(seen * sd**2) / max(float(seen.sum()), 1e-9))) if seen.any() else float("inf")
    return SurfaceError(sd_mm=sd, offset_mm=mean * share * agreed, rms_mm=rms)
