"""Matplotlib's figures as pictures, the same bytes for the same figure."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def png_of(figure: Figure) -> bytes:
    """The figure at its own size."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png", dpi=figure.dpi, metadata={"Software": None})
    return out.getvalue()


def webp_of(figure: Figure) -> bytes:
    """The same in fewer bytes, for a page."""
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="webp", dpi=figure.dpi, pil_kwargs={"quality": 80})
    return out.getvalue()
