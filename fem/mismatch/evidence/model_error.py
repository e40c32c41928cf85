"""The model's own error, as fruit without mismatch show it in the coordinates of the effects.

No model is exact: with every effect absent its residual still resembles small amounts of several effects at
once. These vectors of apparent amounts, one for each simulated recording set without mismatch, are samples of
the model's error (Kaipio and Somersalo 2007, Statistical and Computational Inverse Problems, section 7). Each
is one column of the plain model with a standard deviation of one over the root of their number, so that the
error's covariance is that of the samples. An effect counts for what it explains beyond them.

`model_error.csv` holds the vectors; `benchmarks/model_error.py` makes it. Amounts grow as the flesh's
compliance over the gel's to the power GROWTH: they are stored for a ratio of one.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor

FILE = "model_error.csv"
GROWTH = 2.0
"""Power of the compliance ratio with which apparent amounts grow."""


def signature_keys(signatures: Iterable[tuple[Effect, Signature]]) -> list[str]:
    """A key for every column of the signatures: effect, number of the signature among its own, component.

    The labels of some signatures follow the fruit; their order in an effect does not.
    """
    count: dict[str, int] = {}
    keys = []
    for effect, signature in signatures:
        name = effect.spec.name
        number = count.get(name, 0)
        count[name] = number + 1
        keys += [f"{name} {number} {k}" for k in range(len(signature.columns))]
    return keys


@cache
def known_vectors() -> Mapping[str, Float[np.ndarray, " v"]]:
    """The vectors that are shipped: of each key its amount in every one, for a compliance ratio of one."""
    text = (files("fem.mismatch.evidence") / FILE).read_text("utf-8")
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))
    return {row[0]: np.array(row[1:], dtype=float) for row in rows[1:]}


def model_error_columns(
    columns: Sequence[Regressor],
    keys: Mapping[str, int],
    *,
    compliance_ratio: float,
    known: Mapping[str, Float[np.ndarray, " v"]] | None = None,
) -> list[Regressor]:
    """One column for each vector, a sum of the signatures' columns.

    `columns`: of the case, counted from one as GramMatrix does; `keys`: which of them has which key.
    """
    vectors = known_vectors() if known is None else known
    here = {key: at for key, at in keys.items() if key in vectors}
    if not here:
        return []
    amounts = np.stack([vectors[key] for key in here]) * compliance_ratio**GROWTH
    count = amounts.shape[1]
    return [
        Regressor(
            name=f"model error {v}",
            sd=1 / np.sqrt(count),
            fields=_summed([columns[at - 1] for at in here.values()], amounts[:, v]),
            combines=tuple(zip(here.values(), amounts[:, v].tolist(), strict=True)),
        )
        for v in range(count)
    ]


def _summed(columns: Sequence[Regressor], amounts: Float[np.ndarray, " c"]) -> list[ObservationDelta | None]:
    """The sum of the columns' fields in these amounts, recording by recording and channel by channel."""
    fields: list[ObservationDelta | None] = []
    for k in range(len(columns[0].fields)):
        totals: dict[str, np.ndarray] = {}
        for column, amount in zip(columns, amounts, strict=True):
            field = column.fields[k]
            for channel in ("markers", "balance", "rest"):
                part = None if field is None else getattr(field, channel)
                if part is not None:
                    totals[channel] = totals.get(channel, 0.0) + amount * part
        fields.append(ObservationDelta(**totals) if totals else None)
    return fields
