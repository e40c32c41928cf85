"""Matplotlib's figures as PNG, the same bytes for the same figure."""

import io

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def png_of(figure: Figure) -> bytes:
    """The figure at its own size."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png", dpi=figure.dpi, metadata={"Software": None})
    return out.getvalue()


def show(axes: Axes, image: Float[np.ndarray, "h w 3"], half: float, *, samples: int) -> None:
    """Draws a square image from -half to half both ways, `samples` squared of its pixels as one."""
    pixels = len(image) // samples
    means = image.reshape(pixels, samples, pixels, samples, 3).mean(axis=(1, 3))
    axes.imshow(means, extent=(-half, half, -half, half), interpolation="nearest")
    axes.set_axis_off()
