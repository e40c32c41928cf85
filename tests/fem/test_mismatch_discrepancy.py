"""What the model's own error looks like: such an amount is no finding, more of it is."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.estimation.zero_drift import ZeroDrifts
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect import Signature
from fem.mismatch.effect_spec import DiscrepancyPrior
from fem.mismatch.evidence.discrepancy_prior import (
    discrepancy_columns,
    discrepancy_spread,
)
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.selection.retained_columns import retained_columns
from fem.mismatch.signature_variant import ONE_WAY

SHAPE = (4, 12, 3)
NOISE_MM = 0.01


def effect(name: str) -> SimpleNamespace:
    return SimpleNamespace(spec=SPECS[name])


def prior(name: str) -> DiscrepancyPrior:
    found = SPECS[name].discrepancy
    assert found is not None
    return found


class Recording:
    """Markers with equal and independent noise."""

    def __init__(self, position_mm: np.ndarray, unit: np.ndarray) -> None:
        self.balance = None
        self.rest = ZeroDrifts(measured=np.zeros(0), weight=np.zeros(0))
        tracks = SimpleNamespace(
            unit_displacement=unit, place_mm=np.zeros(SHAPE[1:]), position_mm=position_mm
        )
        self.recording = SimpleNamespace(tracks=tracks)

    def rows(self, fields) -> tuple[np.ndarray, np.ndarray]:
        plain = np.array([field.markers.ravel() for field in fields])
        return plain, plain / NOISE_MM**2


def gain_of(name: str, *, amount: float, compliance_ratio: float = 1.0, compliance: float = 2.0) -> float:
    """ln evidence that an effect's signature adds where so much of it is in the data."""
    rng = np.random.default_rng(3)
    unit, field = rng.normal(size=SHAPE), rng.normal(size=SHAPE)
    position = compliance * unit + amount * field + NOISE_MM * rng.normal(size=SHAPE)
    forward = SimpleNamespace(compliance=compliance, compliance_ratio=compliance_ratio, workers=1)
    own = Regressor(name="own", sd=4.0, fields=[ObservationDelta(markers=field)], positive=True)
    columns = discrepancy_columns(forward, [(effect(name), Signature(variant=ONE_WAY, columns=(own,)))])
    products = GramMatrix(forward, [Recording(position, unit)], [*columns, own])
    nuisances = tuple(range(1, len(columns) + 1))
    return products.fit((*nuisances, len(columns) + 1)).log_evidence - products.fit(nuisances).log_evidence


@pytest.mark.parametrize("name", ["skin", "poisson_ratio"])
def test_the_discrepancy_amount_is_no_finding_and_ten_spreads_more_are(name):
    mean, sd = prior(name).mean, prior(name).sd
    assert gain_of(name, amount=mean) < 0
    assert gain_of(name, amount=mean + sd) < 0
    assert gain_of(name, amount=mean + 10 * sd) > 30


def test_jaws_seem_to_give_way_the_more_the_softer_the_flesh():
    soft = prior("gripper_compliance").sd * 4.0 * 3.0
    assert gain_of("gripper_compliance", amount=soft, compliance_ratio=3.0, compliance=4.0) < 0
    assert gain_of("gripper_compliance", amount=10 * soft, compliance_ratio=3.0, compliance=4.0) > 30


def test_an_effect_without_a_discrepancy_amount_counts_from_nothing():
    assert gain_of("clock_lag", amount=0.05) > 30


def test_a_strong_skin_is_refitted_without_its_own_discrepancy_and_less_surely():
    columns = [
        Regressor(name="1/E", sd=1.0, fields=[]),
        *(
            Regressor(name=f"discrepancy {name}", sd=1.0, fields=[], discrepancy_of=SPECS[name])
            for name in ("skin", "poisson_ratio")
        ),
    ]
    assert retained_columns([effect("skin")], columns, (1, 2)) == (2,)
    assert retained_columns([effect("poisson_ratio")], columns, (1, 2)) == (1, 2)
    assert discrepancy_spread(effect("skin")) == prior("skin").sd
    assert discrepancy_spread(effect("poisson_ratio")) == 0
