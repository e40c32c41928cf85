"""Where size comes from (mat, height or coin), and the box in which a fruit may stand."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from recon.cameras.camera import Camera
from recon.cameras.coin import Coin, coin_scale
from recon.cameras.printed_mat import Mat
from recon.cameras.similarity import affine
from recon.recon_failure import ReconFailure
from recon.surface.unseen_top import expected_excess

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


def spread_of_scale(height_mm: float, height_sd_mm: float, surface_sd_mm: float) -> float:
    """Relative standard deviation of a scale by height: the caliper's error and that of two mesh ends.

    >>> round(spread_of_scale(60.0, height_sd_mm=0.3, surface_sd_mm=0.0), 6)
    0.005
    """
    return float(np.hypot(height_sd_mm, np.sqrt(2) * surface_sd_mm) / height_mm)


@dataclass(frozen=True, kw_only=True)
class Scale:
    """The factor that takes a mesh made without a mat to mm, its relative standard deviation, and doubts."""

    factor: float
    sd: float
    warnings: tuple[str, ...] = ()


def scale_without_mat(
    vertices: Float[np.ndarray, "n 3"],
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]],
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
    by_height = float(np.hypot(spread_of_scale(height_mm, height_sd_mm, surface_sd * factor), excess.sd))
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
