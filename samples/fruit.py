"""Synthetic nectarines: a star-shaped skin, a true pit that deviates from its prior, a known modulus."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.triangle_mesh import Mesh
from samples.cubed_sphere import even_sphere

# Semi-axes of a nectarine's pit over the half-lengths of its fruit's box (x suture, y cheeks, z stem).
# Assumed, and equal to the prior of grading: samples test a pit that deviates from its prior by the spreads
# below, not an unknown kind of fruit.
PIT_OVER_BOX = (0.446, 0.328, 0.567)
PIT_RAISED = (0.010, 0.0, 0.022)
"""Offset of a nectarine's pit from the box centre in half-lengths of the box, as in the prior of grading."""
PIT_OFFSET_SD_MM = 0.3
"""Spread of a pit's centre about its prior, mm, each coordinate (assumed)."""
PIT_SIZE_SD = 0.02
"""Relative spread of each of a pit's half axes about its prior (assumed)."""
POISSON_RATIO = 0.45
"""True ratio of the flesh, which grading assumes too: samples test E, not Poisson's ratio."""
MESH_ERROR_MM = 0.1
"""Root mean square error of the scanned mesh, mm, as in meshes from photos (docs/validation.md, Shape: 0.06
to 0.16)."""


@dataclass(frozen=True, kw_only=True)
class Skin:
    """The surface x(d) = centre + r(d) d over unit directions d, fruit frame, mm.

    r = |d / half_axes|^-1 (1 + cubic form(d)) - stem cavity - blossom dimple - suture groove (on the +x
    half). The defaults give an ellipsoid about the origin.
    """

    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half_axes_mm: tuple[float, float, float]
    stem_depth_mm: float = 0.0
    stem_width: float = 0.3
    blossom_depth_mm: float = 0.0
    groove_depth_mm: float = 0.0
    groove_width: float = 0.1
    cubic: Float[np.ndarray, "3 3 3"] = field(default_factory=lambda: np.zeros((3, 3, 3)))

    def radius_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """r(d) in mm for unit directions."""
        d = directions
        ellipsoid = 1.0 / np.linalg.norm(d / np.asarray(self.half_axes_mm), axis=1)
        lopsided = 1.0 + np.einsum("ijk,ni,nj,nk->n", self.cubic, d, d, d)
        from_stem = np.arccos(np.clip(d[:, 2], -1.0, 1.0))
        stem = self.stem_depth_mm * np.exp(-((from_stem / self.stem_width) ** 2))
        blossom = self.blossom_depth_mm * np.exp(-(((np.pi - from_stem) / 0.35) ** 2))
        on_suture_side = 0.5 * (1.0 + np.tanh(4.0 * d[:, 0]))
        groove = self.groove_depth_mm * np.exp(-((d[:, 1] / self.groove_width) ** 2)) * on_suture_side
        return np.asarray(ellipsoid * lopsided - stem - blossom - groove)

    def points_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The skin's points in the fruit frame."""
        return np.asarray(np.asarray(self.centre_mm) + self.radius_mm(directions)[:, None] * directions)

    def as_mapping(self) -> dict[str, Any]:
        """Its numbers by name, for JSON."""
        return {**asdict(self), "cubic": self.cubic.tolist()}


