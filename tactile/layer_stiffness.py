"""How stiff a gel layer is per area of its face."""

from tactile.sensors import Sensor
from tactile.tactile_failure import TactileFailure, TactileProblem


def bonded_stiffness(E_MPa: float, nu: float, thickness_mm: float) -> tuple[float, float]:
    """Normal and shear stiffness per area (MPa/mm) of a bonded layer under wide contact.

    kn = E (1 - nu) / ((1 + nu) (1 - 2 nu) h) and kt = E / (2 (1 + nu) h).
    """
    kn = E_MPa * (1 - nu) / ((1 + nu) * (1 - 2 * nu) * thickness_mm)
    return kn, E_MPa / (2 * (1 + nu) * thickness_mm)


def layer_stiffness(sensor: Sensor) -> tuple[float, float]:
    """Normal and shear stiffness per area (MPa/mm): as measured, or of a bonded layer."""
    E, nu, h = sensor.E_MPa, sensor.nu, sensor.thickness_mm
    kn, kt = sensor.gel_kn_MPa_per_mm, sensor.gel_kt_MPa_per_mm
    if E is not None and nu is not None and h is not None:
        bonded_kn, bonded_kt = bonded_stiffness(E, nu, h)
        kn, kt = kn or bonded_kn, kt or bonded_kt
    if kn is None or kt is None:
        raise TactileFailure(
            TactileProblem.UNREADABLE_SENSOR,
            f"{sensor.name}: found neither the gel's stiffness nor thickness_mm, E_MPa and nu, "
            "expected one of the two; add gel_kn_MPa_per_mm and gel_kt_MPa_per_mm to [gel].",
        )
    return kn, kt
