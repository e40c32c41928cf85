"""How strong each effect is made: at three levels, from just to be seen to plain, or of any amplitude."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from samples.fruit import POISSON_RATIO
from samples.mismatch.true_recording import PAD_NAMES
from samples.sample_failure import SampleFailure

Range = tuple[float, float]
LEVELS = (0, 1, 2)
"""Three, from just to be seen to plain."""

_RANGES: dict[str, dict[str, tuple[Range, Range, Range]]] = {
    "viscoelastic": {"g": ((0.1, 0.18), (0.22, 0.34), (0.4, 0.58))},
    "stiffening": {"b": ((15.0, 22.0), (28.0, 40.0), (48.0, 65.0))},
    "skin": {"Et_N_per_mm": ((0.3, 0.6), (0.9, 1.8), (2.4, 4.5))},
    "graded_modulus": {"gamma": ((0.1, 0.2), (0.25, 0.4), (0.45, 0.6))},
    "soft_spot": {"ratio": ((0.5, 0.6), (0.3, 0.45), (0.1, 0.22))},
    "anisotropy": {"axial": ((0.2, 0.4), (0.6, 1.1), (1.5, 2.5))},
    "poisson_ratio": {"nu": ((0.405, 0.425), (0.35, 0.38), (0.28, 0.33))},
    "pit_offset": {"length_mm": ((1.1, 1.6), (1.9, 2.6), (3.0, 3.8))},
    "pit_size": {"change": ((0.1, 0.14), (0.16, 0.21), (0.24, 0.3))},
    "loose_pit": {"gap_mm": ((0.04, 0.08), (0.12, 0.2), (0.3, 0.45))},
    "slip": {"mu": ((0.15, 0.18), (0.1, 0.13), (0.05, 0.08))},
    "plastic_set": {"yield_over_E": ((0.085, 0.095), (0.065, 0.078), (0.045, 0.057))},
    "damage": {"dmax": ((0.2, 0.3), (0.4, 0.5), (0.6, 0.75))},
    "sensor_gain": {"change": ((0.04, 0.06), (0.08, 0.12), (0.15, 0.2))},
    "sensor_drift": {"share_per_s": ((0.002, 0.004), (0.006, 0.01), (0.015, 0.025))},
    "gripper_compliance": {"mm_per_N": ((0.003, 0.006), (0.009, 0.014), (0.02, 0.035))},
    "clock_lag": {"lag_s": ((0.04, 0.06), (0.09, 0.13), (0.17, 0.25))},
    "adhesion": {"reach_mm": ((0.05, 0.08), (0.1, 0.14), (0.18, 0.25))},
    "sensor_nonlinear": {"a": ((0.06, 0.1), (0.15, 0.22), (0.28, 0.38))},
    "gel_creep": {"creep": ((0.04, 0.07), (0.1, 0.16), (0.2, 0.3))},
    "gel_hysteresis": {"share": ((0.03, 0.05), (0.06, 0.09), (0.1, 0.14))},
    "thermal_drift": {"strain_per_root_s": ((2e-4, 4e-4), (6e-4, 1e-3), (1.3e-3, 2.1e-3))},
    "third_contact": {"N_per_mm": ((2.0, 4.0), (6.0, 10.0), (15.0, 30.0))},
    "drainage": {"volume_share": ((0.1, 0.2), (0.3, 0.5), (0.6, 0.9))},
    "split_pit": {"share": ((0.3, 0.5), (0.6, 0.8), (0.9, 1.0))},
    "pose_error": {"size": ((0.25, 0.4), (0.5, 0.65), (0.8, 1.0))},
}
"""From and to at each level, in the parameter's own unit (docs/formats.md; `change` and `share_per_s` are
relative, `length_mm` is in mm, `size` about 1). Set by hand, from just to be seen to plain."""


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
"""Least and greatest amplitude of a wide draw, in the unit of the levels above, but counted from no effect:
of a soft spot 1 - ratio, of Poisson's ratio how far it is from the fruit's, of slip 1/mu, of a plastic set E
over the yield stress. Set by hand: from a tenth of the least level, or from what hardly slides or yields, to
the greatest."""
MOST_POISSON_RATIO = 0.488
"""Poisson's ratio above which linear bricks lock (set by hand)."""


@dataclass(frozen=True)
class Amplitude:
    """How far an effect is from none, in the unit of AMPLITUDES."""

    value: float


def drawn_amplitude(effect: str, rng: np.random.Generator, *, above: float = 0.0) -> Amplitude:
    """Log-uniform over the range of the effect; `above`: from that share of it (of the logarithm) on."""
    low, high = np.log(AMPLITUDES[effect])
    return Amplitude(float(np.exp(rng.uniform(low + above * (high - low), high))))


def drawn_parameters(effect: str, level: int | Amplitude, rng: np.random.Generator) -> dict[str, Any]:
    """Parameters of an effect at a level, but for what only the fruit can say (where a soft spot is)."""
    if effect not in _RANGES:
        raise SampleFailure(f"There is no effect {effect!r} in the catalogue.")
    (name, ranges), *_ = _RANGES[effect].items()
    if isinstance(level, Amplitude):
        size = _size_of(effect, level.value)
    else:
        size = float(rng.uniform(*ranges[level]))
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
        small = mirrored < MOST_POISSON_RATIO if isinstance(level, Amplitude) else level == 0
        return {"nu": mirrored if small and sign > 0 else size}
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
        return {name: size, "tau_s": float(np.exp(rng.uniform(np.log(0.4), np.log(6.0))))}
    if effect == "split_pit":
        return {"angle_deg": float(rng.uniform(-90.0, 90.0)), name: size}
    if effect == "thermal_drift":
        return {name: size, "peak_share_per_root_s": size * float(rng.uniform(15.0, 25.0))}
    if effect == "pose_error":
        angle = rng.uniform(0, 2 * np.pi)
        shift = 4.0 * size * np.array([np.cos(angle), np.sin(angle)])
        return {
            "pad": pad,
            "shift_mm": shift.tolist(),
            "tilt_deg": sign * 5.0 * size * float(rng.uniform(0.3, 1)),
        }
    return {name: size}


def _size_of(effect: str, amplitude: float) -> float:
    """The number of _RANGES that an amplitude stands for."""
    if effect == "soft_spot":
        return 1 - amplitude
    if effect == "poisson_ratio":
        return POISSON_RATIO - amplitude
    return 1 / amplitude if effect in ("slip", "plastic_set") else amplitude
