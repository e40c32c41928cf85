"""How strong each effect is made: of any amplitude, from just to be seen to plain."""

from typing import Any

import numpy as np

from samples.fruit import POISSON_RATIO
from samples.mismatch.true_recording import PAD_NAMES
from samples.sample_failure import SampleFailure

Range = tuple[float, float]
AMPLITUDES: dict[str, Range] = {
    "viscoelastic": (0.01, 0.6),
    "stiffening": (1.0, 65.0),
    "skin": (0.05, 4.5),
    "graded_modulus": (0.01, 0.6),
    "soft_spot": (0.04, 0.9),
    "anisotropy": (0.03, 2.5),
    "poisson_ratio": (0.004, 0.17),
    "pit_offset": (0.2, 3.8),
    "pit_size": (0.015, 0.3),
    "loose_pit": (0.005, 0.45),
    "slip": (2.0, 20.0),
    "plastic_set": (4.0, 22.0),
    "damage": (0.03, 0.75),
    "sensor_gain": (0.004, 0.2),
    "sensor_drift": (3e-4, 0.025),
    "gripper_compliance": (4e-4, 0.035),
    "clock_lag": (0.004, 0.25),
    "adhesion": (0.01, 0.25),
    "sensor_nonlinear": (0.01, 0.38),
    "gel_creep": (0.006, 0.3),
    "gel_hysteresis": (0.004, 0.14),
    "thermal_drift": (3e-5, 2.1e-3),
    "pose_error": (0.03, 1.0),
    "third_contact": (0.2, 30.0),
    "drainage": (0.01, 0.9),
    "split_pit": (0.03, 1.0),
}
"""Least and greatest amplitude, in the parameter's own unit (docs/formats.md; of a pit's offset in mm, of a
drift a share per s, of a wrong pose about 1), but counted from no effect: of a soft spot 1 - ratio, of
Poisson's ratio how far it is from the fruit's, of slip 1/mu, of a plastic set E over the yield stress. Set by
hand: from a tenth of what can just be seen, or from what hardly slides or yields, to what is plain."""
NAMES = {
    "stiffening": "b", "skin": "Et_N_per_mm", "anisotropy": "axial", "loose_pit": "gap_mm", "slip": "mu",
    "gripper_compliance": "mm_per_N", "adhesion": "reach_mm", "gel_hysteresis": "share",
    "third_contact": "N_per_mm",
}  # fmt: skip
"""The parameter of each effect that has no other."""
MOST_POISSON_RATIO = 0.488
"""Poisson's ratio above which linear bricks lock (set by hand)."""


def drawn_amplitude(effect: str, rng: np.random.Generator) -> float:
    """Log-uniform over the range of the effect."""
    return float(np.exp(rng.uniform(*np.log(AMPLITUDES[effect]))))


def drawn_parameters(effect: str, amplitude: float, rng: np.random.Generator) -> dict[str, Any]:
    """Parameters of an effect, but for what the fruit alone can say: where a soft spot is."""
    if effect not in AMPLITUDES:
        raise SampleFailure(f"There is no effect {effect!r} in the catalogue.")
    size = _size_of(effect, amplitude)
    sign = float(rng.choice([-1.0, 1.0]))
    pad = str(rng.choice(PAD_NAMES))
    if effect == "viscoelastic":
        return {"g": size, "tau_s": float(np.exp(rng.uniform(np.log(0.4), np.log(12.0))))}
    if effect == "graded_modulus":
        return {"gamma": sign * size}
    if effect == "soft_spot":
        return {"ratio": size, "radius_mm": float(rng.uniform(4.5, 8.5))}
    if effect == "poisson_ratio":
        mirrored = min(MOST_POISSON_RATIO, 2 * POISSON_RATIO - size)
        return {"nu": mirrored if mirrored < MOST_POISSON_RATIO and sign > 0 else size}
    if effect == "pit_offset":
        direction = rng.normal(size=3)
        return {"offset_mm": (size * direction / np.linalg.norm(direction)).tolist()}
    if effect == "pit_size":
        return {"scale": 1 + sign * size}
    if effect == "damage":
        return {"dmax": size, "W0_over_E": float(np.exp(rng.uniform(np.log(5e-4), np.log(4e-3))))}
    if effect == "plastic_set":
        return {"yield_over_E": size, "hardening": 0.05}
    if effect == "sensor_gain":
        return {"pad": pad, "gain": 1 + sign * size}
    if effect == "sensor_drift":
        return {"pad": pad, "share_per_s": sign * size}
    if effect == "clock_lag":
        return {"lag_s": sign * size}
    if effect == "sensor_nonlinear":
        return {"a": sign * size}
    if effect == "gel_creep":
        return {"creep": size, "creep_tau_s": float(np.exp(rng.uniform(np.log(0.5), np.log(6.0))))}
    if effect == "drainage":
        return {"volume_share": size, "tau_s": float(np.exp(rng.uniform(np.log(0.4), np.log(6.0))))}
    if effect == "split_pit":
        return {"angle_deg": float(rng.uniform(-90.0, 90.0)), "share": size}
    if effect == "thermal_drift":
        return {"strain_per_root_s": size, "peak_share_per_root_s": size * float(rng.uniform(15.0, 25.0))}
    if effect == "pose_error":
        angle = rng.uniform(0, 2 * np.pi)
        shift = 4.0 * size * np.array([np.cos(angle), np.sin(angle)])
        return {
            "pad": pad,
            "shift_mm": shift.tolist(),
            "tilt_deg": sign * 5.0 * size * float(rng.uniform(0.3, 1)),
        }
    return {NAMES[effect]: size}


def _size_of(effect: str, amplitude: float) -> float:
    """The parameter that an amplitude stands for."""
    if effect == "soft_spot":
        return 1 - amplitude
    if effect == "poisson_ratio":
        return POISSON_RATIO - amplitude
    return 1 / amplitude if effect in ("slip", "plastic_set") else amplitude
