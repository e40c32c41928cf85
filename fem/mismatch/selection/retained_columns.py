"""Which columns of the plain model a refit keeps: those that the effects' own laws do not hold already."""

from collections.abc import Iterable, Sequence

from fem.mismatch.effect import Effect
from fem.mismatch.evidence.large_deformation import LARGE_DEFORMATION
from fem.mismatch.evidence.turned_fruit import TURNED_FRUIT
from fem.mismatch.model.observation_delta import Regressor


def retained_columns(
    effects: Iterable[Effect], columns: Sequence[Regressor], chosen: Sequence[int]
) -> tuple[int, ...]:
    """The chosen columns without the flesh's large deformation where a law of these effects holds it; the
    fruit's turn stands alone in its place.
    """
    if not any(effect.spec.holds_large_deformation for effect in effects):
        return tuple(sorted(chosen))
    kept = (j for j in chosen if columns[j].name != LARGE_DEFORMATION)
    alone = (j for j, column in enumerate(columns) if column.name == TURNED_FRUIT)
    return tuple(sorted({*kept, *alone}))
