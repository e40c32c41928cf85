"""E of the same recordings, computed again: with a plain jaw's contact that follows from E, and with other
parameters of confirmed effects, whose standard deviations contribute to E's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fem.estimation.fruit_modulus import FruitInference
from fem.fem_failure import FemFailure
from fem.mismatch.effect_spec import Entry
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.batch.confirmed_effects import ConfirmedEffect
from pipeline.batch.rig_setting import batch_rig, jaw_faults
from pipeline.batch.task import FruitTask
from pipeline.fruit.elasticity import fruit_modulus
from pipeline.fruit.flesh_effects import in_the_model
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.placed_grasp import PlacedGrasp, place_grasp
from tactile.rig.rig_curve import RigCurve
from tactile.tactile_failure import TactileFailure

MOST_ROUNDS = 3
"""Most estimates with a contact that follows from the one before. E varies with the power -0.6 of the
contact's radius, and that with the power -1/3 of E: each round leaves a fifth of the error."""
CLOSE = 0.01
"""Change of ln E between rounds below which the iteration ends. Set by hand: a quarter of the spread that the
unknown contact adds (pipeline.fruit.elasticity.PLAIN_JAW_SD)."""


def with_plain_jaws(
    task: FruitTask, fruit: GraspedFruit, *, solids: dict[Support, UnitModulusSolid] | None
) -> tuple[GraspedFruit, FruitInference]:
    """The fruit's modulus, and the fruit with the contacts of plain jaws that follow from it.

    `solids` as in fruit_modulus, which says what is raised.
    """
    inference = fruit_modulus(task, fruit, solids=solids)
    if not any(grasp.plain_jaw for grasp in fruit.placed):
        return fruit, inference
    rig = batch_rig(task.batch_root, task.settings)
    for k in range(MOST_ROUNDS):
        before_MPa = inference.modulus.E_MPa
        plane_strain_MPa = before_MPa / (1 - fruit.poisson_ratio**2)
        placed = tuple(
            _placed_again(replace(grasp, plane_strain_MPa=plane_strain_MPa), task, fruit, rig)
            if grasp.plain_jaw
            else grasp
            for grasp in fruit.placed
        )
        fruit = replace(fruit, placed=placed)
        inference = fruit_modulus(task, fruit, stage=f"response-jaw-{k}", solids=solids)
        if abs(np.log(inference.modulus.E_MPa / before_MPa)) < CLOSE:
            break
    return fruit, inference


@dataclass(frozen=True, kw_only=True)
class EffectSpread:
    """Standard deviations of E, MPa: by effects that all fruit share, and by this fruit's own.

    `doubts`: a sentence for each parameter whose part could not be computed.
    """

    common_sd_MPa: float
    own_sd_MPa: float
    doubts: tuple[str, ...]


def effect_spread(task: FruitTask, fruit: GraspedFruit, E_MPa: float) -> EffectSpread:
    """Computes E again with each parameter one standard deviation higher, and adds dE = |E(p + sd) - E(p)| in
    squares.

    Parameters count as independent. The rig counts as one more, its curve shifted as a whole. Poisson's ratio
    and the pit have their own parts of the error bar.
    """
    effects, rig = task.settings.mismatch, batch_rig(task.batch_root, task.settings)
    in_model = in_the_model(effects)
    variants = [
        (f"{name} ({effect.effect})", bool(effect.fruits), (*effects[:k], shifted, *effects[k + 1 :]), [rig])
        for k, effect in enumerate(effects)
        if effect in in_model or effect.spec.enters is Entry.RECORDING
        for name, shifted in _shifted(effect)
    ]
    if rig is not None:
        variants.append(("the rig's compliance", False, effects, [rig.plus(1.0), rig.plus(-1.0)]))
    shared, of_fruit, doubts = [0.0], [0.0], list[str]()
    for what, of_this_fruit, changed, rigs in variants:
        moved_MPa = _moved(task, fruit, E_MPa, changed, rigs)
        (of_fruit if of_this_fruit else shared).append(moved_MPa or 0.0)
        if moved_MPa is None:
            doubts.append(
                f"the error bar excludes the standard deviation of {what}, because E has no value there"
            )
    return EffectSpread(
        common_sd_MPa=float(np.linalg.norm(shared)),
        own_sd_MPa=float(np.linalg.norm(of_fruit)),
        doubts=tuple(doubts),
    )


def _moved(
    task: FruitTask,
    fruit: GraspedFruit,
    E_MPa: float,
    effects: Sequence[ConfirmedEffect],
    rigs: Sequence[RigCurve | None],
) -> float | None:
    """|change of E| with these effects and the first rig that leaves the fruit travel; None if none does."""
    changed = replace(task, settings=task.settings.model_copy(update={"mismatch": tuple(effects)}))
    for rig in rigs:
        try:
            placed = tuple(_placed_again(grasp, changed, fruit, rig) for grasp in fruit.placed)
            inference = fruit_modulus(changed, replace(fruit, placed=placed), stage="response-shifted")
            return abs(inference.modulus.E_MPa - E_MPa)
        except (TactileFailure, FemFailure, ExceptionGroup):
            continue
    return None


def _shifted(effect: ConfirmedEffect) -> Iterator[tuple[str, ConfirmedEffect]]:
    """The effect with one number at a time a standard deviation higher."""
    for name, sd in effect.sd.items():
        value = effect.parameters[name]
        moved: list[float | tuple[float, ...]] = []
        if isinstance(value, tuple):
            spread = sd if isinstance(sd, tuple) else (sd,) * len(value)
            moved = [
                tuple(x + step * (axis == k) for k, x in enumerate(value)) for axis, step in enumerate(spread)
            ]
        elif isinstance(value, int | float) and isinstance(sd, int | float):
            moved = [value + sd]
        for shifted in moved:
            yield name, effect.model_copy(update={"parameters": {**effect.parameters, name: shifted}})


def _placed_again(
    grasp: PlacedGrasp, task: FruitTask, fruit: GraspedFruit, rig: RigCurve | None
) -> PlacedGrasp:
    """The recording placed again with these faults of the jaws removed, and without checks."""
    again = place_grasp(
        grasp.path,
        fruit.shape.vertices,
        fruit.shape.faces,
        name=grasp.name,
        faults=jaw_faults(task.settings.mismatch, rig),
        sd_mm=fruit.shape.sd_mm,
        plane_strain_MPa=grasp.plane_strain_MPa,
        mat_from_fruit=fruit.shape.mat_from_fruit,
    )
    return replace(again, findings=grasp.findings)
