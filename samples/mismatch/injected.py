"""Amplitudes and parameters of injected effects, from barely visible to plain."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from samples.brick_flesh import BrickFlesh
from samples.fruit import POISSON_RATIO
from samples.gel_contact import DEFAULT_GEL, Gel
from samples.grasp_plan import PlannedGrasp
from samples.mismatch.altered_flesh import graded, soft_spot, stiffer_along_stem, uneven, with_skin
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.flesh_laws import (
    Damaged,
    Draining,
    FleshLaw,
    Lame,
    PlainFlesh,
    Relaxing,
    StiffeningFlesh,
    Yielding,
)
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
"""Least and greatest amplitude in the parameter's unit (docs/formats.md), counted from no effect. A pit's
offset is in mm, a drift a share per s, a wrong pose a factor on 4 mm and 5 degrees. A soft spot has 1 -
ratio, Poisson's ratio its difference from the fruit's, slip 1/mu, a plastic set E over the yield stress. Set
by hand: from a tenth of the smallest visible one, or from the onset of slip or yield, to a plain effect."""
EFFECTS = tuple(AMPLITUDES)
"""Effects of the catalogue."""
OUT_OF_CATALOGUE = ("palm", "gel_softening")
"""Physics outside the catalogue; the right answer to each is "unknown". `palm`: the fruit's bottom rests on
the gripper's palm, a spring, in every grasp. `gel_softening`: both gels soften during contact, and the sensor
still uses their nominal stiffness."""
MATERIAL_LAWS = ("stiffening", "viscoelastic", "plastic_set", "damage", "drainage")
TOUCHES_WIDELY = ("stiffening", "skin")
"""Effects that make flesh stiffer than its modulus suggests, so that the contact patches are wider."""
STIFFENING_IS_FIRMER = 3.0
"""Factor on the stiffness in NonlinearBody's iterations. Half of it did not converge while a pad shears:
measured on an earlier scheme, which iterated over the skin's displacement, and kept."""


@dataclass(frozen=True, kw_only=True)
class InjectedEffect:
    """One effect with the parameters of its label. Raises SampleFailure for an unknown effect."""

    effect: str
    parameters: dict[str, Any]

    def __post_init__(self) -> None:
        known = (*EFFECTS, *OUT_OF_CATALOGUE)
        if self.effect not in known:
            raise SampleFailure(f"There is no effect {self.effect!r}; there are: {', '.join(known)}.")

    def number(self, name: str) -> float:
        """A numeric parameter."""
        return float(self.parameters[name])


def named(injected: tuple[InjectedEffect, ...], effect: str) -> InjectedEffect | None:
    """The injected effect of that name, if any."""
    return next((p for p in injected if p.effect == effect), None)


def touches_widely(injected: tuple[InjectedEffect, ...]) -> bool:
    """Whether one of them is in TOUCHES_WIDELY."""
    return any(p.effect in TOUCHES_WIDELY for p in injected)


def label_of(injected: tuple[InjectedEffect, ...]) -> dict[str, Any]:
    """A case's label: `effect`, the sorted names joined by + (or none), and `parameters`, those of a single
    effect or one group per effect. Physics outside the catalogue is "unknown"; a parameter holds its name.
    """
    for injection in injected:
        if injection.effect in OUT_OF_CATALOGUE:
            parameters = {"physics": injection.effect, **injection.parameters}
            return {"effect": "unknown", "parameters": parameters}
    name = "+".join(sorted(p.effect for p in injected)) or "none"
    groups = {p.effect: dict(p.parameters) for p in injected}
    return {"effect": name, "parameters": groups[name] if len(injected) == 1 else groups}


def gel_of(injected: tuple[InjectedEffect, ...], gel: Gel = DEFAULT_GEL) -> Gel:
    """The pads' gel, with low friction for slip and with adhesion if injected."""
    slip, adhesion = named(injected, "slip"), named(injected, "adhesion")
    gel = gel if slip is None else replace(gel, friction=slip.number("mu"))
    return gel if adhesion is None else replace(gel, reach_mm=adhesion.number("reach_mm"))


