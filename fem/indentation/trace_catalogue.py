"""All effects that are looked for in a bare indenter's trace: those of the files in effects/, one each."""

import pkgutil
from importlib import import_module

from fem.indentation import effects
from fem.indentation.trace_effect import TraceEffectSpec


def _collected() -> tuple[TraceEffectSpec, ...]:
    """By TraceEffectSpec.rank: the order in which starts are drawn."""
    names = sorted(module.name for module in pkgutil.iter_modules(effects.__path__))
    found: list[TraceEffectSpec] = [import_module(f"{effects.__name__}.{name}").EFFECT for name in names]
    return tuple(sorted(found, key=lambda effect: effect.rank))


TRACE_EFFECTS: tuple[TraceEffectSpec, ...] = _collected()
OF_THE_MACHINE = frozenset(effect.spec.name for effect in TRACE_EFFECTS if effect.spec.of_the_jaws)
"""Names of those that belong to the machine, not to the flesh."""
