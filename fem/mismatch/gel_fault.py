"""Effects of a gel or its reading that appear in the relation of force to the gel's displacement.

A law (fem.mismatch.evidence.gel_relation.GelLaw) maps true force and displacement to recorded
ones. The fit of this relation gives the evidence for the law, and the prior of its amounts. But a gel may
truly behave so, and be read correctly. Two fits of the flesh separate the cases
(fem.mismatch.selection.decision): one without and one with the law inverted,

    y - shift(theta) = X + s c(f_true(theta)) + ...

f_true drives the model as recorded forces do
(fem.estimation.prepared_grasp), which derives most of them from the displacement already.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeGuard

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.prepared_grasp import prepared_grasp
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.evidence.gel_relation import (
    GelLaw,
    GelRecord,
    RelationFit,
    fit_law,
    gel_records,
)
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.signature_variant import ONE_WAY, Variant

KEPT, NO_FORCE_N = 1e-3, 1e-9
"""Relative and absolute (N) limits below which singular values of a change of forces are dropped."""
HELD = 0.01
"""Prior standard deviation of an amount in the fit of the flesh over that of the relation: it is nearly
fixed. For a nonlinearity of 0.28 in soft flesh, the flesh's equations alone would give 0.20. So evidence may
be a little low, and error bars take the standard deviation of the relation."""


@dataclass(frozen=True, kw_only=True)
class GelFault(Effect):
    """A `law` with the priors of its parameters about no fault. `amounts`: parameters that are zero without
    the fault and enter linearly to first order. `others`: start values of the remaining parameters.
    """

    seen_directly = True
    law: GelLaw
    amounts: tuple[str, ...]
    prior_sd: Mapping[str, float]
    others: Mapping[str, float] = field(default_factory=dict)

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One, if the relation determines the fault: the change per measured amount, which it then has."""
        measured = self.measured(model)
        if measured is None:
            return []
        nothing = {**measured.values, **dict.fromkeys(self.amounts, 0.0)}
        columns = []
        for name in self.amounts:
            amount, sd = measured.values[name], measured.sd[name]
            there = self.respond(model, {**nothing, name: amount}, ONE_WAY)
            columns.append(
                there.column(model, name, sd=HELD * sd, per=amount or 1.0, measured=amount, measured_sd=sd)
            )
        return [Signature(variant=ONE_WAY, columns=tuple(columns))]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The measured values."""
        measured = self.measured(model)
        measured_values = {} if measured is None else measured.values
        linear = dict(zip(self.amounts, amounts, strict=True))
        values = {**self.others, **linear, **measured_values}
        return self.spec.within_bounds(*(values[spec.name] for spec in self.spec.searched))

    @property
    def of_the_relation(self) -> bool:
        """Whether the force-displacement relation shows it; otherwise it is measured in another way."""
        return True

    def direct_evidence(self, model: CaseModel) -> float:
        """Evidence of the relation; zero if it does not determine the fault."""
        measured = self.measured(model)
        return 0.0 if measured is None else measured.evidence

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The start, with HELD times the standard deviation of the relation. The flesh's equations determine
        the gel less well, and their own model error would change it.
        """
        start = self.start(model, signature, np.zeros(len(self.amounts)))
        return {
            name: Prior(start[name], HELD * sd, measured=True) for name, sd in self.relation_sd(model).items()
        }

    def relation_sd(self, model: CaseModel) -> dict[str, float]:
        """Standard deviation of each parameter from the relation, on the search's scale."""
        measured = self.measured(model)
        assert measured is not None, "asked only where it is seen"
        return {
            spec.name: measured.sd[spec.name] / (measured.values[spec.name] if spec.log else 1.0)
            for spec in self.spec.searched
        }

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The flesh under the forces with the law inverted, and places shifted by what the law added."""
        key = (self.spec.name, *sorted(parameters.items()))
        return model.memoised(key, partial(self._respond, model, parameters))

    def _respond(self, model: CaseModel, parameters: Mapping[str, float]) -> Response:
        unit, shift, balance, rest = [], [], [], []
        for recording in model.grasps:
            records = [record for record in self.records(model) if record.grasp == recording.case.name]
            true = [self.law.undone(record, parameters) for record in records]
            change, shifted = _undone(recording, records, true)
            unit.append(recording.tracks.unit_displacement - _response(model, recording, change))
            balance.append(recording.wrench(change))
            shift.append(shifted)
            rest.append(
                np.array(
                    [
                        drift_between(record.time_s, record.air, record.total_N - true_record.total_N)
                        for record, true_record in zip(records, true, strict=True)
                    ]
                )
            )
        return Response(unit=unit, shift_mm=shift, balance=balance, rest=rest)

    def measured(self, model: CaseModel) -> RelationFit | None:
        """The law's parameters from force against displacement; memoised for the case."""
        return model.memoised(
            ("gel relation", self.spec.name), lambda: self.fitted(model, self.records(model))
        )

    def records(self, model: CaseModel) -> tuple[GelRecord, ...]:
        """Records to which the law is fitted, without zero drift, which bends the relation as a law does."""
        return tuple(record.without_zero_drift() for record in gel_records(model))

    def fitted(self, model: CaseModel, records: Sequence[GelRecord]) -> RelationFit | None:
        """The law's parameters from these records; None if the records do not determine them."""
        budget = model.case.budget
        start = {name: 0.1 * self.prior_sd[name] for name in self.amounts}
        return fit_law(
            records,
            self.law,
            start={**start, **self.others},
            prior_sd=self.prior_sd,
            bounds={spec.name: (spec.low, spec.high) for spec in self.spec.searched},
            scale_sd=float(np.hypot(budget.gel_scale_sd, budget.force_scale_sd)),
        )


