"""The fruit frame, and the orientation by shape: stem from its hollow, suture from its groove.

Fruit frame: stem end up z, suture to +x, origin under the middle on the support plane.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from recon.cameras.similarity import affine
from recon.silhouettes.hull import ball
from recon.surface.ray_mesh import RayMesh
from recon.triangle_mesh import Faces, Vertices

SURE = 0.5
"""Confidence above which an orientation by shape contradicts the convention. Set by hand."""
MOST_TILT_DEG = 15.0
"""Largest tilt of the stem without a warning, degrees: fruit do not stand straight. Set by hand."""
MOST_TURN_DEG = 20.0
"""Largest angle of the suture to the arrow without a warning, degrees: people align by eye. Set by hand."""


def to_fruit_frame(vertices: Vertices) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "4 4"]]:
    """The vertices of a mesh photographed upright, in its fruit frame, and `fruit_from_mesh`.

    The origin goes to the centre of the mesh's box in x and y and to its lowest point in z.

    >>> to_fruit_frame(np.array([[1.0, 2.0, 3.0], [3.0, 6.0, 4.0]]))[0].tolist()
    [[-1.0, -2.0, 0.0], [1.0, 2.0, 1.0]]
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return vertices + shift, affine(np.eye(3), shift)


WIDTHS = (0.2, 0.28, 0.36, 0.45)
"""Widths of stem hollows, as angles (rad) from the fruit's centre. Set by hand."""
GROOVE_WIDTHS = (0.08, 0.11, 0.15)
"""Widths of sutures, as angles (rad) about the stem axis. Set by hand."""
LEVEL = 4
"""Subdivisions of an icosahedron on which the radius is taken: 2562 directions, 4 degrees apart."""
CAPS = 3
"""Subdivisions for the tried directions of the stem: 642, 8 degrees apart."""
SMOOTH_DEGREE = 4
"""Degree of the polynomials that describe a fruit without hollow: lopsided, and no sharper. Set by hand."""
SMOOTH_TURNS = 4
"""Highest harmonic round the stem that describes a fruit without groove."""
LEAST_HOLLOW = 0.02
"""Reference depth of a stem hollow over the fruit's radius (`_prominence`). Set by hand."""
LEAST_GROOVE = 0.006
"""Reference depth of a suture over the fruit's radius."""
BAND_DEG = (50.0, 115.0)
"""Polar angles from the stem to search a suture, clear of the stem's hollow and of the blossom end."""
APART_DEG = 40.0
"""Angle, degrees, within which two candidates are the same hollow or groove."""


@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Stem axis and suture by shape, unit vectors in the mesh's own axes.

    A confidence is (1 - second best / best) times a factor that rises from 0 to 1 with the depth of the best
    hollow or groove. The suture's is also multiplied by the stem's. It is a rule, not a probability.
    `hollow_mm` and `groove_mm` are depths below the smooth surface; the groove's is the mean along it.
    """

    stem: Float[np.ndarray, "3"]
    stem_confidence: float
    hollow_mm: float
    suture: Float[np.ndarray, "3"]
    suture_confidence: float
    groove_mm: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the shape's stem axis and z."""
        return float(np.degrees(np.arccos(np.clip(self.stem[2], -1, 1))))

    @property
    def turn_deg(self) -> float:
        """Azimuth of the groove, from +x towards +y."""
        return float(np.degrees(np.arctan2(self.suture[1], self.suture[0])))


