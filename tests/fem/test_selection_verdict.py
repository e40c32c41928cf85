"""When the best explanation of all recordings is a name, and when what it leaves makes it "unknown"."""

from types import SimpleNamespace

import pytest

from fem.mismatch.result import UNKNOWN
from fem.mismatch.selection.model_selection import Hypothesis, NullCase, verdict_of
from fem.mismatch.thresholds import CLEAR_GAIN

NULL_CASE = NullCase(chi2=1000.0, most_chi2=1500.0, compliance_ratio=1.0)


def said(*, before: float, after: float, gain: float, direct: float = 0.0) -> str | tuple[str, ...]:
    """The verdict where the plain model leaves chi-square `before`, and the one effect tried `after`."""
    effect = SimpleNamespace(direct_evidence=lambda _: direct, measured_sd=lambda _: {})
    fit = SimpleNamespace(chi2=after)
    only = Hypothesis(
        name="skin",
        gain=gain,
        probability=1.0,
        linear_fits=(),
        refit=SimpleNamespace(fit=fit, forward=None, effects=(effect,), parameters=({},)),  # type: ignore[arg-type]
    )
    return verdict_of(SimpleNamespace(null=SimpleNamespace(chi2=before)), (only,), NULL_CASE)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("after", "gain", "verdict"),
    [
        (1250.0, CLEAR_GAIN - 1, "skin"),  # a quarter more than usual: sound recordings leave as much
        (1700.0, CLEAR_GAIN - 1, UNKNOWN),  # many sound ones leave this, and few gain so much by a false name
        (1700.0, CLEAR_GAIN + 1, "skin"),
        (2100.0, 10 * CLEAR_GAIN, UNKNOWN),  # no sound one leaves twice the usual, whatever was gained
    ],
)
def test_what_is_left_is_held_against_what_sound_recordings_leave(after, gain, verdict) -> None:
    assert said(before=after + 100.0, after=after, gain=gain) == verdict


def test_a_name_that_explains_most_of_a_large_excess_stands() -> None:
    assert said(before=6000.0, after=3900.0, gain=1000.0) == "skin"
    assert said(before=6000.0, after=4100.0, gain=1000.0) == UNKNOWN


def test_what_recordings_show_directly_is_named_whatever_is_left() -> None:
    assert said(before=2400.0, after=2400.0, gain=500.0, direct=CLEAR_GAIN + 1) == "skin"
    assert said(before=2400.0, after=2400.0, gain=500.0, direct=CLEAR_GAIN - 1) == UNKNOWN