@dataclass(frozen=True, kw_only=True)
class SamplePit:
    """An ellipsoid aligned with the fruit frame, mm."""

    centre_mm: tuple[float, float, float]
    semi_axes_mm: tuple[float, float, float]

    def points_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Surface points on rays from its centre."""
        radius = 1.0 / np.linalg.norm(directions / np.asarray(self.semi_axes_mm), axis=1)
        return np.asarray(np.asarray(self.centre_mm) + radius[:, None] * directions)


@dataclass(frozen=True, kw_only=True)
class SampleFruit:
    """One fruit with its true shape, pit and properties."""

    fruit_id: str
    seed: int = 0
    skin: Skin
    pit: SamplePit
    E_MPa: float
    poisson_ratio: float = POISSON_RATIO
    ripeness: float = 0.5


def fruits_of_seed(count: int, *, seed: int) -> tuple[SampleFruit, ...]:
    """`count` nectarines with moduli spread evenly in ln E over 0.15 to 1.6 MPa, in shuffled order.

    Ripeness (the colour) follows the modulus with some scatter, as it does in an orchard.
    """
    rng = np.random.default_rng([seed, 0])
    steps = (np.arange(count) + rng.uniform(0.25, 0.75, count)) / count
    E_MPa = 0.15 * (1.6 / 0.15) ** steps
    order = rng.permutation(count)
    while count > 2 and (np.all(np.diff(order) > 0) or np.all(np.diff(order) < 0)):
        order = rng.permutation(count)
    ripeness = np.clip(1.0 - steps + rng.normal(0.0, 0.05, count), 0.05, 0.97)
    return tuple(
        fruit_of_seed(
            f"N{k + 1:02d}", seed=1000 * seed + k + 1, E_MPa=float(E_MPa[i]), ripeness=float(ripeness[i])
        )
        for k, i in enumerate(order)
    )


def fruit_of_seed(fruit_id: str, *, seed: int, E_MPa: float, ripeness: float = 0.5) -> SampleFruit:
    """A nectarine of about 60 x 59 x 56 mm, the same for the same seed.

    Its pit deviates from the category's proportions by 0.3 mm per axis and 2 % in size (standard deviations).
    """
    rng = np.random.default_rng([seed, 1])
    size = rng.normal(1.0, 0.035)
    half = size * np.array([30.6, 29.6, 29.6]) * rng.normal(1.0, 0.012, 3)
    cubic = rng.normal(0.0, 0.006, (3, 3, 3))
    skin = Skin(
        half_axes_mm=triple(half),
        stem_depth_mm=float(rng.uniform(3.0, 4.2)),
        stem_width=float(rng.uniform(0.27, 0.33)),
        blossom_depth_mm=float(rng.uniform(0.5, 1.0)),
        groove_depth_mm=float(rng.uniform(0.6, 1.0)),
        groove_width=float(rng.uniform(0.10, 0.14)),
        cubic=cubic,
    )
    skin = on_its_base(skin)
    low, high = box_mm(skin)
    half_box = (high - low) / 2
    centre = (low + high) / 2 + np.array(PIT_RAISED) * half_box + rng.normal(0.0, PIT_OFFSET_SD_MM, 3)
    semi_axes = np.array(PIT_OVER_BOX) * half_box * rng.normal(1.0, PIT_SIZE_SD, 3)
    pit = SamplePit(centre_mm=triple(centre), semi_axes_mm=triple(semi_axes))
    return SampleFruit(fruit_id=fruit_id, seed=seed, skin=skin, pit=pit, E_MPa=E_MPa, ripeness=ripeness)


def box_mm(skin: Skin) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Lowest and highest corner of the skin's axis-aligned box."""
    points = skin.points_mm(even_sphere(96).directions)
    return points.min(axis=0), points.max(axis=0)


def skin_mesh(skin: Skin, *, cells: int) -> Mesh:
    """Vertices (mm) and the 12 cells^2 outward triangles of the skin."""
    sphere = even_sphere(cells)
    return skin.points_mm(sphere.directions), sphere.triangles()


def scanned_mesh(fruit: SampleFruit, *, cells: int, error_mm: float) -> Mesh:
    """The fruit's skin with a scanner's error; the same fruit gives the same mesh."""
    return scanned_skin(
        fruit.skin, cells=cells, error_mm=error_mm, rng=np.random.default_rng([fruit.seed, 2])
    )


def scanned_skin(skin: Skin, *, cells: int, error_mm: float, rng: np.random.Generator) -> Mesh:
    """The skin with a scanner's error: a smooth error along its rays with the given RMS."""
    sphere = even_sphere(cells)
    error = scan_error_mm(sphere.directions, error_mm=error_mm, rng=rng)
    return skin.points_mm(sphere.directions) + error, sphere.triangles()


def scan_error_mm(
    directions: Float[np.ndarray, "n 3"], *, error_mm: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """A scanner's error along rays in these directions (unit vectors): smooth, with the given RMS."""
    waves, phase = rng.normal(size=(24, 3)) * 5.0, rng.uniform(0, 2 * np.pi, 24)
    wobble = np.cos(directions @ waves.T + phase).sum(axis=1)
    wobble *= error_mm / np.sqrt(np.mean(wobble**2))
    return np.asarray(wobble[:, None] * directions)


def on_its_base(skin: Skin) -> Skin:
    """The skin moved so that its lowest point is at z = 0 and its box is centred on the z axis."""
    low, high = box_mm(skin)
    middle = (low + high) / 2
    return replace(skin, centre_mm=(float(-middle[0]), float(-middle[1]), float(-low[2])))


def triple(values: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    """A point or three sizes as Python's own numbers."""
    return float(values[0]), float(values[1]), float(values[2])
