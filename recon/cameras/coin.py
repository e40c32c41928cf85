"""Scale from a coin that lies beside the fruit: the circle of its rim, measured in all photos together."""

import difflib
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from recon.cameras.camera import Camera
from recon.picture_values import Pictures, sampled
from recon.recon_failure import ReconProblem
from recon.silhouettes.mask import lab

USUAL_THICKNESS_MM = 1.9
"""Assumed for a coin that is given by its diameter alone; those of coins.toml have 1.35 to 2.5."""
STRUCK_SD_MM = 0.03
"""Standard deviation of the diameter of struck and worn coins from their mint's value (assumed)."""
EDGE_MM = 0.15
"""Depth of a coin's widest circle below its top: the edge is rounded (assumed)."""
LEAST_SD = 0.005
"""Least relative error: the start of the search changes the result by 0.1 to 1.0 % on a coin 38 px wide."""
SPOTS = 180
"""Samples along the rim: every two degrees."""
RADIUS_STEP = 0.02
"""Relative step of the tried radii: about a fifth of an element of the top view (1 / 9 radius)."""
LEAST_STEP = 3.0
"""Least colour step of an edge, CIE Lab units, over four samples across a rim or a pixel of the top view."""
OUTERMOST = 0.5
"""Coins have rings: the rim is the outermost step along a ray that reaches this share of the strongest."""
OUTERMOST_VOTES = 0.8
"""The first guess is the largest radius that reaches this share of the most votes."""
FEWEST_VIEWS = 3
"""Least number of photos that show the rim: of three, one that errs is detectable."""
LEAST_SHARE = 0.45
"""Least share of the rim's far half that a photo must show to count."""


@dataclass(frozen=True, kw_only=True)
class Coin:
    """Name, diameter and thickness of a coin."""

    name: str
    diameter_mm: float
    thickness_mm: float = USUAL_THICKNESS_MM


@dataclass(frozen=True, kw_only=True)
class CoinScale:
    """Factor from the cameras' unit to mm, its relative sd, and the coin's centre (x, y) in that unit."""

    factor: float
    sd: float
    centre: tuple[float, float]


def coin_named(name: str) -> Coin:
    """The coin of that name in coins.toml, in any case; raises ReconFailure (no-scale) that lists all coins.

    >>> coin_named("1 EURO").diameter_mm
    23.25
    """
    table = tomllib.loads(files("recon").joinpath("coins.toml").read_text(encoding="utf-8"))
    coins = {name: Coin(name=name, diameter_mm=d, thickness_mm=t) for name, (d, t) in table.items()}
    same = {known.casefold(): coin for known, coin in coins.items()}
    if name.strip().casefold() in same:
        return same[name.strip().casefold()]
    near = difflib.get_close_matches(name, coins, n=1)
    meant = f'did you mean "{near[0]}"? ' if near else ""
    known = ", ".join(f"{coin.name} ({coin.diameter_mm:g} mm)" for coin in coins.values())
    raise ReconProblem.NO_SCALE.failure(
        f'drupe knows no coin "{name}"; {meant}known: {known}; for another coin give its diameter as coin_mm'
    )


def coin_scale(
    images: Pictures, cameras: Sequence[Camera], coin: Coin, *, unit_mm: float, spread: float
) -> CoinScale:
    """The scale by a coin on the plane z = 0; cameras have no distortion.

    `unit_mm` is the cameras' unit in mm, known to within `spread` (relative). The rim is a circle at the
    coin's thickness less EDGE_MM above the plane. A Hough transform of the photos' top views finds it. Colour
    steps across its far half in all photos then give centre and radius, with Cauchy's weights. The fruit's
    middle is at x = y = 0. Raises ReconFailure (no-scale) if fewer than three photos show the circle.
    """
    high = coin.thickness_mm - EDGE_MM
    about = coin.diameter_mm / 2 / unit_mm
    seen = [cv2.GaussianBlur(lab(image), (0, 0), 0.8) for image in images]
    x = _sought(seen, cameras, about, high / unit_mm, spread)
    for step in (spread + 0.06, spread, spread, 0.1, 0.1, 0.1):
        height = high * 2 * float(x[2]) / coin.diameter_mm
        spots = [
            _far_rim(colours, camera, x, height, step) for colours, camera in zip(seen, cameras, strict=True)
        ]
        spots = [s for s in spots if len(s) >= LEAST_SHARE * SPOTS / 2]
        if len(spots) < FEWEST_VIEWS:
            raise ReconProblem.NO_SCALE.failure(
                f'drupe found no coin of {coin.diameter_mm:g} mm ("{coin.name}") on the ground in three '
                f"photos (its rim is visible in {len(spots)}). Lay it flat beside the fruit, in view of most "
                "photos, on a ground of another colour. Or give height_mm."
            )
        at = np.concatenate(spots)

        def misses(x: Float[np.ndarray, "3"], at: Float[np.ndarray, "n 2"] = at) -> Float[np.ndarray, " n"]:
            return np.asarray((np.hypot(at[:, 0] - x[0], at[:, 1] - x[1]) - x[2]) / about)

        x = least_squares(misses, x, loss="cauchy", f_scale=0.005).x
    radii = np.array([np.median(np.hypot(s[:, 0] - x[0], s[:, 1] - x[1])) for s in spots])
    sd = float(1.25 * np.median(np.abs(radii - np.median(radii))) * 1.4826 / np.sqrt(len(radii)) / x[2])
    return CoinScale(
        factor=coin.diameter_mm / (2 * float(x[2])),
        sd=float(np.hypot(max(sd, LEAST_SD), STRUCK_SD_MM / coin.diameter_mm)),
        centre=(float(x[0]), float(x[1])),
    )


