"""Photos of the fruit upside down: the side that stood on the mat, put in the place of a guess."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import moved
from recon.checks.photo_check import checked_photos
from recon.checks.quality import seen_doubts
from recon.checks.verdict import require_seen
from recon.fruit_mesh import Reconstruction
from recon.recon_failure import ReconFailure
from recon.surface.coverage import seeing_views, seen_and_unseen
from recon.surface.flipped import ScannedSide, both_sides
from recon.surface.repair import repaired

WHERE = "photos-flipped/"
Route = Callable[[Sequence[Photo]], Reconstruction]


def with_underside(
    upright: Reconstruction, read: Callable[[], Sequence[Photo]], route: Route, *, mat: Mat | None
) -> Reconstruction:
    """The upright reconstruction with the other side's skin; as it was, with a warning, where that fails.

    `read` gives the photos of the fruit upside down, `route` makes a mesh of them as it did of the others.
    """
    try:
        return _merged(upright, read(), route, mat)
    except ReconFailure as failure:
        why = failure.detail.rstrip(".")
        return replace(upright, warnings=(*upright.warnings, f"drupe did not use {WHERE}: {why}."))


def _merged(
    upright: Reconstruction, photos: Sequence[Photo], route: Route, mat: Mat | None
) -> Reconstruction:
    """The upright mesh with its underside from the photos of the fruit upside down; raises ReconFailure."""
    checked = checked_photos(photos, mat)
    over = route(checked.photos)
    require_seen(over.quality, left_out=checked.warnings)
    joined = both_sides(_side(upright), _side(over), on_mat=mat is not None)
    mesh = repaired(joined.vertices, upright.faces, max_faces=len(upright.faces))
    quality, views = upright.quality, None
    if upright.cameras and over.cameras:
        places = np.concatenate([_places(upright), moved(_places(over), joined.upright_from_over)])
        views = seeing_views(mesh.vertices, mesh.faces, places)
        share, hole_mm2 = seen_and_unseen(mesh.vertices, mesh.faces, views)
        quality = replace(quality, seen_share=share, unseen_mm2=hole_mm2)
    quality = replace(quality, flipped_views=over.quality.views_used, flipped_miss_mm=joined.miss_mm)
    kept = [w for w in upright.warnings if w not in seen_doubts(upright.quality)]
    said = [
        f"In {WHERE}: {w}"
        for w in (*checked.warnings, *over.warnings, *over.notes)
        if w not in seen_doubts(over.quality)
    ]
    if joined.by_convention:
        said.append(
            f"The fruit is so round that {WHERE} fits in two ways. drupe assumed that you turned the "
            "fruit over about the mat's arrow, with the suture still along the arrow."
        )
    return replace(
        upright,
        vertices=mesh.vertices,
        faces=mesh.faces,
        surface_sd_mm=max(upright.surface_sd_mm, joined.miss_mm / float(np.sqrt(2))),
        quality=quality,
        views=views,
        sd_mm=None,
        flipped_cameras=tuple(
            replace(camera, k1=over.quality.k1).moved(joined.upright_from_over) for camera in over.cameras
        ),
        warnings=(*kept, *seen_doubts(quality), *said),
        seconds=upright.seconds | {f"{name}, upside down": spent for name, spent in over.seconds.items()},
    )


def _side(made: Reconstruction) -> ScannedSide:
    return ScannedSide.of(made.vertices, made.faces, _places(made))


def _places(made: Reconstruction) -> Float[np.ndarray, "v 3"]:
    return np.array([camera.place for camera in made.cameras]).reshape(-1, 3)
