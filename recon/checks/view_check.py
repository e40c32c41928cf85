"""Where photos were taken, by the mat's tags alone, and whether they show the fruit all around."""

from collections.abc import Sequence

import numpy as np

from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat
from recon.cameras.view_plan import missing_views
from recon.checks.quality import ReconQuality, require_seen, warnings_of, widest_gap_deg
from recon.silhouettes.hull import ball
from recon.surface.ray_mesh import seen_and_unseen
from recon.triangle_mesh import facing

USUAL_HEIGHT_MM = 50.0
"""Assumed height (mm) of a fruit; 20 mm more change the visible share of skin by 0.01 or 0.02."""
LEVEL = 3
"""Subdivisions of the ball that represents the fruit: 642 vertices, 8 degrees apart."""


def view_doubts(
    photos: Sequence[Photo],
    mat: Mat,
    *,
    given: Sequence[str],
    height_mm: float | None,
    left_out: Sequence[str] = (),
) -> tuple[str, ...]:
    """Warnings if `photos` do not show a fruit on the mat well all around, with where to take others.

    A ball of the fruit's height represents its skin. `given`: the names of all photos of the set in order;
    `left_out`: why some of them are not in `photos`. Raises ReconFailure as grading would: mat-not-found, or
    too-few-views (fewer than six photos that can be placed, or none over 120 degrees around the fruit).
    """
    poses = cameras_from_mat(photos, mat)
    places = np.array([camera.place for camera in poses.cameras])
    radius_mm = (height_mm or USUAL_HEIGHT_MM) / 2
    middle = np.array([0.0, 0.0, radius_mm])
    lacking = missing_views([camera.name for camera in poses.cameras], places, middle, given=given)
    directions, faces = ball(LEVEL)
    skin = middle + radius_mm * directions
    views = np.sum([facing(skin, directions, place) > 0 for place in places], axis=0)
    share, unseen_mm2 = seen_and_unseen(skin, faces, views)
    quality = ReconQuality(
        views_given=len(given),
        views_used=len(places),
        reprojection_px=poses.reprojection_px,
        widest_gap_deg=widest_gap_deg(places, middle),
        seen_share=share,
        unseen_mm2=unseen_mm2,
    )
    require_seen(quality, left_out=left_out, lacking=lacking)
    warnings = " ".join(warnings_of(quality, largest_mm=2 * radius_mm))
    return tuple(said for said in (*poses.warnings, f"{warnings} {lacking}".strip()) if said)
