"""Grasps between a gel and a plain jaw: how widely the jaw touches follows from E, and E from that."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fem.estimation.fruit_modulus import FruitInference
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.batch.rig_setting import batch_rig, jaw_faults
from pipeline.batch.task import FruitTask
from pipeline.fruit.elasticity import fruit_modulus
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.placed_grasp import PlacedGrasp, place_grasp

MOST_ROUNDS = 3
"""Estimates with a contact that follows from the one before. E goes with the power -0.6 of the contact's
radius and that with the power -1/3 of E: each round leaves a fifth of the error."""
CLOSE = 0.01
"""Change of ln E from one round to the next below which there is no other. Set by hand: a tenth of the spread
that not seeing the contact adds (pipeline.fruit.elasticity.PLAIN_JAW_SD)."""


def with_plain_jaws(
    task: FruitTask, fruit: GraspedFruit, *, solids: dict[Support, UnitModulusSolid] | None
) -> tuple[GraspedFruit, FruitInference]:
    """The fruit's modulus, and the fruit with the contacts of plain jaws that go with it.

    `solids` as in fruit_modulus, which says what is raised.
    """

    def modulus(placed: Sequence[PlacedGrasp], stage: str) -> FruitInference:
        return fruit_modulus(
            task,
            placed,
            fruit.mesh,
            poisson_ratio=fruit.poisson_ratio,
            budget=fruit.budget,
            stage=stage,
            solids=solids,
        )

    inference = modulus(fruit.placed, "response")
    if not any(grasp.plain_jaw for grasp in fruit.placed):
        return fruit, inference
    rig = batch_rig(task.batch_root, task.settings)
    surface = fruit.shape.vertices, fruit.shape.faces
    for k in range(MOST_ROUNDS):
        before_MPa = inference.modulus.E_MPa
        plane_strain_MPa = before_MPa / (1 - fruit.poisson_ratio**2)
        placed = tuple(
            replace(
                place_grasp(
                    grasp.path,
                    *surface,
                    name=grasp.name,
                    faults=jaw_faults(task.settings.mismatch, rig),
                    sd_mm=fruit.shape.sd_mm,
                    mat_from_fruit=fruit.shape.mat_from_fruit,
                    plane_strain_MPa=plane_strain_MPa,
                ),
                findings=grasp.findings,
            )
            if grasp.plain_jaw
            else grasp
            for grasp in fruit.placed
        )
        inference = modulus(placed, f"response-jaw-{k}")
        fruit = replace(fruit, placed=placed)
        if abs(np.log(inference.modulus.E_MPa / before_MPa)) < CLOSE:
            break
    return fruit, inference
