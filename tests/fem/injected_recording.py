"""Recordings of a body of revolution with an injected modulus, and the coarse tetrahedra that must find it.

The truth is solved in two dimensions by quadratic quadrilaterals (axisymmetric), the estimate uses the
mesher's tetrahedra.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from axisymmetric import Revolved, cored_ball, cylinder
from fem_shapes import ball
from recorded_pad import recorded_pad

from fem.estimation.error_budget import MODEL, TACTILE, ErrorBudget
from fem.estimation.grasp_model import GraspModel, grasp_model
from fem.estimation.modulus import ModulusEstimate, estimate_modulus
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

NU = 0.45
E_MPA = 0.3
RADIUS_MM, CORE_MM, HEIGHT_MM = 25.0, 10.0, 20.0
BUDGET = ErrorBudget()
RADII_MM = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 7.0, 6.0, 5.0, 3.5])
PHASES = ("load",) * 5 + ("hold",) + ("unload",) * 3
AXIS = np.arange(-8.0, 8.5)
MARKERS = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
BALL = cored_ball(RADIUS_MM, CORE_MM, NU)
PUCK = cylinder(RADIUS_MM, HEIGHT_MM, NU)
BOTH = (1.0, -1.0)


def pressure_MPa(r_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    """A smooth bowl that grows and steepens with its radius."""
    return 0.005 * radius_mm * np.maximum(1 - (r_mm / radius_mm) ** 2, 0.0) ** 2


def height_of(body: Revolved, r_mm: np.ndarray) -> np.ndarray:
    """z of the loaded surface."""
    edge = body.nodes[:, -1]
    return np.interp(r_mm, edge[:, 0], edge[:, 1])


def truth(body: Revolved) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the markers for E = 1, and their forces, frame by frame, for a pad above."""
    if id(body) not in _TRUTH:
        _TRUTH[id(body)] = _solved(body)
    return _TRUTH[id(body)]


_TRUTH: dict[int, tuple[np.ndarray, np.ndarray]] = {}


def _solved(body: Revolved) -> tuple[np.ndarray, np.ndarray]:
    tractions = [lambda r, a=a: -pressure_MPa(r, a) for a in RADII_MM]
    surface = body.surface_displacement(tractions)
    r = np.linalg.norm(MARKERS, axis=1)
    unit = np.zeros((len(RADII_MM), len(r), 3))
    force = np.zeros_like(unit)
    slope = np.gradient(body.nodes[:, -1, 1], body.nodes[:, -1, 0])
    stretch = np.sqrt(1 + np.interp(r, body.nodes[:, -1, 0], slope) ** 2)
    for frame, radius in enumerate(RADII_MM):
        radial, down = (np.interp(r, body.nodes[:, -1, 0], surface[frame, :, k]) for k in range(2))
        unit[frame, :, :2] = (radial / np.maximum(r, 1e-9))[:, None] * MARKERS
        unit[frame, :, 2] = down
        force[frame, :, 2] = -pressure_MPa(r, radius) * stretch
    return unit, force


def recorded(
    body: Revolved,
    sides: tuple[float, ...],
    rng: np.random.Generator,
    *,
    noise: float = 1.0,
    surface_mm: float = 0.1,
    moves: bool = True,
) -> GraspHistory:
    """What sensors would have seen: noise, scale errors, a scanned surface that is off, a fruit that
    moves."""
    unit, force = truth(body)
    shift = rng.normal(size=(len(RADII_MM), 1, 3)) * 0.2 * moves
    touching = np.linalg.norm(MARKERS, axis=1) < RADII_MM[:, None]
    pads = []
    for name, side in zip(("left", "right"), sides, strict=False):
        mirror = np.array([1.0, 1.0, side])
        place = np.column_stack([MARKERS, height_of(body, np.linalg.norm(MARKERS, axis=1))]) * mirror
        gel = -mirror * force / 0.2 * [0, 0, 1]
        gel_seen = gel * (1 + 0.004 * noise * rng.normal(size=(len(place), 1)))
        seen = place + mirror * unit / E_MPA + shift + [0, 0, surface_mm * side] + (gel_seen - gel)
        force_seen = mirror * force * (1 + 0.01 * noise * rng.normal(size=(len(place), 1)))
        seen = seen + 0.004 * noise * rng.normal(size=seen.shape)
        felt = force_seen + 1e-4 * noise * rng.normal(size=force.shape)
        pads.append(
            recorded_pad(
                place,
                felt,
                touching=touching,
                sd_mm=0.004 * noise,
                sd_N=1e-4 * noise,
                name=name,
                rest_mm=np.column_stack([MARKERS, np.zeros(len(place))]),
                position_mm=seen,
                gel_mm=gel_seen,
            )
        )
    return GraspHistory(time_s=np.arange(len(RADII_MM)) * 0.1, phase=PHASES, pads=tuple(pads))


def grasp(seed: int = 0, **options: float) -> GraspHistory:
    """Two pads on the ball around a core."""
    return recorded(BALL, BOTH, np.random.default_rng(seed), **options)


@cache
def ball_mesh() -> FleshMesh:
    """The ball around a core as the estimate sees it."""
    return tetrahedralise(
        *ball(6000, semi_axes_mm=3 * (RADIUS_MM,)),
        *ball(3000, semi_axes_mm=3 * (CORE_MM,)),
        edge_mm=6.0,
        refine_at_mm=np.array([[0, 0, RADIUS_MM], [0, 0, -RADIUS_MM]]),
        refine_radius_mm=7.0,
        refine_edge_mm=2.0,
    )


def solid_of(
    mesh: FleshMesh, history: GraspHistory, *, poisson_ratio: float = NU, support: str = "free"
) -> UnitModulusSolid:
    """The mesh factorised for one recording's contact."""
    return UnitModulusSolid.factorise(
        mesh, poisson_ratio=poisson_ratio, support=support, contact_nodes=contact_nodes(mesh, [history])
    )


@cache
def free_ball() -> UnitModulusSolid:
    """All recordings of `grasp` touch the same skin."""
    return solid_of(ball_mesh(), grasp())


@cache
def plain_model() -> GraspModel:
    """The model of a recording of `grasp` without its noise in the forces: good for every seed."""
    return grasp_model(grasp(noise=0.0), free_ball())


@cache
def own_model(noise: float = 1.0) -> GraspModel:
    """The model of the first recording of `grasp` with its own noise."""
    return grasp_model(grasp(noise=noise), free_ball())


def found_in(history: GraspHistory, model: GraspModel | None = None) -> ModulusEstimate:
    """The modulus of a recording on the ball."""
    return estimate_modulus(history, model or grasp_model(history, free_ball()), budget=BUDGET)


def own_sd_MPa(estimate: ModulusEstimate) -> float:
    """What one recording alone brings: noise, scale errors and misfit."""
    return float(np.hypot(estimate.parts_sd_MPa[TACTILE], estimate.parts_sd_MPa[MODEL]))


def with_pads(history: GraspHistory, **changes: object) -> GraspHistory:
    """The recording with something of every pad replaced: a value, or a function of the pad."""
    pads = tuple(
        replace(pad, **{name: value(pad) if callable(value) else value for name, value in changes.items()})
        for pad in history.pads
    )
    return replace(history, pads=pads)
