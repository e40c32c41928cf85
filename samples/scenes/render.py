"""Path-traced pictures of a scene: the whole frame with few light samples, the fruit's crop with more."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from samples.cubed_sphere import even_sphere
from samples.photos import _denoiser, _mitsuba, _normals, _sensor
from samples.scenes.coin import coin_mesh
from samples.scenes.draw import Scene
from samples.scenes.ground import ground_shape
from samples.scenes.lens import margin_px
from samples.scenes.light import flash_mesh, flash_radiance, photographer_mesh, standing_lights
from samples.scenes.sheet import sheet_mat, sheet_mesh, sheet_texture
from samples.scenes.skin import skin_attributes, skin_bsdf
from samples.viewpoints import View

_PAPER_BELOW_MM = 0.02
_TABLE_BELOW_MM = 0.3
_CROP_SHARE = 0.25  # of the projected box, added on every side... half of it on each
_FEATHER_PX = 8


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """Light samples per pixel of the frame and, in addition, of the fruit's crop; path depth; skin cells."""

    frame_samples: int = 4
    crop_samples: int = 6
    depth: int = 4
    skin_cells: int = 200


def pictures(
    scene: Scene, *, options: RenderOptions, first: int = 0
) -> Iterator[Float[np.ndarray, "h w 3"]]:
    """Linear RGB light of each view as a pinhole sees it, `margin_px` pixels larger on every side.

    Raises RendererMissing.
    """
    mi = _mitsuba()
    denoise = _denoiser()
    world = load_world(mi, scene, options=options)
    integrator = mi.load_dict(
        {"type": "aov", "aovs": "a:albedo,n:sh_normal", "path": {"type": "path", "max_depth": options.depth}}
    )
    box = scene.fruit.skin.points_mm(even_sphere(12).directions)
    for k, view in enumerate(scene.views):
        if k < first:
            continue
        wide = widened(view, margin_px(view, k1=scene.pipeline.k1))
        world.stand(view)

        def shoot(
            samples: int, crop: tuple[int, int, int, int], seed: int, wide: View = wide
        ) -> Float[np.ndarray, "h w 9"]:
            sensor = _sensor(mi, wide)
            sensor["film"] |= dict(
                zip(("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), crop, strict=True)
            )
            sensor["sampler"] = {"type": "multijitter", "sample_count": samples}
            return np.array(
                mi.render(
                    world.scene, sensor=mi.load_dict(sensor), integrator=integrator, spp=samples, seed=seed
                )
            )

        frame = shoot(options.frame_samples, (0, 0, wide.width_px, wide.height_px), 2 * k)
        picture = _denoised(denoise, frame)
        left, top, width, height = crop = _crop(wide, box)
        window = np.s_[top : top + height, left : left + width]
        if options.crop_samples:
            more = shoot(options.crop_samples, crop, 2 * k + 1)
            share = options.crop_samples / (options.crop_samples + options.frame_samples)
            fine = _denoised(denoise, share * more + (1 - share) * frame[window])
            edge = _feather(height, width)
            picture[window] = edge * fine + (1 - edge) * picture[window]
        yield picture


def fruit_mask(scene: Scene, k: int, *, options: RenderOptions) -> Bool[np.ndarray, "h w"]:
    """Where the renderer's ray through a pixel's centre meets the fruit first, in view k, without distortion."""
    mi = _mitsuba()
    world = load_world(mi, scene, options=options)
    view = scene.views[k]
    sensor = mi.load_dict(_sensor(mi, view))
    y, x = np.mgrid[: view.height_px, : view.width_px].astype(np.float32)
    at = mi.Point2f(((x + 0.5) / view.width_px).ravel(), ((y + 0.5) / view.height_px).ravel())
    rays, _ = sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5, 0.5))
    met = world.scene.ray_intersect_preliminary(rays)
    fruit = next(shape for shape in world.scene.shapes() if shape.id() == "fruit")
    return np.array(met.is_valid() & (met.shape == mi.ShapePtr(fruit))).reshape(y.shape)


@dataclass(frozen=True, kw_only=True)
class World:
    """A loaded scene, and `stand`, which puts in place what moves with the camera."""

    scene: Any
    stand: Callable[[View], None]


