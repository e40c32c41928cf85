"""What the modulus is estimated from: the history of a contact, marker by marker, in the fruit frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

SMALLEST_SD_MM = 5e-4
"""Half a micrometre: noise assumed for a recording without measurable noise, for finite weights."""
SMALLEST_SHARE_OF_FORCE = 1e-4
"""Share of the largest force on a marker, for the same reason. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class PadHistory:
    """One pad's markers over time (those in and around its patch), mm and N in the fruit frame.

    `rest_mm`: markers on the undeformed gel, pad frame. `surface_mm`: where each sits on the fruit's mesh.
    `position_mm`: where it is. `gel_displacement_mm`: the measured part of that position, whose scale is in
    doubt. `force_N`: what the gel puts on the fruit. `episode`: how often the marker has come into contact,
    -1 while it touches nothing. `displacement_sd_mm`, `force_sd_N`: noise of one component in one frame,
    above zero (the caller applies SMALLEST_SD_MM and SMALLEST_SHARE_OF_FORCE); `lag1`: its correlation
    with the next frame. `surface_sd_mm`: error of the fruit's mesh within the pad's contact patch, root mean
    square; None where only that of the whole mesh is known (fem.estimation.error_budget).
    """

    name: str
    rest_mm: Float[np.ndarray, "n 3"]
    surface_mm: Float[np.ndarray, "n 3"]
    position_mm: Float[np.ndarray, "t n 3"]
    gel_displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    episode: Int[np.ndarray, "t n"]
    displacement_sd_mm: float
    force_sd_N: float
    lag1: float
    surface_sd_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class PatternNoise:
    """Noise in forces that were brought to patterns f_r: in each frame the amount of f_r is off by

        g_r . n_d + q_r . n_f

    n_d, n_f: noise of the markers' displacement and of their recorded force in that frame. `patterns`: f_r.
    `of_displacement` (N/mm): g_r, the gel's springs, so that this part is the same noise as that of the
    markers' places. `of_force` (1): q_r, where the recorded force itself was kept. All pads side by side.
    """

    patterns: Float[np.ndarray, "r n 3"]
    of_displacement: Float[np.ndarray, "r n 3"]
    of_force: Float[np.ndarray, "r n 3"]


@dataclass(frozen=True, kw_only=True)
class GraspHistory:
    """One recording: a time and a phase ("air", "load", "hold", "unload") per frame, and its pads.

    `pattern_noise`: of forces that were brought to patterns (fem.estimation.prepared_grasp); None: each
    component of each force carries noise of its own, PadHistory.force_sd_N.
    """

    time_s: Float[np.ndarray, " t"]
    phase: tuple[str, ...]
    pads: tuple[PadHistory, ...]
    pattern_noise: PatternNoise | None = None

    @property
    def pad_of_marker(self) -> Int[np.ndarray, " n"]:
        """The number of each marker's pad, all pads' markers side by side."""
        return np.repeat(np.arange(len(self.pads)), [len(pad.rest_mm) for pad in self.pads])
