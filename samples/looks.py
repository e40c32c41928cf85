"""How a skin takes light: its colours by direction, its roughness and its gloss."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from samples.appearance import linear_rgb, random_field, skin_colours

Colour = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Look:
    """A principled skin (Burley 2012): roughness and coat, and two sRGB colours that mottle fades between.

    `mottle` is how far broad patches (a few to a fruit) go from one colour to the other, `fine` the relative
    amplitude of lightness at a twenty-fifth of a radian, `specks` the number of pale dots.
    """

    roughness: float
    specular: float
    clearcoat: float
    clearcoat_gloss: float
    colour: Colour
    other: Colour
    mottle: float
    fine: float
    specks: int = 0
    speck_colour: Colour = (0.8, 0.7, 0.5)

    def colours(
        self,
        directions: Float[np.ndarray, "n 3"],
        *,
        ripeness: float,
        rng: np.random.Generator,
    ) -> Float[np.ndarray, "n 3"]:
        """Linear RGB by direction; a riper skin has more of the other colour."""
        share = ripeness * 0.4 + self.mottle * (
            random_field(directions, 3.0, rng) + 0.5 * random_field(directions, 9.0, rng)
        )
        share = np.clip(share, 0.0, 1.0)[:, None]
        srgb = np.array(self.colour) * (1 - share) + np.array(self.other) * share
        srgb *= 1 + self.fine * random_field(directions, 25.0, rng)[:, None]
        if self.specks:
            spots = rng.normal(size=(self.specks, 3))
            spots /= np.linalg.norm(spots, axis=1, keepdims=True)
            nearest = np.max(directions @ spots.T, axis=1)
            pale = 0.6 * np.exp(-((np.arccos(np.clip(nearest, -1, 1)) / 0.012) ** 2))[:, None]
            srgb = srgb * (1 - pale) + np.array(self.speck_colour) * pale
        return linear_rgb(srgb)


@dataclass(frozen=True, kw_only=True)
class NectarineLook(Look):
    """Blush on a ground colour, and lenticels: `skin_colours`."""

    def colours(
        self,
        directions: Float[np.ndarray, "n 3"],
        *,
        ripeness: float,
        rng: np.random.Generator,
    ) -> Float[np.ndarray, "n 3"]:
        """Linear RGB by direction."""
        return skin_colours(directions, ripeness=ripeness, rng=rng)


NECTARINE = NectarineLook(
    roughness=0.38, specular=0.45, clearcoat=0.6, clearcoat_gloss=0.75,
    colour=(0.9, 0.6, 0.2), other=(0.5, 0.05, 0.07), mottle=0.0, fine=0.0,
)  # fmt: skip
"""Roughness, gloss and coat are shares of 1 as the renderer's "principled" surface has them, colours sRGB
shares; all by eye on shop fruit, as in the looks below."""
RED_CHERRY = Look(
    roughness=0.22, specular=0.5, clearcoat=1.0, clearcoat_gloss=0.93,
    colour=(0.50, 0.06, 0.08), other=(0.30, 0.02, 0.05), mottle=0.12, fine=0.03,
)  # fmt: skip
"""By eye: glossy, red with dark mottle."""
BLACK_CHERRY = Look(
    roughness=0.20, specular=0.5, clearcoat=1.0, clearcoat_gloss=0.95,
    colour=(0.17, 0.04, 0.09), other=(0.10, 0.03, 0.08), mottle=0.10, fine=0.02,
)  # fmt: skip
"""By eye: glossy and so dark that hardly more than its highlights is seen."""
BLOOMED_PLUM = Look(
    roughness=0.75, specular=0.2, clearcoat=0.0, clearcoat_gloss=0.5,
    colour=(0.34, 0.26, 0.42), other=(0.26, 0.17, 0.33), mottle=0.12, fine=0.02,
)  # fmt: skip
"""By eye: dull from bloom."""
WAXY_PLUM = Look(
    roughness=0.45, specular=0.4, clearcoat=0.2, clearcoat_gloss=0.6,
    colour=(0.50, 0.16, 0.20), other=(0.33, 0.09, 0.17), mottle=0.15, fine=0.02, specks=150,
)  # fmt: skip
"""By eye: its bloom rubbed off."""
