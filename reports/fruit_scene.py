"""3D model of the fruit as binary glTF 2.0: the pit, and the skin with its contact patches.

Vertices have colours (COLOR_0, RGBA); the skin is half transparent, so that the pit shows. A map of the skin
is a second set of colours (COLOR_1); the skin's `extras` hold its name and limits. Photos of the skin are one
image by direction from a point, which the `extras` hold too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from reports.skin_layer import FLESH, PADS, PIT, SkinLayer, middle

SKIN_TRIANGLES, PIT_TRIANGLES = 1600, 400
"""Most triangles after decimation. Set by hand: 30 kB without photos, facets of 4 mm on a fruit of 60 mm."""
SKIN_ALPHA, PATCH_ALPHA = 0.45, 0.92
"""Opacity of the skin, and of contact patches and maps (by eye)."""
ROUND = 1.6
"""Radius of a marker's patch over the median spacing: patches close, and rims are half a spacing wide."""
_COMPONENTS = {"<f4": 5126, "|u1": 5121, "<u2": 5123}
"""glTF component types (glTF 2.0, 3.6.2.2) by numpy type."""
_VERTICES, _TRIANGLES = 34962, 34963
"""Buffer targets (glTF 2.0, 5.11.5)."""


@dataclass(frozen=True, eq=False)
class SceneSurface:
    """A closed surface: vertices (mm) and triangles."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]

    def decimated(self, most: int) -> SceneSurface:
        """The surface with at most `most` triangles."""
        if len(self.faces) <= most:
            return self
        import pyvista

        mesh = pyvista.PolyData.from_regular_faces(np.array(self.vertices, dtype=float), np.array(self.faces))
        small = mesh.decimate(1 - most / len(self.faces), volume_preservation=True)
        return SceneSurface(
            np.array(small.points, dtype=float), np.array(small.regular_faces, dtype=np.int32)
        )


@dataclass(frozen=True, eq=False)
class _Part:
    """A mesh of the scene: its sets of vertex colours (RGBA, 0 to 1), and what else its glTF holds."""

    name: str
    surface: SceneSurface
    colours: list[Float[np.ndarray, "_n 4"]]
    extras: dict[str, object] = field(default_factory=dict)


def fruit_scene(
    skin: SceneSurface,
    pit: SceneSurface | None,
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]],
    layer: SkinLayer | None = None,
    *,
    photo: bytes = b"",
    stem_and_suture: bool = True,
) -> bytes:
    """A GLB in mm, z to the stem. `contacts_mm`: points that each pad touches; `layer`: a map of the skin;
    `photo`: the skin's JPEG by direction (reports.skin_texture); `stem_and_suture`: whether the body has
    them, at +z and +x.
    """
    parts: list[_Part] = []
    if pit is not None and len(pit.faces):
        inner = pit.decimated(PIT_TRIANGLES)
        parts.append(_Part("pit", inner, [np.tile([*PIT, 1.0], (len(inner.vertices), 1))]))
    outer = skin.decimated(SKIN_TRIANGLES)
    painted = _Part("skin", outer, [_painted(outer.vertices, contacts_mm)])
    if layer is not None:
        nearest = np.asarray(cKDTree(skin.vertices).query(outer.vertices)[1])
        colour = np.tile([*FLESH, SKIN_ALPHA], (len(outer.vertices), 1))
        shown = layer.shown[nearest]
        colour[shown] = np.insert(layer.colours[nearest[shown]], 3, PATCH_ALPHA, axis=1)
        painted.colours.append(colour)
        painted.extras["map"] = {"name": layer.name, "low": layer.low, "high": layer.high}
    painted.extras["stem_and_suture"] = stem_and_suture
    if photo:
        painted.extras["photo"] = {"image": 0, "middle": middle(skin.vertices).tolist()}
    return _glb([*parts, painted], photo)


def _painted(
    vertices: Float[np.ndarray, "n 3"], contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]]
) -> Float[np.ndarray, "n 4"]:
    """RGBA of the skin's vertices, with a patch around each touched point."""
    colour = np.tile([*FLESH, SKIN_ALPHA], (len(vertices), 1))
    for k, points in enumerate(contacts_mm.values()):
        if len(points) < 2:
            continue
        tree = cKDTree(points)
        distance, _ = tree.query(points, k=2)
        pitch = float(np.median(np.asarray(distance)[:, 1]))
        colour[tree.query(vertices)[0] < ROUND * pitch] = [*PADS[k % len(PADS)], PATCH_ALPHA]
    return colour


def _glb(parts: list[_Part], photo: bytes) -> bytes:
    """Header, JSON chunk and binary chunk (glTF 2.0, 4.4)."""
    buffer = bytearray()
    views: list[dict[str, int]] = []
    accessors: list[dict[str, object]] = []

    def held(array: np.ndarray, target: int, **more: object) -> int:
        content = array.tobytes()
        buffer.extend(b"\0" * (-len(buffer) % 4))
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(content), "target": target})
        buffer.extend(content)
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": _COMPONENTS[array.dtype.str],
                "count": len(array),
                "type": "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}",
                **more,
            }
        )
        return len(accessors) - 1

    meshes = []
    for part in parts:
        places = np.asarray(part.surface.vertices, dtype="<f4")
        painted = {
            f"COLOR_{k}": held(np.round(255 * colour).astype("|u1"), _VERTICES, normalized=True)
            for k, colour in enumerate(part.colours)
        }
        limits = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
        corners = np.ravel(part.surface.faces).astype("<u2")
        primitive = {
            "attributes": {"POSITION": held(places, _VERTICES, **limits), **painted},
            "indices": held(corners, _TRIANGLES),
            "material": 0,
        }
        extras = {"extras": part.extras} if part.extras else {}
        meshes.append({"name": part.name, **extras, "primitives": [primitive]})
    images = {}
    if photo:
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(photo)})
        images = {"images": [{"bufferView": len(views) - 1, "mimeType": "image/jpeg"}]}
        buffer.extend(photo)
    buffer.extend(b"\0" * (-len(buffer) % 4))
    content = {
        "asset": {"version": "2.0", "generator": "drupe"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": k, "name": mesh["name"]} for k, mesh in enumerate(meshes)],
        "meshes": meshes,
        "materials": [{"alphaMode": "BLEND", "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        **images,
        "buffers": [{"byteLength": len(buffer)}],
    }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = _chunk(b"JSON", text) + _chunk(b"BIN\0", bytes(buffer))
    return b"glTF" + _word(2) + _word(12 + len(chunks)) + chunks


def _chunk(kind: bytes, data: bytes) -> bytes:
    return _word(len(data)) + kind + data


def _word(value: int) -> bytes:
    return value.to_bytes(4, "little")
