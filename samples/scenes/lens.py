"""Mild radial lens distortion: x_d = x_u (1 + k1 |x_u|^2) in units of the focal length, about the centre."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from samples.viewpoints import Viewpoint


def distorted_pixels(
    pixels: Float[np.ndarray, "n 2"], view: Viewpoint, *, k1: float
) -> Float[np.ndarray, "n 2"]:
    """Where the lens puts what a pinhole would put at `pixels` (centre of the first pixel (0, 0))."""
    middle = _middle(view)
    x = (pixels - middle) / view.focal_px
    return np.asarray(middle + view.focal_px * x * (1 + k1 * np.sum(x**2, axis=-1, keepdims=True)))


def pinhole_pixels(
    pixels: Float[np.ndarray, "n 2"], view: Viewpoint, *, k1: float
) -> Float[np.ndarray, "n 2"]:
    """The inverse of `distorted_pixels`, by fixed-point iteration."""
    middle = _middle(view)
    seen = (pixels - middle) / view.focal_px
    x = seen
    for _ in range(20):
        x = seen / (1 + k1 * np.sum(x**2, axis=-1, keepdims=True))
    return np.asarray(middle + view.focal_px * x)


def margin_px(views: Sequence[Viewpoint], *, k1: float) -> int:
    """How many pixels more a pinhole picture needs on every side to fill the distorted one, in every view."""
    reach = [
        pinhole_pixels(np.array([(0.0, 0.0), (0.0, (v.height_px - 1) / 2)]), v, k1=k1).min() for v in views
    ]
    return int(max(0.0, np.ceil(-min(reach)))) + (2 if k1 else 0)


def distorted_picture(
    picture: Float[np.ndarray, "h w c"], view: Viewpoint, *, k1: float, margin: int
) -> Float[np.ndarray, "h2 w2 c"]:
    """The lens's picture out of a pinhole picture that is `margin` pixels larger on every side."""
    if k1 == 0.0:
        return picture[margin : margin + view.height_px, margin : margin + view.width_px]
    y, x = np.mgrid[: view.height_px, : view.width_px].astype(float)
    source = pinhole_pixels(np.stack([x.ravel(), y.ravel()], 1), view, k1=k1).reshape(*x.shape, 2)
    grid = (source + margin).astype(np.float32)
    warped = cv2.remap(
        picture.astype(np.float32), grid, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped)


def _middle(view: Viewpoint) -> Float[np.ndarray, " 2"]:
    return np.array([view.width_px - 1, view.height_px - 1]) / 2
