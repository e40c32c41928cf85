"""Open3D without what it imports for a browser, dash and plotly: half a second and 45 MiB."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType

NAMES: dict[str, tuple[str, ...]] = {
    "dash": ("html", "dcc", "Dash"),
    "plotly": (),
    "plotly.graph_objects": (),
}
"""Modules that open3d.visualization.draw_plotly imports, and what it takes from each by name: used where
something is drawn in a browser alone, which no fruit is."""


def load_open3d() -> None:
    """Imports Open3D, once a process; where it cannot be had, its user says so (recon.surface.ray_mesh)."""
    with _stand_ins(), suppress(ImportError, OSError):
        import open3d  # noqa: F401


@contextmanager
def _stand_ins() -> Iterator[None]:
    """Empty modules in the place of those that nobody has imported yet; they are gone afterwards."""
    missing = [name for name in NAMES if name not in sys.modules]
    for name in missing:
        module = ModuleType(name)
        vars(module).update(dict.fromkeys(NAMES[name]))
        sys.modules[name] = module
    try:
        yield
    finally:
        for name in missing:
            del sys.modules[name]
