"""Mitsuba 3 and Open Image Denoise, imported at first use, and the parts that all pictures share: cameras,
meshes, vertex normals, channels.
"""

import importlib
import os
from collections.abc import Callable
from ctypes.util import find_library
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from samples.sample_failure import RendererMissing
from samples.viewpoints import Viewpoint


def mitsuba() -> Any:
    """The module mitsuba with a variant set: LLVM if a compiler is found, else scalar.

    Raises RendererMissing.
    """
    try:
        mi = importlib.import_module("mitsuba")
    except ImportError as missing:
        raise RendererMissing(
            "Photos of sample fruit need the renderer Mitsuba 3, which is not installed; "
            "run in drupe's folder: pip install '.[samples]'"
        ) from missing
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb" if _compiler_found() else "scalar_rgb")
    return mi


def _compiler_found() -> bool:
    """Whether there is libLLVM 16 or later (15 and older abort the process); tells Dr.Jit its path."""
    if "DRJIT_LIBLLVM_PATH" in os.environ:
        return True
    names = (find_library(f"LLVM-{version}") for version in range(30, 15, -1))
    path = next((name for name in names if name), None)
    if path is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = path
    return path is not None


def denoiser() -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Open Image Denoise as a function of colour (linear, HDR), albedo and normal. Raises RendererMissing."""
    try:
        oidn = importlib.import_module("pyoidn")
    except ImportError as missing:
        raise RendererMissing(
            "Photos of sample fruit need Open Image Denoise (pyoidn), which is not installed; "
            "run in drupe's folder: pip install '.[samples]' (pip has no pyoidn for Linux on ARM)"
        ) from missing

    def denoise(colour: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return np.asarray(oidn.denoise(colour, albedo=albedo, normal=normal, hdr=True))

    return denoise


def sensor(mi: Any, view: Viewpoint) -> dict[str, Any]:
    """A view as the description of a pinhole camera (dictionary for `mi.load_dict`)."""
    world_from_cam = np.linalg.inv(view.cam_from_world)
    # Mitsuba's camera looks along +z with x to the left and y up
    pose = world_from_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(view.width_px / 2 / view.focal_px))),
        "near_clip": 10.0,
        "far_clip": 5000.0,
        "to_world": mi.ScalarTransform4f(pose),
        "film": {
            "type": "hdrfilm", "width": view.width_px, "height": view.height_px, "pixel_format": "rgb",
            "rfilter": {"type": "box"},  # the denoiser expects pixels whose noise is independent
        },
        "sampler": {"type": "independent"},
    }  # fmt: skip


def window_sensor(mi: Any, view: Viewpoint, window: tuple[int, int, int, int]) -> dict[str, Any]:
    """The camera of a window of the picture (left, top, width, height in px)."""
    left, top, width, height = window
    part = sensor(mi, replace(view, width_px=width, height_px=height))
    part["principal_point_offset_x"] = 0.5 - (view.width_px / 2 - left) / width
    part["principal_point_offset_y"] = 0.5 - (view.height_px / 2 - top) / height
    return part


def layers_of(layers: Float[np.ndarray, "h w c"]) -> list[Float[np.ndarray, "_ _ 3"]]:
    """A rendered picture's channels in contiguous groups of three: colour, albedo, normal."""
    return [np.ascontiguousarray(layers[..., c : c + 3]) for c in range(0, layers.shape[2], 3)]


def mesh_shape(
    mi: Any,
    name: str,
    points: Float[np.ndarray, "n 3"],
    triangles: np.ndarray,
    *,
    bsdf: dict[str, Any],
    emitter: dict[str, Any] | None = None,
    uv: Float[np.ndarray, "n 2"] | None = None,
    normals: Float[np.ndarray, "n 3"] | None = None,
    attributes: dict[str, np.ndarray] | None = None,
) -> Any:
    """A mesh for the renderer with its colours or texture coordinates."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if emitter is not None:
        properties["emitter"] = mi.load_dict(emitter)
    mesh = mi.Mesh(
        name, len(points), len(triangles), props=properties, has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
    )  # fmt: skip
    for key, values in (attributes or {}).items():
        mesh.add_attribute(key, 1 if values.ndim == 1 else 3, values.astype(np.float32).ravel())
    parts = mi.traverse(mesh)
    parts["vertex_positions"] = points.astype(np.float32).ravel()
    parts["faces"] = triangles.astype(np.uint32).ravel()
    if normals is not None:
        parts["vertex_normals"] = normals.astype(np.float32).ravel()
    if uv is not None:
        parts["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parts.update()
    return mesh
