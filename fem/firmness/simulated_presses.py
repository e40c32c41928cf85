"""A fruit between plates and under a small ball, simulated on its own mesh round its own pit, for E = 1 MPa.

The plates close on the narrowest width across the stem axis (z), as on two cheeks, without friction. The
fruit is kept from turning. The ball presses half way between a plate and the next cheek, away from the
suture, into a fruit that is held elsewhere.
Measured (benchmarks/results/firmness_readings.csv) on balls with pits of 0, 0.4 and 0.6 of the diameter,
squeezed by 0.25 to 5 % of it: the force is within 2.4 % of axisymmetric elements at small strain, from 1 % on
within 1.7 %, at 5 % within 0.8 %. With neo-Hookean flesh theirs differs at 5 % by -1, 1 and 5 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from fem.indentation.compressed_ellipsoid import LARGEST_PIT, Ellipsoid
from fem.mesh.closest_point import enclosed_volume_mm3
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.solid.closed_forms import hertz_sphere_force_N
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved
from fem.solid.unilateral_contact import pressures

LOOSE = 1e5
"""Between two tools the fruit may float: a spring this many times softer than a node holds it, and takes less
than 1e-4 of the force."""


@dataclass(frozen=True, kw_only=True)
class RigidTool:
    """A tool that advances against `towards` (unit vector, from the flesh to the tool).

    `nodes`: skin nodes that it may touch; `gap_mm`: how far each is from the tool at first touch.
    """

    nodes: Int[np.ndarray, " c"]
    towards: Float[np.ndarray, "3"]
    gap_mm: Float[np.ndarray, " c"]


def tool_force_N(
    solid: UnitModulusSolid, tools: Sequence[RigidTool], approach_mm: Float[np.ndarray, " f"]
) -> Float[np.ndarray, " f"]:
    """Force on the first tool at each approach from first touch, N per MPa of E; approaches ascend.

    Under tools that only push, the gap of every skin node is  w = g - d + n' C n p >= 0  with forces p >= 0
    and w p = 0. g is the initial gap, d the tool's advance, n the direction to the tool, and C the skin's
    compliance. The kinematics are exact for a flat plate; strain is small.

    One tool: the mean displacement of the flesh is zero (a free solid). Two: the approach is that of both
    together, and the fruit moves freely between them, without rotation.
    """
    nodes = np.unique(np.concatenate([tool.nodes for tool in tools]))
    compliance = replace(solid, contact_nodes=nodes).contact_compliance
    which = np.concatenate([np.full(len(tool.nodes), k) for k, tool in enumerate(tools)])
    at = np.searchsorted(nodes, np.concatenate([tool.nodes for tool in tools]))
    pushed = np.zeros((3 * len(nodes), len(at)))
    for axis in range(3):
        pushed[3 * at + axis, np.arange(len(at))] = np.stack([tool.towards for tool in tools])[which, axis]
    inward = pushed.T @ compliance @ pushed
    inward = (inward + inward.T) / 2
    if len(tools) > 1:
        along = pushed.reshape(-1, 3, len(at)).sum(axis=0).T @ tools[0].towards
        inward += LOOSE * np.trace(inward) / len(inward) * np.outer(along, along)
    gap = np.concatenate([tool.gap_mm for tool in tools])
    pressed = pressures(inward, gap - approach_mm[:, None] / len(tools))
    return np.asarray(pressed[:, which == 0].sum(axis=1))


DEGREE = 4
"""Of the polynomial. A sphere's cap as wide as its radius is met within 5e-4 of the radius."""
POWERS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
"""Exponents of the polynomial's terms."""
FEWEST = 12
"""Vertices that a patch is fitted to at least: twice the terms of degree two."""