def orientation_of(vertices: Vertices, faces: Faces) -> Orientation:
    """Stem axis and suture of a closed fruit mesh in any pose.

    r(d) is the surface's distance from the centre of volume in direction d. At the stem a round hollow a
    exp(-(angle/w)²), w = 0.2 to 0.45, explains most of r's deviation from a smooth surface. That is a
    polynomial of degree 4, robust against hollows. The suture is the meridian on which r, less its harmonics
    up to 4 around the axis, dips most. Its depth is a trimmed mean from 50 to 115 degrees off the stem. A
    blossom end deeper than the stem's hollow is mistaken for it.
    """
    centre = volume_centre(vertices, faces)
    directions, _ = ball(LEVEL)
    skin = RayMesh(vertices, faces)
    radius = _radii(skin, centre, directions)
    size = float(np.median(radius))
    hollow = _smooth(directions, radius) - radius
    tried, _ = ball(CAPS)
    depth, gain = _caps(tried, directions, hollow)
    best = int(np.argmax(gain))
    stem = _refined_axis(tried[best], directions, hollow)
    depth_mm = float(depth[best])
    away = tried @ stem < np.cos(np.radians(APART_DEG))
    stem_confidence = _prominence(
        np.sqrt(gain[best]), np.sqrt(gain[away].max(initial=0.0)), depth_mm / size / LEAST_HOLLOW
    )
    suture, groove, other = _groove(skin, centre, stem)
    return Orientation(
        stem=stem,
        stem_confidence=stem_confidence,
        hollow_mm=depth_mm,
        suture=suture,
        suture_confidence=stem_confidence * _prominence(groove, other, groove / size / LEAST_GROOVE),
        groove_mm=groove,
    )


def volume_centre(vertices: Vertices, faces: Faces) -> Float[np.ndarray, "3"]:
    """Centre of volume of a closed mesh."""
    return np.asarray(trimesh.triangles.mass_properties(vertices[faces], skip_inertia=True)["center_mass"])


def _prominence(best: float, second: float, over: float) -> float:
    """(1 - second / best)(1 - exp(-over²)): 0.63 of the lead counts at the reference depth (`over` = 1)."""
    if not best > 0:
        return 0.0
    return float((1 - min(max(second, 0.0) / best, 1.0)) * (1 - np.exp(-(max(over, 0.0) ** 2))))


