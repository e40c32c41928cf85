"""The model's own error, in the coordinates of the effects.

No model is exact: with every effect absent its residual still resembles small amounts of some effects. A
signature of these is therefore also a column of the plain model, with mean zero and a standard deviation that
simulated fruit without mismatch show. An effect counts only for what exceeds it. This is the Bayesian
approximation error approach (Kaipio and Somersalo 2007, Inverse Problems 23, section 4) with a diagonal
covariance: the full one of few fruit has directions in which errors cancel that other fruit do not have.

`model_error.csv` has one share for each effect: the root mean square of its apparent amount over fruit
without mismatch, over the prior standard deviation of the amount and the compliance ratio of flesh to gel,
with which apparent amounts grow. It also has how much larger or smaller the error of one case may be
(fem.mismatch.evidence.error_scale). `benchmarks/mismatch_scores.py` measures both.
"""

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.error_scale import ScalePrior
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.signature_variant import OfPad

FILE = "model_error.csv"


SIZE, FREEDOM = "size of the scale", "freedom of the scale"
"""Rows of FILE that are no effect's."""


@cache
def _rows() -> Mapping[str, float]:
    text = (files("fem.mismatch.evidence") / FILE).read_text("utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return {row["effect"]: float(row["share"]) for row in rows}


def model_error_shares() -> Mapping[str, float]:
    """The shipped share of each effect."""
    return {name: share for name, share in _rows().items() if name not in (SIZE, FREEDOM)}


def scale_prior() -> ScalePrior:
    """The shipped prior of the error's scale."""
    return ScalePrior(size=_rows()[SIZE], freedom=_rows()[FREEDOM])


def model_error_columns(
    signatures: Sequence[tuple[Effect, Signature, tuple[int, ...]]],
    *,
    compliance_ratio: float,
    shares: Mapping[str, float] | None = None,
) -> list[Regressor]:
    """One column for each of the signatures', with its fields; alternatives of one effect, on one pad if the
    effect is a pad's, resemble each other and share its error.

    `signatures`: of a case, with the numbers of their columns.
    """

    def place(effect: Effect, signature: Signature) -> tuple[str, str]:
        variant = signature.variant
        return effect.spec.name, variant.pad if isinstance(variant, OfPad) else ""

    known = model_error_shares() if shares is None else shares
    count = Counter(place(effect, signature) for effect, signature, _ in signatures)
    return [
        replace(
            column,
            name=f"model error {effect.spec.name}",
            mean=0.0,
            sd=share * compliance_ratio * column.sd / np.sqrt(count[place(effect, signature)]),
            positive=False,
            of_forces=None,
            same_as=number,
        )
        for effect, signature, numbers in signatures
        if (share := known.get(effect.spec.name, 0.0)) > 0
        for column, number in zip(signature.columns, numbers, strict=True)
    ]
