"""Scale of a mesh by mat, height or coin, and the box in which a fruit may stand. Also the excess height of a
mesh whose top no photo shows from the side.
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
"""Margin around an outline, px: enough for its errors."""
NOISE_PX, SEED = 0.5, 1
"""Noise of the outlines, px, and seed. Without noise a ball seen from 45 degrees keeps a conical top."""
NO_CONE = 0.02
"""Excess of the hull below which the fitted surface's, under 0.2 %, is not computed."""
SHOULDER, SHOULDER_TO_DEG, SHOULDER_SD = 0.06, 25.0, 0.45
"""Factor, largest elevation and relative standard deviation of the shoulder's term; see `expected_excess`."""
FIT_SD = 0.5
"""Relative standard deviation of the fitted surface's excess. Stone fruit with the stem cavity up need the
shoulder's term beyond an ellipsoid's excess."""
SIDEWAYS_DEG = 25.0
"""Elevation below which the expected excess is zero: meshes of an egg and a nectarine, seen from 15 and 18
degrees, have the right height. Fruits with a cavity are 0.4 to 3.1 % too tall there (21 meshes). That is 0.8
to 1.9 times the shoulder's term, which serves as the standard deviation."""
TOP_SHARE = 0.1
"""Upper share of the height that counts as the top."""


@dataclass(frozen=True, kw_only=True)
class TopExcess:
    """Expected relative excess of the mesh's height over the fruit's, and its standard deviation."""

    value: float
    sd: float

    def remaining(self, measured: float) -> "TopExcess":
        """The excess after a share of the top was measured, which has the summit with that probability.

        Mean and variance of a mixture: this excess with probability p = 1 - measured, else none.
        """
        p = 1.0 - measured
        return TopExcess(
            value=p * self.value, sd=float(np.sqrt(p * self.sd**2 + p * measured * self.value**2))
        )


def top_share(vertices: Vertices, measured: Bool[np.ndarray, " n"]) -> float:
    """Share of the vertices in the upper tenth of the height that were measured."""
    z = vertices[:, 2]
    return float(measured[z >= z.max() - TOP_SHARE * np.ptp(z)].mean())


def expected_excess(
    cameras: Sequence[Camera], box: Float[np.ndarray, "3"], elevation_rad: float
) -> TopExcess:
    """Expected excess of a mesh with sides `box` that stands on z = 0 at x = y = 0, seen by these cameras.

    value = fitted_excess of an ellipsoid (0 up to NO_CONE) + SHOULDER (a / c)² tan(min(e, 25 degrees)). Here
    c is half the height and a the mean of the other semi-axes. e = `elevation_rad` is the lowest camera's
    elevation above the top. The mesh's height is assumed to include half of the hull's excess. Below
    SIDEWAYS_DEG the value is 0 and the shoulder's term the standard deviation.
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
    """Relative excess of the hull's height over the ellipsoid's, for photos at `elevation_rad` above its top.

    A tangent plane inclined by e meets the axis at sqrt(c² + a² tan² e) above the centre. The excess is
    (sqrt(1 + (a / c)² tan² e) - 1) / 2 of the height 2 c, a the mean of the other semi-axes.

    >>> round(hull_excess(np.ones(3), np.radians(30.0)), 3)
    0.077
    """
    wide = (semi[0] + semi[1]) / (2 * semi[2])
    return float(np.sqrt(1 + (wide * np.tan(max(elevation_rad, 0.0))) ** 2) - 1) / 2


def fitted_excess(cameras: Sequence[Camera], box: Float[np.ndarray, "3"]) -> float:
    """Relative excess of the height of an ellipsoid that is fitted to its own outlines in these photos.

    `box`: its axes along x, y and z; it stands on z = 0 at x = y = 0. Its outlines are conics (Hartley and
    Zisserman 2004, 8.3) with correlated noise of NOISE_PX. Hull and surface are fitted as for a fruit.
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
"""Relative error of a printed mat whose bar of 100 mm was measured to 0.1 mm (assumed)."""
UNSURE = 0.005
"""Standard deviation of the excess above which a warning names it: 0.15 mm at the skin of a 60 mm fruit."""
APART_SD = 3.0
"""Standard deviations by which coin and height may differ without a warning."""
NEAREST_COIN, FARTHEST_COIN = 0.12, 0.3
"""Least and greatest relative distance from the height's scale to search the coin (beyond are its rings)."""
Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def blank_box(mat: Mat) -> Box:
    """The box (mm) above the mat's blank centre, with a margin for a fruit that overhangs it."""
    inner = min(float(np.abs(corners[:, :2]).max(1).min()) for corners in mat.corners_mm.values())
    half = max(inner, 0.12 * mat.width_mm)
    return box_about_z(1.45 * half, 2.7 * half)


def box_about_z(half: float, high: float) -> Box:
    """The box within `half` of the z axis in x and y, from the ground up to `high`."""
    return np.array([-half, -half, 0.0]), np.array([half, half, high])


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Factor that scales a mesh made without a mat to mm, its relative standard deviation, and warnings."""

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

    The mesh is assumed to be height_mm (1 + excess) tall. The excess is that of the share of the top without
    measured relief (1 - `top_measured`). The height's error combines the caliper's, that of two mesh ends
    (`surface_sd`, in the mesh's unit), and the excess's. The coin is searched within three of these
    (NEAREST_COIN to FARTHEST_COIN); if it is not found, the height counts, with a warning.
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
