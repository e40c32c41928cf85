"""Matplotlib figures as pictures; the same figure gives the same bytes."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def png_of(figure: Figure) -> bytes:
    """PNG of the figure at its own size."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png", dpi=figure.dpi, metadata={"Software": None})
    return out.getvalue()


def webp_of(figure: Figure) -> bytes:
    """WebP of the figure at quality 80: fewer bytes, for a page."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="webp", dpi=figure.dpi, pil_kwargs={"quality": 80})
    return out.getvalue()
