"""Interface of the catalogue's effects: specification, linear signatures, full response.

The plain model of one recording, marker by marker (fem.estimation.compliance_fit):

    y(t) = X + s c(t) + R q(t) + g d(t) + noise,        sum of the pads' forces and moments = 0

An effect changes c, adds to y, or unbalances the forces. To add physics to the finder, add a file to
fem/mismatch/effects that defines one such object as EFFECT.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import LinearInForces
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.result import Where
from fem.mismatch.signature_variant import ONE_WAY, Variant

Parameters: TypeAlias = Mapping[str, float]
"""Values of an effect's searched parameters, by name."""
Amounts: TypeAlias = Float[np.ndarray, " k"]
"""Amounts of a signature's columns."""


class Prior(NamedTuple):
    """Normal prior of a parameter: its mean, and the standard deviation on the scale searched (relative where
    `log`). It is half-normal if the mean is at the parameter's lower bound or below. One that was `measured`
    holds the parameter; others state its usual size, which real effects exceed, and do not.
    """

    mean: float
    sd: float
    measured: bool = False


@dataclass(frozen=True, kw_only=True)
class Signature:
    """One way in which an effect can appear, linear in the amounts of its columns.

    `variant` distinguishes alternatives (a relaxation time, a pad). `untried`: reason why the signature could
    not be computed, a sentence without a full stop; there are no columns then.
    """

    variant: Variant
    columns: tuple[Regressor, ...]
    untried: str = ""

    @classmethod
    def of_markers(
        cls,
        name: str,
        markers_mm: Fields,
        *,
        sd: float,
        variant: Variant = ONE_WAY,
        positive: bool = False,
        least: float = 0.0,
        of_forces: LinearInForces | None = None,
    ) -> "Signature":
        """A signature of one amount that moves every recording's markers; options as of Regressor."""
        column = Regressor(
            name=name,
            sd=sd,
            fields=[ObservationDelta(markers=field_mm) for field_mm in markers_mm],
            positive=positive,
            least=least,
            of_forces=of_forces,
        )
        return cls(variant=variant, columns=(column,))


@dataclass(frozen=True, kw_only=True)
class Response:
    """An effect's prediction of all recordings, linear in its parameters or not; one entry per recording.

    `unit`: the markers' displacement for E = 1 MPa, which replaces c; the plain model's own
    (`tracks.unit_displacement`) if the effect does not change it. `shift_mm`: shift of their recorded
    positions, independent of E, or None. `balance`: predicted sum of force (N) and moment (N mm over ARM_MM)
    of all pads, or None for zero. `rest`: predicted zero drift of each pad's normal force, N/s, or None for
    zero.
    """

    unit: Fields
    shift_mm: Fields | None = None
    balance: Sequence[Float[np.ndarray, "_f 6"]] | None = None
    rest: Sequence[Float[np.ndarray, " _p"]] | None = None

    def change(self, model: CaseModel, grasp: int) -> ObservationDelta:
        """Change that it makes to the plain model's prediction of one recording."""
        markers = model.compliance * (self.unit[grasp] - model.plain[grasp])
        return ObservationDelta(
            markers=markers if self.shift_mm is None else markers + self.shift_mm[grasp],
            balance=None if self.balance is None else self.balance[grasp],
            rest=None if self.rest is None else self.rest[grasp],
        )

    def column(
        self,
        model: CaseModel,
        name: str,
        *,
        sd: float,
        per: float = 1.0,
        positive: bool = False,
        least: float = 0.0,
        measured: float = 0.0,
        measured_sd: float = 0.0,
    ) -> Regressor:
        """Its change as a column. The change is that of an amount `per`; options as of Regressor."""
        fields = [ObservationDelta().plus(1 / per, self.change(model, k)) for k in range(len(self.unit))]
        return Regressor(
            name=name,
            sd=sd,
            fields=fields,
            positive=positive,
            least=least,
            measured=measured,
            measured_sd=measured_sd,
        )

    @classmethod
    def plain(
        cls,
        model: CaseModel,
        change: Fields | None = None,
        *,
        shift_mm: Fields | None = None,
        balance: Sequence[Float[np.ndarray, "_f 6"]] | None = None,
        rest: Sequence[Float[np.ndarray, " _p"]] | None = None,
    ) -> "Response":
        """The plain model's response, with `change` (mm MPa) added to each recording's displacement."""
        unit = model.plain
        if change is not None:
            unit = [plain + more for plain, more in zip(unit, change, strict=True)]
        return cls(unit=unit, shift_mm=shift_mm, balance=balance, rest=rest)


def superposed(model: CaseModel, responses: Sequence[Response]) -> Response:
    """One response with the sum of all changes, which are small."""

    def summed(channel: str, grasp: int, nothing: np.ndarray) -> np.ndarray:
        known = (getattr(response, channel) for response in responses)
        return np.asarray(sum((fields[grasp] for fields in known if fields is not None), nothing))

    grasps = range(len(model.grasps))
    plain = model.plain
    pads = [len(recording.links) for recording in model.grasps]
    return Response(
        unit=[plain[k] + sum(response.unit[k] - plain[k] for response in responses) for k in grasps],
        shift_mm=[summed("shift_mm", k, np.zeros_like(plain[k])) for k in grasps],
        balance=[summed("balance", k, np.zeros((len(plain[k]), 6))) for k in grasps],
        rest=[summed("rest", k, np.zeros(pads[k])) for k in grasps],
    )


@dataclass(frozen=True, kw_only=True)
class Effect(ABC):
    """One effect; `spec`: its specification.

    `seen_directly`: the recordings alone show it, whatever the fruit is. Its signature has no columns if its
    response is the plain model's. `says_more`: it has an auxiliary likelihood, from other data than the
    markers' motion.
    """

    spec: EffectSpec
    seen_directly: ClassVar[bool] = False
    says_more: ClassVar[bool] = False

    @abstractmethod
    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """Its linear signatures about the plain model: alternatives. At most one is true."""

    @abstractmethod
    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The full response at these parameters; `variant` is that of the signature that found the effect."""

    def at_small_strain(self, model: CaseModel) -> Fields | None:
        """-K0^-1 D U, mm: the one signature, of one column, at small strain, of an effect that adds theta D
        to the flesh's stiffness K0. None for other effects.
        """
        return None

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The parameters that correspond to a signature's fitted amounts, within their bounds. They are the
        amounts themselves unless the effect overrides this.
        """
        return self.spec.within_bounds(*amounts)

    def other_start(self, model: CaseModel, variant: Variant) -> dict[str, float] | None:
        """A second start of the search; None if only the linear round gives one."""
        return None

    def auxiliary_log_likelihood(self, model: CaseModel, parameters: Parameters, variant: Variant) -> float:
        """ln likelihood ratio to the plain model of data other than the markers' motion; it counts for no
        more than the motion does.
        """
        return 0.0

    def direct_evidence(self, model: CaseModel) -> float:
        """ln likelihood ratio of its direct evidence, effect to no effect; it counts in full."""
        return 0.0

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """Priors of searched parameters, as wide as those of the signature's amounts; by default the amounts
        are the parameters. A parameter without one has the prior of its bounds (EffectParameter.spread). An
        effect that overrides `start` overrides this, too.
        """
        return {
            spec.name: Prior(0.0, column.sd)
            for spec, column in zip(self.spec.searched, signature.columns, strict=True)
        }

    def where(self, parameters: Parameters) -> Where | None:
        """Its place in the fruit; None if it has no place."""
        return None
