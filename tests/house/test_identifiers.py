"""One name for one thing, of plain words: modules, classes and identifiers."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("fem", "recon", "tactile", "pipeline", "reports", "samples", "drupe", "tests", "benchmarks")

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
    "lookalike": "model discrepancy",
    "mended": "corrected; relabelled",
    "odds": "log odds",
    "planted": "injected; synthetic",
    "planting": "injected; synthetic",
    "plate": "background plate",
    "programme": "protocol",
    "seeming": "model discrepancy",
    "senseless": "violates a sign constraint",
    "settled": "converged; fixed point; fitted",
    "shelf": "update stack",
    "sight": "adjoint basis; view",
    "softness": "compliance ratio",
    "squeezed": "in quasi-static contact",
    "stance": "orientation",
    "strength": "hyperparameters",
    "temper": "temperature",
    "tempered": "divided by a temperature",
    "told": "said; named; reported",
    "untold": "unknown",
    "witnessed": "auxiliary log-likelihood",
}
"""Home-made word: the field's term in its place."""

HOME_MADE_NAMES = {
    "ALIKE": "design effect",
    "Column": "Regressor",
    "Ground": "CaseModel",
    "LastRuns": "WarmStart",
    "MARKER_EXCESS": "variance inflation",
    "Memory": "memoised",
    "Moment": "LoadStep",
    "Named": "ModelSelection",
    "Outside": "OutOfCatalogue",
    "Products": "GramMatrix",
    "Ranked": "Hypothesis",
    "Recorded": "GraspEquations",
    "Seen": "GraspResponse",
    "Shown": "LinearFit",
    "Squeeze": "Grip",
    "Standing": "MeshedFruit",
    "USUAL": "null quantile",
    "_Tried": "Hypothesis",
    "drawn_outside": "drawn_out_of_catalogue",
    "prove": "cross-validation",
    "seen_through": "project_recording",
    "side_by_side": "parallel_map",
    "squeeze_of": "grip_of",
}
"""Names that were home-made whole; their words alone are plain English."""

ALLOWED = ("log_odds", "inverse_odds", "background_plate", "s368_plate", "flat_plate")
"""Terms of the field that hold such a word; s368 is the flat plate of Roark's table."""

KEYS = ("stance",)
"""Names that are keys of files as docs/formats.md fixes them."""

PRONOUNS = {"found", "one", "own"}
"""Names that say nothing of the thing; a noun from its type or collection says what it is."""


def words_of(identifier: str) -> set[str]:
    """The words of a name, of one with underscores or capitals alike, in lower case.

    >>> sorted(words_of("_BackgroundPlate_mm"))
    ['background', 'mm', 'plate']
    """
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)}


def refused(source: str) -> list[str]:
    """The identifiers of a source that are pronouns, are home-made or hold such a word outside of the allowed
    terms.

    Names of tests are sentences, and keys of files stay as they were fixed.
    """
    names = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.string in HOME_MADE_NAMES:
            names.append(token.string)
        elif (
            token.type == tokenize.NAME and not token.string.startswith("test_") and token.string not in KEYS
        ):
            name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", token.string).lower()
            for term in ALLOWED:
                name = name.replace(term, "")
            if token.string in PRONOUNS or words_of(name) & HOME_MADE.keys():
                names.append(token.string)
    return names


@pytest.mark.parametrize("room", ROOMS)
def test_no_identifier_is_home_made_or_a_pronoun(room):
    names = {
        path.relative_to(ROOT).as_posix(): refused(path.read_text(encoding="utf-8"))
        for path in sorted((ROOT / room).rglob("*.py"))
    }
    assert {path: names_of_file for path, names_of_file in names.items() if names_of_file} == {}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("class StanceRecord: ...", ["StanceRecord"]),
        ("class Seen: ...", ["Seen"]),
        ("first_odds = log_odds(BackgroundPlate, 'settled')", ["first_odds"]),
        ("def test_it_is_told(seen): resistance = platelet", []),
        ("watch.own = f(found=1)", ["own", "found"]),
        ("as_ones = 'one'  # own, found", []),
    ],
)
def test_words_are_found_whole_outside_of_prose_and_allowed_terms(source, expected):
    assert refused(source) == expected


FOLDERS = ("fem", "recon", "tactile", "pipeline", "reports", "samples", "drupe", "benchmarks")


def sources() -> list[Path]:
    return [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def shared(places: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: where for name, where in places.items() if len(where) > 1}


def test_no_two_modules_are_named_alike():
    places = defaultdict(list)
    for path in sources():
        if path.name != "__init__.py":
            places[path.name].append(str(path.relative_to(ROOT)))
    assert shared(places) == {}


def test_no_two_public_classes_are_named_alike():
    places = defaultdict(list)
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(ROOT)))
    assert shared(places) == {}
