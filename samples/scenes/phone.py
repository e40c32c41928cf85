"""From light to a photo: a plain picture, or the processing of a phone as image edits."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

PIPELINES = ("none", "phone")
PLAIN_QUALITY = 92
"""JPEG quality, 0 to 100: the usual default of cameras, about."""
ORIENTATIONS = (3, 6, 8)  # EXIF: half turn; quarter turn clockwise; quarter turn the other way, to see it


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """`sharpening` is the weight of unsharp masking with a blur of `sharpening_px` (halos). `noise_reduction`
    is the bilateral filter's range, `chroma_noise` the colour noise after it (levels). `tone_clip` and
    `tone_share` are CLAHE's clip limit and weight. `k1` is radial distortion, `vignetting` the light loss in
    the corners; `gamma` maps finished tones v to v^gamma.
    """

    kind: str
    sharpening: float = 0.0
    sharpening_px: float = 1.2
    noise_reduction: float = 0.0
    chroma_noise: float = 0.0
    tone_clip: float = 0.0
    tone_share: float = 0.0
    k1: float = 0.0
    vignetting: float = 0.0
    gamma: float = 1.0
    sensor_noise: float = 0.8
    metered_each: bool = False
    jpeg_quality: int = PLAIN_QUALITY


@dataclass(frozen=True, kw_only=True)
class Shot:
    """Differences between photos: white-balance gains (R, G, B), focal length over its mean, blur (standard
    deviation, px), EXIF orientation (1: stored upright).
    """

    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    focal_scale: float = 1.0
    blur_px: float = 0.0
    orientation: int = 1


def draw_pipeline(
    rng: np.random.Generator, *, photos: int, kinds: tuple[str, ...] = PIPELINES
) -> tuple[Pipeline, tuple[Shot, ...]]:
    """A pipeline of one of `kinds`, and its shots. With both kinds two of three are phones. A phone applies
    each of its edits in four sets of five, distortion in two of five, and rotated storage in one of three.
    """
    drawn = "phone" if rng.uniform() < 0.66 else "none"
    kind = drawn if drawn in kinds else kinds[0]
    plain = Pipeline(kind=kind)
    if kind == "none":
        return plain, (Shot(),) * photos
    on = rng.uniform(size=7) < 0.8
    pipeline = replace(
        plain,
        sharpening=float(on[0] * rng.uniform(0.4, 1.5)),
        sharpening_px=float(rng.uniform(0.8, 2.0)),
        noise_reduction=float(on[1] * rng.uniform(8, 28)),
        chroma_noise=float(on[1] * rng.uniform(1.0, 4.0)),
        tone_clip=float(on[2] * rng.uniform(1.2, 3.0)),
        tone_share=float(on[2] * rng.uniform(0.25, 0.75)),
        vignetting=float(on[3] * rng.uniform(0.08, 0.4)),
        k1=float(rng.uniform(-0.05, 0.03)) if rng.uniform() < 0.4 else 0.0,
        gamma=float(rng.uniform(0.8, 1.25)),
        sensor_noise=float(rng.uniform(1.0, 4.0)),
        metered_each=bool(on[4]),
        jpeg_quality=int(rng.integers(55, 93)),
    )
    turned = int(rng.choice(ORIENTATIONS)) if rng.uniform() < 0.33 else 1
    shots = []
    for _ in range(photos):
        gains = 1 + on[5] * rng.uniform(-0.06, 0.06, 3)
        breathing = 1 + on[6] * rng.uniform(-0.004, 0.004)
        blur = rng.uniform(0.7, 1.6) * (rng.uniform() < 0.08)
        shots.append(
            Shot(
                gains=(float(gains[0]), float(gains[1]), float(gains[2])),
                focal_scale=float(breathing),
                blur_px=float(blur),
                # people turn the phone over now and then
                orientation=turned if rng.uniform() < 0.85 else 1,
            )
        )
    return pipeline, tuple(shots)


def exposed(
    light: Float[np.ndarray, "h w 3"], *, gain: float, pipeline: Pipeline, shot: Shot
) -> Float[np.ndarray, "h w 3"]:
    """Linear light on the sensor: vignetting, exposure, white balance, blur. Channels R, G, B."""
    height, width = light.shape[:2]
    y, x = np.ogrid[:height, :width]
    square = (
        ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / ((width**2 + height**2) / 4)
    ).astype(np.float32)
    counted = light * (gain * (1 - pipeline.vignetting * square))[..., None]
    counted = counted * np.asarray(shot.gains, dtype=np.float32)
    if shot.blur_px:
        counted = cv2.GaussianBlur(counted, (0, 0), shot.blur_px)
    return np.asarray(counted, dtype=np.float32)


def developed(
    light: Float[np.ndarray, "h w 3"], *, pipeline: Pipeline, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The finished BGR picture from the sensor's light: tone curve, noise, and a phone's edits."""
    tone = np.clip(light, 0.0, None)
    tone = np.where(tone > 0.7, 0.7 + 0.3 * np.tanh((tone - 0.7) / 0.3), tone)
    srgb = np.where(tone <= 0.0031308, 12.92 * tone, 1.055 * np.maximum(tone, 1e-9) ** (1 / 2.4) - 0.055)
    levels = 255.0 * np.asarray(srgb, dtype=np.float32) ** pipeline.gamma
    levels += pipeline.sensor_noise * rng.normal(size=levels.shape).astype(np.float32)
    if pipeline.kind == "phone":
        levels = _phone_edits(levels, pipeline, rng)
    return np.ascontiguousarray(np.clip(np.rint(levels), 0, 255)[..., ::-1], dtype=np.uint8)


def _phone_edits(
    levels: Float[np.ndarray, "h w 3"], pipeline: Pipeline, rng: np.random.Generator
) -> Float[np.ndarray, "h w 3"]:
    """A phone's edits after the sensor: noise reduction, local contrast, sharpening."""
    if pipeline.noise_reduction:
        smooth = cv2.bilateralFilter(
            np.clip(levels, 0, 255).astype(np.float32), 5, pipeline.noise_reduction, 1.6
        )
        levels = cv2.medianBlur(smooth, 3) if pipeline.noise_reduction > 20 else smooth
        blotches = rng.normal(size=(levels.shape[0] // 4, levels.shape[1] // 4, 3)).astype(np.float32)
        blotches = cv2.resize(blotches, levels.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        blotches -= blotches.mean(axis=2, keepdims=True)
        levels = levels + pipeline.chroma_noise * blotches
    if pipeline.tone_share:
        lab = cv2.cvtColor(np.clip(levels, 0, 255).astype(np.uint8), cv2.COLOR_RGB2LAB)
        before = lab[..., 0]
        after = cv2.createCLAHE(pipeline.tone_clip, (6, 8)).apply(before)
        brighter = pipeline.tone_share * (after.astype(np.float32) - before)
        levels = levels * (1 + brighter / np.maximum(before, 12.0))[..., None]
    if pipeline.sharpening:
        levels = levels + pipeline.sharpening * (
            levels - cv2.GaussianBlur(levels, (0, 0), pipeline.sharpening_px)
        )
    return np.asarray(levels)
