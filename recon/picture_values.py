"""Values of a picture between its pixels."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Picture = UInt8[np.ndarray, "h w 3"]
Pictures = Sequence[UInt8[np.ndarray, "_ _ 3"]]
"""Pictures of three channels, BGR or Lab, of any sizes."""


def sampled(
    picture: np.ndarray,
    pixels: Float[np.ndarray, "*n 2"],
    *,
    outside: float | None = None,
    how: int = cv2.INTER_LINEAR,
) -> np.ndarray:
    """Values at pixels (column, row), bilinear by default; off the picture `outside`, or its edge's if None.

    >>> picture = np.array([[0.0, 2.0]], dtype=np.float32)
    >>> sampled(picture, np.array([[0.5, 0.0], [9.0, 0.0]]), outside=-1.0)
    array([ 1., -1.], dtype=float32)
    """
    row, count = 1024, pixels[..., 0].size
    padded = np.full((-(-count // row) * row, 2), -9.0, np.float32)
    padded[:count] = np.clip(pixels, -9.0, 30000.0).reshape(-1, 2)
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    maps, beyond = padded.reshape(-1, row, 2), (outside or 0.0,) * 4
    values = cv2.remap(picture, maps, None, how, borderMode=border, borderValue=beyond)
    values = values.reshape(len(padded), *picture.shape[2:])[:count]
    return np.asarray(values.reshape(*pixels.shape[:-1], *picture.shape[2:]))
