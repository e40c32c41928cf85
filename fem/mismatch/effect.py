"""What every effect of the catalogue is: its specification, linear signatures, a full response.

The plain model of one recording, marker by marker (fem.estimation.compliance_fit):

    y(t) = X + s c(t) + R q(t) + g d(t) + noise,        sum of the pads' forces and moments = 0

An effect changes c, adds to y, or unbalances the forces. Adding physics to the finder is adding a file to
fem/mismatch/effects that holds one such object as EFFECT.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

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
"""Of an effect, by the names of its searched parameters."""
Amounts: TypeAlias = Float[np.ndarray, " k"]
"""Of a signature's columns."""


@dataclass(frozen=True, kw_only=True)
class Signature:
    """One way in which an effect can show, linear in the amounts of its columns.

    `variant` tells alternatives apart (a relaxation time, a pad). `untried`: why it could not be computed, a
    sentence without a full stop; it has no columns then.
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
        """One amount that moves the markers of every recording; the options are those of Regressor."""
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
    """What an effect predicts of all recordings, linear in its parameters or not; one entry per recording.

    `unit`: the markers' displacement for E = 1 MPa, in the place of c; the plain model's own
    (`tracks.unit_displacement`) where the effect does not change it. `shift_mm`: what is added to their
    recorded positions whatever E is, or None. `balance`: what force (N) and moment (N mm over ARM_MM) of all
    pads should add up to, or None for zero. `rest`: zero drift of each pad's normal force that is predicted,
    N/s, or None for zero.
    """

    unit: Fields
    shift_mm: Fields | None = None
    balance: Sequence[Float[np.ndarray, "_f 6"]] | None = None
    rest: Sequence[Float[np.ndarray, " _p"]] | None = None

    def change(self, model: CaseModel, grasp: int) -> ObservationDelta:
        """What it adds to the plain model's prediction of one recording."""
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
    ) -> Regressor:
        """Its change, which is that of `per` of the amount, as a column; options as of Regressor."""
        fields = [ObservationDelta().plus(1 / per, self.change(model, k)) for k in range(len(self.unit))]
        return Regressor(name=name, sd=sd, fields=fields, positive=positive, least=least)

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
        """The plain model's, with `change` (mm MPa) added to each recording's displacement."""
        unit = model.plain
        if change is not None:
            unit = [plain + more for plain, more in zip(unit, change, strict=True)]
        return cls(unit=unit, shift_mm=shift_mm, balance=balance, rest=rest)


def superposed(model: CaseModel, responses: Sequence[Response]) -> Response:
    """One response with the changes of all: small changes add up."""

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
    """One missing physics; `spec`: all that it states of itself.

    `seen_directly`: the recordings show it by themselves, whatever the fruit is; its signature has no columns
    where its response is the plain model's. `says_more`: more is known of it than the markers' motion says.
    """

    spec: EffectSpec
    seen_directly: ClassVar[bool] = False
    says_more: ClassVar[bool] = False

    @abstractmethod
    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """Its linear signatures about the plain model: alternatives, of which at most one holds."""

    @abstractmethod
    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The full response at these parameters; `variant` is that of the signature it was found with."""

    def at_small_strain(self, model: CaseModel) -> Fields | None:
        """Where it adds theta D to the flesh's stiffness K0: its one signature, of one column, at small
        strain: -K0^-1 D U, mm.
        """
        return None

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The parameters that the amounts found with a signature stand for, within their bounds: the amounts
        themselves, unless the effect says otherwise.
        """
        return self.spec.within_bounds(*amounts)

    def other_start(self, model: CaseModel, variant: Variant) -> dict[str, float] | None:
        """Where the search may start as well; None where nothing but the linear round shows."""
        return None

    def auxiliary_log_likelihood(self, model: CaseModel, parameters: Parameters, variant: Variant) -> float:
        """ln likelihood of what else is known, over the plain model's; counts for as much as the motion
        itself at most.
        """
        return 0.0

    def direct_evidence(self, model: CaseModel) -> float:
        """ln likelihood of its marks over that of none; it counts in full."""
        return 0.0

    def measured_sd(self, model: CaseModel) -> dict[str, float]:
        """Standard deviation of each number that is searched and was measured: the search's prior about its
        start.
        """
        return {}

    def where(self, parameters: Parameters) -> Where | None:
        """Its place in the fruit; None where it has none of its own."""
        return None