@dataclass(frozen=True, kw_only=True)
class SmoothPatch:
    """Height over the plane that touches the fruit in the direction `out`, at places near `centre_mm`.

    A mesh's facets cut corners of a few hundredths of a millimetre, which is much of the first approach. The
    polynomial through the vertices goes between them as the skin does.
    """

    centre_mm: Float[np.ndarray, "3"]
    frame: Float[np.ndarray, "3 3"]
    """Rows: two directions along the skin, and out of it."""
    radius_mm: float
    coefficients: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls, vertices_mm: Float[np.ndarray, "v 3"], out: Float[np.ndarray, "3"], *, radius_mm: float
    ) -> "SmoothPatch":
        """The patch within `radius_mm` of the outermost vertex, or as far as FEWEST vertices reach; of degree
        two where there are less than twice as many vertices as terms.
        """
        centre = vertices_mm[np.argmax(vertices_mm @ out)]
        across = np.cross(out, np.eye(3)[np.abs(out).argmin()])
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(out, across), out])
        place = (vertices_mm - centre) @ frame.T
        away = np.linalg.norm(place, axis=1)
        radius_mm = max(radius_mm, float(np.sort(away)[min(FEWEST, len(away)) - 1]))
        near = (np.hypot(place[:, 0], place[:, 1]) <= radius_mm) & (place[:, 2] > -radius_mm)
        terms, height = _terms(place[near, :2] / radius_mm), place[near, 2]
        degree = DEGREE if near.sum() >= 2 * len(POWERS) else 2
        used = [k for k, (i, j) in enumerate(POWERS) if i + j <= degree]
        coefficients = np.zeros(len(POWERS))
        coefficients[used] = np.linalg.lstsq(terms[:, used], height)[0]
        return cls(centre_mm=centre, frame=frame, radius_mm=radius_mm, coefficients=coefficients)

    def lateral_mm(self, points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Along the skin (two) and out of it, from the centre."""
        return np.asarray((points_mm - self.centre_mm) @ self.frame.T)

    def near(self, points_mm: Float[np.ndarray, "p 3"], within_mm: float) -> np.ndarray:
        """Which points of the skin are so near to the centre, measured along the plane."""
        place = self.lateral_mm(points_mm)
        return np.asarray((np.hypot(place[:, 0], place[:, 1]) < within_mm) & (place[:, 2] > -self.radius_mm))

    def height_mm(self, points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
        """Of the smooth skin over the plane, at the points' lateral places."""
        return np.asarray(_terms(self.lateral_mm(points_mm)[:, :2] / self.radius_mm) @ self.coefficients)

    def lattice_mm(self, within_mm: float, spacing_mm: float) -> Float[np.ndarray, "q 3"]:
        """Points on the skin, about `spacing_mm` apart, up to `within_mm` from the centre."""
        count = int(within_mm / spacing_mm)
        line = np.arange(-count, count + 1) * spacing_mm
        flat = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        flat = flat[np.hypot(*flat.T) <= within_mm]
        out = _terms(flat / self.radius_mm) @ self.coefficients
        return np.asarray(self.centre_mm + np.column_stack([flat, out]) @ self.frame)


def _terms(flat: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p k"]:
    return np.stack([flat[:, 0] ** i * flat[:, 1] ** j for i, j in POWERS], axis=1)


BALL_MM = 2.5
"""Radius of the ball."""
SQUEEZES = np.array([0.0025, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.07, 0.1])
"""Approaches of the plates over the diameter between them."""
DEPTHS = np.array([0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0])
"""Of the ball over its radius."""
TOUCHED = 0.45
"""Of the fruit's radius: skin within it of the axis may touch a plate."""
METHOD_SD = 0.017
"""Relative standard deviation of the force by elements and smooth skin: the largest difference above from a
squeeze of 1 % on."""
FIRST_SD = 0.017
"""What elements, coarse for so small a contact, add at the first of SQUEEZES: with METHOD_SD the largest
difference above. It goes as one over the squeeze."""
WAVY = 0.3
"""Of the skin's error, what has waves as short as a contact; the rest shifts or scales it. Set by hand:
plates read within 2 % on the sample nectarines, whose skin is from photos (0.17 to 0.20 mm). The error
is too small at 5 %: on balls with waves of 14 to 24 mm the forces scatter by 1 to 1.5 times it. At 2 % they
scatter by half of it."""
DOF_LIMIT = 45_000
"""Of the mesh. With 60,000 the force changes by at most 0.4 % from a squeeze of 1 % on, in twice the time."""

_Surface = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class PressCurve:
    """Force per modulus (N/MPa) against depth (mm) from samples; none beyond the deepest."""

    depth_mm: Float[np.ndarray, " f"]
    sampled_N_per_MPa: Float[np.ndarray, " f"]

    @cached_property
    def _over_hertz(self) -> CubicSpline:
        """Force over depth^(3/2), smooth in the root of depth."""
        return CubicSpline(np.sqrt(self.depth_mm), self.sampled_N_per_MPa / self.depth_mm**1.5)

    def force_N_per_MPa(self, depth_mm: float) -> float:
        """phi(d); NaN beyond the deepest sample. Below the first it goes on as Hertz's."""
        if not depth_mm <= self.depth_mm[-1]:
            return float("nan")
        return float(self._over_hertz(np.sqrt(max(depth_mm, self.depth_mm[0]))) * max(depth_mm, 0.0) ** 1.5)


@dataclass(frozen=True, kw_only=True)
class FruitPresses:
    """Both curves of one fruit. `diameters_mm`: between the plates, across them, and along the stem.

    `surface_sd_mm`: error of the skin's place under a plate.
    """

    plates: PressCurve
    ball: PressCurve
    diameters_mm: tuple[float, float, float]
    pit_share: float
    surface_sd_mm: float = 0.0

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Of curvature under the plates, from the three diameters."""
        return Ellipsoid(diameters_mm=self.diameters_mm, axis=0, pit_share=0.0).radii_mm

    def plates_sd(self, depth_mm: float) -> float:
        """Relative standard deviation of the plates' force by the method.

        Elements (METHOD_SD, FIRST_SD), large deformation (1 % and, with a pit, 0.9 s (share/0.6)^3 at a
        squeeze s), and the skin: force goes with the root of the curvature's radius, which an error of the
        skin changes by its share of the approach d/2 at either contact. That makes WAVY sd / (2 sqrt(2)
        (d/2)).
        """
        squeeze = depth_mm / self.diameters_mm[0]
        pit = 0.9 * squeeze * (self.pit_share / 0.6) ** 3
        first = FIRST_SD * SQUEEZES[0] / squeeze
        skin = WAVY * self.surface_sd_mm / (np.sqrt(2) * depth_mm)
        return float(np.linalg.norm([METHOD_SD, first, 0.01 + pit, skin]))

    def ball_sd(self, depth_mm: float) -> float:
        """The same of the ball's force. A paraboloid at small strain stands for a sphere at large ones: that
        is off by some 10 % of the force where the depth is the radius (Du et al., "Nonlinear indentation of
        second-order hyperelastic materials", arXiv 2209.05646, 2022), and less in proportion before.
        """
        return float(np.hypot(METHOD_SD, 0.1 * depth_mm / BALL_MM))


def simulated_presses(
    fruit: _Surface,
    pit: _Surface | None,
    *,
    poisson_ratio: float,
    poisson_ratio_sd: float,
    pit_size_sd: float,
    surface_sd_mm: float = 0.0,
) -> tuple[FruitPresses, ...]:
    """The fruit's presses; then with Poisson's ratio, and with its pit, one standard deviation larger.

    z is the stem axis. Those without a standard deviation are left out. Raises FemFailure as tetrahedralise,
    UnitModulusSolid and Ellipsoid do.
    """
    places = _places(fruit[0])
    mesh = _mesh(fruit, pit, places)
    fruit_mm3 = enclosed_volume_mm3(*fruit)
    share = 0.0 if pit is None else (enclosed_volume_mm3(*pit) / fruit_mm3) ** (1 / 3)
    varied = [(mesh, poisson_ratio)]
    if poisson_ratio_sd > 0:
        varied.append((mesh, min(poisson_ratio + poisson_ratio_sd, 0.499)))
    if pit is not None and pit_size_sd > 0:
        varied.append((with_pit_moved(mesh, np.array([0, 0, 0, np.log1p(pit_size_sd)])), poisson_ratio))
    presses = []
    for flesh, nu in varied:
        solid = UnitModulusSolid.factorise(flesh, poisson_ratio=nu, support="free")
        plates, ball = _curves(solid, places)
        presses.append(
            FruitPresses(
                plates=plates,
                ball=ball,
                diameters_mm=places.diameters_mm,
                pit_share=share,
                surface_sd_mm=surface_sd_mm,
            )
        )
    _ = presses[0].radii_mm  # refuses what is no fruit
    return tuple(presses)


def spheroid_presses(
    diameters_mm: tuple[float, float, float], *, pit_share: float, poisson_ratio: float
) -> FruitPresses:
    """Of an ellipsoid squeezed along its first diameter, from the table of spheroids and Hertz's formula: no
    mesh, and no pit under the ball.
    """
    shape = Ellipsoid(diameters_mm=diameters_mm, axis=0, pit_share=min(pit_share, LARGEST_PIT))
    depth = SQUEEZES * diameters_mm[0]
    force = shape.curve(thickness_mm=None, poisson_ratio=poisson_ratio).force_N_per_MPa(depth)
    radius = 1 / (1 / BALL_MM + 2 / float(np.mean(diameters_mm)))
    under_ball = [
        hertz_sphere_force_N(
            E_MPa=1.0, poisson_ratio=poisson_ratio, radius_mm=radius, indentation_mm=float(d)
        )
        for d in DEPTHS * BALL_MM
    ]
    return FruitPresses(
        plates=PressCurve(depth_mm=depth, sampled_N_per_MPa=force),
        ball=PressCurve(depth_mm=DEPTHS * BALL_MM, sampled_N_per_MPa=np.array(under_ball)),
        diameters_mm=diameters_mm,
        pit_share=pit_share,
    )


@dataclass(frozen=True, kw_only=True)
class _Places:
    plates: tuple[SmoothPatch, SmoothPatch]
    ball: SmoothPatch
    diameters_mm: tuple[float, float, float]

    @property
    def radius_mm(self) -> float:
        return self.diameters_mm[0] / 2


def _places(vertices_mm: Float[np.ndarray, "v 3"]) -> _Places:
    """Where the tools touch."""
    turn = np.radians(np.arange(180))
    level = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(180)])
    width = np.ptp(vertices_mm @ level.T, axis=0)
    k = int(width.argmin())
    radius = float(width[k]) / 2
    wide = TOUCHED * radius
    plates = [SmoothPatch.of(vertices_mm, way * level[k], radius_mm=wide) for way in (1, -1)]
    ball = SmoothPatch.of(vertices_mm, level[(k + 45) % 180], radius_mm=min(2.4 * BALL_MM, radius))
    return _Places(
        plates=(plates[0], plates[1]),
        ball=ball,
        diameters_mm=(float(width[k]), float(width[(k + 90) % 180]), float(np.ptp(vertices_mm[:, 2]))),
    )


def _mesh(fruit: _Surface, pit: _Surface | None, places: _Places) -> FleshMesh:
    """Elements an eighth to a quarter as long as the contact at 5 % is wide, and a sixth of the ball."""
    half_width = places.radius_mm * np.sqrt(0.05)
    points, edges = [], []
    for patch, within, edge in (
        *((patch, half_width, half_width / 4) for patch in places.plates),
        *((patch, half_width / 2, half_width / 7) for patch in places.plates),
        (places.ball, 0.6 * BALL_MM, 0.16 * BALL_MM),
    ):
        lattice = patch.lattice_mm(within, edge)
        points.append(lattice)
        edges.append(np.full(len(lattice), edge))
    edge_mm = np.concatenate(edges)
    return tetrahedralise(
        *fruit,
        *((None, None) if pit is None else pit),
        edge_mm=np.inf,
        refine_at_mm=np.concatenate(points),
        refine_radius_mm=0.6 * edge_mm,
        refine_edge_mm=edge_mm,
        dof_limit=DOF_LIMIT,
    )


def _curves(solid: UnitModulusSolid, places: _Places) -> tuple[PressCurve, PressCurve]:
    skin = solid.mesh.outer_nodes
    skin_mm = solid.mesh.nodes_mm[skin]

    def tool(patch: SmoothPatch, within_mm: float, curvature_per_mm: float) -> RigidTool:
        def apart_mm(points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
            off = patch.lateral_mm(points_mm)[:, :2]
            return np.asarray(curvature_per_mm * (off**2).sum(axis=1) / 2 - patch.height_mm(points_mm))

        near = patch.near(skin_mm, within_mm)
        first = apart_mm(patch.lattice_mm(patch.radius_mm / 2, patch.radius_mm / 100)).min()
        return RigidTool(nodes=skin[near], towards=patch.frame[2], gap_mm=apart_mm(skin_mm[near]) - first)

    approach, depth = SQUEEZES * places.diameters_mm[0], DEPTHS * BALL_MM
    plates = [tool(patch, TOUCHED * places.radius_mm, 0.0) for patch in places.plates]
    ball = tool(places.ball, 1.3 * BALL_MM, 1 / BALL_MM)
    return (
        PressCurve(depth_mm=approach, sampled_N_per_MPa=tool_force_N(solid, plates, approach)),
        PressCurve(depth_mm=depth, sampled_N_per_MPa=tool_force_N(solid, [ball], depth)),
    )