def _far_rim(
    colours: Float[np.ndarray, "h w 3"],
    camera: Camera,
    x: Float[np.ndarray, "3"],
    height: float,
    reach: float,
) -> Float[np.ndarray, "n 2"]:
    """Points (x, y) of the rim's far half at which a photo shows the colour step."""
    radii = x[2] * (1 + np.linspace(-reach, reach, 41))
    turn = 2 * np.pi * np.arange(SPOTS) / SPOTS
    way = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    away = x[:2] - camera.place[:2]
    way = way[way @ (away / np.linalg.norm(away)) > -0.1]
    flat = x[:2] + radii[None, :, None] * way[:, None]
    points = np.concatenate([flat, np.full((*flat.shape[:2], 1), height)], axis=2)
    pixels = camera.project(points.reshape(-1, 3)).reshape(flat.shape)
    across = sampled(colours, pixels, outside=float("nan")).astype(float)
    steps = np.linalg.norm(across[:, 4:] - across[:, :-4], axis=2)
    good = np.isfinite(steps).all(axis=1)
    steps, out = steps[good], way[good]
    inner = steps[:, 1:-1]
    top = (inner >= steps[:, :-2]) & (inner > steps[:, 2:])
    strong = top & (inner > OUTERMOST * steps.max(axis=1, keepdims=True, initial=0.0)) & (inner > LEAST_STEP)
    best = steps.shape[1] - 2 - strong[:, ::-1].argmax(axis=1)
    clear = strong.any(axis=1)
    steps, best, out = steps[clear], best[clear], out[clear]
    row = np.arange(len(best))
    a, b, c = steps[row, best - 1], steps[row, best], steps[row, best + 1]
    part = 0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-9)
    radius = np.interp(best + 2 + np.clip(part, -0.5, 0.5), np.arange(len(radii)), radii)
    return np.asarray(x[:2] + radius[:, None] * out)


def _sought(
    seen: Sequence[Float[np.ndarray, "_ _ 3"]],
    cameras: Sequence[Camera],
    about: float,
    height: float,
    spread: float,
) -> Float[np.ndarray, "3"]:
    """Centre and radius of the circle with the most even colour steps all around.

    In each photo's top view every colour gradient votes for centres at the tried radii, along its direction,
    both ways (Hough). The votes of all photos are added.
    """
    distance = float(np.median([np.linalg.norm(c.place) for c in cameras]))
    half = 0.65 * distance
    element = about / 9
    side = int(2 * half / element)
    y, x = np.mgrid[:side, :side]
    flat = np.stack([x.ravel() * element - half, y.ravel() * element - half, np.full(x.size, height)], 1)
    trials = 2 * int(np.ceil(spread / RADIUS_STEP)) + 1
    radii = about * (1 + np.linspace(-spread, spread, trials))
    votes = np.zeros((trials, side, side), np.float32)
    for colours, camera in zip(seen, cameras, strict=True):
        pixels = camera.project(flat).reshape(side, side, 2)
        ahead = camera.into(flat)[:, 2].reshape(side, side) > 0
        ground = np.nan_to_num(sampled(colours, pixels, outside=float("nan")))
        picture = np.where(ahead[..., None], ground, np.float32(0))
        gx = np.stack([cv2.Sobel(picture[..., k], cv2.CV_32F, 1, 0) for k in range(3)], 2) / 8
        gy = np.stack([cv2.Sobel(picture[..., k], cv2.CV_32F, 0, 1) for k in range(3)], 2) / 8
        strongest = np.argmax(gx**2 + gy**2, axis=2)[..., None]
        gx, gy = (np.take_along_axis(g, strongest, 2)[..., 0] for g in (gx, gy))
        steep = np.hypot(gx, gy)
        shown = cv2.erode(((picture != 0).any(2)).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        rows, columns = np.nonzero((steep > LEAST_STEP) & shown)
        if len(rows) == 0:
            continue
        ux, uy = gx[rows, columns] / steep[rows, columns], gy[rows, columns] / steep[rows, columns]
        for k, radius in enumerate(radii):
            round_ = np.zeros((side, side), np.float32)
            for sign in (-1.0, 1.0):
                at = np.rint(
                    np.stack([columns + sign * ux * radius / element, rows + sign * uy * radius / element], 1)
                ).astype(int)
                ok = ((at >= 0) & (at < side)).all(axis=1)
                round_ += np.bincount(at[ok, 1] * side + at[ok, 0], minlength=side * side).reshape(side, side)
            votes[k] += np.minimum(cv2.GaussianBlur(round_, (0, 0), 1.0), 8.0)
    total = votes.max(axis=0) + 0.2 * votes.sum(axis=0)
    row, column = np.unravel_index(int(np.argmax(total)), total.shape)
    near = votes[:, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].max(axis=(1, 2))
    outermost = int(np.flatnonzero(near >= OUTERMOST_VOTES * near.max())[-1])
    return np.array([column * element - half, row * element - half, radii[outermost]])