def plain_flesh(flesh: BrickFlesh, injected: tuple[InjectedEffect, ...] = ()) -> PlainFlesh:
    """The Neo-Hookean law with every injected effect on modulus or anisotropy."""
    ratio: Float[np.ndarray, "m 27"] | float = 1.0
    axial = 0.0
    for injection in injected:
        if injection.effect == "graded_modulus":
            ratio = ratio * graded(flesh.bricks, gamma=injection.number("gamma"))
        elif injection.effect == "soft_spot":
            ratio = ratio * soft_spot(
                flesh.bricks, centre_mm=np.array(injection.parameters["centre_mm"]),
                radius_mm=injection.number("radius_mm"), ratio=injection.number("ratio"),
            )  # fmt: skip
        elif injection.effect == "anisotropy":
            axial = injection.number("axial")
    return PlainFlesh(lame=Lame(mu=flesh.mu_MPa, lam=flesh.lam_MPa), ratio=ratio, axial=axial)


def stiffness_at_rest(flesh: BrickFlesh, law: PlainFlesh) -> csr_array:
    """Tangent stiffness of the law in the undeformed shape."""
    total = flesh.stiffness
    if isinstance(law.ratio, np.ndarray):
        total = total + uneven(flesh, law.ratio)
    return csr_array(total + stiffer_along_stem(flesh, axial=law.axial)) if law.axial else csr_array(total)


def membrane(flesh: BrickFlesh, injected: tuple[InjectedEffect, ...]) -> csr_array | None:
    """Stiffness of an injected skin; None without one."""
    skin = named(injected, "skin")
    if skin is None:
        return None
    nu = flesh.lam_MPa / (2 * (flesh.lam_MPa + flesh.mu_MPa))
    return with_skin(flesh, Et_N_per_mm=skin.number("Et_N_per_mm"), poisson_ratio=nu)


def flesh_law(plain: PlainFlesh, injection: InjectedEffect | None) -> tuple[FleshLaw, float]:
    """The law of an injected effect, and the solver's stiffness over that at rest."""
    if injection is None or injection.effect not in MATERIAL_LAWS:
        return plain, 1.0
    if injection.effect == "stiffening":
        return StiffeningFlesh(plain=plain, **injection.parameters), STIFFENING_IS_FIRMER
    if injection.effect == "viscoelastic":
        return Relaxing(plain=plain, **injection.parameters), 1.0
    if injection.effect == "drainage":
        return Draining(plain=plain, **injection.parameters), 1.0
    modulus = plain.lame.modulus
    if injection.effect == "plastic_set":
        limit, hardening = injection.number("yield_over_E") * modulus, injection.number("hardening") * modulus
        return Yielding(plain=plain, yield_MPa=limit, hardening_MPa=hardening), 1.0
    W0_MPa = injection.number("W0_over_E") * modulus
    return Damaged(plain=plain, dmax=injection.number("dmax"), W0_MPa=W0_MPa), 1.0


