"""Maps on a fruit's skin: value and colour of each vertex. Other modules draw the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

FLESH = np.array([0.99, 0.74, 0.47])
"""sRGB (0 to 1) of ripe flesh on photos (by eye)."""
PIT = np.array([0.36, 0.20, 0.12])
"""sRGB (0 to 1) of a brown pit (by eye)."""
PADS = ((0.114, 0.306, 0.537), (0.0, 0.47, 0.42), (0.48, 0.25, 0.55), (0.35, 0.35, 0.35))
"""sRGB (0 to 1) of the pads' contacts: blue, green, violet, grey, for colour-blind readers too (by eye)."""
FROM_SIDES = (
    ("suture side", 0.0, 8.0),
    ("right of the suture", 90.0, 8.0),
    ("opposite side", 180.0, 8.0),
    ("left of the suture", 270.0, 8.0),
    ("stem end", 0.0, 86.0),
    ("blossom end", 0.0, -86.0),
)
"""Name, azimuth and elevation (degrees) of the views: four sides a little from above, stem, blossom end."""
SIGNED = ("7d0630", "d1495b", "f2b9a6", "f7f3ea", "a9cbe0", "3c8dbc", "163f70")
ONE_SIDED = ("f7f3ea", "e8c06a", "c77a12", "6b2d00")
"""sRGB in hex from the lowest to the highest value: for values of both signs, and from zero up."""
REACH = 1.6
"""Skin farther than this from every marker has no value, in median spacings of the markers."""
NEIGHBOURS = 6
"""Nearest markers that a value averages, with Gaussian weights (sd: one marker spacing). The mean hides the
noise of one marker and keeps a patch's tilt or dome. Set by hand."""
MOST_SHARE = 0.98
"""The colours end at this quantile of the absolute values."""
LEAST_UM = 20.0
"""Their least reach, um: twice a usual gel's noise, which must not appear as misfit. Set by hand."""


def ramp(shares: Float[np.ndarray, " n"], colours: Sequence[str]) -> Float[np.ndarray, "n 3"]:
    """RGB from 0 to 1 of values from 0 to 1, linear between the colours.

    >>> ramp(np.array([0.0, 1.0]), ("000000", "ff0000")).tolist()
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    stops = np.array([list(bytes.fromhex(colour)) for colour in colours]) / 255
    places = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(shares, places, channel) for channel in stops.T], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinLayer:
    """A map of values of both signs over a surface's vertices, valid where `shown`. Its colour bar reaches
    from -`limit` to `limit`; `low` and `high` are the labels of its ends. `name`: the page's word for the map
    in the 3D view.
    """

    name: str
    values: Float[np.ndarray, " n"]
    shown: Bool[np.ndarray, " n"]
    limit: float
    unit: str

    @property
    def low(self) -> str:
        """The bar's lower end with its unit."""
        return f"-{self.high}"

    @property
    def high(self) -> str:
        """The bar's upper end with its unit."""
        return f"{self.limit:.3g} {self.unit}"

    @property
    def colours(self) -> Float[np.ndarray, "n 3"]:
        """RGB of each vertex, 0 to 1."""
        return ramp(0.5 + 0.5 * self.values / self.limit, SIGNED)


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchResidual:
    """Markers of a pad in a grasp: their places on the skin (fruit frame, mm) and residuals (um).

    Positive: the recorded skin went farther in than the model's.
    """

    name: str
    places_mm: Float[np.ndarray, "k 3"]
    residual_um: Float[np.ndarray, " k"]


def residual_layer(
    vertices_mm: Float[np.ndarray, "n 3"], patches: Sequence[PatchResidual]
) -> SkinLayer | None:
    """Residuals over the whole skin, averaged where patches overlap; None if no patch has two markers."""
    carried = [
        on_skin(vertices_mm, patch.places_mm, patch.residual_um)
        for patch in patches
        if len(patch.places_mm) >= 2
    ]
    if not carried:
        return None
    values, seen = (np.array(per_vertex) for per_vertex in zip(*carried, strict=True))
    count = seen.sum(axis=0)
    measured = np.abs(values[seen])
    return SkinLayer(
        name="residual",
        values=np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1),
        shown=count > 0,
        limit=max(float(np.quantile(measured, MOST_SHARE)) if len(measured) else 0.0, LEAST_UM),
        unit="µm",
    )


def on_skin(
    vertices_mm: Float[np.ndarray, "n 3"],
    places_mm: Float[np.ndarray, "k 3"],
    values: Float[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The markers' values interpolated to the vertices, and whether each vertex is near a marker (REACH)."""
    tree = cKDTree(places_mm)
    pitch = float(np.median(np.asarray(tree.query(places_mm, k=2)[0])[:, 1]))
    pitch = max(pitch, 1e-6)
    count = min(NEIGHBOURS, len(places_mm))
    away, which = (
        np.asarray(per_neighbour).reshape(len(vertices_mm), count)
        for per_neighbour in tree.query(vertices_mm, k=count)
    )
    weight = np.exp(-0.5 * ((away**2 - away[:, :1] ** 2) / pitch**2))
    return (weight * values[which]).sum(axis=1) / weight.sum(axis=1), away[:, 0] < REACH * pitch


def middle(vertices: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 3"]:
    """The centre of the mesh's box."""
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2)


def vertex_normals(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Outward unit normals: the area-weighted mean of the faces around each vertex."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, areas[:, None, :])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(lengths, 1e-12))
