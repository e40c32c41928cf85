"""What is injected into a case: effects of the catalogue by name, with the parameters that labels carry."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from samples.brick_flesh import BrickFlesh
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
from samples.sample_failure import SampleFailure

EFFECTS = (
    "viscoelastic", "stiffening", "skin", "graded_modulus", "soft_spot", "anisotropy", "poisson_ratio",
    "pit_offset", "pit_size", "loose_pit", "slip", "plastic_set", "damage", "sensor_gain", "sensor_drift",
    "gripper_compliance", "clock_lag", "pose_error", "adhesion",
    "sensor_nonlinear", "gel_creep", "gel_hysteresis", "thermal_drift", "third_contact",
    "drainage", "split_pit",
)  # fmt: skip
MATERIAL_LAWS = ("stiffening", "viscoelastic", "plastic_set", "damage", "drainage")
TOUCHES_WIDELY = ("stiffening", "skin")
"""Flesh that gives way less than its modulus says, and so touches the pads in wider patches."""
STIFFENING_IS_FIRMER = 3.0
"""With half of it rounds of flesh and contact did not settle while a pad shears: measured on earlier rounds,
over the shift of the skin, and kept."""


@dataclass(frozen=True, kw_only=True)
class InjectedEffect:
    """One effect; `parameters` are those of its label."""

    effect: str
    parameters: dict[str, Any]

    def __post_init__(self) -> None:
        if self.effect not in EFFECTS:
            raise SampleFailure(f"There is no effect {self.effect!r}; there are: {', '.join(EFFECTS)}.")

    def number(self, name: str) -> float:
        """One parameter that is a number."""
        return float(self.parameters[name])


def named(injected: tuple[InjectedEffect, ...], effect: str) -> InjectedEffect | None:
    """The injected effect of that name, if any."""
    return next((p for p in injected if p.effect == effect), None)


def touches_widely(injected: tuple[InjectedEffect, ...]) -> bool:
    """Whether one of them is in TOUCHES_WIDELY."""
    return any(p.effect in TOUCHES_WIDELY for p in injected)


def label_of(injected: tuple[InjectedEffect, ...]) -> dict[str, Any]:
    """A case's label: `effect`, the names sorted and joined by + (or none), and `parameters`, those of a
    single effect or one group per effect.
    """
    name = "+".join(sorted(p.effect for p in injected)) or "none"
    groups = {p.effect: dict(p.parameters) for p in injected}
    return {"effect": name, "parameters": groups[name] if len(injected) == 1 else groups}


def gel_of(injected: tuple[InjectedEffect, ...], gel: Gel = DEFAULT_GEL) -> Gel:
    """The pads' gel; with slip its friction is low. It may stick."""
    slip, adhesion = named(injected, "slip"), named(injected, "adhesion")
    gel = gel if slip is None else replace(gel, friction=slip.number("mu"))
    return gel if adhesion is None else replace(gel, reach_mm=adhesion.number("reach_mm"))


def plain_flesh(flesh: BrickFlesh, injected: tuple[InjectedEffect, ...] = ()) -> PlainFlesh:
    """The Neo-Hookean law of the flesh with every injected effect that changes its modulus or direction."""
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
    """The tangent of the law in the shape at rest."""
    total = flesh.stiffness
    if isinstance(law.ratio, np.ndarray):
        total = total + uneven(flesh, law.ratio)
    return csr_array(total + stiffer_along_stem(flesh, axial=law.axial)) if law.axial else csr_array(total)


def membrane(flesh: BrickFlesh, injected: tuple[InjectedEffect, ...]) -> csr_array | None:
    """Stiffness of an injected skin."""
    skin = named(injected, "skin")
    if skin is None:
        return None
    nu = flesh.lam_MPa / (2 * (flesh.lam_MPa + flesh.mu_MPa))
    return with_skin(flesh, Et_N_per_mm=skin.number("Et_N_per_mm"), poisson_ratio=nu)


def flesh_law(plain: PlainFlesh, injection: InjectedEffect | None) -> tuple[FleshLaw, float]:
    """The law of an injected effect, and how much firmer than at rest the solver takes the flesh."""
    if injection is None or injection.effect not in MATERIAL_LAWS:
        return plain, 1.0
    modulus = plain.lame.modulus
    if injection.effect == "stiffening":
        return StiffeningFlesh(plain=plain, b=injection.number("b")), STIFFENING_IS_FIRMER
    if injection.effect == "viscoelastic":
        return Relaxing(plain=plain, g=injection.number("g"), tau_s=injection.number("tau_s")), 1.0
    if injection.effect == "plastic_set":
        limit, hardening = injection.number("yield_over_E") * modulus, injection.number("hardening") * modulus
        return Yielding(plain=plain, yield_MPa=limit, hardening_MPa=hardening), 1.0
    if injection.effect == "drainage":
        share, tau_s = injection.number("volume_share"), injection.number("tau_s")
        return Draining(plain=plain, volume_share=share, tau_s=tau_s), 1.0
    return Damaged(
        plain=plain, dmax=injection.number("dmax"), W0_MPa=injection.number("W0_over_E") * modulus
    ), 1.0


def spot_under_pad(
    drawn: DrawnFruit, grasp: PlannedGrasp, *, pad: str, depth_mm: float, aside_deg: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:  # fmt: skip
    """A place `depth_mm` below the skin, seen from the centre `aside_deg` off the pad."""
    towards = -grasp.hold.turns[0 if pad == "left" else 1][:, 2]
    sideways = np.cross(towards, rng.normal(size=3))
    sideways /= np.linalg.norm(sideways)
    angle = np.radians(aside_deg)
    direction = np.cos(angle) * towards + np.sin(angle) * sideways
    radius = float(drawn.fruit.skin.radius_mm(direction[None])[0])
    return np.asarray(np.array(drawn.fruit.skin.centre_mm) + (radius - depth_mm) * direction)
