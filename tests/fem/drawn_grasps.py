"""Grasps of fruit whose pit, skin and pads are off by drawn amounts, and what sensors record of them.

The truth is solved on a mesh of its own, finer at the pads, under a traction field that is integrated there;
an estimator on another mesh gets samples of it at the markers. What is off is moved in the truth's mesh by
fields that the estimator does not know: waves of random direction and length for the skin, pads that press
beside where they are said to.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from fem_shapes import ball
from recorded_pad import recorded_pad
from scipy.spatial import cKDTree

from fem.elements.assembly import assemble
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import SurfacePoints, locate, skin_quadrature
from fem.solid.discretisation_error import discretisation_error
from fem.solid.linear_solid import FreeBody, UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved
from fem.solid.rigid_core import reduced, rigid_modes
from fem.sparse.solver import Analysis, analyse

NU = 0.45
RADII_MM = np.array([2.5, 3.5, 4.5, 5.3, 6.0, 6.0, 5.2, 4.2, 3.2])
PHASES = ("load",) * 5 + ("hold",) + ("unload",) * 3
AIR = 12
AXIS = np.arange(-6.0, 6.5)
FLAT_MM = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
#: markers sit a millimetre apart: the area that each stands for
CELL_MM2 = 1.0
PRESSURE_MPA_PER_MM, SHEAR = 0.01, 0.15
"""Greatest pressure over the radius, where E is USUAL_MPA; shear outwards over pressure, at the rim."""
USUAL_MPA, STIFFER = 0.5, 0.8
"""Stiffer fruit is pressed harder: by this power of its modulus."""
PAD_DEPTH_MM = 8.0
PUT_BACK = 0.5
"""Share of the energy withheld by the truth's own mesh by which its displacement is taken to grow."""
GEL_N_PER_MM = 0.2
WAVES, SHORTEST_MM, LONGEST_MM = 10, 15.0, 40.0
MOTION_MM, MOTION_RAD = 0.2, 0.004


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """White noise per component and frame, and scale errors of single markers."""

    displacement_mm: float = 0.004
    force_N: float = 0.005
    gel_scale: float = 0.004
    force_scale: float = 0.01


@dataclass(frozen=True, kw_only=True)
class Fruit:
    """An ellipsoid about the origin, and its pit as the prior has it."""

    half_axes_mm: np.ndarray
    pit_half_axes_mm: np.ndarray
    pit_centre_mm: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Fruit":
        """About 61 x 59 x 57 mm."""
        half = np.array([30.5, 29.5, 28.5]) * rng.normal(1, 0.03) * rng.normal(1, 0.012, 3)
        return cls(
            half_axes_mm=half,
            pit_half_axes_mm=half * [0.446, 0.328, 0.567],
            pit_centre_mm=rng.normal(0, 0.5, 3),
        )

    def meshed(self, at_mm: np.ndarray, **sizes: float) -> FleshMesh:
        """Mesh with short edges at these points."""
        return tetrahedralise(
            *ball(4000, semi_axes_mm=self.half_axes_mm),
            *ball(2000, semi_axes_mm=self.pit_half_axes_mm, centre_mm=self.pit_centre_mm),
            refine_at_mm=at_mm,
            **sizes,
        )

    def normal(self, points_mm: np.ndarray) -> np.ndarray:
        """Outward, also off the skin."""
        slope = points_mm / self.half_axes_mm**2
        return slope / np.linalg.norm(slope, axis=-1, keepdims=True)


