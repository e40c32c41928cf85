"""Scenes as folders: photos/, mat.json, fruit_truth.ply, cameras_truth.json, scene.json."""

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.cameras.printed_mat import Mat, mat_mapping
from recon.surface.mesh_file import write_mesh
from samples.fruit import skin_mesh
from samples.renderer import denoiser, mitsuba
from samples.scenes.draw import Scene, scene_mapping
from samples.scenes.phone import developed, exposed
from samples.scenes.render import RenderOptions, pictures
from samples.scenes.sheet import sheet_mat
from samples.viewpoints import Viewpoint, distorted_picture, margin_px

# EXIF orientation: left turns (np.rot90) from the upright picture to the stored one
_LEFT_TURNS = {1: 0, 3: 2, 6: 1, 8: 3}


def write_jpeg(path: Path, image: UInt8[np.ndarray, "h w 3"], *, quality: int, orientation: int = 1) -> None:
    """Write a BGR picture; orientations other than 1 are stored rotated and tagged (EXIF 2.3, tag 0x0112).

    Raises OSError if the file cannot be written.
    """
    stored = np.ascontiguousarray(np.rot90(image, _LEFT_TURNS[orientation]))
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    data = cv2.imencode(".jpg", stored, flags)[1].tobytes()
    if orientation != 1:
        entry = struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)
        tiff = b"II*\x00" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0)
        body = b"Exif\x00\x00" + tiff
        data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    path.write_bytes(data)


# linear light of the metered part after exposure (by eye: paper is pale grey, not white)
_PAPER_LEVEL = 0.62
_SCENE_LEVEL = 0.16
"""Geometric mean of luminance over full scale for a picture without paper: photography's middle grey is
0.18."""


def complete(folder: Path, *, photos: int) -> bool:
    """Whether a set is complete: it has all photos and scene.json, the last file that is written."""
    return (folder / "scene.json").is_file() and len(list((folder / "photos").glob("*.jpg"))) == photos


def write_scene(
    out: Path, scene: Scene, *, options: RenderOptions, progress: Callable[[str], None] | None = None
) -> Path:
    """Render a scene into out/<name>, which appears once it is complete. Raises RendererMissing."""
    folder, part = out / scene.name, out / f"{scene.name}.part"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    mat = sheet_mat(scene.sheet) if scene.sheet is not None else None
    if mat is not None:
        _write_json(part / "mat.json", mat_mapping(mat))
    write_mesh(part / "fruit_truth.ply", *skin_mesh(scene.fruit.skin, cells=72))
    _write_json(part / "cameras_truth.json", cameras_mapping(scene))
    facts = scene_mapping(scene)
    gains = write_photos(part / "photos", scene, options=options, progress=progress)
    for photo, gain in zip(facts["photos"], gains, strict=True):
        photo["exposure_gain"] = gain
    _write_json(part / "scene.json", facts)
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)
    return folder


def write_photos(
    folder: Path, scene: Scene, *, options: RenderOptions, progress: Callable[[str], None] | None = None
) -> list[float]:
    """Render a scene's photos into a folder as 000.jpg, 001.jpg, ...; returns each photo's exposure gain.

    The same scene and options give the same pictures. Raises RendererMissing before it makes the folder.
    """
    mitsuba()
    denoiser()
    folder.mkdir(parents=True, exist_ok=True)
    mat = sheet_mat(scene.sheet) if scene.sheet is not None else None
    margin = margin_px(scene.views, k1=scene.pipeline.k1)
    lights, gains = [], []
    for k, pinhole in enumerate(pictures(scene, options=options)):
        light = distorted_picture(pinhole, scene.views[k], k1=scene.pipeline.k1, margin=margin)
        lights.append(light.astype(np.float16))
        gains.append(metered_gain(light, mat=mat, view=scene.views[k]) * 2**scene.camera.exposure_ev)
        if progress is not None:
            progress(f"{scene.name}: photo {k + 1} of {len(scene.views)}")
    if not scene.pipeline.metered_each:
        gains = [float(np.percentile(gains, 40))] * len(gains)
    rng = np.random.default_rng([scene.seed, 20])
    for k, (light, shot) in enumerate(zip(lights, scene.shots, strict=True)):
        counted = exposed(light.astype(np.float32), gain=gains[k], pipeline=scene.pipeline, shot=shot)
        image = developed(counted, pipeline=scene.pipeline, rng=rng)
        write_jpeg(
            folder / f"{k:03d}.jpg", image, quality=scene.pipeline.jpeg_quality,
            orientation=shot.orientation,
        )  # fmt: skip
    return gains


def metered_gain(light: Float[np.ndarray, "h w 3"], *, mat: Mat | None, view: Viewpoint) -> float:
    """Factor on linear light that exposes a picture: by the paper of the mat, or else by the mean.

    The 70th percentile of points spread over the mat is paper. Without a mat the geometric mean becomes a
    middle grey, unless that would overexpose more than a fiftieth of the picture.
    """
    luminance = np.maximum(light @ np.array([0.2126, 0.7152, 0.0722], dtype=light.dtype), 1e-6)
    if mat is not None:
        x, y = np.meshgrid(*(np.linspace(-0.48, 0.48, 60) * side for side in (mat.width_mm, mat.height_mm)))
        points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        ahead = points @ view.cam_from_world[2, :3] + view.cam_from_world[2, 3] > 10.0
        seen = np.rint(view.pixels(points[ahead])).astype(int)
        inside = np.all((seen >= 0) & (seen < [view.width_px, view.height_px]), axis=1)
        column, row = seen[inside].T
        return float(_PAPER_LEVEL / np.percentile(luminance[row, column], 70))
    gain = _SCENE_LEVEL / np.exp(np.mean(np.log(luminance)))
    return float(min(gain, 0.85 / np.percentile(luminance, 98)))


def cameras_mapping(scene: Scene) -> dict[str, Any]:
    """Content of cameras_truth.json: mean focal length (px), k1, and each photo's pose and focal length.

    R, t: camera (x right, y down, z ahead) from mat; pictures are upright, the principal point is central.
    """
    return {
        "f": scene.camera.focal_px,
        "k1": scene.pipeline.k1,
        "width": scene.views[0].width_px,
        "height": scene.views[0].height_px,
        "cx_colmap": scene.views[0].width_px / 2,
        "cy_colmap": scene.views[0].height_px / 2,
        "views": [
            {
                "name": f"{k:03d}.jpg",
                "f": view.focal_px,
                "R": view.cam_from_world[:3, :3].tolist(),
                "t": view.cam_from_world[:3, 3].tolist(),
            }
            for k, view in enumerate(scene.views)
        ],
    }


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
