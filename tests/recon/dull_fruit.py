"""Skins of plums and cherries without bloom: smaller and rounder than the nectarines of the samples."""

import numpy as np

from samples.fruit import Skin, on_its_base, triple

# half axes (mm), spreads of the size and of each axis, depths and widths of stem and groove, lopsidedness
PLUM = ((21.5, 20.0, 24.0), 0.06, 0.03, 0.07, 0.22, 0.01, 0.018, 0.12, 0.010)
CHERRY = ((12.7, 11.9, 12.2), 0.03, 0.02, 0.16, 0.40, 0.015, 0.012, 0.16, 0.012)


def skin_of_kind(kind: tuple, *, seed: int) -> Skin:
    """A skin that stands on z = 0, the same for the same seed."""
    axes, size_sd, axis_sd, stem_depth, stem_width, blossom_depth, groove_depth, groove_width, lopsided_sd = (
        kind
    )
    rng = np.random.default_rng([seed, 6])
    half = np.array(axes) * rng.normal(1.0, size_sd) * rng.normal(1.0, axis_sd, 3)
    mean = float(half.mean())
    skin = Skin(
        half_axes_mm=triple(half),
        stem_depth_mm=mean * stem_depth * float(rng.uniform(0.85, 1.15)),
        stem_width=stem_width * float(rng.uniform(0.9, 1.1)),
        blossom_depth_mm=mean * blossom_depth,
        groove_depth_mm=mean * groove_depth * float(rng.uniform(0.7, 1.3)),
        groove_width=groove_width,
        cubic=rng.normal(0.0, lopsided_sd, (3, 3, 3)),
    )
    return on_its_base(skin)
