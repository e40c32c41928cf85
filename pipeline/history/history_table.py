"""History as tables: a row per fruit and day, and a row per lot, day and class with its statistics."""

from collections.abc import Sequence
from itertools import groupby

import pandas as pd

from pipeline.history.lot_statistics import PERCENTILES, class_ranges, lot_statistics, share_outside
from pipeline.history.stored_batch import StoredBatch, StoredFruit

COLUMNS = (
    "measured_on", "category", "cultivar", "lot", "fruit_id", "E_MPa", "E_sd_MPa", "doubted",
    "reference_E_MPa", "shore_oo", "penetrometer_N",
)  # fmt: skip
BATCH_COLUMNS = (
    "orchard", "operator", "gripper", "gripper_serial", "sensor", "sensor_serial", "calibration",
)  # fmt: skip
MORE_COLUMNS = (
    "maturity", "grasps", "batch", "revision", "graded_utc", "harvest_date", "temperature_C", *BATCH_COLUMNS,
    "calibrated_on",
)  # fmt: skip
"""Further columns; the user's own columns follow."""
STATISTICS_COLUMNS = (
    "measured_on", "category", "cultivar", "lot", "grippers", "n", "mean_E_MPa", "sd_E_MPa",
    *(f"p{share}_E_MPa" for share in PERCENTILES), "n_needed", "precision", "maturity", "share_outside",
    "share_outside_low", "share_outside_high",
)  # fmt: skip


def fruit_table(batches: Sequence[StoredBatch]) -> pd.DataFrame:
    """The table of fruit, a row per fruit and day, in the order of `batches`."""
    of_user = (name for batch in batches for fruit in batch.fruit for name in fruit.columns)
    names = list(dict.fromkeys([*COLUMNS, *MORE_COLUMNS, *of_user]))
    rows = [
        fruit.columns | _of_batch(batch) | _of_fruit(batch, fruit)
        for batch in batches
        for fruit in batch.fruit
    ]
    return pd.DataFrame(rows, columns=names, dtype=object)


def _of_batch(batch: StoredBatch) -> dict[str, object]:
    return {
        "measured_on": batch.measured.isoformat(),
        "batch": batch.key,
        "revision": batch.revisions,
        "graded_utc": batch.graded_utc,
        "harvest_date": batch.harvest and batch.harvest.isoformat(),
        "temperature_C": batch.temperature_C,
        "calibrated_on": batch.calibrated_on and batch.calibrated_on.isoformat(),
        **{name: getattr(batch, name) or None for name in ("category", "cultivar", "lot", *BATCH_COLUMNS)},
    }


def _of_fruit(batch: StoredBatch, fruit: StoredFruit) -> dict[str, object]:
    maturity = (
        name for name, _, limit in class_ranges(batch.limits) if limit is None or fruit.E_MPa <= limit
    )
    return {
        "fruit_id": fruit.fruit_id,
        "E_MPa": float(f"{fruit.E_MPa:.4g}"),
        "E_sd_MPa": float(f"{fruit.E_sd_MPa:.3g}"),
        "doubted": "true" if fruit.doubted else None,
        "reference_E_MPa": fruit.E_known_MPa,
        "shore_oo": fruit.shore_oo,
        "penetrometer_N": fruit.penetrometer_N,
        "maturity": next(maturity, None) if fruit.E_known_MPa is None else None,
        "grasps": len(fruit.grasps),
    }


def statistics_table(batches: Sequence[StoredBatch], *, precision: float) -> pd.DataFrame:
    """Statistics of the fruit that count: a row per lot, day and class (of the day's newest batch)."""
    rows = []

    def lot_and_day(batch: StoredBatch) -> tuple[object, ...]:
        return (*batch.series, batch.measured)

    for (category, cultivar, lot, measured), of_day in groupby(
        sorted(batches, key=lot_and_day), key=lot_and_day
    ):
        on_day = list(of_day)
        E_MPa = [fruit.E_MPa for batch in on_day for fruit in batch.fruit if fruit.fitted]
        if not E_MPa:
            continue
        of_lot = lot_statistics(E_MPa, precision=precision)
        row = {
            "measured_on": f"{measured}",
            "category": category,
            "cultivar": cultivar or None,
            "lot": lot or None,
            "grippers": "; ".join(sorted({batch.gripper for batch in on_day} - {""})) or None,
            "n": of_lot.n,
            "mean_E_MPa": of_lot.mean_MPa,
            "sd_E_MPa": of_lot.sd_MPa,
            **{f"p{share}_E_MPa": E for share, E in zip(PERCENTILES, of_lot.percentiles_MPa, strict=True)},
            "n_needed": of_lot.needed,
            "precision": precision,
        }
        newest = max(on_day, key=lambda batch: batch.graded_utc)
        for name, lower, upper in class_ranges(newest.limits) or [("", 0.0, None)]:
            share, low, high = share_outside(E_MPa, above_MPa=lower, up_to_MPa=upper)
            shares = {"share_outside": share, "share_outside_low": low, "share_outside_high": high}
            rows.append({**row, "maturity": name or None, **(shares if name else {})})
    return pd.DataFrame(rows, columns=list(STATISTICS_COLUMNS), dtype=object)
