"""The fruit in three dimensions with the finder's map on its skin."""

from __future__ import annotations

import numpy as np

from reports.explain_entries import ExplainEntry
from reports.fruit_scene import SceneSurface, fruit_scene
from reports.skin_layer import SkinLayer
from reports.skin_picture import BLIND_BELOW


def explained_scene(entry: ExplainEntry, pit: SceneSurface | None) -> bytes | None:
    """A GLB as `fruit_scene` makes it; on the skin the standard score of softer (negative) or firmer flesh
    wherever a spot could be seen. None where the finder has no such map.
    """
    maps = entry.maps
    if maps is None:
        return None
    shown = np.isfinite(maps.modulus_score) & (maps.visible >= BLIND_BELOW)
    if not shown.any():
        return None
    values = np.where(shown, maps.modulus_score, 0.0)
    layer = SkinLayer(
        name="finder",
        values=values,
        shown=shown,
        limit=max(float(np.abs(values).max()), BLIND_BELOW),
        unit="σ",
    )
    return fruit_scene(SceneSurface(maps.vertices_mm, maps.triangles), pit, entry.contacts_mm, layer)
