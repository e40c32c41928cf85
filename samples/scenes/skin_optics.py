"""Optics of a scene's fruit skin: colour, gloss, patches, specks, bloom."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from samples.appearance import linear_rgb, random_field, specks, unit
from samples.fruit import triple

Rgb = tuple[float, float, float]

# two sRGB colours at the ends of each skin's patches, by eye on shop fruit
COLOURS: dict[str, tuple[Rgb, Rgb]] = {
    "white-yellow": ((0.90, 0.82, 0.54), (0.92, 0.76, 0.36)),
    "green": ((0.50, 0.60, 0.20), (0.66, 0.69, 0.30)),
    "orange": ((0.93, 0.60, 0.18), (0.86, 0.38, 0.11)),
    "red": ((0.64, 0.09, 0.09), (0.42, 0.03, 0.06)),
    "blue-black": ((0.13, 0.12, 0.24), (0.22, 0.10, 0.19)),
    "two-coloured": ((0.89, 0.72, 0.30), (0.62, 0.10, 0.10)),
}
# principled parameters (Burley 2012): roughness, specular, clear coat, its gloss, sheen of fuzz
GLOSSES: dict[str, tuple[float, float, float, float, float]] = {
    "dull": (0.70, 0.25, 0.0, 0.5, 0.4),
    "bloom": (0.45, 0.40, 0.2, 0.6, 0.2),
    "satin": (0.40, 0.45, 0.3, 0.6, 0.0),
    "glossy": (0.22, 0.50, 1.0, 0.93, 0.0),
}
_BLOOM: Rgb = (0.62, 0.65, 0.74)
"""sRGB (0 to 1) of wax bloom, a bluish grey (by eye)."""
_BLOOM_ROUGHNESS = 0.85
"""Roughness of skin under full bloom; 1 is matt (by eye)."""


@dataclass(frozen=True, kw_only=True)
class SkinLook:
    """`mottle`: how far broad patches go from one colour to the other. `fine`: relative amplitude of
    lightness over about 1/25 radian. `specks`: number of pale dots. `bloom`: mean share of the waxy white
    layer. Roughness and the rest belong to the principled model.
    """

    colour: str
    gloss: str
    srgb: Rgb
    other_srgb: Rgb
    mottle: float
    fine: float
    specks: int
    bloom: float
    roughness: float
    specular: float
    clearcoat: float
    clearcoat_gloss: float
    sheen: float
    pattern_seed: int


def draw_skin(rng: np.random.Generator) -> SkinLook:
    """A skin with random colour and gloss, independent and with equal probabilities."""
    colour = str(rng.choice(sorted(COLOURS)))
    gloss = str(rng.choice(sorted(GLOSSES)))
    roughness, specular, coat, coat_gloss, sheen = GLOSSES[gloss]
    srgb, other = (np.clip(np.array(c) * rng.normal(1.0, 0.06, 3), 0.02, 0.97) for c in COLOURS[colour])
    return SkinLook(
        colour=colour,
        gloss=gloss,
        srgb=triple(srgb),
        other_srgb=triple(other),
        mottle=float(rng.uniform(0.0, 0.35)),
        fine=float(rng.uniform(0.0, 0.06)),
        specks=int(rng.integers(40, 700) * rng.integers(2)),
        bloom=float(rng.uniform(0.25, 0.6)) if gloss == "bloom" else 0.0,
        roughness=float(roughness * rng.uniform(0.85, 1.15)),
        specular=specular,
        clearcoat=coat,
        clearcoat_gloss=coat_gloss,
        sheen=sheen,
        pattern_seed=int(rng.integers(1 << 30)),
    )


def ripe_skin(ripeness: float, *, pattern_seed: int) -> SkinLook:
    """A satin nectarine: green-yellow with a faint blush (ripeness 0) to orange with a deep red one (1)."""
    roughness, specular, coat, coat_gloss, sheen = GLOSSES["satin"]
    unripe, ripe = np.array(((0.62, 0.66, 0.22), (0.70, 0.54, 0.18))), np.array(COLOURS["red"])
    ground, blush = unripe + ripeness * (np.array(((0.93, 0.66, 0.18), ripe[1])) - unripe)
    return SkinLook(
        colour="two-coloured", gloss="satin", srgb=triple(ground), other_srgb=triple(blush), mottle=0.3,
        fine=0.05, specks=900, bloom=0.0, roughness=roughness, specular=specular, clearcoat=coat,
        clearcoat_gloss=coat_gloss, sheen=sheen, pattern_seed=pattern_seed,
    )  # fmt: skip


def skin_attributes(
    look: SkinLook, directions: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Linear RGB and roughness by unit direction."""
    rng = np.random.default_rng([look.pattern_seed, 0])
    patches = random_field(directions, 3.0, rng) + 0.5 * random_field(directions, 9.0, rng)
    if look.colour == "two-coloured":
        sunny = directions @ unit(rng.normal(size=3) * np.array([1, 1, 0.4]))
        cover = rng.uniform(-0.4, 0.5) + 0.9 * sunny + (0.2 + look.mottle) * patches
        cover += 0.15 * random_field(directions, 40.0, rng)
        share = 1 / (1 + np.exp(-4.5 * cover))
    else:
        share = np.clip(0.35 + look.mottle * patches, 0.0, 1.0)
    srgb = np.array(look.srgb) * (1 - share[:, None]) + np.array(look.other_srgb) * share[:, None]
    srgb *= 1 + look.fine * random_field(directions, 25.0, rng)[:, None]
    if look.specks:
        pale = 0.6 * specks(directions, look.specks, 0.013, rng)[:, None]
        srgb = srgb * (1 - pale) + np.clip(1.25 * srgb + 0.12, 0, 0.95) * pale
    stem = 0.5 * np.exp(-((np.arccos(np.clip(directions[:, 2], -1, 1)) / 0.12) ** 2))[:, None]
    srgb = srgb * (1 - stem) + np.array([0.45, 0.40, 0.18]) * stem
    roughness = np.full(len(directions), look.roughness)
    if look.bloom:
        rubbed = random_field(directions, 3.0, rng) + 0.5 * random_field(directions, 16.0, rng)
        layer = np.clip(look.bloom + 0.15 * rubbed, 0.02, 0.85)
        srgb = srgb * (1 - layer[:, None]) + np.array(_BLOOM) * layer[:, None]
        roughness += np.sqrt(layer) * (_BLOOM_ROUGHNESS - roughness)
    return linear_rgb(srgb), np.clip(roughness, 0.05, 1.0)


def skin_bsdf(look: SkinLook) -> dict[str, Any]:
    """The renderer's principled material; colour and roughness come from the mesh."""
    return {
        "type": "principled",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "roughness": {"type": "mesh_attribute", "name": "vertex_roughness"},
        "specular": look.specular,
        "clearcoat": look.clearcoat,
        "clearcoat_gloss": look.clearcoat_gloss,
        "sheen": look.sheen,
    }
