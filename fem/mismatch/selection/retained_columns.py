"""Which columns of the plain model a refit keeps: those that the effects' own laws do not hold already."""

from collections.abc import Iterable, Sequence

from fem.mismatch.effect import Effect
from fem.mismatch.evidence.large_deformation import LARGE_DEFORMATION
from fem.mismatch.evidence.turned_fruit import TURNED_FRUIT
from fem.mismatch.model.observation_delta import Regressor


def retained_columns(
    effects: Iterable[Effect], columns: Sequence[Regressor], chosen: Sequence[int]
) -> tuple[int, ...]:
    """The chosen columns without what these effects' own laws hold, for their refits: their saturating
    discrepancies, and the flesh's large deformation, in whose place the fruit's turn stands alone.
    """
    effects = tuple(effects)
    saturating = {
        effect.spec.name
        for effect in effects
        if effect.spec.discrepancy is not None and effect.spec.discrepancy.saturating
    }
    large = any(effect.spec.holds_large_deformation for effect in effects)

    def left_out(column: Regressor) -> bool:
        if column.name == LARGE_DEFORMATION:
            return large
        return column.discrepancy_of is not None and column.discrepancy_of.name in saturating

    alone = (j for j, column in enumerate(columns) if large and column.name == TURNED_FRUIT)
    return tuple(sorted({*(j for j in chosen if not left_out(columns[j])), *alone}))
