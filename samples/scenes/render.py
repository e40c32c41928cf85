"""Path-traced pictures of a scene: the whole frame with few light samples, the fruit's crop with more."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.triangle_mesh import vertex_normals
from samples.cubed_sphere import even_sphere
from samples.fruit import box_mm
from samples.renderer import (
    denoiser,
    layers_of,
    mesh_shape,
    mitsuba,
    sensor,
    window_sensor,
)
from samples.scanned_skin import ScannedSkin
from samples.scenes.draw import Scene
from samples.scenes.euro_coin import coin_mesh
from samples.scenes.ground import ground_shape
from samples.scenes.light import flash_mesh, flash_radiance, photographer_mesh, standing_lights
from samples.scenes.phone import developed, exposed
from samples.scenes.sheet import sheet_mat, sheet_mesh, sheet_texture
from samples.scenes.skin_optics import skin_attributes, skin_bsdf
from samples.scenes.stand import turntable_shapes
from samples.viewpoints import Viewpoint, margin_px

_FINER = 3
"""Samples along each side of a pixel for the share that the fruit covers, in steps of a ninth."""
_WIDEST, _NARROWEST = 3.2, 1.15
"""Largest and smallest width of a close-up over that of the fruit's box."""
_LEVELS = (0.30, 0.80)
"""Range of a close-up's exposure, as shares of full scale."""


_PAPER_BELOW_MM = 0.02
"""Depth of the mat below z = 0, mm, so that mat and fruit do not share a plane."""
_TABLE_BELOW_MM = 0.3
"""Depth of the table below z = 0, mm: a sheet bends and never lies quite flat."""
_WINDOW_OVER_BOX = 1.25
"""Width of the window with more light samples over the fruit's box, to include shadow and rim."""
_FEATHER_PX = 8
"""Width of the blend between the window and the rest of the picture, px."""
_LEAST_ALBEDO = 0.05  # surfaces that only reflect have light too


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """Light samples per pixel of the halved frame and of the fruit's window (`crop_samples`), surface samples
    per pixel of the frame (`print_samples`), path depth, skin cells.
    """

    frame_samples: int = 4
    print_samples: int = 8
    crop_samples: int = 4
    depth: int = 4
    skin_cells: int = 200


def pictures(scene: Scene, *, options: RenderOptions) -> Iterator[Float[np.ndarray, "h w 3"]]:
    """Linear RGB light of each view through a pinhole, `margin_px` pixels larger on every side.

    Paths sample the frame's light at half the resolution. It is divided by albedo, denoised, enlarged, and
    multiplied by the albedo at full resolution: print stays sharp at a quarter of the cost. Paths sample the
    fruit's window at full resolution. Raises RendererMissing.
    """
    mi = mitsuba()
    oidn = denoiser()
    world = load_world(mi, scene, options=options)
    surfaces = {"type": "aov", "aovs": "a:albedo,n:sh_normal"}
    sees = mi.load_dict(surfaces)
    lit = mi.load_dict({**surfaces, "path": {"type": "path", "max_depth": options.depth}})
    box = scene.fruit.skin.points_mm(even_sphere(12).directions)
    margin = margin_px(scene.views, k1=scene.pipeline.k1)
    wides = [widened(view, margin) for view in scene.views]
    windows = _windows(wides, box)

    def shot(sensor: dict[str, Any], integrator: Any, samples: int, seed: int) -> Float[np.ndarray, "h w c"]:
        made = mi.render(
            world.scene, sensor=mi.load_dict(sensor), integrator=integrator, spp=samples, seed=seed
        )
        return np.array(made)

    for k, wide in enumerate(wides):
        world.stand(wide)
        coarse = shot(sensor(mi, halved(wide)), lit, options.frame_samples, 3 * k)
        clean = shot(sensor(mi, wide), sees, options.print_samples, 3 * k + 1)
        falling = coarse[..., :3] / _colour(coarse[..., 3:])
        falling = oidn(falling, *layers_of(coarse[..., 3:]))
        falling = cv2.resize(falling, (wide.width_px, wide.height_px), interpolation=cv2.INTER_LINEAR)
        picture = falling * _colour(clean)
        left, top, width, height = windows[k]
        fine = shot(window_sensor(mi, wide, windows[k]), lit, options.crop_samples, 3 * k + 2)
        part = picture[top : top + height, left : left + width]
        edge = _feather(height, width)
        part[:] = edge * oidn(*layers_of(fine)) + (1 - edge) * part
        yield picture


