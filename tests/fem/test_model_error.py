"""The model's own error: so much of an effect is no finding, more is."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect import Signature
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.evidence.model_error import model_error_columns, model_error_shares
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.signature_variant import ONE_WAY

SHAPE = (4, 12, 3)
NOISE_MM = 0.01
COMPLIANCE = 2.0


class Recording:
    """Markers with equal and independent noise on one pad."""

    def __init__(self, position_mm: np.ndarray, unit: np.ndarray) -> None:
        self.balance = None
        self.rest = ZeroDrifts(measured=np.zeros(0), weight=np.zeros(0))
        tracks = SimpleNamespace(
            unit_displacement=unit,
            place_mm=np.random.default_rng(8).normal(size=SHAPE[1:]),
            position_mm=position_mm,
            episode=np.zeros(SHAPE[:2], dtype=int),
        )
        self.recording = SimpleNamespace(
            tracks=tracks,
            load=np.linspace(0.2, 1.0, SHAPE[0]),
            pad_of_marker=np.zeros(SHAPE[1], dtype=int),
            links=(None,),
            pose=np.broadcast_to(np.eye(4), (1, SHAPE[0], 4, 4)),
        )

    def rows(self, fields) -> tuple[np.ndarray, np.ndarray]:
        plain = np.array([field.markers.ravel() for field in fields])
        return plain, plain / NOISE_MM**2


def products(amount: float, *, share: float, ratio: float = 1.0, ways: int = 1) -> GramMatrix:
    """Of data with so much of an effect, model error first among the nuisances; the effect's column last."""
    rng = np.random.default_rng(3)
    unit, field = rng.normal(size=SHAPE), rng.normal(size=SHAPE)
    column = Regressor(name="own", sd=4.0, fields=[ObservationDelta(markers=field)])
    signature = Signature(variant=ONE_WAY, columns=(column,))
    effect = SimpleNamespace(spec=SPECS["skin"])
    errors = model_error_columns(
        [(effect, signature, (1,))] * ways, compliance_ratio=ratio, shares={"skin": share}
    )
    place = np.random.default_rng(8).normal(size=SHAPE[1:])
    position = place + COMPLIANCE * unit + amount * field + NOISE_MM * rng.normal(size=SHAPE)
    model = SimpleNamespace(compliance=COMPLIANCE, compliance_ratio=ratio, workers=1)
    return GramMatrix(model, [Recording(position, unit)], [column, *errors])


def gain(matrix: GramMatrix) -> float:
    errors = tuple(range(2, len(matrix.columns)))
    return matrix.fit((*errors, 1)).log_evidence - matrix.fit(errors).log_evidence


def test_so_much_as_the_model_is_off_by_is_no_finding_and_ten_times_that_is():
    sd = 0.02 * 4.0
    assert gain(products(sd, share=0.02)) < 0
    assert gain(products(10 * sd, share=0.02)) > 30
    assert gain(products(sd, share=1e-9)) > 5


def test_the_softer_the_flesh_the_more_is_error():
    amount = 3 * 0.02 * 4.0
    assert gain(products(amount, share=0.02, ratio=3.0)) < 0.1 < gain(products(amount, share=0.02))


def test_alternatives_of_one_effect_share_its_error():
    single, several = (products(0.2, share=0.02, ways=ways) for ways in (1, 4))
    variances = [sum(column.sd**2 for column in matrix.columns[2:]) for matrix in (single, several)]
    assert variances[0] == pytest.approx(variances[1])
    assert gain(several) == pytest.approx(gain(single), abs=1e-6)


def test_a_column_of_the_error_has_the_products_of_its_signature():
    matrix = products(0.2, share=0.02)
    at = {int(j): row + 1 for row, j in enumerate(matrix.rows[0])}
    np.testing.assert_array_equal(matrix.products[0][at[2]], matrix.products[0][at[1]])
    np.testing.assert_array_equal(matrix.weighed[0][at[2]], matrix.weighed[0][at[1]])


def test_the_shipped_shares_are_of_known_effects():
    assert model_error_shares().keys() <= SPECS.keys()
    assert all(0 < share < 0.5 for share in model_error_shares().values())
