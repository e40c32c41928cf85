"""From photos to a mesh in the fruit frame, with every doubt that photos and mesh give rise to."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.batch.cache import StageRecord
from pipeline.batch.task import FruitTask
from pipeline.files.plain_file import listed
from recon.cameras.camera import Camera, straightened
from recon.cameras.photos import Photo, read_photos
from recon.cameras.view_plan import missing_views
from recon.checks.photo_check import checked_photos
from recon.checks.quality import require_seen, shape_doubts
from recon.fruit_mesh import ReconOptions, Reconstruction, reconstruct, reconstruct_with_model
from recon.learned.fruit_model import SHIPPED
from recon.surface.orientation import to_fruit_frame
from recon.surface.ray_mesh import RayMesh
from recon.underside import with_underside
from reports.outlined_photos import OutlinedPhoto, outline_sheet_jpeg, outlined_photo_jpeg
from reports.photo import thumbnail_jpeg
from reports.skin_texture import SkinPhoto, skin_texture


class KeptMesh(StageRecord):
    """The stage "mesh": a fruit's surface in its own frame (mm), and its quality from the photos.

    `views`, `sd_mm`: as in FruitShape. `photo`: the bytes of a small JPEG; `outlines`: JPEG of all photos
    used with their outlines, empty with a geometry model; `skin`: JPEG of the skin by direction
    (reports.skin_texture), empty then too.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    mesh_from_fruit: Float[np.ndarray, "4 4"]
    views: Int[np.ndarray, " n"] | None
    sd_mm: Float[np.ndarray, " n"] | None
    photo: UInt8[np.ndarray, " b"]
    outlines: UInt8[np.ndarray, " c"]
    skin: UInt8[np.ndarray, " d"]
    scale_sd: float
    surface_sd_mm: float | None
    quality: dict[str, int | float]
    warnings: tuple[str, ...]


def photographed(task: FruitTask, model: Path | None) -> KeptMesh:
    """The mesh of a fruit's photos, its quality, a small photo, and warnings; raises ReconFailure."""
    given = read_photos(task.folder.photos)
    checked = checked_photos(given, task.mat)
    recon = task.settings.recon
    options = ReconOptions(
        max_faces=recon.max_faces,
        providers=recon.providers,
        coin=task.settings.photos.scale,
        fruit_model=SHIPPED if recon.fruit_model else None,
    )
    route = partial(
        reconstruct if model is None else partial(reconstruct_with_model, model=model),
        mat=task.mat,
        height_mm=task.given.height_mm,
        options=options,
    )
    made = route(checked.photos)
    require_seen(
        replace(made.quality, views_given=len(given)),
        left_out=checked.warnings,
        lacking=_lacking(made, [photo.name for photo in given]),
    )
    whole, over = made, list[Photo]()

    def route_over(photos: Sequence[Photo]) -> Reconstruction:
        over.extend(photos)
        return route(photos)

    if task.folder.flipped_files():
        whole = with_underside(
            made, lambda: read_photos(task.folder.photos_flipped), route_over, mat=task.mat
        )
    quality = replace(whole.quality, views_given=len(given))
    vertices, fruit_from_mesh = to_fruit_frame(whole.vertices)
    used = list(_used(checked.photos, [replace(camera, k1=made.quality.k1) for camera in made.cameras]))
    skin = _skin(
        chain(used, _used(over, whole.flipped_cameras)), (*made.cameras, *whole.flipped_cameras), whole
    )
    photo, outlines = _pictures(given[0], used, made)
    return KeptMesh(
        vertices=vertices,
        faces=whole.faces,
        mesh_from_fruit=np.linalg.inv(fruit_from_mesh),
        views=whole.views,
        sd_mm=whole.sd_mm,
        photo=np.frombuffer(photo, dtype=np.uint8),
        outlines=np.frombuffer(outlines, dtype=np.uint8),
        skin=np.frombuffer(skin, dtype=np.uint8),
        scale_sd=whole.scale_sd,
        surface_sd_mm=whole.surface_sd_mm,
        quality=quality.known(),
        warnings=(
            *checked.warnings,
            *whole.warnings,
            *whole.notes,
            *_unused_doubts(checked.photos, made),
            *shape_doubts(vertices, whole.faces, body=task.body),
        ),
    )


def _lacking(made: Reconstruction, given: Sequence[str]) -> str:
    """Which views are missing, and without a mat, which photos could not be joined to the others."""
    if not made.cameras:
        return ""
    return missing_views(
        [c.name for c in made.cameras],
        np.array([c.place for c in made.cameras]),
        made.vertices.mean(axis=0),
        given=given,
        unplaced=made.unplaced if made.frame == "shape" else (),
    )


def _used(photos: Sequence[Photo], cameras: Sequence[Camera]) -> Iterator[UInt8[np.ndarray, "_h _w 3"]]:
    by_name = {photo.name: photo for photo in photos}
    return (straightened(by_name[camera.name], camera)[0] for camera in cameras)


def _pictures(
    first: Photo, images: Sequence[UInt8[np.ndarray, "_ _ 3"]], made: Reconstruction
) -> tuple[bytes, bytes]:
    """JPEGs: a photo, with its outline if it has one, and all photos with theirs, if any."""
    outlined = [
        OutlinedPhoto(camera.name, image, outline)
        for camera, image, outline in zip(made.cameras, images, made.outlines, strict=False)
        if len(outline)
    ]
    if not outlined:
        return thumbnail_jpeg(first.image), b""
    return outlined_photo_jpeg(outlined[0]), outline_sheet_jpeg(outlined)


def _skin(
    images: Iterable[UInt8[np.ndarray, "_ _ 3"]], cameras: Sequence[Camera], whole: Reconstruction
) -> bytes:
    """A JPEG of the skin of the whole fruit, from photos without distortion and their cameras."""
    if not cameras:
        return b""
    photos = (
        SkinPhoto(image, camera.intrinsics @ camera.cam_from_world[:3], camera.place)
        for image, camera in zip(images, cameras, strict=True)
    )
    hidden = RayMesh(whole.vertices, whole.faces).hidden
    return skin_texture(whole.vertices, whole.faces, photos, hidden)


def _unused_doubts(photos: Sequence[Photo], made: Reconstruction) -> list[str]:
    used = {camera.name for camera in made.cameras}
    unused = [photo.name for photo in photos if photo.name not in used]
    if not used or not unused:
        return []
    ground = "mat" if made.frame == "mat" else "ground around it"
    return [
        f"drupe left out {listed(unused)}: the fruit is cut off or hidden there, the outline fits "
        "no other photo, or the camera has no pose. Retake such photos with the whole fruit and "
        f"the {ground} in view."
    ]
