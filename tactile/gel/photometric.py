"""The shape of a lit gel from its colours: shading to slopes by look-up, slopes to depth by Poisson's law.

In every channel the brightness over that of the untouched gel, r = I / I0, depends on the face's slopes
alone (distant lights, any albedo and vignetting). Three channels give two slopes, by a look-up fitted to
presses with a ball of known radius, or to Lambert's law for lights of known direction. A pixel at normalised
image coordinates m = (u, v, 1) sees the point Z m; with the face's normal n in the camera's frame

    d(ln Z)/du = -n_u / (n . m),   d(ln Z)/dv = -n_v / (n . m),

which is integrated in the least squares sense (Frankot and Chellappa 1988, here with a fixed border: sine
transforms of the five-point Laplacian). Perspective and lens distortion are thereby exact.

Depth is so known only below the border of the image: what the border itself does, the slab says. Integrated
with a border held at zero, a face that displaces by w is seen as w - H w_b, where w_b is w on the border and
H carries a border's values inward as a harmonic function. Both are linear in the forces, so the inverse takes
the seen depth as (G_z - H B) t, B the compliance of the border, and puts H B t back.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.fft import dstn, idstn
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

from tactile.gel.grid import GelGrid, with_smooth
from tactile.gel.slab import GelLayer, tent_compliance
from tactile.gel_camera import on_face, project, rays
from tactile.sensors import GelCamera, GelLight

BLOCK_PX = 4
"""Sides of the blocks whose mean colour counts: slopes are smooth over it, and noise falls fourfold."""
DEGREE = 3
"""Of the polynomial from three brightnesses to two slopes: 20 terms. Set by hand."""
DARK = 0.75
"""Of the gel's brightness; what is darker is a marker. Set by hand."""
LIT_SLOPE = 0.7
"""Slope up to which the look-up of known lights is fitted: 35 degrees. Set by hand."""
STEEPEST = 1.0
"""Slope that is believed at most: 45 degrees, which a gel's face does not reach."""
CELLS = 48
"""Cells along the longer side of the image for the harmonic functions: they are smooth."""
PER_SIDE = 12
"""Places along each side of the image at which the border's rise is taken, in straight lines between: it is
as smooth as the gel is thick. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class SlopeLookup:
    """Slopes dz/dx and dz/dy (gel frame) as polynomials in the three channels' r - 1."""

    coefficients: Float[np.ndarray, "k 2"]

    def slopes(self, change: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 2"]:
        """Slopes where brightness changed by r - 1."""
        return np.asarray(_powers(change) @ self.coefficients)


def fitted_lookup(change: Float[np.ndarray, "m 3"], slopes: Float[np.ndarray, "m 2"]) -> SlopeLookup:
    """The look-up that fits known slopes best (least squares, a whisker of ridge; no change, no slope)."""
    basis = _powers(change)
    weight = 1e-6 * np.trace(basis.T @ basis) / basis.shape[1]
    normal = basis.T @ basis + weight * np.eye(basis.shape[1])
    return SlopeLookup(coefficients=np.linalg.solve(normal, basis.T @ slopes))


def lambert_change(
    lights: tuple[GelLight, ...], ambient: float, slopes: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 3"]:
    """r - 1 of a matt face: ambient light plus each light's strength times its cosine with the face."""

    def brightness(slope: np.ndarray) -> np.ndarray:
        inward = np.column_stack([slope, -np.ones(len(slope))])
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        total = np.full((len(slope), 3), ambient)
        for light in lights:
            total = total + np.maximum(inward @ light.direction, 0.0)[:, None] * light.colour
        return np.asarray(total)

    return np.asarray(brightness(slopes) / brightness(np.zeros((1, 2))) - 1.0)


def lambert_lookup(lights: tuple[GelLight, ...], *, ambient: float = 0.0) -> SlopeLookup:
    """The look-up of lights of known direction, for slopes up to LIT_SLOPE."""
    side = np.linspace(-LIT_SLOPE, LIT_SLOPE, 61)
    slopes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    slopes = slopes[np.linalg.norm(slopes, axis=1) <= LIT_SLOPE]
    return fitted_lookup(lambert_change(lights, ambient, slopes), slopes)


class PhotometricDepth:
    """Depth of a gel's face, frame by frame, against the frame in which nothing touches it."""

    def __init__(
        self,
        camera: GelCamera,
        reference: UInt8[np.ndarray, "h w 3"],
        lookup: SlopeLookup,
        *,
        gamma: float = 1.0,
    ) -> None:
        self._camera, self._lookup = camera, lookup
        self._light = (255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.float32)
        height, width = reference.shape[:2]
        self._shape = (height // BLOCK_PX, width // BLOCK_PX)
        rest, clear = _blocks(reference, _between_dots(reference), self._shape, self._light)
        self._reference = _filled(rest, clear, sigma=6.0)
        _, direction = rays(camera, self.pixels.reshape(-1, 2))
        turn = camera.gel_from_camera[:3, :3]
        local = direction @ turn
        self._plane = (local / local[:, 2:]).reshape(*self._shape, 3)
        self._steps = [np.gradient(self._plane, axis=axis) for axis in (0, 1)]
        gel_normal = turn[2]
        self._rest_depth = -camera.gel_from_camera[2, 3] / (self._plane @ gel_normal)
        self._flat = self._log_depth_gradient(np.zeros((*self._shape, 2)))
        self._eigen = laplacian_eigenvalues(self._shape)

    def change(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "a b 3"]:
        """r - 1 at the middle of every block, dots filled from round about."""
        now, clear = _blocks(image, _between_dots(image), self._shape, self._light)
        return _filled(now / self._reference - 1.0, clear, sigma=1.2)

    @property
    def pixels(self) -> Float[np.ndarray, "a b 2"]:
        """Where the middles of the blocks are."""
        rows, columns = np.meshgrid(*[np.arange(n) for n in self._shape], indexing="ij")
        return np.stack([columns, rows], axis=-1) * BLOCK_PX + (BLOCK_PX - 1) / 2

    def face(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "a b"]:
        """Depth along the camera's axis (mm) at the middle of every block of 4 x 4 pixels."""
        slopes = np.clip(self._lookup.slopes(self.change(image)), -STEEPEST, STEEPEST)
        extra = self._log_depth_gradient(slopes) - self._flat
        return np.asarray(self._rest_depth * np.exp(_integrated(extra, self._eigen)))

    def at(
        self, image: UInt8[np.ndarray, "h w 3"], pixels: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n 3"]:
        """Points of the face (mm, gel frame) that pixels of this frame show; NaN for pixels that are NaN."""
        place = (pixels - (BLOCK_PX - 1) / 2) / BLOCK_PX
        depth = map_coordinates(self.face(image), place.T[::-1], order=3, mode="nearest")
        centre, direction = rays(self._camera, np.nan_to_num(pixels))
        local = direction @ self._camera.gel_from_camera[:3, 2]
        points = centre + direction * (depth / local)[:, None]
        return np.where(np.isfinite(pixels).all(axis=1)[:, None], points, np.nan)

    def _log_depth_gradient(self, slopes: Float[np.ndarray, "a b 2"]) -> Float[np.ndarray, "a b 2"]:
        """d(ln Z) from block to block, along rows and columns of blocks."""
        normal = np.concatenate([-slopes, np.ones((*self._shape, 1))], axis=-1)
        normal = normal @ self._camera.gel_from_camera[:3, :3]
        along = np.einsum("abx,abx->ab", normal, self._plane)
        return np.stack([-np.einsum("abx,abx->ab", normal, step) / along for step in self._steps], axis=-1)


def _powers(change: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... k"]:
    """Monomials of a colour change up to DEGREE in red, green and blue, the constant left out."""
    red, green, blue = (
        np.cumprod([np.ones_like(channel), *[channel] * DEGREE], axis=0)
        for channel in np.moveaxis(np.asarray(change), -1, 0)
    )
    terms = [
        red[i] * green[j] * blue[k]
        for i in range(DEGREE + 1)
        for j in range(DEGREE + 1 - i)
        for k in range(DEGREE + 1 - i - j)
        if i + j + k > 0
    ]
    return np.stack(terms, axis=-1)


def _between_dots(image: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the bare gel: not much darker than the neighbourhood at its brightest."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    grey = np.maximum(np.maximum(small[..., 0], small[..., 1]), small[..., 2])
    bright = cv2.blur(cv2.dilate(grey, np.ones((7, 7), np.uint8)), (15, 15))
    dark = (grey < DARK * bright).astype(np.uint8)
    wide = cv2.dilate(dark, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.resize(wide, (width, height), interpolation=cv2.INTER_NEAREST) == 0)


def _blocks(
    image: UInt8[np.ndarray, "h w 3"],
    clear: Bool[np.ndarray, "h w"],
    shape: tuple[int, int],
    light: Float[np.ndarray, "256"],
) -> tuple[Float[np.ndarray, "a b 3"], Float[np.ndarray, "a b"]]:
    """Mean light of each block's clear pixels (`light` of each picture value), and their share."""
    size = (shape[1], shape[0])
    height, width = shape[0] * BLOCK_PX, shape[1] * BLOCK_PX
    mask = clear[:height, :width].astype(np.float32)
    share = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    shown = cv2.bitwise_and(image[:height, :width], image[:height, :width], mask=mask.astype(np.uint8))
    total = cv2.resize(cv2.LUT(shown, light), size, interpolation=cv2.INTER_AREA)
    return total / np.maximum(share, 1e-6)[..., None], np.where(share > 0.2, share, 0.0)


def _filled(
    values: Float[np.ndarray, "a b 3"], weight: Float[np.ndarray, "a b"], *, sigma: float
) -> Float[np.ndarray, "a b 3"]:
    """Values smoothed over blocks, the weightless ones filled from round about."""
    out = np.zeros_like(values)
    empty = np.ones(weight.shape, dtype=bool)
    for widen in (1.0, 2.5, 6.0, 15.0):
        share = cv2.GaussianBlur(weight, (0, 0), sigma * widen)
        total = cv2.GaussianBlur(values * weight[..., None], (0, 0), sigma * widen)
        fresh = empty & (share > 0.02)
        out[fresh] = total[fresh] / share[fresh][:, None]
        empty &= ~fresh
        if not empty.any():
            break
    return out


def _integrated(
    gradient: Float[np.ndarray, "a b 2"], eigen: Float[np.ndarray, "c d"]
) -> Float[np.ndarray, "a b"]:
    """The surface, zero at the border, whose steps from block to block are nearest to `gradient`."""
    down = (gradient[1:, :, 0] + gradient[:-1, :, 0]) / 2
    right = (gradient[:, 1:, 1] + gradient[:, :-1, 1]) / 2
    divergence = (down[1:, 1:-1] - down[:-1, 1:-1]) + (right[1:-1, 1:] - right[1:-1, :-1])
    return np.pad(poisson(divergence, eigen), 1)


def laplacian_eigenvalues(shape: tuple[int, int]) -> Float[np.ndarray, "a b"]:
    """Eigenvalues of the five-point Laplacian inside a grid's border, in the order of the sine transform."""
    a, b = (2.0 * np.cos(np.pi * np.arange(1, n - 1) / (n - 1)) - 2.0 for n in shape)
    return np.asarray(a[:, None] + b)


def poisson(right: Float[np.ndarray, "a b"], eigen: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """The inside values, zero at the border, whose five-point Laplacian is `right`, by sine transforms."""
    return np.asarray(idstn(dstn(right, type=1) / eigen, type=1))


def border_observation(
    layer: GelLayer, grid: GelGrid, camera: GelCamera
) -> tuple[Float[np.ndarray, "d u"], Float[np.ndarray, "n e"]]:
    """What shading sees of nodal forces and smooth fields, and the border's share H B of depth (mm/N)."""
    width, height = camera.image_px
    edge = _ring(width, height)
    places = on_face(camera, edge)[:, :2]
    made = -tent_compliance(layer, places, grid.nodes_mm, pitch_mm=grid.pitch_mm)
    at_border = with_smooth(grid, made.reshape(3 * len(edge), -1), places)[2::3]
    carried = _harmonic(camera, grid.rest_mm[:, :2], width, height) @ at_border
    observed = with_smooth(grid, grid.compliance, grid.rest_mm[:, :2])
    observed[2::3] -= carried
    return observed, carried[:, : 3 * len(grid.nodes_mm)]


def _ring(width: int, height: int) -> Float[np.ndarray, "r 2"]:
    """Pixels along the border, clockwise from the first."""
    share = np.arange(PER_SIDE) / PER_SIDE
    right, down = width - 1.0, height - 1.0
    return np.concatenate(
        [
            np.column_stack([share * right, 0 * share]),
            np.column_stack([right + 0 * share, share * down]),
            np.column_stack([(1 - share) * right, down + 0 * share]),
            np.column_stack([0 * share, (1 - share) * down]),
        ]
    )


def _harmonic(
    camera: GelCamera, at_mm: Float[np.ndarray, "n 2"], width: int, height: int
) -> Float[np.ndarray, "n r"]:
    """H: values at the ring's pixels (linear in between) to values at points of the face."""
    columns = CELLS + 1
    rows = round(CELLS * height / width) + 1
    x, y = np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)
    pixels = project(camera, np.column_stack([at_mm, np.zeros(len(at_mm))]))
    position = np.arange(4 * PER_SIDE)
    out = np.empty((len(at_mm), len(position)))
    for k in position:
        tent = np.zeros(4 * PER_SIDE + 1)
        tent[k] = 1.0
        tent[-1] = tent[0]

        def side(first: int, share: np.ndarray, tent: np.ndarray = tent) -> np.ndarray:
            return np.asarray(np.interp((first + share) * PER_SIDE, np.arange(4 * PER_SIDE + 1), tent))

        grid = np.zeros((rows, columns))
        along, down = x / x[-1], y / y[-1]
        grid[0], grid[:, -1] = side(0, along), side(1, down)
        grid[-1], grid[:, 0] = side(2, 1 - along), side(3, 1 - down)
        filled = _laplace(grid)
        read = RegularGridInterpolator((y, x), filled, bounds_error=False, fill_value=None)
        out[:, k] = read(pixels[:, ::-1])
    return out


def _laplace(border: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """The discrete harmonic function with these border values (sine transform)."""
    pull = border[2:, 1:-1] + border[:-2, 1:-1] + border[1:-1, 2:] + border[1:-1, :-2]
    rows, columns = border.shape
    out = border.copy()
    out[1:-1, 1:-1] = poisson(-pull, laplacian_eigenvalues((rows, columns)))
    return out
