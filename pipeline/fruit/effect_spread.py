"""What a modulus may be off by because the confirmed effects in it are themselves known only so well."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.effect_spec import Entry
from pipeline.batch.confirmed_effects import ConfirmedEffect
from pipeline.batch.rig_setting import batch_rig, jaw_faults
from pipeline.batch.task import FruitTask
from pipeline.fruit.elasticity import fruit_modulus
from pipeline.fruit.flesh_effects import in_the_model
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.placed_grasp import place_grasp
from tactile.rig.rig_curve import RigCurve
from tactile.tactile_failure import TactileFailure


@dataclass(frozen=True, kw_only=True)
class EffectSpread:
    """Standard deviations of E, MPa: of effects that all fruit share, and of this fruit's own.

    `doubts`: a sentence for each parameter whose share could not be found.
    """

    common_sd_MPa: float
    own_sd_MPa: float
    doubts: tuple[str, ...]


def effect_spread(task: FruitTask, fruit: GraspedFruit, E_MPa: float) -> EffectSpread:
    """E again with each parameter one standard deviation higher: dE = |E(p + sd) - E(p)|, added in squares.

    Parameters count as independent, and the rig as one more, its curve shifted as a whole. Poisson's ratio
    and the pit have their own parts of the error bar.
    """
    shared, of_fruit, doubts = [0.0], [0.0], list[str]()
    effects = task.settings.mismatch
    rig = batch_rig(task.batch_root, task.settings)
    in_model = in_the_model(effects)
    for k, effect in enumerate(effects):
        if effect not in in_model and effect.spec.enters is not Entry.RECORDING:
            continue
        for name, shifted in _shifted(effect):
            moved = _moved(task, fruit, E_MPa, (*effects[:k], shifted, *effects[k + 1 :]), [rig])
            (of_fruit if effect.fruits else shared).append(moved or 0.0)
            if moved is None:
                doubts.append(
                    f"the error bar excludes the standard deviation of {effect.effect}'s {name}, because "
                    "E has no value there"
                )
    if rig is not None:
        moved = _moved(task, fruit, E_MPa, effects, [rig.plus(1.0), rig.plus(-1.0)])
        shared.append(moved or 0.0)
        if moved is None:
            doubts.append(
                "the error bar excludes the standard deviation of the rig's compliance, "
                "because E has no value there"
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
    """|change of E| with these effects and the first rig that leaves the fruit travel; None with none."""
    for rig in rigs:
        try:
            return abs(_modulus(task, fruit, effects, rig=rig) - E_MPa)
        except (TactileFailure, FemFailure, ExceptionGroup):
            continue
    return None


def _shifted(effect: ConfirmedEffect) -> Iterator[tuple[str, ConfirmedEffect]]:
    """The effect with one number after the other a standard deviation higher."""
    for name, sd in effect.sd.items():
        value = effect.parameters[name]
        if isinstance(value, tuple):
            spread = sd if isinstance(sd, tuple) else (sd,) * len(value)
            for axis, step in enumerate(spread):
                moved = tuple(x + step * (axis == k) for k, x in enumerate(value))
                yield name, effect.model_copy(update={"parameters": {**effect.parameters, name: moved}})
        elif isinstance(value, int | float) and isinstance(sd, int | float):
            yield name, effect.model_copy(update={"parameters": {**effect.parameters, name: value + sd}})


def _modulus(
    task: FruitTask, fruit: GraspedFruit, effects: Sequence[ConfirmedEffect], *, rig: RigCurve | None
) -> float:
    """E of the same mesh and the same recordings with other parameters."""
    changed = replace(task, settings=task.settings.model_copy(update={"mismatch": tuple(effects)}))
    surface = fruit.shape.vertices, fruit.shape.faces
    of_the_jaws = jaw_faults(effects, rig)
    placed = [
        place_grasp(
            g.path,
            *surface,
            name=g.name,
            faults=of_the_jaws,
            plane_strain_MPa=g.plane_strain_MPa,
            mat_from_fruit=fruit.shape.mat_from_fruit,
        )
        for g in fruit.placed
    ]
    return fruit_modulus(
        changed,
        placed,
        fruit.mesh,
        poisson_ratio=fruit.poisson_ratio,
        budget=fruit.budget,
        stage="response-shifted",
    ).modulus.E_MPa
