"""Every sentence that the code can say to a user, as a template."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("fem", "pipeline", "recon", "tactile")
ENGLISH_ALONE = ("pipeline/history/migrations", "pipeline/start.py")
"""Statements of SQL, and the words of a computer on which drupe cannot start."""
NO_SENTENCE = (
    "#", "@alias", "text/", "drupe: internal error", "failed to map segment", "The MLE may be",
    "The random effects", "The Hessian matrix",
)  # fmt: skip
"""Comments of written files, names of units, kinds of pages, what is for developers, and texts by which
warnings of other libraries are known.
"""
HELP = frozenset({"help", "short_help", "metavar", "epilog", "show_default"})
"""Arguments with the manual of a command, which is English, as the first lines in COMMANDS are."""


def modules() -> list[Path]:
    """Those with sentences for users."""
    every = (path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    return sorted(path for path in every if not path.relative_to(ROOT).as_posix().startswith(ENGLISH_ALONE))


@cache
def templates(path: Path) -> tuple[str, ...]:
    """Texts of four words or more in a module, without docstrings, manuals and comments of written files;
    what varies is {0}, {1}, ...
    """
    return tuple(dict.fromkeys(_templates(ast.parse(path.read_text("utf-8")))))


def _templates(tree: ast.Module) -> Iterator[str]:
    inside = {id(part) for node in ast.walk(tree) for part in _no_sentences(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in inside:
            text = _template(node)
            words = re.findall(r"[A-Za-z]{2,}", re.sub(r"\{\d\}", " ", text))
            if " " in text and len(words) >= 4 and not text.startswith(NO_SENTENCE):
                yield text


def _no_sentences(node: ast.AST) -> Iterator[ast.AST]:
    """Parts of a node that are no sentence of their own."""
    if isinstance(node, ast.JoinedStr):
        yield from node.values
    elif isinstance(node, ast.Expr):
        yield node.value
    elif isinstance(node, ast.keyword) and node.arg in HELP:
        yield from ast.walk(node.value)
    elif (
        isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == "COMMANDS"
    ):
        yield from ast.walk(node)


def _template(node: ast.Constant | ast.JoinedStr) -> str:
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    text = "".join(str(part.value) if _is_text(part) else "{}" for part in parts)
    pieces = re.split(r"\{\w*(?::[^{}]*)?\}", text)
    return pieces[0] + "".join(f"{{{k}}}{piece}" for k, piece in enumerate(pieces[1:]))


def _is_text(part: ast.expr) -> bool:
    return isinstance(part, ast.Constant) and isinstance(part.value, str)