def load_world(mi: Any, scene: Scene, *, options: RenderOptions) -> World:
    """Everything of the scene for the renderer; what moves with the camera stands as in the first view."""
    first = scene.views[0]
    shapes: dict[str, Any] = {"type": "scene", **standing_lights(mi, scene.light)}
    shapes["table"] = ground_shape(mi, scene.ground, z_mm=-_TABLE_BELOW_MM if scene.sheet else 0.0)
    shapes["fruit"] = _fruit(mi, scene, options)
    if scene.sheet is not None:
        mat = sheet_mat(scene.sheet)
        points, triangles, uv = sheet_mesh(scene.sheet, mat)
        print_rgb = np.ascontiguousarray(sheet_texture(scene.sheet, mat)[::-1])
        paper = {"type": "bitmap", "raw": True, "wrap_mode": "clamp", "bitmap": mi.Bitmap(print_rgb)}
        bsdf = {"type": "twosided", "material": {"type": "diffuse", "reflectance": paper}}
        shapes["mat"] = _mesh(mi, "mat", points - [0, 0, _PAPER_BELOW_MM], triangles, bsdf=bsdf, uv=uv)
    if scene.coin is not None:
        points, triangles, colour = coin_mesh(scene.coin)
        metal = {
            "type": "principled", "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
            "metallic": 1.0, "roughness": 0.32,
        }  # fmt: skip
        shapes["coin"] = _mesh(mi, "coin", points, triangles, bsdf=metal, attributes={"vertex_color": colour})
    moving: dict[str, Callable[[View], np.ndarray]] = {}
    if scene.light.flash_radii_mm is not None:
        glow = flash_radiance(scene.light, distance_mm=scene.camera.distance_mm)
        points, triangles = flash_mesh(scene.light, first)
        lamp = {"type": "area", "radiance": {"type": "rgb", "value": list(glow)}}
        shapes["flash"] = _mesh(mi, "flash", points, triangles, bsdf={"type": "diffuse"}, emitter=lamp)
        moving["flash"] = lambda view: flash_mesh(scene.light, view)[0]
    if scene.light.photographer:
        points, triangles = photographer_mesh(first)
        cloth = {
            "type": "twosided",
            "material": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.08, 0.09, 0.12]}},
        }
        shapes["body"] = _mesh(mi, "body", points, triangles, bsdf=cloth)
        moving["body"] = lambda view: photographer_mesh(view)[0]
    loaded = mi.load_dict(shapes)

    def stand(view: View) -> None:
        if moving:
            values = mi.traverse(loaded)
            for name, points_of in moving.items():
                values[f"{name}.vertex_positions"] = points_of(view).astype(np.float32).ravel()
            values.update()

    return World(scene=loaded, stand=stand)


def widened(view: View, margin: int) -> View:
    """The same view with `margin` pixels more on every side."""
    return replace(view, width_px=view.width_px + 2 * margin, height_px=view.height_px + 2 * margin)


def _fruit(mi: Any, scene: Scene, options: RenderOptions) -> Any:
    sphere = even_sphere(options.skin_cells)
    colour, roughness = skin_attributes(scene.skin, sphere.directions)
    return _mesh(
        mi, "fruit", scene.fruit.skin.points_mm(sphere.directions), sphere.triangles(),
        bsdf=skin_bsdf(scene.skin), smooth=True,
        attributes={"vertex_color": colour, "vertex_roughness": roughness},
    )  # fmt: skip


def _mesh(
    mi: Any,
    name: str,
    points: Float[np.ndarray, "n 3"],
    triangles: np.ndarray,
    *,
    bsdf: dict[str, Any],
    emitter: dict[str, Any] | None = None,
    uv: Float[np.ndarray, "n 2"] | None = None,
    smooth: bool = False,
    attributes: dict[str, np.ndarray] | None = None,
) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if emitter is not None:
        properties["emitter"] = mi.load_dict(emitter)
    mesh = mi.Mesh(
        name, len(points), len(triangles), props=properties, has_vertex_normals=smooth,
        has_vertex_texcoords=uv is not None,
    )  # fmt: skip
    for key, values in (attributes or {}).items():
        mesh.add_attribute(key, 1 if values.ndim == 1 else 3, values.astype(np.float32).ravel())
    parts = mi.traverse(mesh)
    parts["vertex_positions"] = points.astype(np.float32).ravel()
    parts["faces"] = triangles.astype(np.uint32).ravel()
    if smooth:
        parts["vertex_normals"] = _normals(points, triangles).astype(np.float32).ravel()
    if uv is not None:
        parts["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parts.update()
    return mesh


def _denoised(
    denoise: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], layers: Float[np.ndarray, "h w 9"]
) -> Float[np.ndarray, "h w 3"]:
    colour, albedo, normal = (np.ascontiguousarray(layers[..., c : c + 3]) for c in (0, 3, 6))
    return np.array(denoise(colour, albedo, normal))


def _crop(view: View, points_mm: Float[np.ndarray, "n 3"]) -> tuple[int, int, int, int]:
    """Left, top, width and height of the points' box, a quarter larger, inside the picture."""
    seen = view.pixels(points_mm)
    low, high = seen.min(axis=0), seen.max(axis=0)
    more = 0.5 * _CROP_SHARE * (high - low) + _FEATHER_PX
    low = np.clip(np.floor(low - more), 0, [view.width_px - 32, view.height_px - 32]).astype(int)
    high = np.clip(np.ceil(high + more), low + 32, [view.width_px, view.height_px]).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _feather(height: int, width: int) -> Float[np.ndarray, "h w 1"]:
    y, x = np.mgrid[:height, :width]
    inside = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    return np.asarray(np.clip((inside + 0.5) / _FEATHER_PX, 0, 1)[..., None], dtype=np.float32)
