"""Quality of a reconstruction in numbers, the warnings from them, and refusals."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from recon.pit.priors import STONE_FRUIT, PitBody
from recon.recon_failure import ReconProblem
from recon.silhouettes.hull import Silhouette, drawn
from recon.silhouettes.outline import outline_of
from recon.triangle_mesh import Faces, Vertices, volume_mm3

FEWEST_VIEWS = 6
"""Least photos in use; with 8, meshes are 0.09 to 0.20 mm off (benchmarks/results/recon.csv). By hand."""
WIDEST_GAP_DEG = 120.0
"""Widest angle about the fruit without a photo, degrees: a third of a turn. Set by hand."""


ENOUGH_SEEN = 0.8
"""Share of visible skin below which drupe warns. Set by hand."""
UNKNOWN = float("nan")


@dataclass(frozen=True, kw_only=True)
class ReconQuality:
    """Counts, residuals and agreement of one reconstruction.

    `seen_share` of the surface is visible to two cameras or more, upright or flipped; the method closed the
    rest, `unseen_mm2`. `flipped_views`: number of photos of the fruit upside down that were used.
    `flipped_miss_mm`: root mean square distance of their mesh from the upright one on skin that both saw.
    `offset_rms_mm`, `offset_local_mm`, `offset_volume_share`: distance of the skin from the mesh by the
    photos beside its rims (recon/checks/ground_check.py). They are root mean square, the value that 2 % of
    the skin exceeds, and the sum over the volume. `ground_known_share` of the rims have ground behind them
    that other photos show.
    """

    views_given: int = 0
    views_used: int = 0
    reprojection_px: float = UNKNOWN
    silhouette_iou: float = UNKNOWN
    outline_rms_mm: float = UNKNOWN
    clear_outline_share: float = UNKNOWN
    focal_px: float = UNKNOWN
    focal_sd_px: float = UNKNOWN
    k1: float = UNKNOWN
    widest_gap_deg: float = UNKNOWN
    seen_share: float = UNKNOWN
    unseen_mm2: float = UNKNOWN
    decimation_rms_mm: float = UNKNOWN
    relief_share: float = 0.0
    flipped_views: int = 0
    flipped_miss_mm: float = UNKNOWN
    offset_rms_mm: float = UNKNOWN
    offset_local_mm: float = UNKNOWN
    offset_volume_share: float = UNKNOWN
    ground_known_share: float = UNKNOWN

    def known(self) -> dict[str, int | float]:
        """The finite numbers, by name."""
        return {name: number for name, number in asdict(self).items() if np.isfinite(number)}


def outline_rms_mm(vertices: Vertices, faces: Faces, silhouettes: Sequence[Silhouette]) -> float:
    """Root mean square distance between the mesh's projected rim and the outlines, mm at the fruit."""
    squares = []
    for s in silhouettes:
        rim = outline_of(drawn(vertices, faces, s.window, s.camera))
        if rim is None:
            continue
        at = np.rint(rim.points).astype(int)
        squares.append((s.distance_px[at[:, 1], at[:, 0]] * s.camera.pixel_mm(vertices)) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else float("inf")


def widest_gap_deg(places: Float[np.ndarray, "v 3"], middle: Float[np.ndarray, "3"]) -> float:
    """The widest horizontal angle, seen from the fruit, without a camera.

    Three photos from the front half leave the back half without a camera.

    >>> widest_gap_deg(np.array([[1.0, 0, 1], [0, 1, 1], [-1, 0, 1]]), np.zeros(3))
    180.0
    """
    angles = np.sort(np.degrees(np.arctan2(places[:, 1] - middle[1], places[:, 0] - middle[0])))
    return float(np.max(np.diff(np.concatenate([angles, angles[:1] + 360.0]))))


def warnings_of(quality: ReconQuality, *, largest_mm: float) -> tuple[str, ...]:
    """Warnings for staff about what may be wrong."""
    out = []
    q = quality
    if q.views_used < 12:
        out.append(f"Only {q.views_used} views show the fruit; the shape is coarser than with 24 views.")
    if q.views_used < 0.75 * q.views_given:
        out.append(f"drupe left out {q.views_given - q.views_used} of {q.views_given} photos.")
    if q.widest_gap_deg > 75:
        out.append(
            f"There is a gap of {q.widest_gap_deg:.0f} degrees without photos around the fruit; drupe "
            "estimated that side."
        )
    if q.reprojection_px > 1.5:
        out.append(
            f"Camera poses fit only to {q.reprojection_px:.1f} px; the photos may be blurred or the "
            "mat not flat."
        )
    if q.silhouette_iou < 0.97:
        out.append(
            f"Outlines agree to only {100 * q.silhouette_iou:.1f} %; another object may be in the photos."
        )
    if q.outline_rms_mm > 0.01 * largest_mm:
        out.append(f"The mesh deviates from the outlines by {q.outline_rms_mm:.2f} mm (root mean square).")
    return (*out, *seen_doubts(q))


def seen_doubts(quality: ReconQuality) -> tuple[str, ...]:
    """A warning if cameras see too little of the surface."""
    if not quality.seen_share < ENOUGH_SEEN:
        return ()
    share = f"Only {100 * quality.seen_share:.0f} % of the surface is visible to two or more cameras"
    return (f"{share}; take photos from more heights.",)


def depth_doubts(edge_depth_mm: float) -> tuple[str, ...]:
    """A warning of a hollow as deep as the search range (`Relief.edge_depth_mm`; 0: none).

    >>> depth_doubts(0.0)
    ()
    """
    if not edge_depth_mm > 0:
        return ()
    return (
        f"A hollow of the mesh is {edge_depth_mm:.1f} mm deep, about as deep as drupe searches; the true "
        "hollow may be deeper. Compare the mesh with the fruit.",
    )


def require_seen(quality: ReconQuality, *, left_out: Sequence[str] = (), lacking: str = "") -> None:
    """Raise ReconFailure (too-few-views) for fewer than six views, or a side of over 120 degrees without any.

    Such meshes are wrong by half to all of the volume. `left_out`: why photos were not tried; `lacking`: the
    missing views, in words.
    """
    where = f" {lacking}" if lacking else ""
    if quality.views_used < FEWEST_VIEWS:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"Too few views: only {quality.views_used} of {quality.views_given} photos are usable, "
            f"expected at least {FEWEST_VIEWS}.{_why_left_out(quality, left_out)} Take 24 sharp "
            f"photos from all sides, at two or three heights.{where}",
        )
    if quality.widest_gap_deg > WIDEST_GAP_DEG:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"Too few views: usable photos leave a gap of {quality.widest_gap_deg:.0f} degrees around "
            f"the fruit, expected at most {WIDEST_GAP_DEG:.0f}; take photos from that side too.{where}",
        )


