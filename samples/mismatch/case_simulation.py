"""One mismatch case from its plan: simulation of the truth, then the machine's faults."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from samples.fruit import POISSON_RATIO, Skin
from samples.graded_bricks import BrickGrading
from samples.grasp_plan import PlannedGrasp, four_grasps
from samples.mismatch.drawn_fruit import CATEGORIES, Category, DrawnFruit, drawn_fruit, seen_by_drawn_sensor
from samples.mismatch.grip import InnerContact
from samples.mismatch.injected import (
    MATERIAL_LAWS,
    OUT_OF_CATALOGUE,
    InjectedEffect,
    drawn_out_of_catalogue,
    drawn_parameters,
    flesh_law,
    gel_of,
    membrane,
    named,
    plain_flesh,
    spot_under_pad,
    stiffness_at_rest,
    touches_widely,
)
from samples.mismatch.machine_effects import (
    recorded_late,
    with_bent_reading,
    with_drift,
    with_gain,
    with_gel_creep,
    with_gripper_compliance,
    with_hysteresis,
    with_instants,
    with_nominal_stiffness,
    with_pose_error,
    with_thermal_drift,
)
from samples.mismatch.meshed_fruit import CASE, WIDE_SHARE, MeshedFruit, meshed_fruit
from samples.mismatch.nonlinear_body import NonlinearBody, sound_body, whole_fruit
from samples.mismatch.other_bodies import (
    borne_N,
    drawn_place_mm,
    inward_normal,
    loose_compliance,
    on_a_palm,
    pit_contact,
    split_pit_stiffness,
    with_third_contact,
)
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import (
    ElasticBody,
    GrippedBody,
    SofteningGelBody,
    TrueRecording,
    grasped,
    grip_of,
)
from samples.sample_failure import SampleFailure

FAULTS: dict[str, Callable[..., TrueRecording]] = {
    "sensor_gain": with_gain,
    "sensor_drift": with_drift,
    "gripper_compliance": with_gripper_compliance,
    "pose_error": with_pose_error,
    "sensor_nonlinear": with_bent_reading,
    "gel_creep": with_gel_creep,
    "gel_hysteresis": with_hysteresis,
    "thermal_drift": with_thermal_drift,
    "gel_softening": lambda truth, **_: with_nominal_stiffness(truth),
}
"""Function for each fault of machine and gels, by effect; its arguments are the label's parameters."""
BODIES = ("loose_pit", "third_contact", "split_pit")
"""Effects that need another body of linear flesh; at most one, and none together with a material law."""
ALONE = ("split_pit", *OUT_OF_CATALOGUE)
"""Effects that are only injected alone."""


@dataclass(frozen=True, kw_only=True)
class CasePlan:
    """All decisions of a case before any computation."""

    drawn: DrawnFruit
    grasps: tuple[PlannedGrasp, ...]
    injected: tuple[InjectedEffect, ...]


def planned(case_id: str, effects: tuple[tuple[str, float], ...], *, seed: tuple[int, ...]) -> CasePlan:
    """A case with the given effects and amplitudes; the seed determines all the rest."""
    rng = np.random.default_rng(list(seed))
    kind: Category = CATEGORIES[int(rng.integers(len(CATEGORIES)))]
    injected = tuple(
        InjectedEffect(effect=effect, parameters=drawn_parameters(effect, amplitude, rng))
        for effect, amplitude in effects
    )
    offset, size, ratio = (named(injected, e) for e in ("pit_offset", "pit_size", "poisson_ratio"))
    drawn = drawn_fruit(
        case_id,
        category=kind,
        rng=rng,
        pit_shift_mm=None if offset is None else np.array(offset.parameters["offset_mm"]),
        pit_scale=1.0 if size is None else size.number("scale"),
        poisson_ratio=POISSON_RATIO if ratio is None else ratio.number("nu"),
    )
    grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
    injected = tuple(_placed(p, drawn, grasps, rng) for p in injected)
    return CasePlan(drawn=seen_by_drawn_sensor(drawn, rng), grasps=grasps, injected=injected)


def _placed(
    injection: InjectedEffect, drawn: DrawnFruit, grasps: tuple[PlannedGrasp, ...], rng: np.random.Generator
) -> InjectedEffect:
    if injection.effect in OUT_OF_CATALOGUE:
        return drawn_out_of_catalogue(injection.effect, rng)
    if injection.effect == "third_contact":
        place = drawn_place_mm(drawn.fruit.skin, rng)
        return replace(injection, parameters={**injection.parameters, "centre_mm": place.tolist()})
    if injection.effect != "soft_spot":
        return injection
    number, pad = int(rng.integers(3)), str(rng.choice(["left", "right"]))
    depth = float(rng.uniform(2.5, 5.5))
    centre = spot_under_pad(
        drawn, grasps[number], pad=pad, depth_mm=depth, aside_deg=float(rng.uniform(0, 18)), rng=rng
    )
    where = {"grasp": number + 1, "pad": pad, "depth_mm": depth, "centre_mm": centre.tolist()}
    return replace(injection, parameters={**injection.parameters, **where})


