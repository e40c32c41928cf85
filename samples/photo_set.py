"""Photographs of a sample fruit on the mat, path-traced (Mitsuba 3), denoised (Open Image Denoise).

Neither renderer is needed to grade: they are the optional extra `samples`, imported when a photo is asked
for.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.cameras.printed_mat import Mat
from recon.triangle_mesh import vertex_normals
from samples.appearance import mat_texture, skin_colours, table_texture
from samples.cubed_sphere import even_sphere
from samples.fruit import SampleFruit, box_mm, triple
from samples.renderer import denoiser, layers_of, mesh_shape, mitsuba, sensor
from samples.scenes.light import Lamp, lamp_shape
from samples.scenes.phone import Pipeline, developed
from samples.viewpoints import Viewpoint, rings

NECTARINE = {"roughness": 0.38, "specular": 0.45, "clearcoat": 0.6, "clearcoat_gloss": 0.75}
"""Of a skin, as shares of 1, as the renderer's "principled" surface has them (Burley 2012); by eye on shop
fruit."""
SOFTBOX = (1.0, 0.95, 0.88)
"""Linear RGB of both lamps."""


@dataclass(frozen=True, kw_only=True)
class PhotoOptions:
    """Picture size, light samples per pixel, JPEG quality, sensor noise (sRGB levels), and how far away the
    camera is.
    """

    width_px: int = 1280
    height_px: int = 960
    samples_per_pixel: int = 8
    jpeg_quality: int = 72
    noise_levels: float = 0.8
    skin_cells: int = 160
    reach_mm: float = 315.0


def write_photos(
    folder: Path,
    fruit: SampleFruit,
    mat: Mat,
    *,
    views: int,
    options: PhotoOptions,
    progress: Callable[[str], None] | None = None,
) -> tuple[Viewpoint, ...]:
    """Render `views` photos into `folder` as 000.jpg, 001.jpg, ... without EXIF; returns the true views.

    The same fruit and options give the same pictures. Raises RendererMissing.
    """
    mitsuba()
    denoiser()
    folder.mkdir(parents=True, exist_ok=True)
    low, high = box_mm(fruit.skin)
    rng = np.random.default_rng([fruit.seed, 3])
    where = rings(
        views, rng, aim_mm=(0.0, 0.0, 0.42 * float(high[2] - low[2])),
        width_px=options.width_px, height_px=options.height_px, reach_mm=options.reach_mm,
    )  # fmt: skip
    for k, image in enumerate(rendered(fruit, mat, where, options=options)):
        flags = [cv2.IMWRITE_JPEG_QUALITY, options.jpeg_quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        cv2.imwrite(str(folder / f"{k:03d}.jpg"), image, flags)
        if progress is not None:
            progress(f"{fruit.fruit_id}: photo {k + 1} of {views}")
    return where


def rendered(
    fruit: SampleFruit, mat: Mat, views: tuple[Viewpoint, ...], *, options: PhotoOptions
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """One BGR picture per view, rendered when asked for. Raises RendererMissing."""
    mi = mitsuba()
    denoise = denoiser()
    rng = np.random.default_rng([fruit.seed, 4])
    scene = mi.load_dict(_scene(mi, fruit, mat, options, rng))
    integrator = mi.load_dict(
        {"type": "aov", "aovs": "a:albedo,n:sh_normal", "path": {"type": "path", "max_depth": 5}}
    )
    gain = float(rng.uniform(0.9, 1.1))
    camera_pipeline = Pipeline(kind="none", sensor_noise=options.noise_levels)
    for k, view in enumerate(views):
        camera = mi.load_dict(sensor(mi, view))
        layers = np.array(
            mi.render(scene, sensor=camera, integrator=integrator, spp=options.samples_per_pixel, seed=k + 1)
        )
        yield developed(gain * denoise(*layers_of(layers)), pipeline=camera_pipeline, rng=rng)


def _scene(
    mi: Any, fruit: SampleFruit, mat: Mat, options: PhotoOptions, rng: np.random.Generator
) -> dict[str, Any]:
    """The scene for the renderer: two softboxes, the mat on its table, the fruit."""
    high = float(box_mm(fruit.skin)[1][2])
    to = mi.ScalarTransform4f
    turn = float(rng.uniform(0, 360))
    lights = {}
    for k, (azimuth, elevation, power) in enumerate(((turn, 52.0, 11.0), (turn + 150.0, 35.0, 6.0))):
        softbox = Lamp(
            azimuth_deg=azimuth, elevation_deg=elevation, distance_mm=700.0, half_mm=(150.0, 110.0),
            rgb=SOFTBOX, share=1.0,
        )  # fmt: skip
        lights[f"softbox{k}"] = lamp_shape(mi, softbox, radiance=triple(power * np.array(SOFTBOX)))
    bitmap = {"type": "bitmap", "raw": True, "wrap_mode": "mirror"}
    sheet = to().translate([0, 0, -0.02]).scale([mat.width_mm / 2, mat.height_mm / 2, 1])
    return {
        "type": "scene",
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.38, 0.40, 0.43]}},
        **lights,
        "table": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, -0.3]).rotate([0, 0, 1], turn).scale([900, 900, 1]),
            "bsdf": {
                "type": "diffuse", "reflectance": {**bitmap, "bitmap": mi.Bitmap(table_texture(rng))},
            },
        },
        "mat": {
            "type": "rectangle",
            "to_world": sheet,
            "bsdf": {"type": "diffuse", "reflectance": {**bitmap, "bitmap": mi.Bitmap(_upright(mat))}},
        },
        "fruit": _skin(mi, fruit, options),
        "ceiling": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, 1500 + high]).scale([200, 200, 1]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [2.0, 2.0, 2.1]}},
        },
    }  # fmt: skip


def _skin(mi: Any, fruit: SampleFruit, options: PhotoOptions) -> Any:
    """The fruit's skin for the renderer, coloured by its ripeness."""
    sphere = even_sphere(options.skin_cells)
    points, triangles = fruit.skin.points_mm(sphere.directions), sphere.triangles()
    colours = skin_colours(
        sphere.directions, ripeness=fruit.ripeness, rng=np.random.default_rng([fruit.seed, 5])
    )
    coat = {
        "type": "principled", "base_color": {"type": "mesh_attribute", "name": "vertex_color"}, **NECTARINE,
    }  # fmt: skip
    return mesh_shape(
        mi, "skin", points, triangles, bsdf=coat, normals=vertex_normals(points, triangles),
        attributes={"vertex_color": colours},
    )  # fmt: skip


def _upright(mat: Mat) -> Float[np.ndarray, "h w 3"]:
    # the renderer lays a bitmap's first row along v = 0, the rectangle's -y side
    return np.ascontiguousarray(mat_texture(mat, pixels_per_mm=max(8.0, 144.0 / mat.tag_mm))[::-1])
