"""The ranking as CSV, for spreadsheets and for programs: one row per fruit."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable

import pandas as pd

from reports.entries import BatchEntry, FruitEntry, ranked

_NUMBER = r"\d*(?:[.,\s]\d+)*\.?(?:[eE][+-]?\d+)?[%\s]*"
_REST = rf"\s*(?:[^\s\d.,;)>]|{_NUMBER}(?:[-+*/^&=<>＋－＝]|:\s*[\d$]))"
"""What follows the sign of a formula: no number, or a number and an operator (not "7" or "7 mm")."""
_FORMULA = re.compile(rf"^(?=\t|[\s\"]*[=+\-@＝＋－＠])|(?<=[;,\t])(?=[\s\"]*(?:[=@＝＠]|[+\-＋－]{_REST}))")
"""Places in a text where a spreadsheet would begin to read a formula."""


def ranking_json(batch: BatchEntry) -> str:
    """The ranking as JSON for programs: a list of one object per fruit, columns as keys, unknown values null.
    Text is unchanged but for line breaks: formulas get no apostrophe.
    """
    rows, _ = _rows(batch, _plain)
    return json.dumps(rows, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def ranking_csv(batch: BatchEntry) -> str:
    """The ranking as CSV (RFC 4180, LF): softest first, then fruit without a rank, then reference bodies.

    Moduli carry four significant figures, their standard deviations three; an unknown value is an empty cell.
    `safe_cell` puts an apostrophe before text that a spreadsheet would run as a formula; spreadsheets read it
    as "this is text". Line breaks in text become spaces.
    """
    rows, columns = _rows(batch, safe_cell)
    table = pd.DataFrame(rows, columns=columns, dtype=object)
    return table.to_csv(index=False, lineterminator="\n", na_rep="")


def _said_by(fruit: FruitEntry) -> str | None:
    """Source of `mismatch`: settings, explain or screen."""
    if fruit.mismatch:
        return "settings" if fruit.mismatch_taken else "explain"
    return "screen" if fruit.screen else None


def safe_cell(text: str | None) -> str | None:
    """Text on one line that no spreadsheet runs as a formula; None for empty text.

    An apostrophe goes before = + - @ at the start of the text, and before a formula after a separator in it.
    Some locales read `;`, a comma or a tab as the end of the cell, quoted or not. Numbers after a separator
    stay, and a second call changes nothing.

    >>> safe_cell("=1+1"), safe_cell("lot 7;=cmd"), safe_cell("a - b, -0.3 mm")
    ("'=1+1", "lot 7;'=cmd", 'a - b, -0.3 mm')
    """
    if not text:
        return None
    return _FORMULA.sub("'", " ".join(text.replace("\x00", "").splitlines()))


def _plain(text: str | None) -> str | None:
    """Text on one line; None for empty text."""
    return " ".join(text.replace("\x00", "").splitlines()) if text else None


def _rows(
    batch: BatchEntry, written: Callable[[str], str | None]
) -> tuple[list[dict[str, object]], list[str]]:
    """A row per fruit in ranked order, its texts converted by `written`; and the columns: drupe's, firmness
    readings, the user's own.
    """
    names = list(dict.fromkeys([*batch.readings, *(name for name, _ in batch.columns)]))
    rows = []
    for fruit in ranked(batch.fruits):
        of_fruit = {**fruit.readings, **fruit.columns}
        cells = _row(fruit) | {name: of_fruit.get(name) for name in names}
        rows.append({name: written(cell) if isinstance(cell, str) else cell for name, cell in cells.items()})
    return rows, [*RANKING_COLUMNS, *names]


def _row(fruit: FruitEntry) -> dict[str, object]:
    """A fruit's cells by column. New columns go to the end: programs read columns by name and by place."""
    judged = fruit.verdicts[-1] if fruit.verdicts else None
    return {
        "rank": fruit.rank,
        "fruit_id": fruit.fruit_id,
        "outcome": fruit.outcome,
        "E_MPa": _significant(fruit.E_MPa, figures=4),
        "E_sd_MPa": _significant(fruit.E_sd_MPa, figures=3),
        "maturity": fruit.maturity,
        "maturity_probability": _decimals(fruit.maturity_probability, places=4),
        "p_softer_than_next": _decimals(fruit.p_softer_than_next, places=4),
        "height_mm": _decimals(fruit.height_mm, places=2),
        "volume_mm3": _decimals(fruit.volume_mm3, places=0),
        "grasps": fruit.grasps,
        "shore_oo": _decimals(fruit.shore_oo, places=2),
        "mismatch": fruit.mismatch or (fruit.screen.verdict if fruit.screen else None),
        "reason": fruit.reason,
        "rank_probability": _decimals(fruit.rank_probability, places=4),
        "rank_low": fruit.rank_low,
        "rank_high": fruit.rank_high,
        "warnings": "; ".join([*fruit.doubts, *fruit.warnings]),
        "doubts": "; ".join(fruit.doubts),
        "reference": "true" if fruit.reference else None,
        "E_uncorrected_MPa": _significant(fruit.E_uncorrected_MPa, figures=4),
        "mismatch_by": _said_by(fruit),
        "screen": fruit.screen.verdict if fruit.screen else None,
        "screen_p": _significant(fruit.screen.p_value, figures=2) if fruit.screen else None,
        "decision": fruit.decision,
        "decision_reason": fruit.decision_reason.replace("\u00a0", " "),
        "E_scale_sd_MPa": _significant(fruit.E_scale_sd_MPa, figures=3),
        "judged_class": judged.judged_class if judged else None,
        "judged_by": judged.by if judged else None,
        "judged_why": judged.why if judged else None,
        "judged_utc": judged.at_utc.strftime("%Y-%m-%dT%H:%M:%SZ") if judged else None,
        "judged_E_MPa": _significant(judged.E_MPa, figures=4) if judged else None,
        "judged_earlier": "true" if judged and judged.earlier else None,
        "E_at_pulp_MPa": _significant(fruit.E_at_pulp_MPa, figures=4),
        "E_at_pulp_sd_MPa": _significant(fruit.E_at_pulp_sd_MPa, figures=3),
    }


def _significant(value: float | None, *, figures: int) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.{figures}g}")


def _decimals(value: float | None, *, places: int) -> float | int | None:
    if value is None or not math.isfinite(value):
        return None
    return round(value, places) if places else round(value)


RANKING_COLUMNS = tuple(_row(FruitEntry(fruit_id="", ok=False, outcome="")))
"""The columns, in order."""
