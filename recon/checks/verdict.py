"""Is the mesh that came out to be believed? Refusals, and doubts about its shape, for staff to act on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from recon.cameras.view_plan import ViewPlan, plan_words
from recon.checks.quality import ReconQuality
from recon.pit.priors import STONE_FRUIT, PitBody
from recon.recon_failure import ReconProblem
from recon.triangle_mesh import volume_mm3

FEWEST_VIEWS = 6
"""Photos in use, at least; with 8, meshes are 0.09 to 0.20 mm off (benchmarks/results/recon.csv). By hand."""
WIDEST_GAP_DEG = 120.0
"""Degrees about the fruit that no photo covers, at most: a third of a turn. Set by hand."""


def require_seen(
    quality: ReconQuality, *, left_out: Sequence[str] = (), plan: ViewPlan | None = None
) -> None:
    """Refuse a shape seen from too few directions: fewer than six views, or a side of over 120 degrees
    without any, make meshes wrong by half to all of the volume.

    `left_out`: why photos were not tried; `plan`: where the others were taken, which the failure says and
    carries. Raises ReconFailure (too-few-views).
    """
    where = "" if plan is None else f" {plan_words(plan)}".rstrip()
    if quality.views_used < FEWEST_VIEWS:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"Too few views: only {quality.views_used} of {quality.views_given} photos are usable, "
            f"expected at least {FEWEST_VIEWS}.{_why_left_out(quality, left_out)} Take 24 sharp "
            f"photos from all sides, at two or three heights.{where}",
            plan,
        )
    if quality.widest_gap_deg > WIDEST_GAP_DEG:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"Too few views: usable photos leave a gap of {quality.widest_gap_deg:.0f} degrees around "
            f"the fruit, expected at most {WIDEST_GAP_DEG:.0f}; take photos from that side too.{where}",
            plan,
        )


def _why_left_out(quality: ReconQuality, left_out: Sequence[str]) -> str:
    if quality.views_used == quality.views_given:
        return ""
    return "".join(f" {reason}" for reason in left_out) + (
        " In the unused photos, the fruit is cut off or hidden, the outline fits no other photo, or the "
        "camera has no pose. Another fruit beside it also spoils the outline."
    )


def shape_doubts(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], *, body: PitBody = STONE_FRUIT
) -> tuple[str, ...]:
    """Sentences where the mesh is no single body of its category: too long, or hollow between lumps."""
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