def halved(view: Viewpoint) -> Viewpoint:
    """The same view at half the resolution. Raises ValueError if a side is odd."""
    if view.width_px % 2 or view.height_px % 2:
        raise ValueError(f"a picture of {view.width_px} x {view.height_px} px cannot be halved")
    return scaled(view, 0.5)


def _colour(surfaces: Float[np.ndarray, "h w 6"]) -> Float[np.ndarray, "h w 3"]:
    """Factor on light, from albedo and normal; about 1 for the background, which has neither."""
    room = np.clip(1 - np.linalg.norm(surfaces[..., 3:], axis=-1, keepdims=True), 0, 1)
    return np.asarray(surfaces[..., :3] + room + _LEAST_ALBEDO)


def fruit_cover(
    mi: Any,
    world: "World",
    scene: Scene,
    view: Viewpoint,
    window: tuple[int, int, int, int],
    *,
    finer: int,
) -> Float[np.ndarray, "h w"]:
    """Share of each pixel of a window that the fruit covers in a pinhole view, from `finer`^2 rays each."""
    left, top, width, height = (finer * side for side in window)
    fine = scaled(view, finer)
    which = mi.load_dict({"type": "aov", "aovs": "i:shape_index"})
    camera = mi.load_dict(window_sensor(mi, fine, (left, top, width, height)))
    shape = np.array(mi.render(world.scene, sensor=camera, integrator=which, spp=1))[..., 0]
    middle_mm = np.array([[0.0, 0.0, 0.5 * box_mm(scene.fruit.skin)[1][2]]])
    column, row = np.rint(fine.pixels(middle_mm)[0] - [left, top]).astype(int)
    on_fruit = (shape == shape[row, column]).astype(np.float32)  # nothing hides the fruit's middle
    return np.asarray(cv2.resize(on_fruit, window[2:], interpolation=cv2.INTER_AREA))


def scaled(view: Viewpoint, factor: float) -> Viewpoint:
    """The same view with `factor` times as many pixels along each side."""
    return replace(
        view,
        focal_px=view.focal_px * factor,
        width_px=round(view.width_px * factor),
        height_px=round(view.height_px * factor),
    )


@dataclass(frozen=True, kw_only=True)
class World:
    """A loaded scene, and `stand`, which places the parts that move with the camera."""

    scene: Any
    stand: Callable[[Viewpoint], None]


