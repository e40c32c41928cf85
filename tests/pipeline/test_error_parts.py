"""What would make an error bar smaller, by the parts that moduli have."""

import pytest

from fem.estimation.error_budget import DISCRETISATION, MODEL, PIT_PLACE, REGISTRATION, SCATTER, TACTILE
from pipeline.ranking.error_parts import ADVICE, smaller_error


@pytest.mark.parametrize("part", [TACTILE, REGISTRATION, PIT_PLACE, MODEL, SCATTER])
def test_the_largest_part_is_named_with_what_to_do(part):
    said = smaller_error({part: 3.0, DISCRETISATION: 1.0})
    assert (
        said.replace("\u00a0", " ")
        == f"90 % of its variance comes from: {part}; smaller with {ADVICE[part]}."
    )


def test_two_parts_are_named_where_none_is_half_and_none_where_none_is_known():
    said = smaller_error({TACTILE: 1.0, MODEL: 1.1, SCATTER: 0.9})
    assert said.index(MODEL) < said.index(TACTILE)
    assert SCATTER not in said
    assert smaller_error({DISCRETISATION: 1.0}).endswith("comes from: discretisation.")
    assert smaller_error({}) == ""
