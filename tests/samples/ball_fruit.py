"""A ball round a concentric ball: the sample fruit with closed forms."""

import numpy as np

from samples.fruit import SampleFruit, SamplePit, Skin


def ball(radius_mm: float, core_mm: float, E_MPa: float, nu: float) -> SampleFruit:
    skin = Skin(
        centre_mm=(0.0, 0.0, 0.0), half_axes_mm=(radius_mm,) * 3, stem_depth_mm=0.0, stem_width=0.3,
        blossom_depth_mm=0.0, groove_depth_mm=0.0, groove_width=0.1, cubic=np.zeros((3, 3, 3)),
    )  # fmt: skip
    pit = SamplePit(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(core_mm,) * 3)
    return SampleFruit(
        fruit_id="ball", seed=0, skin=skin, pit=pit, E_MPa=E_MPa, poisson_ratio=nu, ripeness=0.5
    )
