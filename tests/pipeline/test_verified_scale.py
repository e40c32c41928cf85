"""A reference body takes the place of what is assumed of the sensor's scales; the error bar still covers."""

import math

import numpy as np
import pytest

from pipeline.batch.records import FruitRecord, Given, ModulusRecord
from pipeline.fruit.elasticity import GAIN, SENSOR
from pipeline.ranking.error_parts import COMMON_SCALE, about_error
from pipeline.ranking.reference_ratio import PART, against_references
from pipeline.ranking.report_entries import _facts
from reports.entries import FruitEntry
from reports.tables import RANKING_COLUMNS, _row

OWN, PICTURES, HIDDEN_GAIN, COMMON = 0.012, 0.05, 0.009, 0.03


def record(name: str, E_MPa: float, *, known: float | None = None, outcome: str = "graded") -> FruitRecord:
    """As grading leaves it: relative parts OWN, PICTURES and HIDDEN_GAIN of the error, COMMON beside it."""
    parts = {"noise": OWN * E_MPa, SENSOR: PICTURES * E_MPa, GAIN: HIDDEN_GAIN * E_MPa}
    modulus = ModulusRecord(
        E_MPa=E_MPa,
        E_sd_MPa=math.hypot(*parts.values()),
        common_sd_MPa=PICTURES * E_MPa,
        scale_sd_MPa=COMMON * E_MPa,
        parts_sd_MPa=parts,
    )
    given = (
        Given()
        if known is None
        else Given(reference=True, reference_E_MPa=known, reference_E_sd_MPa=0.01 * known)
    )
    return FruitRecord(
        fruit_id=name, outcome=outcome, key="k", given=given, modulus=modulus if outcome == "graded" else None
    )


def after(read: float, *, correct: bool) -> ModulusRecord:
    """A fruit of 0.4 MPa beside a body of 0.5, both read by this factor."""
    found, _ = against_references(
        [record("soft", 0.4 * read), record("ball", 0.5 * read, known=0.5)], correct=correct
    )
    assert found[0].modulus is not None
    return found[0].modulus


def adds_up(modulus: ModulusRecord) -> bool:
    return math.hypot(*modulus.parts_sd_MPa.values()) == pytest.approx(modulus.E_sd_MPa)


def test_a_body_shows_a_gain_that_the_assumed_scales_would_cover() -> None:
    """6 % are one standard deviation of what is assumed, and four of what the body is known to."""
    corrected = after(1.06, correct=True)
    assert corrected.E_MPa == pytest.approx(0.4)
    assert corrected.scale_sd_MPa == corrected.parts_sd_MPa[SENSOR] == 0.0
    assert corrected.parts_sd_MPa[PART] == pytest.approx(0.4 * math.hypot(OWN, 0.01))
    assert adds_up(corrected)
    doubted = after(1.06, correct=False)
    assert doubted.E_sd_MPa > math.log(1.06) * doubted.E_MPa
    assert adds_up(doubted)


def test_a_body_read_as_known_leaves_what_it_is_known_to() -> None:
    modulus = after(1.0, correct=False)
    body = math.hypot(OWN, 0.01)
    left = math.hypot(modulus.scale_sd_MPa, modulus.parts_sd_MPa[SENSOR]) / modulus.E_MPa
    assert left < body < math.hypot(PICTURES, COMMON)
    assert modulus.scale_sd_MPa < COMMON / 3 * modulus.E_MPa
    assert adds_up(modulus)


def test_without_a_graded_body_the_assumed_scale_stays() -> None:
    records = [record("soft", 0.4), record("ball", 0.5, known=0.5, outcome="never-touches")]
    found, _ = against_references(records, correct=True)
    assert found[0].modulus == records[0].modulus
    assert against_references(records[:1], correct=False)[0][0].modulus == records[0].modulus


@pytest.mark.parametrize("correct", [False, True])
def test_the_error_bar_covers_drawn_grippers(correct: bool) -> None:
    """Scales drawn as they are assumed; the error of E over both parts of its error bar."""
    rng = np.random.default_rng(5)
    z = []
    for _ in range(400):
        scale = math.exp(rng.normal(0, math.hypot(COMMON, PICTURES)))
        fruit = record("soft", 0.4 * scale * math.exp(rng.normal(0, OWN)))
        body = record("ball", 0.5 * scale * math.exp(rng.normal(0, OWN) + rng.normal(0, 0.01)), known=0.5)
        modulus = against_references([fruit, body], correct=correct)[0][0].modulus
        assert modulus is not None
        sd = math.hypot(modulus.E_sd_MPa, modulus.scale_sd_MPa)
        z.append(math.log(modulus.E_MPa / 0.4) * modulus.E_MPa / sd)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert np.mean(np.abs(z) > 2) < 0.07


def test_report_and_ranking_show_the_common_scale_beside_the_error_bar() -> None:
    one = record("soft", 0.4)
    assert one.modulus is not None
    said = about_error(one.modulus)
    assert f"A {COMMON_SCALE} adds ± 3 % of E" in said
    assert "A body of known modulus in fruits.csv (reference = true) removes it." in said
    assert (f"Beside the error bar: {COMMON_SCALE}", "± 0.012 MPa") in _facts(one, None)
    entry = FruitEntry(fruit_id="soft", ok=True, outcome="graded", E_MPa=0.4, E_scale_sd_MPa=0.012)
    assert RANKING_COLUMNS[-1] == "E_scale_sd_MPa"
    assert _row(entry)["E_scale_sd_MPa"] == 0.012
    none = one.modulus.model_copy(update={"scale_sd_MPa": 0.0})
    assert COMMON_SCALE not in about_error(none)