def _radii(
    skin: RayMesh, centre: Float[np.ndarray, "3"], directions: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Distance of the surface from the centre in each direction."""
    radius, _, _ = skin.met(np.broadcast_to(centre, directions.shape), directions)
    return np.where(np.isfinite(radius), radius, np.median(radius))


def _smooth(directions: Float[np.ndarray, "k 3"], radius: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The polynomial of degree 4 in the direction by least squares, reweighted to ignore hollows."""
    x, y, z = directions.T
    powers = [
        (i, j, n - i - j)
        for n in (SMOOTH_DEGREE - 1, SMOOTH_DEGREE)
        for i in range(n + 1)
        for j in range(n + 1 - i)
    ]
    columns = np.stack([x**i * y**j * z**k for i, j, k in powers], axis=1)
    weight = np.ones(len(radius))
    for _ in range(6):
        fit = columns @ np.linalg.lstsq(columns * weight[:, None], radius * weight, rcond=None)[0]
        off = fit - radius
        scale = 1.5 * float(np.median(np.abs(off))) + 1e-9
        weight = 1 / (1 + np.maximum(off, 0) ** 2 / scale**2)
    return np.asarray(fit)


def _caps(
    centres: Float[np.ndarray, "c 3"], directions: Float[np.ndarray, "k 3"], hollow: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Depth of the best round hollow about each centre, and the sum of squares that it explains."""
    angle = np.arccos(np.clip(centres @ directions.T, -1, 1))
    depth, gain = np.zeros(len(centres)), np.zeros(len(centres))
    for width in WIDTHS:
        near = angle < 2.5 * width
        bell = np.zeros(angle.shape)
        bell[near] = np.exp(-((angle[near] / width) ** 2))
        count = near.sum(1)
        mean = bell.sum(1) / count
        square = (bell**2).sum(1) - count * mean**2
        depth_here = (bell @ hollow - mean * (near @ hollow)) / square
        explained = np.where(depth_here > 0, depth_here**2 * square, 0.0)
        better = explained > gain
        depth, gain = np.where(better, depth_here, depth), np.where(better, explained, gain)
    return depth, gain


def _refined_axis(
    start: Float[np.ndarray, "3"], directions: Float[np.ndarray, "k 3"], hollow: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "3"]:
    """The centre of the hollow near `start`, searched on ever finer 3 x 3 grids about it."""
    best, step = start, 0.08
    while step > 0.004:
        side, up = _across(best)
        tried = np.stack([best + step * (a * side + b * up) for a in (-1, 0, 1) for b in (-1, 0, 1)])
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        gain = _caps(tried, directions, hollow)[1]
        if np.argmax(gain) == 4:
            step /= 2
        best = tried[int(np.argmax(gain))]
    return np.asarray(best)


def _across(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit vectors at right angles to an axis and to each other."""
    side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.7 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def _groove(
    skin: RayMesh, centre: Float[np.ndarray, "3"], stem: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], float, float]:
    """Direction and depth of the deepest meridian groove, and depth of the next, over APART_DEG away."""
    side, up = _across(stem)
    polar = np.radians(np.linspace(*BAND_DEG, 27))
    turn = np.radians(np.arange(360.0))
    equator = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
    directions = np.cos(polar)[:, None, None] * stem + np.sin(polar)[:, None, None] * equator
    radius = _radii(skin, centre, directions.reshape(-1, 3)).reshape(len(polar), len(turn))
    harmonics = [np.ones(len(turn))]
    harmonics += [f(m * turn) for m in range(1, SMOOTH_TURNS + 1) for f in (np.cos, np.sin)]
    columns = np.stack(harmonics, axis=1)
    hollow = radius @ (columns @ np.linalg.pinv(columns)).T - radius
    depth = np.zeros(len(turn))
    for width in GROOVE_WIDTHS:
        bell = np.exp(-((np.sin(turn) / width) ** 2)) * (np.cos(turn) > 0)
        wide = (np.abs(np.angle(np.exp(1j * turn))) < 3 * width).astype(float)
        bell = bell - wide * bell.sum() / wide.sum()
        around = np.fft.ifft(np.fft.fft(hollow, axis=1) * np.conj(np.fft.fft(bell))).real / np.sum(bell**2)
        depth = np.maximum(depth, np.mean(np.sort(around, axis=0)[3:-3], axis=0))
    best = int(np.argmax(depth))
    away = np.abs(np.angle(np.exp(1j * (turn - turn[best])))) > np.radians(APART_DEG)
    return equator[best], float(depth[best]), float(depth[away].max())


def orientation_warnings(orientation: Orientation) -> tuple[str, ...]:
    """Warnings if the shape of the mesh, in the fruit frame, contradicts the convention of placement.

    The frame stays as placed, because the recordings' poses refer to it.
    """
    out = []
    if orientation.stem_confidence >= SURE and orientation.tilt_deg > MOST_TILT_DEG:
        out.append(
            f"The stem axis appears tilted by {orientation.tilt_deg:.0f} degrees (a hollow "
            f"{orientation.hollow_mm:.1f} mm deep; confidence {orientation.stem_confidence:.2f}), but "
            "drupe placed the pit for an upright fruit. Set the fruit upright, photograph and grasp "
            "it again, or give its pit as pit.ply."
        )
    elif orientation.suture_confidence >= SURE and abs(orientation.turn_deg) > MOST_TURN_DEG:
        side = "left" if orientation.turn_deg > 0 else "right"
        out.append(
            f"The suture appears turned by {abs(orientation.turn_deg):.0f} degrees to the {side} of "
            f"the mat's arrow, or of +x (a groove {orientation.groove_mm:.1f} mm deep; confidence "
            f"{orientation.suture_confidence:.2f}). drupe placed the pit for a suture along the "
            "arrow. Turn the fruit, photograph and grasp it again, or give its pit as pit.ply."
        )
    return tuple(out)
