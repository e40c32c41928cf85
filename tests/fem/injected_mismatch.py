"""Two grasps of one fruit with an injected modulus, as the mismatch finder is handed them; coarse.

The truth is solved on a mesh of its own. A bed of springs (the gel) pushes; each pad's pose follows its
markers, so that what belongs to a machine (lags, gains, jaws that give way, wrong poses) can be put into the
recording by its definition alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from unittest import mock

import coarse_fruit
import numpy as np
from coarse_fruit import FOOT_MM, HALF_AXES_MM, NU, PIT_HALF_AXES_MM, PIT_MIDDLE_MM, store, stored
from fem_shapes import ball
from jaxtyping import Int
from plain_model import case_model, screened_effects
from recorded_pad import recorded_pad

from fem.estimation.error_budget import ErrorBudget
from fem.grasp_history import GraspHistory, PadHistory
from fem.mesh import flesh_mesh
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import locate
from fem.mismatch.effect import Effect
from fem.mismatch.mismatch_case import GraspCase, MismatchCase, PadMotion
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import nodal_loads
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.screening import LinearRound
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes, pad_link

E_MPA = 0.25
AXIS = np.linspace(-3.6, 3.6, 7)
FLAT = np.column_stack(
    [grid.ravel() for grid in np.meshgrid(AXIS, AXIS, indexing="ij")] + [np.zeros(len(AXIS) ** 2)]
)
CELL_MM2 = (AXIS[1] - AXIS[0]) ** 2
GEL_N_PER_MM = np.array([0.06, 0.06, 0.18])
NOISE_MM, NOISE_N = 0.002, 1e-3
STEP_S = 0.25
RADII_MM = np.array([0, 0, 0, 2.4, 2.9, 3.4, 3.8, 4.2, 4.5, 4.5, 4.5, 4.5, 4.5, 4.1, 3.6, 3.0, 2.4])
PHASES = ("air",) * 3 + ("load",) * 6 + ("hold",) * 4 + ("unload",) * 4
TIME_S = np.arange(len(RADII_MM)) * STEP_S
NAMES = ("left", "right")
WAYS = ((0, 1), (1, 2))
"""Grasp by grasp: the axis along which the pads close, and that of their own x."""


def meshed(
    edge_mm: float, at_pads_mm: float, points: int, pit: tuple[np.ndarray, np.ndarray] | None = None
) -> FleshMesh:
    """The coarse fruit, or flesh about another pit, with short edges where the pads press."""
    vertices, faces = ball(points, semi_axes_mm=HALF_AXES_MM)
    vertices[:, 2] = np.maximum(vertices[:, 2], FOOT_MM)
    pit = pit or ball(300, semi_axes_mm=PIT_HALF_AXES_MM, centre_mm=PIT_MIDDLE_MM)
    where = np.array([side * np.eye(3)[k] * HALF_AXES_MM[k] for k in (0, 1) for side in (1, -1)])
    return tetrahedralise(
        vertices,
        faces,
        *pit,
        edge_mm=edge_mm,
        refine_at_mm=where,
        refine_radius_mm=4.5,
        refine_edge_mm=at_pads_mm,
    )


@cache
def finders_mesh() -> FleshMesh:
    """The mesh that the finder is handed; coarse but where pads press; stored (see store_meshes)."""
    return stored("finders")


@cache
def true_mesh() -> FleshMesh:
    """The mesh that the truth is solved on; `meshed(9.0, 2.0, 2000)`, stored (see store_meshes)."""
    return stored("true")


def store_meshes() -> None:
    """Make the stored meshes again."""
    coarser = {"LARGEST_SHARE": 1 / 6, "VOLUME_TOLERANCE": 6e-3}  # the pit's volume is 4 in 1000 too small
    with mock.patch.multiple(flesh_mesh, **coarser):
        store("finders", meshed(10.0, 2.8, 1000))
    store("true", meshed(9.0, 2.0, 2000))
    store("coarse", coarse_fruit.meshed(1 / 7.5))


def pad_axes(grasp: int, side: float) -> np.ndarray:
    """x, y and z of a pad as columns; z points into the fruit."""
    z, x = -side * np.eye(3)[WAYS[grasp][0]], np.eye(3)[WAYS[grasp][1]]
    return np.column_stack([x, np.cross(z, x), z])


def on_skin(grasp: int, side: float) -> np.ndarray:
    """The markers on the ellipsoid, along the pad's normal."""
    along = WAYS[grasp][0]
    place = FLAT @ pad_axes(grasp, side).T
    rest = np.delete(np.arange(3), along)
    place[:, along] = (
        side * HALF_AXES_MM[along] * np.sqrt(1 - ((place[:, rest] / HALF_AXES_MM[rest]) ** 2).sum(axis=1))
    )
    return place