def with_amount(
    injection: InjectedEffect, peak_N: float, truths: tuple[TrueRecording, ...] = ()
) -> InjectedEffect:
    """The effect with its label's parameters in newtons. Plans state drifts as shares of the peak force per
    time, and do not state a third contact's force.
    """
    if injection.effect == "third_contact" and truths:
        return replace(injection, parameters={**injection.parameters, "force_N": max(map(borne_N, truths))})
    if injection.effect == "thermal_drift":
        strain, share = injection.number("strain_per_root_s"), injection.number("peak_share_per_root_s")
        return replace(injection, parameters={"strain_per_root_s": strain, "N_per_root_s": share * peak_N})
    if injection.effect != "sensor_drift":
        return injection
    amount = injection.number("share_per_s") * peak_N
    return replace(injection, parameters={"pad": injection.parameters["pad"], "newton_per_s": amount})


def true_recordings(plan: CasePlan, *, fineness: BrickGrading = CASE) -> tuple[TrueRecording, ...]:
    """The plan's grasps, mesh by mesh; grasp 4 meets the flesh as grasp 1 changed it.

    Raises NotInEquilibrium if a grasp does not converge.
    """
    lag = named(plan.injected, "clock_lag")
    recordings: dict[str, TrueRecording] = {}
    for mesh in sorted({g.mesh for g in plan.grasps}):
        here = [g for g in plan.grasps if g.mesh == mesh]
        stands = meshed_fruit(
            plan.drawn.fruit, here[0], sensor=plan.drawn.sensor, fineness=fineness,
            wider=WIDE_SHARE if touches_widely(plan.injected) else 0.0,
        )  # fmt: skip
        body, inner = body_of(stands, plan.injected, skin=plan.drawn.fruit.skin)
        for grasp in here:
            grip = grip_of(stands, gel=gel_of(plan.injected, plan.drawn.sensor.gel), inner=inner)
            if lag is None:
                recordings[grasp.name] = grasped(grasp, grip, body)
                continue
            lag_s = lag.number("lag_s")
            frames = grasp.motion.time_s[grasp.motion.recorded]
            everything = grasped(with_instants(grasp, frames - lag_s), grip, body)
            recordings[grasp.name] = recorded_late(everything, frames, lag_s=lag_s)
    return tuple(recordings[g.name] for g in plan.grasps)


def body_of(
    stands: MeshedFruit, injected: tuple[InjectedEffect, ...], *, skin: Skin | None = None
) -> tuple[GrippedBody, InnerContact | None]:
    """The flesh of one mesh with its injected effects, and a loose pit's or third contact's inner contact.

    `skin` determines a third contact's normal. Raises SampleFailure for a third contact without it, and for
    effects that cannot be simulated together.
    """
    flesh = stands.flesh
    for effect in ALONE:
        if named(injected, effect) and len(injected) > 1:
            raise SampleFailure(f"{effect} is injected alone: no other effect is simulated with it.")
    if palm := named(injected, "palm"):
        whole = whole_fruit(flesh, stands.dofs, support=on_a_palm(flesh, **palm.parameters))
        return NonlinearBody(whole, plain_flesh(flesh)), None
    if softening := named(injected, "gel_softening"):
        return SofteningGelBody(sound_body(stands), **softening.parameters), None
    plain, skin_stiffness = plain_flesh(flesh, injected), membrane(flesh, injected)
    laws = [p for p in injected if p.effect in (*MATERIAL_LAWS, *BODIES)]
    if len(laws) > 1:
        names = " and ".join(p.effect for p in laws)
        raise SampleFailure(f"{names} cannot be injected together: each needs a flesh of its own.")
    injection = laws[0] if laws else None
    at_rest = stiffness_at_rest(flesh, plain)
    if injection is None or injection.effect in MATERIAL_LAWS:
        law, firmer = flesh_law(plain, injection)
        whole = whole_fruit(flesh, stands.dofs, stiffness=at_rest, support=skin_stiffness)
        return NonlinearBody(whole, law, firmer=firmer), None
    linear = at_rest if skin_stiffness is None else csr_array(at_rest + skin_stiffness)
    if injection.effect == "loose_pit":
        loose = loose_compliance(flesh, stands.dofs, extra=csr_array(linear - flesh.stiffness))
        return ElasticBody(loose), pit_contact(flesh, gap_mm=injection.number("gap_mm"))
    if injection.effect == "split_pit":
        split = split_pit_stiffness(flesh, **injection.parameters)
        return ElasticBody(skin_compliance(split, stands.dofs)), None
    if skin is None:
        raise SampleFailure("a third contact needs the fruit's skin, which says its normal.")
    place = np.array(injection.parameters["centre_mm"])
    compliance, seat = with_third_contact(
        flesh, stands.dofs, centre_mm=place, normal=inward_normal(skin, place),
        N_per_mm=injection.number("N_per_mm"), stiffness=linear,
    )  # fmt: skip
    return ElasticBody(compliance), seat


def as_recorded(truth: TrueRecording, injected: tuple[InjectedEffect, ...]) -> TrueRecording:
    """The true recording with the machine's faults; the simulation has already included a late clock."""
    for fault in injected:
        if fault.effect in FAULTS:
            truth = FAULTS[fault.effect](truth, **fault.parameters)
    return truth
