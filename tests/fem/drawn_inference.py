"""Moduli and pits inferred from drawn grasps, on the estimator's own mesh with the prior's pit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from drawn_grasps import NU, Off, Sensor, True1MPa, World, press_of
from drawn_grasps import recorded as recorded_raw

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.fruit_modulus import FruitInference, infer_modulus
from fem.estimation.grasp_model import GraspModel, grasp_model
from fem.estimation.modulus import ModulusEstimate, estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

SOFTEST_MPA, STIFFEST_MPA = 0.1, 3.0


def drawn_off(rng: np.random.Generator, budget: ErrorBudget) -> Off:
    """Everything off by the spreads that the budget states."""
    return Off(
        pit=rng.normal(size=4) * np.append(np.full(3, budget.pit_offset_sd_mm), budget.pit_size_sd),
        skin_mm=budget.surface_sd_mm,
        waves=int(rng.integers(2**31)),
        pose_mm=rng.normal(size=(2, 2, 2)) * budget.pose_sd_mm,
        poisson_ratio=NU + float(rng.normal()) * budget.poisson_ratio_sd,
    )


def drawn_modulus_MPa(rng: np.random.Generator) -> float:
    """Evenly spread in the logarithm."""
    return float(SOFTEST_MPA * (STIFFEST_MPA / SOFTEST_MPA) ** rng.uniform())


def recorded(world: World, grasp: int, truth: True1MPa, **options: Any) -> GraspHistory:
    """A recording as grading prepares it."""
    axes = [pad.axes for pad in world.grasps[grasp]]
    turns = np.stack([np.column_stack([axis[1], axis[0], -axis[2]]) for axis in axes])
    return prepared_grasp(recorded_raw(world, grasp, truth, **options), turns).history


@dataclass(frozen=True, kw_only=True)
class Estimator:
    """The estimator's mesh of a world's fruit; models of all grasps on it, for the usual press.

    `typical`: the grasps without noise on a fruit that is as it is said to be, all frames under load. The
    responses' change with what is not known follows from forces, and those of any recording are `typical`
    ones times the press.
    """

    world: World
    mesh: FleshMesh
    typical: tuple[GraspHistory, ...]
    models: tuple[GraspModel, ...]

    @classmethod
    def of(cls, world: World, **sizes: float) -> "Estimator":
        """A mesh of its own, and the models on it."""
        at = np.vstack([pad.markers_mm(world.fruit) for pads in world.grasps for pad in pads])
        mesh = world.fruit.meshed(at, **sizes)
        rng, silent = (
            np.random.default_rng(0),
            Sensor(displacement_mm=0.0, force_N=0.0, gel_scale=0.0, force_scale=0.0),
        )
        typical = tuple(
            recorded_raw(world, k, truth, E_MPa=0.5, rng=rng, sensor=silent)
            for k, truth in enumerate(world.solved(Off()))
        )
        return cls(world=world, mesh=mesh, typical=typical, models=models_on(mesh, typical))

    def of_press(
        self, models: Sequence[GraspModel], histories: Sequence[GraspHistory], E_MPa: float
    ) -> list[GraspModel]:
        """The models for these recordings of a fruit of that modulus, in the frames that they load."""
        calibrated = []
        for model, usual, history in zip(models, self.typical, histories, strict=True):
            used = loaded_frames(history)[loaded_frames(usual)]
            values = press_of(E_MPa) * model.sensitivity.values[:, used]
            calibrated.append(replace(model, sensitivity=replace(model.sensitivity, values=values)))
        return calibrated

    def both(
        self, truths: Sequence[True1MPa], *, E_MPa: float, rng: np.random.Generator, budget: ErrorBudget
    ) -> FruitInference:
        """Fruit modulus and pit from all grasps, each grasp's own modulus with them."""
        histories = [
            recorded(self.world, k, truth, E_MPa=E_MPa, rng=rng, sensor=Sensor())
            for k, truth in enumerate(truths)
        ]

        def respond(mesh: FleshMesh) -> list[GraspModel]:
            models = self.models if mesh is self.mesh else models_on(mesh, self.typical)
            return self.of_press(models, histories, E_MPa)

        return infer_modulus(histories, self.mesh, respond, budget=budget)

    def alone(
        self,
        truths: Sequence[True1MPa],
        *,
        E_MPa: float,
        rng: np.random.Generator,
        budget: ErrorBudget,
        sensor: Sensor,
    ) -> list[ModulusEstimate]:
        """Each grasp's own modulus."""
        histories = [
            recorded(self.world, k, truth, E_MPa=E_MPa, rng=rng, sensor=sensor, said=Sensor())
            for k, truth in enumerate(truths)
        ]
        models = self.of_press(self.models, histories, E_MPa)
        return [estimate_modulus(*pair, budget=budget) for pair in zip(histories, models, strict=True)]


def models_on(mesh: FleshMesh, histories: Sequence[GraspHistory]) -> tuple[GraspModel, ...]:
    """Models of all grasps on one factorisation."""
    nodes = contact_nodes(mesh, histories)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free", contact_nodes=nodes)
    return tuple(grasp_model(history, solid) for history in histories)