def is_of_relation(effect: Effect) -> TypeGuard[GelFault]:
    """Whether it is a gel fault that appears in force against displacement."""
    return isinstance(effect, GelFault) and effect.of_the_relation


def _undone(
    recording: GraspResponse, records: Sequence[GelRecord], true: Sequence[GelRecord]
) -> tuple[Float[np.ndarray, "f n 3"], Float[np.ndarray, "f n 3"]]:
    """What the fault adds to the model's driving forces, N, and to the places, mm, in the frames used."""
    history, pads, shifts = recording.case.history, [], []
    for pad, record, true_record in zip(history.pads, records, true, strict=True):
        force, moved = (
            np.einsum("tij,tnj->tni", record.turn, had - has)
            for had, has in (
                (record.force_N, true_record.force_N),
                (record.displacement_mm, true_record.displacement_mm),
            )
        )
        pads.append(
            replace(
                pad,
                force_N=pad.force_N - force,
                gel_displacement_mm=pad.gel_displacement_mm - moved,
                position_mm=pad.position_mm - moved,
            )
        )
        shifts.append(moved)
    prepared = prepared_grasp(replace(history, pads=tuple(pads)), recording.case.turns).history
    driving, driven = (
        np.concatenate([pad.force_N for pad in grasp.pads], axis=1)
        for grasp in (recording.prepared, prepared)
    )
    change = driving - driven
    return change[recording.used], np.concatenate(shifts, axis=1)[recording.used]


def _response(
    model: CaseModel, recording: GraspResponse, force_N: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "f n 3"]:
    """Displacement (times E) of the markers under forces of low rank in time, mm MPa."""
    left, size, right = np.linalg.svd(force_N.reshape(len(force_N), -1), full_matrices=False)
    kept = size > max(KEPT * float(size[0]), NO_FORCE_N)
    if not kept.any():
        return np.zeros_like(force_N)
    patterns = right[kept].reshape(-1, *force_N.shape[1:])
    answer = recording.response_to(patterns)
    return np.asarray(np.tensordot(left[:, kept] * size[kept], answer, axes=1))


def drift_between(
    time_s: Float[np.ndarray, " t"], air: Bool[np.ndarray, " t"], total_N: Float[np.ndarray, " t"]
) -> float:
    """Mean after the contact minus that before it, over the time between, without the frames adjacent to the
    contact; zero if either side has no frames.
    """
    touched = np.flatnonzero(~air)
    if not len(touched):
        return 0.0
    before, after = np.arange(touched[0] - 1), np.arange(touched[-1] + 2, len(air))
    if not (len(before) and len(after)):
        return 0.0
    return float(
        (total_N[after].mean() - total_N[before].mean()) / (time_s[after].mean() - time_s[before].mean())
    )
