"""The catalogue: all effects that the finder knows. Each file in effects/ defines one, as EFFECT."""

import pkgutil
from importlib import import_module

from fem.mismatch import effects
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectSpec


def _collected() -> tuple[Effect, ...]:
    """Sorted by EffectSpec.rank, which decides between explanations that are exactly equal."""
    names = sorted(module.name for module in pkgutil.iter_modules(effects.__path__))
    catalogue: list[Effect] = [import_module(f"{effects.__name__}.{name}").EFFECT for name in names]
    return tuple(sorted(catalogue, key=lambda effect: effect.spec.rank))


EFFECTS: tuple[Effect, ...] = _collected()
SPECS: dict[str, EffectSpec] = {effect.spec.name: effect.spec for effect in EFFECTS}
"""Specifications by name, in the order of the catalogue."""