def load_world(mi: Any, scene: Scene, *, options: RenderOptions) -> World:
    """The whole scene for the renderer; parts that move with the camera are placed as in the first view."""
    first = scene.views[0]
    lights = standing_lights(mi, scene.light)
    shapes: dict[str, Any] = {"type": "scene", **lights}
    table_mm = -_TABLE_BELOW_MM if scene.sheet else 0.0
    if scene.turntable is not None:
        shapes |= turntable_shapes(mi, scene.turntable, z_mm=table_mm)
        table_mm -= scene.turntable.height_mm
    shapes["table"] = ground_shape(mi, scene.ground, z_mm=table_mm)
    shapes["fruit"] = _fruit(mi, scene, options)
    if scene.sheet is not None:
        mat = sheet_mat(scene.sheet)
        points, triangles, uv = sheet_mesh(scene.sheet, mat)
        print_rgb = np.ascontiguousarray(sheet_texture(scene.sheet, mat)[::-1])
        paper = {"type": "bitmap", "raw": True, "wrap_mode": "clamp", "bitmap": mi.Bitmap(print_rgb)}
        bsdf = {"type": "twosided", "material": {"type": "diffuse", "reflectance": paper}}
        shapes["mat"] = mesh_shape(mi, "mat", points - [0, 0, _PAPER_BELOW_MM], triangles, bsdf=bsdf, uv=uv)
    if scene.coin is not None:
        points, triangles, colour = coin_mesh(scene.coin)
        metal = {
            "type": "principled", "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
            "metallic": 1.0, "roughness": 0.32,
        }  # fmt: skip
        shapes["coin"] = mesh_shape(
            mi, "coin", points, triangles, bsdf=metal, attributes={"vertex_color": colour}
        )
    moving: dict[str, Callable[[Viewpoint], np.ndarray]] = {}
    if scene.light.flash_radii_mm is not None:
        glow = flash_radiance(scene.light, distance_mm=scene.camera.distance_mm)
        points, triangles = flash_mesh(scene.light, first)
        lamp = {"type": "area", "radiance": {"type": "rgb", "value": list(glow)}}
        shapes["flash"] = mesh_shape(mi, "flash", points, triangles, bsdf={"type": "diffuse"}, emitter=lamp)
        moving["flash"] = lambda view: flash_mesh(scene.light, view)[0]
    if scene.light.photographer:
        points, triangles = photographer_mesh(first)
        cloth = {
            "type": "twosided",
            "material": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.08, 0.09, 0.12]}},
        }
        shapes["body"] = mesh_shape(mi, "body", points, triangles, bsdf=cloth)
        moving["body"] = lambda view: photographer_mesh(view)[0]
    turning = {}
    if scene.turntable is not None:  # in the mat's frame, fixed parts turn with the camera
        turning = {name: shapes[name]["to_world"] for name in (*lights, "table", "card")}
    loaded = mi.load_dict(shapes)

    def stand(view: Viewpoint) -> None:
        if moving or turning:
            values = mi.traverse(loaded)
            for name, points_of in moving.items():
                values[f"{name}.vertex_positions"] = points_of(view).astype(np.float32).ravel()
            turn = mi.ScalarTransform4f().rotate([0, 0, 1], view.azimuth_deg)
            for name, placed in turning.items():
                values[f"{name}.to_world"] = mi.Transform4f((turn @ placed).matrix)
            values.update()

    return World(scene=loaded, stand=stand)


def widened(view: Viewpoint, margin: int) -> Viewpoint:
    """The same view with `margin` pixels more on every side."""
    return replace(view, width_px=view.width_px + 2 * margin, height_px=view.height_px + 2 * margin)


def _fruit(mi: Any, scene: Scene, options: RenderOptions) -> Any:
    sphere, skin = even_sphere(options.skin_cells), scene.fruit.skin
    points, triangles = skin.points_mm(sphere.directions), sphere.triangles()
    colour, roughness = skin_attributes(scene.skin, sphere.directions)
    if isinstance(skin, ScannedSkin):
        colour, normals = skin.colours(sphere.directions), skin.normals(sphere.directions)
    else:
        normals = vertex_normals(points, triangles)
    return mesh_shape(
        mi, "fruit", points, triangles, bsdf=skin_bsdf(scene.skin), normals=normals,
        attributes={"vertex_color": colour, "vertex_roughness": roughness},
    )  # fmt: skip


def _windows(
    views: Sequence[Viewpoint], points_mm: Float[np.ndarray, "n 3"]
) -> tuple[tuple[int, int, int, int], ...]:
    """Left, top, width and height of a window around the points in each view: their box and a quarter more.

    All have one size, because another size costs the renderer a second of compilation.
    """
    lows, highs = [], []
    for view in views:
        seen = view.pixels(points_mm)
        lows.append(seen.min(axis=0))
        highs.append(seen.max(axis=0))
    low, high = np.array(lows), np.array(highs)
    size = np.ceil((high - low).max(axis=0) * _WINDOW_OVER_BOX).astype(int) + 2 * _FEATHER_PX
    full = np.array([[view.width_px, view.height_px] for view in views])
    size = np.minimum(size, full.min(axis=0))
    corner = np.clip(np.rint((low + high) / 2 - size / 2).astype(int), 0, full - size)
    return tuple((int(x), int(y), int(size[0]), int(size[1])) for x, y in corner)


