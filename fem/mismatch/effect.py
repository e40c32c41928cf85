"""What every effect of the catalogue is: a name, parameters, a linear signature, a nonlinear model.

The plain model of one recording, marker by marker (fem.estimation.compliance_fit):

    y(t) = X + s c(t) + R q(t) + g d(t) + noise,        sum of the pads' forces and moments = 0

An effect changes c, adds to y, or unbalances the forces. Adding physics to the finder is adding a file to
fem/mismatch/effects that holds one such object, and its name to fem.mismatch.catalogue.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.result import Parameter

Family = Literal["object", "interaction", "measurement"]


@dataclass(frozen=True, kw_only=True)
class ParameterSpec:
    """One parameter: its name and unit as in an answer, and what it lies between.

    `log`: it is searched for on a logarithmic scale. `spread`: its prior standard deviation, a quarter of the
    bounds' distance unless given. `model_sd` (its unit) and `model_share` (of its value): how far off the
    model's own error leaves it, however low the noise: the scatter about the truth over single effects by
    another solver (benchmarks/results/mismatch.csv), which no nuisance stands for. A vector's components are
    parameters of their own, named "offset_mm.0" and so on; an answer joins them again. `strain_power`: as
    forces are what is measured, strains grow as 1/E, and what the law sees of the parameter (searched on a
    logarithmic scale) is its ratio to (1/E)^strain_power. `low_is_a_law`: a fit at the lower end is no sign
    that the effect stands for something else.
    """

    name: str
    unit: str
    low: float
    high: float
    log: bool = False
    spread: float | None = None
    model_sd: float = 0.0
    model_share: float = 0.02
    strain_power: float = 0.0
    low_is_a_law: bool = False

    def __post_init__(self) -> None:
        if self.strain_power and not self.log:
            raise ValueError(f"{self.name}: a strain_power is for parameters on a logarithmic scale")


@dataclass(frozen=True, kw_only=True)
class Signature:
    """One way in which an effect can show, linear in the amounts of its columns.

    `label` tells alternatives apart ("tau 1 s", "left"); an effect that has one way only has an empty one.
    `apart`: what it gains on sound recordings is its own, not that of the effect's other ways. `untried`: why
    it could not be computed, a sentence without a full stop; it has no columns then.
    """

    label: str
    columns: tuple[Regressor, ...]
    apart: bool = False
    untried: str = ""


@dataclass(frozen=True, kw_only=True)
class Response:
    """What the nonlinear model makes of all recordings, one entry per recording.

    `unit`: the markers' displacement for E = 1 MPa, in the place of c. `shift_mm`: what is added to their
    recorded positions, or None. `balance`: what force and moment of all pads should add up to (fields), or
    None for zero.
    """

    unit: Sequence[Float[np.ndarray, "f n 3"]]
    shift_mm: Sequence[Float[np.ndarray, "f n 3"]] | None = None
    balance: Sequence[Float[np.ndarray, "f 6"]] | None = None
    rest: Sequence[Float[np.ndarray, " p"]] | None = None


class Effect(Protocol):
    """One missing physics."""

    name: str
    family: Family
    parameters: tuple[ParameterSpec, ...]

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Its linear signatures about the plain model: alternatives, of which at most one holds."""
        ...

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The parameters that the amounts found with a signature stand for, within their bounds."""
        ...

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
        """The nonlinear model; `choice` is the label of the signature it was found with (a pad, a side)."""
        ...


@runtime_checkable
class AuxiliaryLikelihood(Protocol):
    """An effect of which more is known than the markers' motion says."""

    def beside(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> float:
        """ln likelihood of that, over the plain model's; counts for as much as the motion itself at most."""
        ...


@runtime_checkable
class Remarked(Protocol):
    """An effect that needs a word more than its name at some parameters."""

    def remark(self, parameters: Mapping[str, Parameter]) -> str:
        """A sentence that a reader must know of such parameters; empty where there is none."""
        ...


@runtime_checkable
class StartsElsewhere(Protocol):
    """An effect whose parameters show in some other way than in the linear round."""

    def other_start(self, forward: ForwardModel, choice: str) -> dict[str, float] | None:
        """Where the search may start as well; None where nothing else shows."""
        ...
