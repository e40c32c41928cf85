"""How a gel's face answers a traction on a grid that repeats itself, by all wave vectors of the plane."""

import numpy as np
from jaxtyping import Float

from tactile.gel.slab import GelSlab


def traction_response(
    layer: GelSlab, traction_MPa: Float[np.ndarray, "a b 3"], *, spacing_mm: float
) -> Float[np.ndarray, "a b 3"]:
    """Displacement (mm), x along the first axis; leave some thicknesses unloaded round what counts."""
    shape = traction_MPa.shape[:2]
    kx, ky = (2.0 * np.pi * np.fft.fftfreq(n, spacing_mm) for n in shape)
    k = np.hypot(kx[:, None], ky)
    unit = np.stack([kx[:, None] + 0.0 * k, ky + 0.0 * k], axis=-1) / np.maximum(k, 1e-30)[..., None]
    shear, cross, normal, across = layer.spectrum(k.ravel()).reshape(*k.shape, 4).transpose(2, 0, 1)
    flat = unit[..., :, None] * unit[..., None, :]
    kernel = np.zeros((*k.shape, 3, 3), dtype=complex)
    kernel[..., :2, :2] = (shear - across)[..., None, None] * flat + across[..., None, None] * np.eye(2)
    kernel[..., :2, 2] = -1j * cross[..., None] * unit
    kernel[..., 2, :2] = 1j * cross[..., None] * unit
    kernel[..., 2, 2] = normal
    for axis, n in enumerate(shape):  # an even grid's highest wave number has no partner of opposite sign
        if n % 2 == 0:
            edge = np.moveaxis(kernel, axis, 0)[n // 2]
            edge.imag = 0.0
    loaded = np.fft.fft2(traction_MPa, axes=(0, 1))
    return np.real(np.fft.ifft2(np.einsum("abij,abj->abi", kernel, loaded), axes=(0, 1)))
