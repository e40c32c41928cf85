"""The coarse fruit of coarse_fruit pinched at two places, as the mismatch finder is handed it."""

from dataclasses import replace
from functools import cache

import numpy as np
from coarse_fruit import NU, fruit_mesh, pinch

from fem.estimation.error_budget import ErrorBudget
from fem.grasp_history import GraspHistory
from fem.mismatch.mismatch_case import GraspCase, MismatchCase, PadMotion
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import PlainModel, plain_model
from fem.solid.linear_solid import UnitModulusSolid

COMPLIANCE = 4.0
FRAMES = 8


@cache
def long_pinch() -> GraspHistory:
    """The pinch in FRAMES frames of growing, then falling load; the fruit's own motion is nil."""
    short = pinch()
    share = np.sin(np.linspace(0.3, 2.9, FRAMES))
    pads = []
    for pad in short.pads:
        force = share[:, None, None] * (
            4 * pad.force_N[1] + 0.4 * np.sin(np.arange(FRAMES))[:, None, None] * pad.force_N[2]
        )
        still = np.zeros_like(force)
        pressed = share[:, None, None] * np.array([0.0, 0.0, -0.5])
        pads.append(
            replace(
                pad,
                position_mm=pad.surface_mm + still,
                gel_displacement_mm=still + pressed,
                force_N=force,
                episode=np.zeros(force.shape[:2], dtype=np.int64),
            )
        )
    phase = ("load",) * 4 + ("unload",) * 4
    return GraspHistory(time_s=np.arange(FRAMES) * 0.1, phase=phase, pads=tuple(pads))


def facing(way: float) -> np.ndarray:
    """The pose of a pad that pushes along x, forwards or backwards."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, 0, way], [1, 0, 0], [0, way, 0]])
    return pose


def as_case(history: GraspHistory) -> MismatchCase:
    """One recording of the coarse fruit."""
    pads = tuple(
        PadMotion(
            name=pad.name,
            pose=np.repeat(facing(np.sign(pad.force_N[:, :, 0].sum()))[None], len(history.time_s), axis=0),
            normal_N=np.abs(pad.force_N[:, :, 0].sum(axis=1)),
            markers=len(pad.rest_mm),
        )
        for pad in history.pads
    )
    grasp = GraspCase(name="grasp-1", history=history, pads=pads, support="free")
    return MismatchCase(mesh=fruit_mesh(), grasps=(grasp,), poisson_ratio=NU, budget=ErrorBudget())


@cache
def pinched() -> PlainModel:
    """The plain model; the markers' positions are those of a fruit that nothing moves."""
    return plain_model(as_case(long_pinch()))


def model_of(moved_mm: np.ndarray | None = None) -> CaseModel:
    """The ground on which effects stand, where the markers have moved so beyond the plain model."""
    base = pinched()
    recording = base.grasps[0]
    response = COMPLIANCE * recording.tracks.unit_displacement
    beyond = np.zeros_like(response) if moved_mm is None else moved_mm
    position = recording.tracks.place_mm + response + beyond
    tracks = replace(recording.tracks, position_mm=position)
    return CaseModel(base=replace(base, grasps=(replace(recording, tracks=tracks),)), compliance=COMPLIANCE)


def in_full(model: CaseModel, solid: UnitModulusSolid) -> np.ndarray:
    """c(t) of the recording on a solid of any law, its nodes numbered as those of the plain model."""
    recording = model.grasps[0]
    return recording.over_time(recording.at_markers(solid.displacement(recording.loads(recording.patterns))))
