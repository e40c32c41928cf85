"""One word for one thing: identifiers are the field's terms (docs/glossary.md), not home-made words."""

import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("fem", "recon", "tactile")

HOME_MADE = {
    "alike": "similar; design effect",
    "anchored": "second-order surrogate",
    "beside": "adjacent; auxiliary log-likelihood",
    "departure": "displacement correction; discrepancy",
    "diary": "stage log",
    "foretell": "predict",
    "foretold": "predicted",
    "heard": "information",
    "hindsight": "backward relabelling",
    "landing": "relative indices",
    "mended": "corrected; relabelled",
    "odds": "log odds",
    "plate": "background plate",
    "seeming": "model discrepancy",
    "senseless": "violates a sign constraint",
    "settled": "converged; fixed point; fitted",
    "shelf": "update stack",
    "sight": "adjoint basis; view",
    "softness": "compliance ratio",
    "stance": "orientation",
    "strength": "hyperparameters",
    "told": "said; named; reported",
    "untold": "unknown",
}
"""Home-made word: the field's term in its place."""

ALLOWED = ("log_odds", "inverse_odds", "background_plate", "s368_plate")
"""Terms of the field that hold such a word; s368 is the flat plate of Roark's table."""


def words_of(identifier: str) -> set[str]:
    """The words of a name, of one with underscores or capitals alike, in lower case.

    >>> sorted(words_of("_BackgroundPlate_mm"))
    ['background', 'mm', 'plate']
    """
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)}


def home_made(source: str) -> list[str]:
    """The identifiers of a source that hold a home-made word outside of the allowed terms."""
    found = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NAME:
            name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", token.string).lower()
            for term in ALLOWED:
                name = name.replace(term, "")
            if words_of(name) & HOME_MADE.keys():
                found.append(token.string)
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_no_identifier_is_home_made(room):
    left = {
        str(path.relative_to(ROOT)): names
        for path in sorted((ROOT / room).rglob("*.py"))
        if (names := home_made(path.read_text(encoding="utf-8")))
    }
    assert left == {}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def settled(x): ...", ["settled"]),
        ("class StanceRecord: ...", ["StanceRecord"]),
        ("first_odds = log_odds(BackgroundPlate, 'settled')", ["first_odds"]),
        ("resistance = platelet", []),
    ],
)
def test_words_are_found_whole_and_allowed_terms_are_not(source, expected):
    assert home_made(source) == expected
