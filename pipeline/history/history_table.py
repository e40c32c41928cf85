"""History as CSV: a row per fruit and day, with predicted readings of other instruments where asked for."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.stored_batch import StoredBatch
from reports.tables import safe_cell

COLUMNS = (
    "measured_on", "category", "cultivar", "lot", "fruit_id", "E_MPa", "E_sd_MPa", "doubted",
    "reference_E_MPa", "shore_oo", "penetrometer_N",
)  # fmt: skip
"""Of every table; a conversion adds SCALE_predicted, SCALE_low, SCALE_high (90 %) and SCALE_version. The
user's own columns are last."""


def history_csv(
    batches: Sequence[StoredBatch], conversions: Mapping[tuple[str, str], ScaleConversion]
) -> str:
    """The table, oldest day first. `conversions`: by scale and group, those that were asked for."""
    scales = sorted({scale for scale, _ in conversions})
    added = [f"{scale}_{part}" for scale in scales for part in ("predicted", "low", "high", "version")]
    every = (name for batch in batches for fruit in batch.fruit for name in fruit.columns)
    added += dict.fromkeys(name for name in every if name not in (*COLUMNS, *added))
    rows = []
    for batch in batches:
        for fruit in batch.fruit:
            row: dict[str, object] = {
                name: safe_cell(cell) if isinstance(cell, str) else cell
                for name, cell in fruit.columns.items()
            }
            row |= {
                "measured_on": batch.measured.isoformat(),
                **{name: safe_cell(getattr(batch, name)) for name in ("category", "cultivar", "lot")},
                "fruit_id": safe_cell(fruit.fruit_id),
                "E_MPa": float(f"{fruit.E_MPa:.4g}"),
                "E_sd_MPa": float(f"{fruit.E_sd_MPa:.3g}"),
                "doubted": "true" if fruit.doubted else None,
                "reference_E_MPa": fruit.E_known_MPa,
                "shore_oo": fruit.shore_oo,
                "penetrometer_N": fruit.penetrometer_N,
            }
            for scale in scales if fruit.E_known_MPa is None else ():
                conversion = conversions.get((scale, batch.group))
                if conversion is not None and (predicted := conversion.predicted(fruit.E_MPa)) is not None:
                    middle, half = predicted
                    row |= {
                        f"{scale}_predicted": round(middle, 2),
                        f"{scale}_low": round(middle - half, 2),
                        f"{scale}_high": round(middle + half, 2),
                        f"{scale}_version": conversion.version,
                    }
            rows.append(row)
    table = pd.DataFrame(rows, columns=[*COLUMNS, *added], dtype=object)
    return table.to_csv(index=False, lineterminator="\n", na_rep="")
