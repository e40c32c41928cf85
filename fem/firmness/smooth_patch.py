"""The skin where a flat tool first touches it, as a smooth surface."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

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
