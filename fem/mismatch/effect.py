"""What every effect of the catalogue is: its specification, linear signatures, a full response.

The plain model of one recording, marker by marker (fem.estimation.compliance_fit):

    y(t) = X + s c(t) + R q(t) + g d(t) + noise,        sum of the pads' forces and moments = 0

An effect changes c, adds to y, or unbalances the forces. Adding physics to the finder is adding a file to
fem/mismatch/effects that holds one such object as EFFECT.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.model.force_products import LinearInForces
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.result import Where
from fem.mismatch.signature_variant import ONE_WAY, Variant


@dataclass(frozen=True, kw_only=True)
class Signature:
    """One way in which an effect can show, linear in the amounts of its columns.

    `variant` tells alternatives apart (a relaxation time, a pad). `untried`: why it could not be computed, a
    sentence without a full stop; it has no columns then.
    """

    variant: Variant
    columns: tuple[Regressor, ...]
    untried: str = ""

    @property
    def label(self) -> str:
        """The variant in words."""
        return self.variant.label

    @classmethod
    def of_markers(
        cls,
        name: str,
        markers_mm: Sequence[Float[np.ndarray, "_f _n 3"]],
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

    unit: Sequence[Float[np.ndarray, "_f _n 3"]]
    shift_mm: Sequence[Float[np.ndarray, "_f _n 3"]] | None = None
    balance: Sequence[Float[np.ndarray, "_f 6"]] | None = None
    rest: Sequence[Float[np.ndarray, " _p"]] | None = None

    def change(self, forward: ForwardModel, grasp: int) -> ObservationDelta:
        """What it adds to the plain model's prediction of one recording."""
        plain = forward.base.grasps[grasp].tracks.unit_displacement
        markers = forward.compliance * (self.unit[grasp] - plain)
        return ObservationDelta(
            markers=markers if self.shift_mm is None else markers + self.shift_mm[grasp],
            balance=None if self.balance is None else self.balance[grasp],
            rest=None if self.rest is None else self.rest[grasp],
        )

    @classmethod
    def plain(
        cls,
        forward: ForwardModel,
        change: Sequence[Float[np.ndarray, "_f _n 3"]] | None = None,
        *,
        shift_mm: Sequence[Float[np.ndarray, "_f _n 3"]] | None = None,
        balance: Sequence[Float[np.ndarray, "_f 6"]] | None = None,
        rest: Sequence[Float[np.ndarray, " _p"]] | None = None,
    ) -> "Response":
        """The plain model's, with `change` (mm MPa) added to each recording's displacement."""
        unit = [recording.tracks.unit_displacement for recording in forward.base.grasps]
        if change is not None:
            unit = [plain + more for plain, more in zip(unit, change, strict=True)]
        return cls(unit=unit, shift_mm=shift_mm, balance=balance, rest=rest)


def superposed(forward: ForwardModel, responses: Sequence[Response]) -> Response:
    """One response with the changes of all: small changes add up."""

    def summed(channel: str, grasp: int, nothing: np.ndarray) -> np.ndarray:
        known = (getattr(response, channel) for response in responses)
        return np.asarray(sum((fields[grasp] for fields in known if fields is not None), nothing))

    grasps = range(len(forward.base.grasps))
    plain = [recording.tracks.unit_displacement for recording in forward.base.grasps]
    pads = [len(recording.links) for recording in forward.base.grasps]
    return Response(
        unit=[plain[k] + sum(response.unit[k] - plain[k] for response in responses) for k in grasps],
        shift_mm=[summed("shift_mm", k, np.zeros_like(plain[k])) for k in grasps],
        balance=[summed("balance", k, np.zeros((len(plain[k]), 6))) for k in grasps],
        rest=[summed("rest", k, np.zeros(pads[k])) for k in grasps],
    )


class Effect(Protocol):
    """One missing physics."""

    @property
    def spec(self) -> EffectSpec:
        """All that it states of itself."""
        ...

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Its linear signatures about the plain model: alternatives, of which at most one holds."""
        ...

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The parameters that the amounts found with a signature stand for, within their bounds."""
        ...

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The full response at these parameters; `variant` is that of the signature it was found with."""
        ...


@runtime_checkable
class AuxiliaryLikelihood(Protocol):
    """An effect of which more is known than the markers' motion says."""

    def auxiliary_log_likelihood(
        self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant
    ) -> float:
        """ln likelihood of that, over the plain model's; counts for as much as the motion itself at most."""
        ...


@runtime_checkable
class SeenDirectly(Protocol):
    """An effect that the recordings show by themselves, whatever the fruit is; its signature has no columns
    where its response is the plain model's.
    """

    def direct_evidence(self, forward: ForwardModel) -> float:
        """ln likelihood of its marks over that of none; it counts in full."""
        ...

    def measured_sd(self, forward: ForwardModel) -> dict[str, float]:
        """Standard deviation of each number that is searched, as measured with it: the search's prior about
        its start.
        """
        ...


@runtime_checkable
class LinearInStiffness(Protocol):
    """An effect that adds theta D to the flesh's stiffness K0; its one signature is -K0^-1 D U."""

    @property
    def derivative(self) -> Callable[[ForwardModel], Callable[[np.ndarray], np.ndarray]]:
        """D at the plain law: forces on the nodes (fields, n, 3) of displacements of these."""
        ...

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """None where the fruit has no such effect."""
        ...


@runtime_checkable
class Placed(Protocol):
    """An effect that has a place of its own in the flesh."""

    def where(self, parameters: Mapping[str, float]) -> Where:
        """The place."""
        ...


@runtime_checkable
class StartsElsewhere(Protocol):
    """An effect whose parameters show in some other way than in the linear round."""

    def other_start(self, forward: ForwardModel, variant: Variant) -> dict[str, float] | None:
        """Where the search may start as well; None where nothing else shows."""
        ...
