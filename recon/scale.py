"""Where size comes from (mat, height or coin), the box in which a fruit may stand, and how much too tall a
fruit comes out that no photo shows from the side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from recon.cameras.camera import Camera
from recon.cameras.coin import Coin, coin_scale
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import affine
from recon.picture_values import Pictures
from recon.recon_failure import ReconFailure
from recon.silhouettes.all_views import FIT_LEVEL, OUTLIER_SHARE
from recon.silhouettes.hull import Silhouette, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import SAMPLES, Outline, silhouette_of_outline
from recon.silhouettes.tangent import fitted_to_outlines
from recon.triangle_mesh import Vertices

WAVE = 8
"""Standard deviation of the filter that correlates the errors of an outline's samples, in samples."""
MARGIN_PX = 16
"""px about an outline: enough for its errors."""
NOISE_PX, SEED = 0.5, 1
"""Standard deviation of the outlines: exact ones outweigh bending and leave a ball at 45 degrees a cone."""
NO_CONE = 0.02
"""Excess of a hull under which the fitted surface's is under 0.2 %, and not worked out."""
SHOULDER, SHOULDER_TO_DEG, SHOULDER_SD = 0.06, 25.0, 0.45
"""Size of the shoulder's term, where it ends, and its relative standard deviation: below."""
FIT_SD = 0.5
"""Stone fruits that stand with the stem cavity up come out taller than ellipsoids by SHOULDER (a / c)² tan e,
e up to 25 degrees. The relative standard deviations of that and of the excess."""
SIDEWAYS_DEG = 25.0
"""Below, nothing is taken off: an egg and a nectarine, seen from 15 and 18 degrees, come out right so. Fruits
with a cavity are 0.4 to 3.1 % too tall there (21 meshes), 0.8 to 1.9 times the shoulder's term, which is the
sd."""
TOP_SHARE = 0.1
"""Of the height, what counts as the top of which relief may tell."""


@dataclass(frozen=True, kw_only=True)
class TopExcess:
    """How much taller than the fruit its mesh is expected to be, relative, and its standard deviation."""

    value: float
    sd: float

    def remaining(self, measured: float) -> "TopExcess":
        """What is left where a share of the top was measured: its summit is among them with that probability.

        Mean and variance of a mixture: of this excess with probability p = 1 - measured, and of none.
        """
        p = 1.0 - measured
        return TopExcess(
            value=p * self.value, sd=float(np.sqrt(p * self.sd**2 + p * measured * self.value**2))
        )


def top_share(vertices: Vertices, measured: Bool[np.ndarray, " n"]) -> float:
    """The share of the top's vertices (the upper tenth of the height) that were measured."""
    z = vertices[:, 2]
    return float(measured[z >= z.max() - TOP_SHARE * np.ptp(z)].mean())


def expected_excess(
    cameras: Sequence[Camera], box: Float[np.ndarray, "3"], elevation_rad: float
) -> TopExcess:
    """The excess of a mesh of size `box` that stands on z = 0 at x = y = 0, seen by these cameras.

    value = settled_excess of an ellipsoid + SHOULDER (a / c)² tan(min(e, 25 degrees)), c half the height and
    a the mean of the other semi-axes; `elevation_rad`: e, at which the lowest photo looks down on the top.
    The mesh's own height is taken to count half of the hull's excess too much. Below SIDEWAYS_DEG the value
    is 0, with the shoulder's term as standard deviation.
    """
    hull = hull_excess(box / 2, elevation_rad)
    sideways = elevation_rad < np.radians(SIDEWAYS_DEG)
    cone = 0.0
    if hull > NO_CONE and not sideways:
        cone = max(fitted_excess(cameras, box / [1.0, 1.0, 1.0 + hull / 2]), 0.0)
    down = min(max(elevation_rad, 0.0), float(np.radians(SHOULDER_TO_DEG)))
    wide = float(box[0] + box[1]) / (2 * float(box[2]) / (1 + hull / 2))
    shoulder = SHOULDER * wide**2 * float(np.tan(down))
    if sideways:
        return TopExcess(value=0.0, sd=shoulder)
    return TopExcess(value=cone + shoulder, sd=float(np.hypot(FIT_SD * cone, SHOULDER_SD * shoulder)))