def _why_left_out(quality: ReconQuality, left_out: Sequence[str]) -> str:
    if quality.views_used == quality.views_given:
        return ""
    return "".join(f" {reason}" for reason in left_out) + (
        " In the unused photos, the fruit is cut off or hidden, the outline fits no other photo, or the "
        "camera has no pose. Another fruit beside it also spoils the outline."
    )


def shape_doubts(vertices: Vertices, faces: Faces, *, body: PitBody = STONE_FRUIT) -> tuple[str, ...]:
    """Warnings if the mesh is no single body of its category: too long, or hollow between lumps."""
    out = []
    box = np.ptp(vertices, axis=0)
    if box.max() > body.longest_over_shortest * box.min():
        out.append(
            f"The mesh is {box[0]:.0f} x {box[1]:.0f} x {box[2]:.0f} mm, a ratio of "
            f"{box.max() / box.min():.2f} of length to width, expected at most "
            f"{body.longest_over_shortest:g}. The photos may show two fruits, or a hand or leaf "
            "beside the fruit. Photograph one fruit alone."
        )
    share = volume_mm3(vertices, faces) / float(ConvexHull(vertices).volume)
    if share < body.least_convex:
        out.append(
            f"The mesh fills only {100 * share:.0f} % of its convex hull, expected at least "
            f"{100 * body.least_convex:.0f} %. The photos may show two fruits, or another object "
            "beside the fruit. Photograph one fruit alone."
        )
    return tuple(out)
