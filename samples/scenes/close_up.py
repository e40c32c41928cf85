"""Small square pictures of a scene's fruit, each with the share of every pixel that the fruit covers."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from samples.cubed_sphere import even_sphere
from samples.renderer import denoiser, layers_of, mitsuba, window_sensor
from samples.scenes.draw import Scene
from samples.scenes.phone import developed, exposed
from samples.scenes.render import RenderOptions, fruit_cover, load_world, scaled
from samples.viewpoints import Viewpoint

_FINER = 3
"""Samples along each side of a pixel that tell how much of it the fruit covers: in steps of a ninth."""
_WIDEST, _NARROWEST = 3.2, 1.15
"""Widths of the square over that of the fruit's box."""
_LEVELS = (0.30, 0.80)
"""Exposure, as shares of full scale."""


@dataclass(frozen=True, kw_only=True)
class CloseUp:
    """A BGR picture, and how much of each pixel the fruit covers, 0 to 255."""

    image: UInt8[np.ndarray, "s s 3"]
    cover: UInt8[np.ndarray, "s s"]


def close_ups(scene: Scene, *, side_px: int, samples: int, options: RenderOptions) -> Iterator[CloseUp]:
    """One picture for each view of the scene, path-traced with `samples` per pixel.

    The square is 1.15 to 3.2 times as wide as the fruit's box (evenly in its logarithm) and lies so that the
    box is about inside. Ground that is not in shadow is exposed to 0.30 to 0.80 of full scale; then the
    scene's camera pipeline. Raises RendererMissing.
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
    """The view at the scale at which the drawn square is `side_px` wide, and that square in it."""
    pixels = view.pixels(box)
    low, high = pixels.min(0), pixels.max(0)
    extent = float((high - low).max())
    wide = extent * _NARROWEST * (_WIDEST / _NARROWEST) ** float(rng.uniform())
    centre = (low + high) / 2 + 0.55 * (wide - extent) * rng.uniform(-1, 1, 2)
    seen = scaled(view, side_px / wide)
    corner = np.rint((centre - wide / 2) * (seen.focal_px / view.focal_px)).astype(int)
    return seen, (int(corner[0]), int(corner[1]), side_px, side_px)


def _ground_level(light: Float[np.ndarray, "s s 3"], cover: Float[np.ndarray, "s s"]) -> float:
    """The 70th percentile of the luminance beside the fruit; of all where the fruit fills the picture."""
    luminance = light @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    around = luminance[cover < 0.02]
    return float(max(np.percentile(around if around.size > 100 else luminance, 70), 1e-4))