def hull_excess(semi: Float[np.ndarray, "3"], elevation_rad: float) -> float:
    """How much taller than the ellipsoid its hull is where photos look down on its top at `elevation_rad`.

    The tangent plane that falls by the elevation meets the axis at sqrt(c² + a² tan²) over the middle:
    excess = (sqrt(1 + (a / c)² tan² e) - 1) / 2 of the height 2 c, a the mean of the other semi-axes.

    >>> round(hull_excess(np.ones(3), np.radians(30.0)), 3)
    0.077
    """
    wide = (semi[0] + semi[1]) / (2 * semi[2])
    return float(np.sqrt(1 + (wide * np.tan(max(elevation_rad, 0.0))) ** 2) - 1) / 2


def fitted_excess(cameras: Sequence[Camera], box: Float[np.ndarray, "3"]) -> float:
    """How much taller than itself an ellipsoid comes out from its own outlines in these photos, relative.

    `box`: its axes along x, y and z; it stands on z = 0 at x = y = 0. Its outlines are conics (Hartley and
    Zisserman 2004, 8.3) with waves of NOISE_PX; hull and fitted surface are those that a fruit gets.
    """
    rng = np.random.default_rng(SEED)
    factor = 60.0 / float(box[2])  # the hull's precision is absolute
    semi = factor * box / 2
    centre = np.array([0.0, 0.0, semi[2]])
    larger = np.diag([factor, factor, factor, 1.0])
    waves = gaussian_filter1d(rng.normal(size=(len(cameras), SAMPLES)), WAVE, axis=1, mode="wrap")
    waves *= NOISE_PX / waves.std()
    seen = [_outline(c.moved(larger), semi, centre, wave) for c, wave in zip(cameras, waves, strict=True)]
    rough, faces = visual_hull(
        seen,
        centre_mm=centre,
        longest_mm=4 * float(semi.max()),
        floor_mm=0.0,
        level=FIT_LEVEL,
        outlier_share=OUTLIER_SHARE,
    )
    surface = fitted_to_outlines(rough, faces, seen).vertices
    return float(np.ptp(surface[:, 2]) / (2 * semi[2])) - 1


def _outline(
    camera: Camera,
    semi: Float[np.ndarray, "3"],
    centre: Float[np.ndarray, "3"],
    wave_px: Float[np.ndarray, " n"],
) -> Silhouette:
    """The ellipsoid's outline, whether or not it leaves the picture."""
    T = affine(np.eye(3), centre)
    P = camera.intrinsics @ camera.cam_from_world[:3]
    conic = np.linalg.inv(P @ T @ np.diag([*semi**2, -1.0]) @ T.T @ P.T)
    middle = -np.linalg.solve(conic[:2, :2], conic[:2, 2])
    w, V = np.linalg.eigh(conic[:2, :2] / -(conic[2, 2] + conic[:2, 2] @ middle))
    turn = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    round_ = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = middle + round_ / np.sqrt(w) @ V.T
    normals = round_ * np.sqrt(w) @ V.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = points + wave_px[:, None] * normals
    corner = np.floor(points.min(0)).astype(int) - MARGIN_PX
    columns, rows = np.ceil(points.max(0)).astype(int) + MARGIN_PX - corner
    window = Window(np.zeros((rows, columns, 3), np.uint8), (int(corner[0]), int(corner[1])), 1)
    return silhouette_of_outline(Outline(points - corner, normals, 1.0), window, replace(camera, k1=0.0))


PRINT_SCALE_SD = 0.001
"""Relative error of a mat's print that was measured: 0.1 mm of its bar of 100 (assumed)."""
UNSURE = 0.005
"""Relative error of the scale that is said: 0.15 mm at the skin of a fruit of 60 mm."""
APART_SD = 3.0
"""Standard deviations by which coin and height may differ unsaid."""
NEAREST_COIN, FARTHEST_COIN = 0.12, 0.3
"""How far from the height's scale the coin is sought, at least and at most (beyond, its rings are met)."""
Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def blank_box(mat: Mat) -> Box:
    """The space over the mat's blank centre, with room for a fruit that overhangs it."""
    inner = min(float(np.abs(corners[:, :2]).max(1).min()) for corners in mat.corners_mm.values())
    half = max(inner, 0.12 * mat.width_mm)
    return box_about_z(1.45 * half, 2.7 * half)