def true_force() -> np.ndarray:
    """Forces on the markers in pad axes, N: bowls that grow and steepen, with a little shear outwards."""
    r2 = (FLAT**2).sum(axis=1)
    inside = np.maximum(1 - r2 / np.maximum(RADII_MM[:, None], 1e-9) ** 2, 0.0) * (RADII_MM[:, None] > 0)
    push = 0.012 * RADII_MM[:, None] * inside**1.5 * CELL_MM2
    return np.stack([0.06 * FLAT[:, 0] * push, 0.06 * FLAT[:, 1] * push, push], axis=2)


@dataclass(frozen=True, kw_only=True)
class TruePad:
    """One pad of one grasp as it truly was; fruit frame. `unit`: the skin's displacement for E = 1 MPa."""

    name: str
    axes: np.ndarray
    place_mm: np.ndarray
    unit: np.ndarray
    force_N: np.ndarray
    gel_mm: np.ndarray

    def moved_mm(self, unit: np.ndarray, motion_mm: np.ndarray) -> np.ndarray:
        """Where the markers are, the fruit having moved."""
        return self.place_mm + unit / E_MPA + motion_mm[:, None]


def _history(pads: list[PadHistory]) -> GraspHistory:
    return GraspHistory(time_s=TIME_S, phase=PHASES, pads=tuple(pads))


def bare_pad(grasp: int, side: float, name: str, mesh: FleshMesh) -> PadHistory:
    axes = pad_axes(grasp, side)
    place = locate(mesh, on_skin(grasp, side), within_mm=3.0).point_mm
    force = true_force() @ axes.T
    return recorded_pad(
        place, force, touching=force.any(axis=2), sd_mm=NOISE_MM, sd_N=NOISE_N, name=name, rest_mm=FLAT,
        gel_mm=-(true_force() / GEL_N_PER_MM) @ axes.T,
    )  # fmt: skip


def bare_grasps(mesh: FleshMesh) -> tuple[list[list[PadHistory]], Int[np.ndarray, " s"]]:
    """The pads of every grasp under the true forces, and the nodes of the mesh that they press."""
    bare = [
        [bare_pad(grasp, side, name, mesh) for name, side in zip(NAMES, (-1.0, 1.0), strict=True)]
        for grasp in range(len(WAYS))
    ]
    return bare, contact_nodes(mesh, [_history(pads) for pads in bare])


@cache
def true_solid() -> UnitModulusSolid:
    """The truth's mesh factorised; for the contact nodes of one's own by `replace`."""
    return UnitModulusSolid.factorise(true_mesh(), poisson_ratio=NU, support="free")


@cache
def true_pads() -> tuple[tuple[TruePad, ...], ...]:
    """Solved once on the truth's mesh."""
    return pads_under(lambda force: force)


def pads_under(changed: Callable[[np.ndarray], np.ndarray]) -> tuple[tuple[TruePad, ...], ...]:
    """Both grasps solved on the truth's mesh, `unit` that of the changed forces (t n 3); free of noise."""
    true_pads_of_grasps = []
    bare, nodes = bare_grasps(true_mesh())
    solid = replace(true_solid(), contact_nodes=nodes)
    for grasp, pads in enumerate(bare):
        links = [pad_link(pad, solid) for pad in pads]
        force = np.concatenate([changed(pad.force_N) for pad in pads], axis=1)
        moved = solid.displacement(nodal_loads(links, solid, force))[:, nodes]
        true_pads_of_grasps.append(
            tuple(
                TruePad(
                    name=pad.name,
                    axes=pad_axes(grasp, side),
                    place_mm=pad.surface_mm,
                    unit=link.at_markers(moved),
                    force_N=pad.force_N,
                    gel_mm=pad.gel_displacement_mm,
                )
                for pad, link, side in zip(pads, links, (-1.0, 1.0), strict=True)
            )
        )
    return tuple(true_pads_of_grasps)


