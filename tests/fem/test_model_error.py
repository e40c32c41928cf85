"""The model's own error: so much of an effect is no finding, more is; an effect's model has its share."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect import Response, Signature
from fem.mismatch.evidence.effect_error import MODEL_ERROR, effect_error_columns
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
    forward = SimpleNamespace(compliance=COMPLIANCE, compliance_ratio=ratio, workers=1)
    return GramMatrix(forward, [Recording(position, unit)], [column, *errors])


def gain(found: GramMatrix) -> float:
    errors = tuple(range(2, len(found.columns)))
    return found.fit((*errors, 1)).log_evidence - found.fit(errors).log_evidence


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
    variances = [sum(column.sd**2 for column in found.columns[2:]) for found in (single, several)]
    assert variances[0] == pytest.approx(variances[1])
    assert gain(several) == pytest.approx(gain(single), abs=1e-6)


def test_a_column_of_the_error_has_the_products_of_its_signature():
    found = products(0.2, share=0.02)
    at = {int(j): row + 1 for row, j in enumerate(found.rows[0])}
    np.testing.assert_array_equal(found.products[0][at[2]], found.products[0][at[1]])
    np.testing.assert_array_equal(found.weighed[0][at[2]], found.weighed[0][at[1]])


def test_the_shipped_shares_are_of_known_effects():
    assert model_error_shares().keys() <= SPECS.keys()
    assert all(0 < share < 0.5 for share in model_error_shares().values())


def test_an_effects_model_that_is_off_by_its_stated_share_leaves_nothing_to_a_second_effect():
    """The truth is the model's change times a factor of the load: the second column is that product."""
    rng = np.random.default_rng(5)
    unit, change = rng.normal(size=SHAPE), 20 * NOISE_MM * rng.normal(size=SHAPE)
    change -= (change * unit).sum() / (unit**2).sum() * unit  # what 1/E takes up is no error of the effect
    place = np.random.default_rng(8).normal(size=SHAPE[1:])
    factor = 2 * np.linspace(0.2, 1.0, SHAPE[0])[:, None, None] - 1
    share = MODEL_ERROR["object"]
    truth = 10 * change * (1 + 2 * share * factor)
    position = place + COMPLIANCE * unit + truth + NOISE_MM * rng.normal(size=SHAPE)
    recording = Recording(position, unit)
    forward = SimpleNamespace(
        compliance=COMPLIANCE, workers=1, base=SimpleNamespace(grasps=[recording.recording])
    )
    response = Response(unit=[unit + 10 * change / COMPLIANCE])
    errors = effect_error_columns(forward, [recording], response, share=share)
    effect = Regressor(name="first", sd=4.0, fields=[ObservationDelta(markers=10 * change)])
    second = Regressor(name="second", sd=4.0, fields=[ObservationDelta(markers=change * factor)])
    found = GramMatrix(forward, [recording], [effect, second, *errors])

    def added(kept: tuple[int, ...]) -> float:
        return found.fit((1, *kept, 2)).log_evidence - found.fit((1, *kept)).log_evidence

    assert added(()) > 30
    assert added(tuple(range(3, len(found.columns)))) < 3