def _feather(height: int, width: int) -> Float[np.ndarray, "h w 1"]:
    y, x = np.mgrid[:height, :width]
    inside = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    return np.asarray(np.clip((inside + 0.5) / _FEATHER_PX, 0, 1)[..., None], dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class CloseUp:
    """A BGR picture, and the share of each pixel that the fruit covers, 0 to 255."""

    image: UInt8[np.ndarray, "s s 3"]
    cover: UInt8[np.ndarray, "s s"]


def close_ups(scene: Scene, *, side_px: int, samples: int, options: RenderOptions) -> Iterator[CloseUp]:
    """One square picture for each view of the scene, path-traced with `samples` per pixel.

    The square is 1.15 to 3.2 times as wide as the fruit's box (log-uniform), and the box is about inside.
    Ground without shadow has an exposure of 0.30 to 0.80 of full scale; then the scene's camera pipeline
    follows. Raises RendererMissing.
    """
    mi, oidn = mitsuba(), denoiser()
    rng = np.random.default_rng([scene.seed, 30])
    world = load_world(mi, scene, options=options)
    lit = mi.load_dict(
        {"type": "aov", "aovs": "a:albedo,n:sh_normal", "path": {"type": "path", "max_depth": options.depth}}
    )
    box = scene.fruit.skin.points_mm(even_sphere(12).directions)
    level = float(rng.uniform(*_LEVELS))
    for k, view in enumerate(scene.views):
        seen, window = _square(view, box, rng, side_px=side_px)
        world.stand(view)
        layers = np.array(
            mi.render(
                world.scene, sensor=mi.load_dict(window_sensor(mi, seen, window)), integrator=lit,
                spp=samples, seed=k,
            )
        )  # fmt: skip
        light = oidn(*layers_of(layers))
        cover = fruit_cover(mi, world, scene, seen, window, finer=_FINER)
        counted = exposed(
            light, gain=level / _ground_level(light, cover), pipeline=scene.pipeline, shot=scene.shots[k]
        )
        image = developed(counted, pipeline=scene.pipeline, rng=rng)
        _, stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, scene.pipeline.jpeg_quality])
        yield CloseUp(
            image=np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), np.uint8),
            cover=np.rint(255 * cover).astype(np.uint8),
        )


def _square(
    view: Viewpoint, box: Float[np.ndarray, "n 3"], rng: np.random.Generator, *, side_px: int
) -> tuple[Viewpoint, tuple[int, int, int, int]]:
    """The view, scaled so that a random square around the fruit is `side_px` wide, and that square."""
    pixels = view.pixels(box)
    low, high = pixels.min(0), pixels.max(0)
    extent = float((high - low).max())
    wide = extent * _NARROWEST * (_WIDEST / _NARROWEST) ** float(rng.uniform())
    centre = (low + high) / 2 + 0.55 * (wide - extent) * rng.uniform(-1, 1, 2)
    seen = scaled(view, side_px / wide)
    corner = np.rint((centre - wide / 2) * (seen.focal_px / view.focal_px)).astype(int)
    return seen, (int(corner[0]), int(corner[1]), side_px, side_px)


def _ground_level(light: Float[np.ndarray, "s s 3"], cover: Float[np.ndarray, "s s"]) -> float:
    """70th percentile of the luminance around the fruit, or of the whole picture if the fruit fills it."""
    luminance = light @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    around = luminance[cover < 0.02]
    return float(max(np.percentile(around if around.size > 100 else luminance, 70), 1e-4))
