"""What a run says and keeps of fruit that end without a modulus that counts."""

from pipeline import grade as grading
from pipeline.outcome import Outcome
from pipeline.records import FruitRecord, Given, ModulusRecord


def record(outcome, reason=""):
    modulus = ModulusRecord(E_MPa=900.0, E_sd_MPa=30.0)
    return FruitRecord(fruit_id="A", outcome=outcome, reason=reason, key="k", given=Given(), modulus=modulus)


def test_the_progress_line_of_a_refused_fruit_is_its_reason_and_no_modulus():
    said = grading._in_a_line(record(Outcome.IMPLAUSIBLE_MODULUS.code, "E would be 900 MPa"))
    assert said == "implausible-modulus: E would be 900 MPa"
    assert grading._in_a_line(record("graded")) == "E = 900.000 ± 30.000 MPa"