@dataclass(frozen=True, kw_only=True)
class Recording(TruePad):
    """What one pad's sensors and machine say in all frames, fruit frame; `origin_mm` of its pose."""

    position_mm: np.ndarray
    origin_mm: np.ndarray

    @property
    def pushed_N(self) -> np.ndarray:
        """Force along the pad's normal, all markers."""
        return (self.force_N @ self.axes[:, 2]).sum(axis=1)


Altered = Callable[[Recording], Recording]


def injected_case(
    altered: Altered = lambda pad: pad,
    *,
    seed: int = 0,
    noise: float = 1.0,
    crept: Callable[[np.ndarray], np.ndarray] = lambda unit: unit,
    mesh: Callable[[], FleshMesh] = finders_mesh,
) -> MismatchCase:
    """Two grasps; `altered` is what is wrong with each pad's recording, `crept` what the flesh does."""
    rng = np.random.default_rng(seed)
    fruit = mesh()
    grasps = []
    for grasp, pads in enumerate(true_pads()):
        motion = 0.1 * np.sin(TIME_S[:, None] * [1.0, 1.3, 0.7])
        histories, motions = [], []
        for true in pads:
            position = true.moved_mm(crept(true.unit), motion)
            origin = (position - FLAT @ true.axes.T - true.gel_mm).mean(axis=1)
            touching = true.force_N.any(axis=2)
            pad = altered(Recording(**vars(true), position_mm=position, origin_mm=origin))
            blur = [noise * rng.normal(size=position.shape) for _ in range(2)]
            force = pad.force_N + NOISE_N * blur[1]
            pose = np.tile(np.eye(4), (len(TIME_S), 1, 1))
            pose[:, :3, :3], pose[:, :3, 3] = pad.axes, pad.origin_mm
            histories.append(
                recorded_pad(
                    locate(fruit, pad.place_mm, within_mm=3.0).point_mm,
                    force,
                    touching=touching,
                    sd_mm=NOISE_MM,
                    sd_N=NOISE_N,
                    name=pad.name,
                    rest_mm=FLAT,
                    position_mm=pad.position_mm + NOISE_MM * blur[0],
                    gel_mm=pad.gel_mm + NOISE_MM * blur[0],
                )
            )
            normal = (force @ pad.axes[:, 2]).sum(axis=1)
            motions.append(PadMotion(name=pad.name, pose=pose, normal_N=normal, markers=len(FLAT)))
        history, name = _history(histories), f"grasp-{grasp + 1}"
        grasps.append(GraspCase(name=name, history=history, pads=tuple(motions), support="free"))
    return MismatchCase(mesh=fruit, grasps=tuple(grasps), poisson_ratio=NU, budget=ErrorBudget())


def on_pad(name: str, change: Altered) -> Altered:
    """The change on one pad alone."""
    return lambda pad: change(pad) if pad.name == name else pad


def misplaced(shift_mm: tuple[float, float], tilt_deg: float) -> Altered:
    """Recorded pose = true pose, then a shift in the gel's plane, then a tilt about the pad's x."""
    a = np.radians(tilt_deg)
    tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])

    def change(pad: Recording) -> Recording:
        recorded = pad.axes @ tilt
        moved = pad.axes[:, :2] @ np.asarray(shift_mm)

        def there(points: np.ndarray, origin: np.ndarray) -> np.ndarray:
            return (points - origin) @ pad.axes @ recorded.T + origin + moved

        return replace(
            pad,
            axes=recorded,
            place_mm=there(pad.place_mm, pad.origin_mm[8]),
            position_mm=there(pad.position_mm, pad.origin_mm[:, None]),
            gel_mm=pad.gel_mm @ pad.axes @ recorded.T,
            force_N=pad.force_N @ pad.axes @ recorded.T,
            origin_mm=pad.origin_mm + moved,
        )

    return change


def small_strain_model(case: MismatchCase) -> CaseModel:
    """The plain model without large deformation, which the truth of this module lacks."""
    return case_model(case, beyond_small_strain=False)[0]


def linear_and_refitted(case: MismatchCase, effect: Effect) -> tuple[CaseModel, LinearRound, Refit]:
    """The plain model, the effect's signatures on it, and the best of them in full."""
    model = small_strain_model(case)
    linear = screened_effects(model, [effect])
    again = refit(model, linear, [linear.best[0]])
    assert again is not None
    return model, linear, again


def only_grasp(case: MismatchCase, number: int) -> MismatchCase:
    """One of the recordings."""
    return replace(case, grasps=(case.grasps[number],))
