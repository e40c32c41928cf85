"""Every module constant made of numbers says what it is: unit, and reason or measurement, beside it."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

ROOMS = ("pipeline", "recon", "tactile", "fem", "reports", "samples", "drupe")
ROOT = Path(__file__).resolve().parents[2]
DIRECTIVE = re.compile(r"#\s*(noqa|fmt:|type:|ruff:|pragma|mypy:|isort:)")
FEWEST_WORDS = 2
SHARED = "These"


def constants(source: str) -> Iterator[tuple[int, str, bool]]:
    """Line, names and whether words stand beside it, of each module constant with a number in its value.

    Beside: a docstring right below it, or, beginning with SHARED, below the block of assignments on
    neighbouring lines that it belongs to; a comment on one of its lines or right above it. A directive to a
    tool (noqa, fmt) is no comment.
    """
    said = _comment_lines(source)
    body = ast.parse(source).body
    for place, node in enumerate(body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not _has_number(node.value):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        if not names or all(name.startswith("__") for name in names):
            continue
        lines = range(node.lineno - 1, (node.end_lineno or node.lineno) + 1)
        commented = any(line in said and (line >= node.lineno or said[line]) for line in lines)
        yield node.lineno, ", ".join(names), commented or _has_docstring(body, place)


def without_words(root: Path) -> list[str]:
    """FILE:LINE NAMES of the constants with no words beside them."""
    paths = (path for room in ROOMS for path in sorted((root / room).rglob("*.py")))
    return [
        f"{path.relative_to(root)}:{line} {names}"
        for path in paths
        if not path.is_relative_to(root / "samples" / "data")
        for line, names, has in constants(path.read_text(encoding="utf-8"))
        if not has
    ]


def _has_number(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Constant) and type(node.value) in (int, float, complex)
        for node in ast.walk(value)
    )


def _comment_lines(source: str) -> dict[int, bool]:
    """Lines with a comment, and whether the comment is all there is on the line."""
    return {
        token.start[0]: not token.line[: token.start[1]].strip()
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
        and not DIRECTIVE.match(token.string)
        and len(re.findall(r"\w+", token.string)) >= FEWEST_WORDS
    }


def _has_docstring(body: list[ast.stmt], place: int) -> bool:
    """A docstring right below; or below neighbouring assignments, where it begins with SHARED."""
    for above, below in pairwise(body[place:]):
        if below.lineno != (above.end_lineno or above.lineno) + 1:
            return False
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            text = str(below.value.value)
            right_below = above is body[place]
            return len(re.findall(r"\w+", text)) >= FEWEST_WORDS and (right_below or text.startswith(SHARED))
        if not isinstance(below, ast.Assign | ast.AnnAssign):
            return False
    return False


def test_every_constant_made_of_numbers_has_words_beside_it():
    missing = without_words(ROOT)
    assert not missing, f"{len(missing)} constants have no unit and reason beside them:\n" + "\n".join(
        missing
    )


@pytest.mark.parametrize(
    ("source", "has"),
    [
        ("A = 1\n", [False]),
        ("B = 2  # mm, of another\nA = 1  # noqa: E501\n", [True, False]),
        ('A = 1\n\n"""Not right below."""\n', [False]),
        ("A = 1  # mm, by hand\n", [True]),
        ('A = 1\nB, C = 2, 3\n"""These are mm, by hand."""\n', [True, True]),
        ('A = "3"\nB = True\ndef f():\n    a = 1\n', []),
    ],
)
def test_words_beside_a_constant_are_its_own_and_only_numbers_need_them(source, has):
    assert [said for _, _, said in constants(source)] == has
