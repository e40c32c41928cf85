"""Equations of one recording: markers, balance, and zero drift, with its own nuisances eliminated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.evidence.nuisances import own_nuisances
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import BalanceEquations, MarkerEquations
from fem.mismatch.model.observation_delta import ObservationDelta
from fem.mismatch.model.plain_model import GraspResponse


@dataclass(frozen=True)
class GraspEquations:
    """One recording's equations: markers, balance if no base holds the fruit, and the pads' zero drift.

    The recording's own nuisances (fem.mismatch.evidence.nuisances) are eliminated too: `nuisances` is n,
    `nuisances_weighed` is W n, and `inverse` is (n . W n + L)^-1.
    """

    recording: GraspResponse
    markers: MarkerEquations
    balance: BalanceEquations | None
    rest: ZeroDrifts
    nuisances: Float[np.ndarray, "k d"]
    nuisances_weighed: Float[np.ndarray, "k d"]
    inverse: Float[np.ndarray, "k k"]

    @classmethod
    def of(
        cls, model: CaseModel, recording: GraspResponse, *, markers: MarkerEquations | None = None
    ) -> "GraspEquations":
        """The recording's equations; `markers`: in place of the model's marker_equations."""
        markers = model.marker_equations(recording) if markers is None else markers
        none = np.zeros((0, 0))
        balance = model.balance_equations(recording)
        bare = cls(
            recording,
            markers,
            balance,
            ZeroDrifts.of(recording.case.history, recording.pose[:, 0, :3, 2]),
            none,
            none,
            none,
        )
        nuisances = own_nuisances(model, recording)
        plain, weighed = bare.rows([field for _, _, field in nuisances])
        normal = weighed @ plain.T + np.diag([sd**-2.0 for _, sd, _ in nuisances])
        return replace(bare, nuisances=plain, nuisances_weighed=weighed, inverse=np.linalg.inv(normal))

    def flat(self, field: ObservationDelta | None) -> Float[np.ndarray, " d"]:
        """A field as a flat vector: markers in contact, sums of force, zero drifts."""
        touching, cut, end = self._ends()
        numbers = np.zeros(end + len(self.rest.measured))
        if field is not None and field.markers is not None:
            numbers[:cut] = field.markers[touching].ravel()
        if field is not None and field.balance is not None and self.balance is not None:
            numbers[cut:end] = field.balance.ravel()
        if field is not None and field.rest is not None:
            numbers[end:] = field.rest
        return numbers

    def _ends(self) -> tuple[Bool[np.ndarray, "f n"], int, int]:
        """Which markers touch, and the ends of markers and of force sums in a flat field."""
        touching = self.recording.touching
        cut = 3 * int(touching.sum())
        return touching, cut, cut + (0 if self.balance is None else self.balance.measured.size)

    def rows(self, fields: Sequence[ObservationDelta | None]) -> tuple[np.ndarray, np.ndarray]:
        """The fields phi and W phi, each as a flat vector."""
        _, cut, end = self._ends()
        width = end + len(self.rest.measured)
        plain, weighed = np.zeros((len(fields), width)), np.zeros((len(fields), width))
        for row, field in enumerate(fields):
            plain[row] = self.flat(field)
            if field is not None and field.balance is not None and self.balance is not None:
                weighed[row, cut:end] = self.balance.weighed(field.balance).ravel()
            if field is not None and field.rest is not None:
                weighed[row, end:] = self.rest.weight * field.rest
        weighed[:, :cut] = self.markers.weighed_in_contact(plain[:, :cut])
        if len(self.inverse):
            weighed -= (weighed @ self.nuisances.T) @ self.inverse @ self.nuisances_weighed
        return plain, weighed

    def weighed_markers(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """W phi at the markers, for a field phi of the markers; zero out of contact."""
        touching = self.recording.touching
        _, weighed = self.rows([ObservationDelta(markers=field)])
        weighed_field = np.zeros_like(field)
        weighed_field[touching] = weighed[0, : 3 * int(touching.sum())].reshape(-1, 3)
        return weighed_field
