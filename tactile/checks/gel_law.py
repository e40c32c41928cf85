"""How far a gel's markers move under given forces: the law that force and displacement share.

A gel whose stiffness per area was measured is a bed of springs, u = f / (A k), marker by marker
(tactile/gel/spring_force.py). One that is described by thickness, modulus and Poisson's ratio, and whose
stated stiffness is that of its bonded layer, is an elastic slab (tactile/gel/slab.py).
"""

import numpy as np
from jaxtyping import Float

from tactile.gel.slab import GelSlab, tent_compliance
from tactile.io.recording import GelPad, marker_area_mm2
from tactile.sensors import bonded_stiffness

SAME_STIFFNESS = 0.02
"""A stated stiffness this near to the bonded layer's was computed from it (tactile/sensors.py)."""
MOST_FOR_SLAB = 900
"""Markers for which the slab's compliance is computed: the matrix (3n x 3n) takes 60 MB, and the table it is
read from, an eighth of the markers' spacing fine and 8 thicknesses beyond them, some 220 MB on a face of
20 mm. No law is taken for more: a bed of springs is none for a slab (0.46 of the force at 961 markers)."""


def displacement_of(pad: GelPad, force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n 3"] | None:
    """Displacement (mm, with the sign of the force) that the gel's law gives these marker forces.

    None where no law is known: fewer than nine markers do not say the area of one, and of a slab with more
    than MOST_FOR_SLAB none is computed.
    """
    area_mm2 = marker_area_mm2(pad.rest_mm)
    if area_mm2 is None:
        return None
    slab = slab_of(pad)
    if slab is not None and len(pad.rest_mm) > MOST_FOR_SLAB:
        return None
    if slab is None:
        stiffness = np.array([pad.gel_kt_MPa_per_mm, pad.gel_kt_MPa_per_mm, pad.gel_kn_MPa_per_mm])
        return np.asarray(force_N / (area_mm2 * stiffness))
    flat = pad.rest_mm[:, :2]
    compliance = tent_compliance(slab, flat, flat, pitch_mm=float(np.sqrt(area_mm2)))
    n = len(flat)
    return np.asarray(force_N.reshape(-1, 3 * n) @ compliance.reshape(3 * n, 3 * n).T).reshape(force_N.shape)


def slab_of(pad: GelPad) -> GelSlab | None:
    """The slab that the pad's forces were found with; None where its stiffness was measured."""
    E, nu, h = pad.gel_E_MPa, pad.gel_nu, pad.thickness_mm
    if E is None or nu is None or h is None or not nu < 0.5:
        return None
    bonded, _ = bonded_stiffness(E, nu, h)
    if abs(np.log(pad.gel_kn_MPa_per_mm / bonded)) > SAME_STIFFNESS:
        return None
    return GelSlab(thickness_mm=h, E_MPa=E, nu=nu)
