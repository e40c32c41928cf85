"""A tactile grasp of a sample fruit: two jaws close on it in simulation; the recording they would give."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from samples.brick_flesh import Law, flesh_of
from samples.fruit import SampleFruit
from samples.gel_contact import Gel, at_markers
from samples.grasp_plan import Hold, LoadProtocol
from samples.hexahedra import SHIPPED, Fineness, flesh_bricks
from samples.quasi_static_contact import LoadStep, QuasiStaticContact, at_rest, quasi_static_contact, step
from samples.sample_failure import NotInEquilibrium
from samples.sensor_noise import SensorNoise, measured
from tactile.io.recording import GelPad, Recording

SENSOR = "20x20 marker gel"
MARKER_AREA_MM2 = 1.0
"""Of the gel for each marker: they are 1 mm apart."""


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """A simulated recording and its truth: marker values without noise, and every load step."""

    recording: Recording
    true_displacement_mm: tuple[Float[np.ndarray, "t _n 3"], ...]
    true_force_N: tuple[Float[np.ndarray, "t _n 3"], ...]
    steps: tuple[LoadStep, ...]
    contact: QuasiStaticContact


def simulate(
    fruit: SampleFruit,
    hold: Hold,
    protocol: LoadProtocol,
    *,
    rng: np.random.Generator,
    gel: Gel | tuple[Gel, Gel] | None = None,
    noise: SensorNoise | None = None,
    law: Law = "neo-hookean",
    fineness: Fineness = SHIPPED,
    progress: Callable[[str], None] | None = None,
) -> Grasp:
    """The recording of one grasp. Every frame is solved to equilibrium; frames where nothing moved share it.
    `gel`: of both jaws, or of the left and the right one (a very stiff one is a plain jaw).

    Raises NotInEquilibrium where a step does not converge or the patch outgrows the pad.
    """
    gels = gel if isinstance(gel, tuple) else (gel or Gel(),) * 2
    bricks = flesh_bricks(fruit, hold.turns[0][:, 2], fineness)
    flesh = flesh_of(bricks, E_MPa=fruit.E_MPa, poisson_ratio=fruit.poisson_ratio, law=law)
    contact = quasi_static_contact(flesh, gels, hold.turns, hold.touch_mm)
    steps: list[LoadStep] = []
    travels = protocol.travel_mm.tolist()
    for k, travel in enumerate(travels):
        if k == 0:
            steps.append(at_rest(contact, hold.origins(travel)))
        elif travel == travels[k - 1]:
            steps.append(steps[-1])
        else:
            steps.append(_moved(contact, steps[-1], hold, travels[k - 1], travel))
        if progress is not None:
            progress(f"{fruit.fruit_id}: frame {k + 1} of {len(travels)}")
    return _recorded(fruit, hold, protocol, contact, tuple(steps), noise or SensorNoise(), rng)


def _moved(
    contact: QuasiStaticContact,
    before: LoadStep,
    hold: Hold,
    from_mm: float,
    to_mm: float,
    *,
    halvings: int = 3,
) -> LoadStep:
    """One frame on; a step that does not converge is taken in two."""
    try:
        return step(contact, before, hold.origins(to_mm))
    except NotInEquilibrium:
        if halvings == 0:
            raise
    middle = (from_mm + to_mm) / 2
    halfway = _moved(contact, before, hold, from_mm, middle, halvings=halvings - 1)
    return _moved(contact, halfway, hold, middle, to_mm, halvings=halvings - 1)


def marker_grid() -> Float[np.ndarray, "400 3"]:
    """20 x 20 markers, 1 mm apart, on the flat gel face."""
    line = np.arange(20) - 9.5
    x, y = np.meshgrid(line, line, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.zeros(400)], axis=1)


def _recorded(
    fruit: SampleFruit, hold: Hold, protocol: LoadProtocol, contact: QuasiStaticContact,
    steps: tuple[LoadStep, ...], noise: SensorNoise, rng: np.random.Generator,
) -> Grasp:  # fmt: skip
    """The contact's true motion as the sensors record it, noise included."""
    rest = marker_grid()
    pads, shifts, forces = [], [], []
    for side, name in enumerate(("left", "right")):
        shift = np.stack([_marker_shift(contact, m, side, rest) for m in steps])
        own = contact.gels[side]
        stiffness = np.array([own.kt_MPa_per_mm, own.kt_MPa_per_mm, own.kn_MPa_per_mm])
        force = -stiffness * MARKER_AREA_MM2 * shift
        poses = np.broadcast_to(np.eye(4), (len(steps), 4, 4)).copy()
        poses[:, :3, :3] = hold.turns[side]
        poses[:, :3, 3] = [hold.origins(travel)[side] for travel in protocol.travel_mm.tolist()]
        felt, pushed = measured(shift, force, noise, rng)
        pads.append(
            GelPad(
                name=name,
                pose=poses,
                rest_mm=rest,
                displacement_mm=felt,
                force_N=pushed,
                gel_kn_MPa_per_mm=own.kn_MPa_per_mm,
                gel_kt_MPa_per_mm=own.kt_MPa_per_mm,
            )
        )
        shifts.append(shift)
        forces.append(force)
    gap = np.linalg.norm(hold.touch_mm[1] - hold.touch_mm[0])
    recording = Recording(
        fruit_id=fruit.fruit_id,
        category="nectarine",
        loading="grasp",
        support="free",
        sensor=SENSOR,
        time_s=protocol.time_s,
        aperture_mm=gap - 2 * protocol.travel_mm,
        pads=tuple(pads),
    )
    return Grasp(
        recording=recording,
        true_displacement_mm=tuple(shifts),
        true_force_N=tuple(forces),
        steps=steps,
        contact=contact,
    )


def _marker_shift(
    contact: QuasiStaticContact, at: LoadStep, side: int, rest_mm: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """How far the skin has carried each marker from its rest place; zero where it does not touch."""
    anchors = at.anchors[side]
    carried = anchors.position_mm[:, :2] - anchors.gel_point_mm
    values = np.concatenate([carried, anchors.position_mm[:, 2:]], axis=1)
    seen = at_markers(rest_mm[:, :2], anchors.gel_point_mm, values, contact.faces[side].cells)
    touches = np.nan_to_num(seen[:, 2], nan=1.0) < 0
    shift = np.where(touches[:, None], seen, 0.0)
    gel = contact.gels[side]
    reach = -gel.friction * gel.kn_MPa_per_mm / gel.kt_MPa_per_mm * shift[:, 2]
    size = np.linalg.norm(shift[:, :2], axis=1)
    # between nodes, too, the shear stays within the cone
    shift[:, :2] *= np.minimum(1.0, reach / np.maximum(size, 1e-12))[:, None]
    return shift
