"""Where the markers of a gel would be untouched, from a picture in which it is pressed.

The markers around a print lie nearly where they always do. Fitted to them, the places that the sensor's
description has, shifted as a whole, or else a regular lattice behind a smooth lens
(tactile.markers.smooth_lattice), have the others' places as well. Which markers are unloaded is not known:
several parts of the picture are tried, each fit is widened to the markers that agree with it, and the one
that most agree with is kept (as in least median of squares, Rousseeuw 1984). An unloaded marker stays where
it is seen. A grip also moves a gel as a whole, which no picture of the loaded gel tells from its rest: every
place has that spread besides.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from tactile.markers.marker_lattice import Lattice
from tactile.markers.smooth_lattice import FEWEST, coherent_misfit_px, fitted_lens
from tactile.tactile_failure import TactileFailure, TactileProblem

AGREES_SD = 2.5
"""Standard deviations of the unloaded markers' own misfit, up to which one agrees. Set by hand."""
AGREES_LEAST, AGREES_MOST = 0.02, 0.035
"""Bounds of that, in spacings: printed markers are off by 0.006 to 0.014 (root mean square, 43 empty
pictures), so that 2.5 standard deviations are 0.015 to 0.035."""
ROUNDS = 6
"""Of fitting to the markers that agree, each time anew: sets stay the same after about three. Set by hand."""
FEWEST_UNLOADED, LEAST_SHARE = 20, 0.4
"""Markers that must be unloaded, and their share of all: the lens has 11 numbers. Set by hand."""
LARGEST_SD = 0.15
"""Of a marker's place, in spacings: beyond it a place is nearer to a guess than to a measurement. Set by
hand."""
WHOLE_SD = 0.035
"""Spacings by which a grip moves the unloaded markers: of 127 loaded frames of 26 clips whose empty gel is
known (benchmarks/gel_references.py FOLDER --half even)."""
BELOW_PRINT = 5.0
"""Times the fit's own standard deviation that places below a print are off, on the same frames: the lens
follows the markers that move a little."""

_Fit: TypeAlias = Callable[[Bool[np.ndarray, " n"]], tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]]
"""Places of all markers and one standard deviation of each, px, from those that are chosen."""


@dataclass(frozen=True)
class EstimatedReference:
    """Places (px) of the untouched gel's markers, a standard deviation of each, and which are seen there."""

    rest_px: Float[np.ndarray, "n 2"]
    sd_px: Float[np.ndarray, " n"]
    unloaded: Bool[np.ndarray, " n"]


def estimated_reference(
    lattice: Lattice,
    ideal: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
    *,
    described_px: Float[np.ndarray, "n 2"] | None = None,
    source: str,
) -> EstimatedReference:
    """The untouched places of the markers that `lattice` has in a picture of the loaded gel.

    `ideal`: their places on a regular grid, in steps; `described_px`: where the sensor's description has
    them, which is taken instead; `known`: the markers of which either is known, the others stay where they
    are seen. Raises TactileFailure (no-markers) where too few markers are unloaded for the others' places.
    """
    fit = _shift(lattice, described_px) if described_px is not None else _lens(lattice, ideal)
    unloaded = _widest(lattice, fit, ideal if described_px is None else described_px, known)
    needed = max(FEWEST_UNLOADED, round(LEAST_SHARE * len(known)))
    if unloaded.sum() < needed:
        raise _refusal(source, int(unloaded.sum()), len(known), needed)
    expected, sd_px = fit(unloaded)
    own = float(np.sqrt(((lattice.rest_px - expected)[unloaded] ** 2).mean()))
    whole = WHOLE_SD * lattice.spacing_px
    place_sd_px = np.sqrt((BELOW_PRINT * sd_px) ** 2 + own**2 + whole**2)
    if (place_sd_px[known] > LARGEST_SD * lattice.spacing_px).any():
        raise _refusal(source, int(unloaded.sum()), len(known), needed)
    seen = unloaded | ~known
    rest_px = np.where(seen[:, None], lattice.rest_px, expected)
    return EstimatedReference(rest_px, np.where(seen, whole, place_sd_px), unloaded)


def _lens(lattice: Lattice, ideal: Float[np.ndarray, "n 2"]) -> _Fit:
    """A regular grid behind a smooth lens."""

    def fit(chosen: Bool[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        lens = fitted_lens(ideal[chosen], lattice.rest_px[chosen], lattice.shape)
        return lens.places_px(ideal), lens.sd_px(ideal)

    return fit


def _shift(lattice: Lattice, described_px: Float[np.ndarray, "n 2"]) -> _Fit:
    """The description's places, shifted as a whole."""

    def fit(chosen: Bool[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        off = (lattice.rest_px - described_px)[chosen]
        middle = np.median(off, axis=0)
        sd = float(np.sqrt(((off - middle) ** 2).mean() / max(1, len(off))))
        return described_px + middle, np.full(len(described_px), sd)

    return fit


def _widest(
    lattice: Lattice, fit: _Fit, ideal: Float[np.ndarray, "n 2"], known: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """The markers of the fit that most agree with."""
    best = np.zeros(len(known), dtype=bool)
    if known.sum() < FEWEST:
        return best
    for start in _parts(ideal, known):
        chosen = start
        for _ in range(ROUNDS):
            if chosen.sum() < FEWEST:
                break
            agreeing = known & _agrees(lattice, lattice.rest_px - fit(chosen)[0], chosen)
            if agreeing.sum() > best.sum():
                best = agreeing
            if (agreeing == chosen).all():
                break
            chosen = agreeing
    return best


def _agrees(
    lattice: Lattice, off_px: Float[np.ndarray, "n 2"], chosen: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Markers that are no further off by themselves, and less so together with their neighbours.

    The median of a two-dimensional normal misfit is sqrt(2 ln 2) standard deviations of one coordinate.
    """
    size = np.linalg.norm(off_px, axis=1)
    usual = AGREES_SD * float(np.median(size[chosen])) / np.sqrt(2.0 * np.log(2.0)) / lattice.spacing_px
    most = float(np.clip(usual, AGREES_LEAST, AGREES_MOST)) * lattice.spacing_px
    common = np.linalg.norm(coherent_misfit_px(lattice, off_px), axis=1)
    return np.asarray((size < most * np.sqrt(2.0)) & (common < most))


def _parts(
    ideal: Float[np.ndarray, "n 2"], known: Bool[np.ndarray, " n"]
) -> Iterator[Bool[np.ndarray, " n"]]:
    """All markers, the outer ones, and two thirds and half of them to each side and corner."""
    yield known
    away = ideal - np.median(ideal[known], axis=0)
    across = away / np.maximum(np.abs(away[known]).max(axis=0), 1e-9)
    for rim in (0.45, 0.7):
        yield known & (np.abs(across).max(axis=1) > rim)
    for angle in np.arange(8) * np.pi / 4:
        side = across @ [np.cos(angle), np.sin(angle)]
        yield known & (side > np.quantile(side[known], 1.0 / 3.0))
        yield known & (side > np.quantile(side[known], 0.5))


def _refusal(source: str, found: int, markers: int, needed: int) -> TactileFailure:
    return TactileFailure(
        TactileProblem.NO_MARKERS,
        f"{source}: found {found} of {markers} markers outside the imprint, expected at least "
        f"{needed} to estimate the untouched gel. Name a picture or clip of it (reference = ... in "
        "grasp.toml), or record one with the jaws open.",
    )
