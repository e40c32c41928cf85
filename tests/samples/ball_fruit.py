"""A ball round a concentric ball: the sample fruit with closed forms."""

from samples.fruit import SampleFruit, SamplePit, Skin


def ball(radius_mm: float, core_mm: float, E_MPa: float, nu: float) -> SampleFruit:
    skin = Skin(half_axes_mm=(radius_mm,) * 3)
    pit = SamplePit(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(core_mm,) * 3)
    return SampleFruit(fruit_id="ball", skin=skin, pit=pit, E_MPa=E_MPa, poisson_ratio=nu)