def box_about_z(half: float, high: float) -> Box:
    """The box within `half` of the z axis in x and y, from the ground up to `high`."""
    return np.array([-half, -half, 0.0]), np.array([half, half, high])


@dataclass(frozen=True, kw_only=True)
class Scale:
    """The factor that takes a mesh made without a mat to mm, its relative standard deviation, and doubts."""

    factor: float
    sd: float
    warnings: tuple[str, ...] = ()


def scale_without_mat(
    vertices: Vertices,
    images: Pictures,
    cameras: Sequence[Camera],
    *,
    height_mm: float,
    height_sd_mm: float,
    surface_sd: float,
    coin: Coin | None,
    top_measured: float = 0.0,
) -> Scale:
    """Scale from the height of the fruit, or from a coin beside it, which the height then checks.

    A mesh whose top no photo shows from the side is taken to be height_mm (1 + excess) tall, with the
    expected excess of the share of the top that relief has not measured (1 - `top_measured`). The height's
    error is the caliper's, that of two mesh ends (`surface_sd`, in the mesh's unit), and the excess's. A coin
    is sought within three of these; without one the height counts, with a warning.
    """
    low, high = vertices.min(0), vertices.max(0)
    tall = float(high[2] - low[2])
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    away = np.array([c.place for c in cameras]) - [*middle[:2], high[2]]
    lowest = float(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1)).min())
    centred = [c.moved(affine(np.eye(3), -middle)) for c in cameras]
    excess = expected_excess(centred, high - low, lowest).remaining(top_measured)
    factor = height_mm * (1 + excess.value) / tall
    ends_sd = np.hypot(height_sd_mm, np.sqrt(2) * surface_sd * factor) / height_mm
    by_height = float(np.hypot(ends_sd, excess.sd))
    look = (
        f"The lowest photo looks down on the fruit's top at {np.degrees(lowest):.0f} degrees, so the "
        f"mesh may be {100 * excess.value:.1f} % too tall there. The scale includes this error and "
        f"has a standard deviation of {100 * by_height:.1f} %. Take some photos from just above the "
        "table, or use a coin ([photos] coin)."
    )
    unsure = (look,) if excess.sd > UNSURE else ()
    if coin is None:
        return Scale(factor=factor, sd=by_height, warnings=unsure)
    spread = float(np.clip(APART_SD * by_height, NEAREST_COIN, FARTHEST_COIN))
    try:
        by_coin = coin_scale(images, cameras, coin, unit_mm=factor, spread=spread)
    except ReconFailure as failure:
        not_found = f"{failure.detail.rstrip('.')}; the scale comes from height_mm."
        return Scale(factor=factor, sd=by_height, warnings=(not_found, *unsure))
    apart, said = by_coin.factor / factor - 1, ""
    if abs(apart) > APART_SD * np.hypot(by_coin.sd, by_height):
        said = (
            f"The coin ({coin.name}, {coin.diameter_mm:g} mm) gives a height of "
            f"{height_mm * (1 + apart):.1f} mm, but height_mm is {height_mm:g} mm. The difference of "
            f"{100 * apart:+.1f} % exceeds their errors ({100 * by_coin.sd:.1f} and "
            f"{100 * by_height:.1f} %). drupe uses the coin; measure the height again, and check the "
            "coin's type."
        )
    elif abs(by_coin.factor * tall / height_mm - 1) > APART_SD * by_coin.sd:
        said = (
            f"The mesh is {by_coin.factor * tall:.1f} mm tall by the coin and {height_mm:g} mm by "
            "height_mm. No photo shows the top from the side (the lowest looks down at "
            f"{np.degrees(lowest):.0f} degrees), so the mesh is probably wrong there. Take some "
            "photos from just above the table."
        )
    return Scale(factor=by_coin.factor, sd=by_coin.sd, warnings=(said,) if said else ())
