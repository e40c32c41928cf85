"""Compliance of a gel's face under traction: an elastic slab whose back is bonded to a rigid plate.

The slab 0 < z < h is fixed at z = 0 and carries traction t exp(i k x) on its face z = h. For wave number
k = |k| let H = k h, T = tanh H, s = 1 - 2 nu and a = 2 (1 - nu). The Papkovich-Neuber form
2 mu u = -grad(phi + z psi) + 4 (1 - nu) psi e_z with harmonic phi and psi, leaves two amplitudes g:

    [normal, shear traction] / k = [[-s T - H, a - H T], [a + H T, H - s T]] g
    2 mu [along k, normal]       = [[(3 - 4 nu) T + H, H T], [-H T, (3 - 4 nu) T - H]] g

(both over cosh H). Elimination of g, with S = 1 - T^2 and kappa = 3 - 4 nu, leaves the compliances

    along k by shear:        -a (kappa T + H S) / (2 mu k D),        D = (s T)^2 - a^2 - H^2 S
    along k by pressure:     (H^2 S - kappa s T^2) / (2 mu k D)
    normal by pressure:      -a (kappa T - H S) / (2 mu k D)
    across k by shear:       T / (mu k)

For k -> 0 the compliance is h / mu in shear and h (1 + nu)(1 - 2 nu) / (E (1 - nu)) under pressure. For
k -> infinity it is that of Boussinesq's and Cerruti's half space. The kernel is exact for small strain and
any nu < 0.5 if the slab is wide compared with h. At nu 0.48 the effect of free sides falls to a third every
1.2 thicknesses. For a known outline tactile.gel.gel_sides computes it, and that of a domed face.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import fft
from scipy.ndimage import map_coordinates, spline_filter

from tactile.gel.gel_sides import GelOutline, side_response

FLAT_TO = 0.1
"""Most deviation of a gel's face from the described one, over the thickness."""
FINE_PER_PITCH = 8
"""Grid steps per node spacing in the tabulated response to a tent of traction. Set by hand."""
CLEAR_THICKNESSES = 8.0
"""Margin around the face in thicknesses: exp(-8) of the response, 0.03 %, reaches the next period."""


@dataclass(frozen=True, kw_only=True)
class GelSlab:
    """A bonded elastic slab; infinite without an outline."""

    thickness_mm: float
    E_MPa: float
    nu: float
    outline: GelOutline | None = None

    @property
    def shear_MPa(self) -> float:
        """Shear modulus mu = E / (2 (1 + nu))."""
        return self.E_MPa / (2.0 * (1.0 + self.nu))

    def spectrum(self, k_per_mm: Float[np.ndarray, " q"]) -> Float[np.ndarray, "q 4"]:
        """Kernel (mm/MPa): along k by shear and pressure, normal by pressure, across k. k = 0: its limit."""
        mu, nu, h = self.shear_MPa, self.nu, self.thickness_mm
        k = np.maximum(np.asarray(k_per_mm, dtype=float), 1e-4 / h)
        H = k * h
        T = np.tanh(H)
        s, a, kappa = 1.0 - 2.0 * nu, 2.0 * (1.0 - nu), 3.0 - 4.0 * nu
        sech2 = 1.0 - T * T
        determinant = (s * T) ** 2 - a**2 - H**2 * sech2
        scale = 1.0 / (2.0 * mu * k * determinant)
        along_by_shear = -a * (kappa * T + H * sech2) * scale
        along_by_pressure = (H**2 * sech2 - kappa * s * T**2) * scale
        up_by_pressure = -a * (kappa * T - H * sech2) * scale
        return np.stack([along_by_shear, along_by_pressure, up_by_pressure, T / (mu * k)], axis=1)


def tent_compliance(
    layer: GelSlab,
    at_mm: Float[np.ndarray, "n 2"],
    nodes_mm: Float[np.ndarray, "m 2"],
    *,
    pitch_mm: float,
) -> Float[np.ndarray, "n 3 m 3"]:
    """Displacement (mm) at points of the face per newton on tents of traction around `nodes_mm`.

    A tent is (1 - |x| / pitch)(1 - |y| / pitch) / pitch^2 within one pitch: tents on a square grid of that
    pitch span every bilinear traction. Cubic splines interpolate the response to one tent, tabulated 8 times
    finer than the pitch. If the gel has an outline, the effect of its sides is added (tactile.gel.gel_sides).
    """
    offset = at_mm[:, None] - nodes_mm
    fine = pitch_mm / FINE_PER_PITCH
    reach = float(np.abs(offset).max()) + 2.0 * pitch_mm
    half = int(np.ceil((reach + CLEAR_THICKNESSES * layer.thickness_mm) / fine))
    axis = fine * np.fft.fftfreq(2 * half, 1.0 / (2 * half))
    tent = np.maximum(1.0 - np.abs(axis) / pitch_mm, 0.0) / pitch_mm
    load = tent[:, None] * tent
    tables = _tables(layer, load, fine)
    place = (offset / fine % (2 * half)).reshape(-1, 2).T
    out = np.empty((len(at_mm), 3, len(nodes_mm), 3))
    for i in range(3):
        for j in range(i, 3):
            smooth, where = (tables[i, j], place) if (i, j) in tables else (tables[0, 2 * j - 2], place[::-1])
            read = map_coordinates(smooth, where, order=3, mode="grid-wrap", prefilter=False)
            out[:, i, :, j] = read.reshape(offset.shape[:2])
            if i != j:
                # Reciprocity: terms within the face are even under exchange, those with the normal odd.
                out[:, j, :, i] = out[:, i, :, j] if j < 2 else -out[:, i, :, j]
    if layer.outline is not None:
        sides = side_response(layer.thickness_mm, layer.nu, layer.outline)
        out += sides.between(at_mm, nodes_mm, pitch_mm=pitch_mm) / layer.E_MPa
    return out


def _tables(
    layer: GelSlab, load: Float[np.ndarray, "a a"], fine_mm: float
) -> dict[tuple[int, int], Float[np.ndarray, "a a"]]:
    """Splines of the displacement along i by tents of force along j.

    (1, 1) and (1, 2) are (0, 0) and (0, 2) with x and y exchanged. The response is real, so half of the wave
    numbers suffice. The highest one has no partner of opposite sign, but tents have no amplitude there.
    """
    size = len(load)
    kx = 2.0 * np.pi * fft.fftfreq(size, fine_mm)[:, None]
    ky = 2.0 * np.pi * fft.rfftfreq(size, fine_mm)[None]
    k = np.hypot(kx, ky)
    x, y = kx / np.maximum(k, 1e-30), ky / np.maximum(k, 1e-30)
    shear, cross, normal, across = layer.spectrum(k.ravel()).reshape(*k.shape, 4).transpose(2, 0, 1)
    kernels = {
        (0, 0): (shear - across) * x * x + across,
        (0, 1): (shear - across) * x * y,
        (0, 2): -1j * cross * x,
        (2, 2): normal,
    }
    loaded = fft.rfft2(load)
    return {
        pair: spline_filter(fft.irfft2(kernel * loaded, s=load.shape), order=3, mode="grid-wrap")
        for pair, kernel in kernels.items()
    }
