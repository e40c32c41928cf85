"""A scanned fruit as a sample: surface and colours of a textured mesh, by direction."""

import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.ndimage import map_coordinates

from recon.surface.orientation import volume_centre
from recon.surface.ray_mesh import RayMesh
from samples.appearance import linear_rgb
from samples.fruit import Skin, triple
from samples.sample_failure import SampleFailure


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A textured mesh: vertices (mm), outward triangles, unit normals and texture coordinates (v up) at the
    vertices, BGR picture.
    """

    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    texture: UInt8[np.ndarray, "h w 3"]

    @cached_property
    def _rays(self) -> RayMesh:
        return RayMesh(self.vertices, self.triangles)

    def met(
        self, start_mm: Float[np.ndarray, " 3"], directions: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Distance to the mesh in each direction, the corners of the triangle there, and their weights.

        Raises SampleFailure if a ray meets no triangle.
        """
        away, corners, weights = self._rays.met(np.broadcast_to(start_mm, directions.shape), directions)
        if not np.all(np.isfinite(away)):
            missed = np.mean(~np.isfinite(away))
            raise SampleFailure(
                f"{100 * missed:.1f} % of the scan is open; expected a closed mesh: repair it."
            )
        return away, corners, weights


@dataclass(frozen=True, kw_only=True)
class ScannedSkin(Skin):
    """The first surface of a scan on rays from `centre_mm`; it ignores the analytic terms of `Skin`."""

    scan: Scan

    def radius_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """r(d) in mm for unit directions. Raises SampleFailure if the scan is open there."""
        return self.scan.met(np.array(self.centre_mm), directions)[0]

    def colours(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Linear RGB of the texture (bilinear)."""
        high, wide = self.scan.texture.shape[:2]
        u, v = self._interpolated(self.scan.uv, directions).T
        place = np.stack([(1 - v) * high - 0.5, u * wide - 0.5])
        channels = [
            map_coordinates(self.scan.texture[..., k], place, float, order=1, mode="nearest")
            for k in (2, 1, 0)
        ]
        return np.asarray(linear_rgb(np.stack(channels, axis=1) / 255.0))

    def normals(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit normals, interpolated over each triangle."""
        normals = self._interpolated(self.scan.normals, directions)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def as_mapping(self) -> dict[str, Any]:
        """Its centre and half axes, without the scan."""
        return {"centre_mm": self.centre_mm, "half_axes_mm": self.half_axes_mm}

    def _interpolated(
        self, values: Float[np.ndarray, "v c"], directions: Float[np.ndarray, "n 3"]
    ) -> np.ndarray:
        _, corners, weights = self.scan.met(np.array(self.centre_mm), directions)
        return np.asarray(np.einsum("nk,nkc->nc", weights, values[corners]))


def read_scan(mesh: Path, texture: Path, *, mm_per_unit: float) -> Scan:
    """An OBJ file with normals and texture coordinates, and its picture, without its material file.

    Raises SampleFailure that names a file without texture coordinates, or a picture that does not load.
    """
    loaded = trimesh.load_mesh(io.BytesIO(mesh.read_bytes()), file_type="obj", process=False)
    uv = getattr(loaded.visual, "uv", None)
    if uv is None:
        raise SampleFailure(f"{mesh} has no texture coordinates (vt); expected an OBJ file with a texture.")
    picture = cv2.imread(str(texture), cv2.IMREAD_COLOR)
    if picture is None:
        raise SampleFailure(
            f"{texture} is no picture that can be decoded; expected the texture of {mesh.name}."
        )
    return Scan(
        vertices=mm_per_unit * np.asarray(loaded.vertices, float),
        triangles=np.asarray(loaded.faces, int),
        normals=np.asarray(loaded.vertex_normals, float),
        uv=np.asarray(uv, float),
        texture=picture,
    )


def skin_of_scan(
    scan: Scan, *, stem_mm: Float[np.ndarray, " 3"], suture_mm: Float[np.ndarray, " 3"]
) -> ScannedSkin:
    """The scan in the fruit frame: `stem_mm` straight above the centre of volume, `suture_mm` towards +x.

    Both points lie on the scan, in its axes. The lowest point is at z = 0, the box is centred on the z axis.
    """
    centre = volume_centre(scan.vertices, scan.triangles)
    z = (stem_mm - centre) / np.linalg.norm(stem_mm - centre)
    y = np.cross(z, suture_mm - centre)
    y /= np.linalg.norm(y)
    turn = np.stack([np.cross(y, z), y, z])
    turned = (scan.vertices - centre) @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return ScannedSkin(
        centre_mm=triple(shift),
        half_axes_mm=triple((high - low) / 2),
        scan=replace(scan, vertices=turned + shift, normals=scan.normals @ turn.T),
    )