def spot_under_pad(
    drawn: DrawnFruit, grasp: PlannedGrasp, *, pad: str, depth_mm: float, aside_deg: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:  # fmt: skip
    """A point `depth_mm` below the skin, at `aside_deg` from the pad's direction as seen from the centre."""
    towards = -grasp.hold.turns[0 if pad == "left" else 1][:, 2]
    sideways = np.cross(towards, rng.normal(size=3))
    sideways /= np.linalg.norm(sideways)
    angle = np.radians(aside_deg)
    direction = np.cos(angle) * towards + np.sin(angle) * sideways
    radius = float(drawn.fruit.skin.radius_mm(direction[None])[0])
    return np.asarray(np.array(drawn.fruit.skin.centre_mm) + (radius - depth_mm) * direction)


NAMES = {
    "stiffening": "b", "skin": "Et_N_per_mm", "anisotropy": "axial", "loose_pit": "gap_mm", "slip": "mu",
    "gripper_compliance": "mm_per_N", "adhesion": "reach_mm", "gel_hysteresis": "share",
    "third_contact": "N_per_mm",
}  # fmt: skip
"""Name of the parameter for effects whose draw has only one."""
MOST_POISSON_RATIO = 0.488
"""Poisson's ratio above which bricks lock (set by hand)."""


def drawn_amplitude(effect: str, rng: np.random.Generator) -> float:
    """A log-uniform amplitude in the effect's range; 1 for physics outside the catalogue."""
    return log_uniform(rng, *AMPLITUDES.get(effect, (1.0, 1.0)))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A log-uniform number between two others."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def drawn_parameters(effect: str, amplitude: float, rng: np.random.Generator) -> dict[str, Any]:
    """Random parameters of an effect, except a soft spot's place, which depends on the fruit.

    Empty for physics outside the catalogue. Raises SampleFailure for an unknown effect.
    """
    if effect in OUT_OF_CATALOGUE:
        return {}
    if effect not in AMPLITUDES:
        raise SampleFailure(f"There is no effect {effect!r} in the catalogue.")
    size = _size_of(effect, amplitude)
    sign = float(rng.choice([-1.0, 1.0]))
    pad = str(rng.choice(PAD_NAMES))
    parameters: dict[str, Callable[[], dict[str, Any]]] = {
        "viscoelastic": lambda: {"g": size, "tau_s": log_uniform(rng, 0.4, 12.0)},
        "graded_modulus": lambda: {"gamma": sign * size},
        "soft_spot": lambda: {"ratio": size, "radius_mm": float(rng.uniform(4.5, 8.5))},
        "poisson_ratio": lambda: {"nu": _mirrored(size) if sign > 0 else size},
        "pit_offset": lambda: {"offset_mm": _of_length(size, rng.normal(size=3))},
        "pit_size": lambda: {"scale": 1 + sign * size},
        "damage": lambda: {"dmax": size, "W0_over_E": log_uniform(rng, 5e-4, 4e-3)},
        "plastic_set": lambda: {"yield_over_E": size, "hardening": 0.05},
        "sensor_gain": lambda: {"pad": pad, "gain": 1 + sign * size},
        "sensor_drift": lambda: {"pad": pad, "share_per_s": sign * size},
        "clock_lag": lambda: {"lag_s": sign * size},
        "sensor_nonlinear": lambda: {"a": sign * size},
        "gel_creep": lambda: {"creep": size, "creep_tau_s": log_uniform(rng, 0.5, 6.0)},
        "drainage": lambda: {"volume_share": size, "tau_s": log_uniform(rng, 0.4, 6.0)},
        "split_pit": lambda: {"angle_deg": float(rng.uniform(-90.0, 90.0)), "share": size},
        "thermal_drift": lambda: {
            "strain_per_root_s": size,
            "peak_share_per_root_s": size * float(rng.uniform(15.0, 25.0)),
        },
        "pose_error": lambda: {
            "pad": pad,
            "shift_mm": (4.0 * size * _on_circle(rng)).tolist(),
            "tilt_deg": sign * 5.0 * size * float(rng.uniform(0.3, 1)),
        },
    }
    return parameters.get(effect, lambda: {NAMES[effect]: size})()


def drawn_out_of_catalogue(physics: str, rng: np.random.Generator) -> InjectedEffect:
    """Physics outside the catalogue at a plainly visible amplitude."""
    if physics == "palm":
        parameters = {"N_per_mm": float(rng.uniform(15.0, 30.0)), "area_radius_mm": 6.0}
    else:
        parameters = {"g": float(rng.uniform(0.15, 0.3)), "tau_s": float(rng.uniform(0.8, 3.0))}
    return InjectedEffect(effect=physics, parameters=parameters)


def _mirrored(ratio: float) -> float:
    """Poisson's ratio as far above the fruit's as this one is below, unless bricks lock there."""
    mirrored = 2 * POISSON_RATIO - ratio
    return mirrored if mirrored < MOST_POISSON_RATIO else ratio


def _of_length(size: float, direction: Float[np.ndarray, " 3"]) -> list[float]:
    components: list[float] = (size * direction / np.linalg.norm(direction)).tolist()
    return components


def _on_circle(rng: np.random.Generator) -> Float[np.ndarray, " 2"]:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _size_of(effect: str, amplitude: float) -> float:
    """The parameter's value for an amplitude."""
    if effect == "soft_spot":
        return 1 - amplitude
    if effect == "poisson_ratio":
        return POISSON_RATIO - amplitude
    return 1 / amplitude if effect in ("slip", "plastic_set") else amplitude