@dataclass(frozen=True, kw_only=True)
class Pad:
    """A flat pad: its origin on the skin, the skin's outward normal there, two axes along the skin."""

    name: str
    origin_mm: np.ndarray
    axes: np.ndarray

    @classmethod
    def on(cls, fruit: Fruit, name: str, direction: np.ndarray) -> "Pad":
        """Where a ray from the fruit's centre leaves it."""
        origin = direction / np.linalg.norm(direction / fruit.half_axes_mm)
        out = fruit.normal(origin)
        across = np.cross(out, np.eye(3)[np.abs(out).argmin()])
        across /= np.linalg.norm(across)
        return cls(name=name, origin_mm=origin, axes=np.stack([across, np.cross(out, across), out]))

    def markers_mm(self, fruit: Fruit) -> np.ndarray:
        """The markers brought onto the fruit's skin along the normal."""
        start, out = self.origin_mm + FLAT_MM @ self.axes[:2], self.axes[2]
        a = (out**2 / fruit.half_axes_mm**2).sum()
        b = (start * out / fruit.half_axes_mm**2).sum(axis=1)
        c = ((start / fruit.half_axes_mm) ** 2).sum(axis=1) - 1
        return start + ((-b + np.sqrt(b**2 - a * c)) / a)[:, None] * out

    def traction_MPa(self, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressure (f, p) and traction (f, p, 3): bowls that grow and steepen, and shear outwards."""
        flat = (points_mm - self.origin_mm) @ self.axes.T
        inside = 1 - (flat[:, :2] ** 2).sum(axis=1) / RADII_MM[:, None] ** 2
        below = flat[:, 2] > -PAD_DEPTH_MM
        pressure = PRESSURE_MPA_PER_MM * RADII_MM[:, None] * (np.maximum(inside, 0) * below) ** 2
        along = SHEAR * flat[:, :2] @ self.axes[:2]
        way = along / RADII_MM[:, None, None] - self.axes[2]
        return pressure, pressure[:, :, None] * way


@dataclass(frozen=True, kw_only=True)
class Off:
    """What is off: pit (mm and ln size), skin (spread, mm, of waves of a seed), pads (mm along), nu."""

    pit: np.ndarray = field(default_factory=lambda: np.zeros(4))
    skin_mm: float = 0.0
    waves: int = 0
    pose_mm: np.ndarray = field(default_factory=lambda: np.zeros((2, 2, 2)))
    poisson_ratio: float = NU

    @property
    def same_body(self) -> bool:
        return not self.pit.any() and self.skin_mm == 0 and self.poisson_ratio == NU

    def skin_error_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """How far out the true skin lies at these points."""
        rng = np.random.default_rng([self.waves, 1])
        way = rng.normal(size=(WAVES, 3))
        way *= (2 * np.pi / rng.uniform(SHORTEST_MM, LONGEST_MM, WAVES) / np.linalg.norm(way, axis=1))[
            :, None
        ]
        phase = rng.uniform(0, 2 * np.pi, WAVES)
        size = rng.normal(size=WAVES) / WAVES**0.5
        return self.skin_mm * 2**0.5 * np.cos(points_mm @ way.T + phase) @ size


@dataclass(frozen=True, kw_only=True)
class True1MPa:
    """One grasp of a fruit of E = 1 MPa: displacement and force of its markers, pad by pad."""

    moved_mm: tuple[np.ndarray, ...]
    force_N: tuple[np.ndarray, ...]


@dataclass(frozen=True, kw_only=True)
class World:
    """The truth's mesh of a fruit, its pads, and the plan by which every version of it is factorised."""

    fruit: Fruit
    grasps: tuple[tuple[Pad, Pad], ...]
    solid: UnitModulusSolid
    plan: Analysis

    @classmethod
    def of(cls, fruit: Fruit, directions: np.ndarray, **sizes: float) -> "World":
        """A grasp along each direction."""
        grasps = tuple((Pad.on(fruit, "left", d), Pad.on(fruit, "right", -d)) for d in directions)
        at = np.vstack([pad.markers_mm(fruit) for pads in grasps for pad in pads])
        solid = UnitModulusSolid.factorise(fruit.meshed(at, **sizes), poisson_ratio=NU, support="free")
        plan = analyse(reduced(solid.stiffness, solid.kinematics))
        return cls(fruit=fruit, grasps=grasps, solid=solid, plan=plan)

    @cached_property
    def withheld(self) -> float:
        """Share of the energy that the truth's own mesh withholds (greatest load of the first grasp)."""
        load = self._loads(self.solid.mesh, self.grasps[0], Off())[0][[int(RADII_MM.argmax())]]
        moved = self.solid.displacement(load)
        return float(discretisation_error(self.solid.mesh, moved, poisson_ratio=NU)[0])

    def solved(self, off: Off) -> tuple[True1MPa, ...]:
        """Every grasp, all of them on one factorisation."""
        solid = self.solid if off.same_body else self._body(off)
        poses = [
            tuple(replace(p, origin_mm=p.origin_mm + d @ p.axes[:2]) for p, d in zip(pads, pose, strict=True))
            for pads, pose in zip(self.grasps, off.pose_mm, strict=False)
        ]
        # Along the pads' own axes, so that markers stay a millimetre apart in their pad's plane.
        guess = np.vstack([pad.markers_mm(self.fruit) for pads in poses for pad in pads])
        out = np.repeat([pad.axes[2] for pads in poses for pad in pads], len(FLAT_MM), axis=0)
        steep = (out * self.fruit.normal(guess)).sum(axis=1)
        guess = guess + (off.skin_error_mm(guess) / steep)[:, None] * out
        place = locate(solid.mesh, guess)
        loads, at_markers = [], []
        n = len(FLAT_MM)
        for k, pads in enumerate(poses):
            load, traction = self._loads(solid.mesh, pads, off, place, slice(2 * k * n, 2 * (k + 1) * n))
            loads.append(load)
            at_markers.append(traction)
        moved = (1 + PUT_BACK * self.withheld) * place.sample(solid.displacement(np.concatenate(loads)))
        frames, grasps = len(RADII_MM), []
        for k in range(len(poses)):
            grasp_points = slice(2 * k * n, 2 * (k + 1) * n)
            cell = CELL_MM2 / (place.normal[grasp_points] * out[grasp_points]).sum(axis=1)
            force = at_markers[k] * cell[:, None]
            motion = moved[k * frames : (k + 1) * frames, grasp_points]
            grasps.append(
                True1MPa(moved_mm=(motion[:, :n], motion[:, n:]), force_N=(force[:, :n], force[:, n:]))
            )
        return tuple(grasps)

    def _body(self, off: Off) -> UnitModulusSolid:
        mesh = self.solid.mesh
        to_pit = cKDTree(mesh.nodes_mm[mesh.pit_nodes]).query(mesh.nodes_mm)[0]
        to_skin = cKDTree(mesh.nodes_mm[mesh.outer_nodes]).query(mesh.nodes_mm)[0]
        out = (to_pit / (to_pit + to_skin)) ** 2 * off.skin_error_mm(mesh.nodes_mm)
        waved = mesh.nodes_mm + out[:, None] * self.fruit.normal(mesh.nodes_mm)
        mesh = with_pit_moved(replace(mesh, nodes_mm=waved), off.pit)
        parts = assemble(mesh.nodes_mm, mesh.tets)
        stiffness = parts.for_unit_modulus(poisson_ratio=off.poisson_ratio)
        return replace(
            self.solid,
            mesh=mesh,
            poisson_ratio=off.poisson_ratio,
            parts=parts,
            stiffness=stiffness,
            factor=self.plan.factorise(reduced(stiffness, self.solid.kinematics)),
            free_body=FreeBody.of(mesh),
        )

    def _loads(
        self,
        mesh: FleshMesh,
        pads: tuple[Pad, ...],
        off: Off,
        place: SurfacePoints | None = None,
        marker_points: slice = slice(0),
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces on the nodes, and the traction at the markers, made to balance by a rigid field."""
        points, area = skin_quadrature(mesh)

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            pressure, traction = (sum(both) for both in zip(*(p.traction_MPa(x) for p in pads), strict=True))
            return pressure, traction, rigid_modes(x, centre_mm=np.zeros(3))

        pressure, traction, rigid = at(points.point_mm)
        gram = np.einsum("fp,p,pxi,pxj->fij", pressure, area, rigid, rigid, optimize=True)
        sums = np.einsum("p,pxi,fpx->fi", area, rigid, traction, optimize=True)
        amount = -np.linalg.solve(gram, sums[..., None])[..., 0]
        balanced = traction + pressure[:, :, None] * np.einsum("pxi,fi->fpx", rigid, amount)
        load = points.point_load(balanced * area[:, None])
        if place is None:
            return load, np.zeros(0)
        pressure, traction, rigid = at(place.point_mm[marker_points])
        return load, traction + pressure[:, :, None] * np.einsum("pxi,fi->fpx", rigid, amount)


def press_of(modulus_MPa: float) -> float:
    """How much harder than usual a fruit of that modulus is pressed."""
    return float((modulus_MPa / USUAL_MPA) ** STIFFER)


def recorded(
    world: World,
    grasp: int,
    truth: True1MPa,
    *,
    E_MPa: float,
    rng: np.random.Generator,
    sensor: Sensor,
    said: Sensor | None = None,
) -> GraspHistory:
    """What sensors see of the truth, the fruit moving in the jaws; `said`: the noise that is stated."""
    said = said or sensor
    press = press_of(E_MPa)
    n, frames = len(FLAT_MM), AIR + len(RADII_MM)
    shift, turn = rng.normal(size=(frames, 3)) * MOTION_MM, rng.normal(size=(frames, 3)) * MOTION_RAD
    touching = np.linalg.norm(FLAT_MM, axis=1) < RADII_MM[:, None]
    touching = np.concatenate([np.zeros((AIR, n), dtype=bool), touching])
    pads = []
    for pad, moved, force in zip(world.grasps[grasp], truth.moved_mm, truth.force_N, strict=True):
        moved, force = (np.concatenate([np.zeros((AIR, n, 3)), press * v]) for v in (moved, force))
        place = pad.markers_mm(world.fruit)
        gel = -force / GEL_N_PER_MM
        recording = gel * (1 + sensor.gel_scale * rng.normal(size=(n, 1)))
        recording = recording + sensor.displacement_mm * rng.normal(size=recording.shape)
        felt = force * (1 + sensor.force_scale * rng.normal(size=(n, 1)))
        felt = felt + sensor.force_N * rng.normal(size=felt.shape)
        rigid = shift[:, None] + np.cross(turn[:, None], place[None])
        pads.append(
            recorded_pad(
                place,
                felt,
                touching=touching,
                sd_mm=said.displacement_mm,
                sd_N=said.force_N,
                name=pad.name,
                rest_mm=np.column_stack([FLAT_MM, np.zeros(n)]),
                gel_mm=recording,
                position_mm=place + moved / E_MPa + rigid + (recording - gel),
            )
        )
    return GraspHistory(time_s=np.arange(frames) / 30, phase=("air",) * AIR + PHASES, pads=tuple(pads))
