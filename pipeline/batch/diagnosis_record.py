"""The part of a fruit's mismatch.json (result of `drupe explain`) that grading reads."""

import math

from pydantic import BaseModel

from fem.mismatch.result import NONE, UNKNOWN, Modulus
from pipeline.batch.records import SuspectedRecord


class _NamedEffect(BaseModel):
    effect: str


class _Modulus(BaseModel):
    value: float | None = None
    sd: float | None = None


class _Moduli(BaseModel):
    before: _Modulus = _Modulus()
    after: _Modulus = _Modulus()


class DiagnosisRecord(BaseModel):
    """Key and result in a fruit's mismatch.json (drupe explain), as far as grading reads them."""

    key: str
    verdict: str | tuple[str, ...]
    ranking: tuple[_NamedEffect, ...]
    p_value: float | None = None
    p_nominal: str | None = None
    E_MPa: _Moduli = _Moduli()

    @property
    def names(self) -> tuple[str, ...]:
        """The verdict's names, the most likely first."""
        names = (self.verdict,) if isinstance(self.verdict, str) else self.verdict
        order = {hypothesis.effect: place for place, hypothesis in enumerate(self.ranking)}
        return tuple(sorted(names, key=lambda name: order.get(name, len(order))))

    @property
    def suspected(self) -> tuple[SuspectedRecord, ...]:
        """E with the verdict's effects; empty if the most likely name is no known effect, or E is missing."""
        if self.names[0] in (NONE, UNKNOWN):
            return ()
        effects = [name for name in self.names if name not in (NONE, UNKNOWN)]
        return suspected_of("|".join(effects), self.E_MPa.before, self.E_MPa.after)


def suspected_of(
    effect: str, before: Modulus | _Modulus, after: Modulus | _Modulus
) -> tuple[SuspectedRecord, ...]:
    """E with an effect over E without it; empty if either is not a positive number."""
    known = [
        estimate.value
        for estimate in (before, after)
        if estimate.value is not None and 0 < estimate.value < math.inf
    ]
    if len(known) < 2:
        return ()
    shares = [(estimate.sd or 0.0) / value for estimate, value in zip((before, after), known, strict=True)]
    added = math.sqrt(max(shares[1] ** 2 - shares[0] ** 2, 0.0))
    return (SuspectedRecord(effect=effect, E_ratio=known[1] / known[0], added_sd=added),)
