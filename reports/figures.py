"""Matplotlib figures as pictures; the same figure gives the same bytes."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.text import Text


def png_of(figure: Figure) -> bytes:
    """PNG of the figure at its own size."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png", dpi=figure.dpi, metadata={"Software": None})
    return out.getvalue()


OUTLINE: list[AbstractPathEffect] = [withStroke(linewidth=4, foreground="white")]
"""White around ink: legible on a light and on a dark page behind a figure without ground."""


def outlined(figure: Figure) -> Figure:
    """The figure; its words and lines have an OUTLINE."""
    for artist in figure.findobj(lambda part: isinstance(part, Text | Line2D)):
        artist.set_path_effects(OUTLINE)
    return figure


def webp_of(figure: Figure) -> bytes:
    """WebP of the figure at quality 80: fewer bytes, for a page."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="webp", dpi=figure.dpi, pil_kwargs={"quality": 80})
    return out.getvalue()
