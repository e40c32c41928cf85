"""What users read in the terminal and on pages: short sentences without the terms that the style bans."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from pipeline.batch.outcome import Outcome
from pipeline.cli import app

ROOT = Path(__file__).parents[2]
MOST_WORDS = 25
"""Of a sentence; a placeholder is one word, and a semicolon ends a sentence as a full stop does."""
FEWEST_WORDS = 4
"""Shorter strings are names, units and connecting words."""
PLACEHOLDER = "…"
SQL = r"(CREATE|SELECT|INSERT|PRAGMA|DROP) "
FOLDERS = ("pipeline", "recon", "tactile", "fem", "reports", "drupe")
NOT_READ = ("fem/mismatch", "fem/indentation")
"""The words of effects and contact laws have tests of their own."""
FILE_GUARDS = ("pipeline/files/", "pipeline/batch/write_guard.py")
"""Say what a path is in a few fixed phrases ("is no text"); their length is checked, their terms are not."""
BANNED = (
    r"held against",
    r"what is left",
    r"of which",
    r"as graded",
    r"(un)?said",
    r"as well\b(?! as)",
    r"t(old|ell) apart",
    r"left aside",
    r"taken off",
    r"in spite of",
    r"gives? way",
    r"anew",
    r"look(s|ed)? at\b",
    r"sound (fruit|gripper|flesh)",
    r"leaves out",
    r"goes on from here",
    r"ran away",
    r"stands? for",
    r"makes? it whole",
    r"is taken as",
    r"not to be trusted",
    r"and --\w+ \S+ is",
    r"the other way round",
    r"bears? a print",
)
"""Regular expressions of whole words, in any case."""


def text_of(node: ast.expr) -> str | None:
    """A string constant, f-string or sum of them, each placeholder as one character; else None."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"\{\w*\}", PLACEHOLDER, node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(
            str(part.value) if isinstance(part, ast.Constant) else PLACEHOLDER for part in node.values
        )
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = text_of(node.left), text_of(node.right)
        return None if left is None or right is None else left + right
    return None


def texts(node: ast.AST) -> Iterator[str]:
    """Every text under a node but docstrings, which are statements of their own."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    text = text_of(node) if isinstance(node, ast.expr) else None
    if text is not None:
        yield text
        return
    for child in ast.iter_child_nodes(node):
        yield from texts(child)


def modules() -> list[str]:
    paths = (path.relative_to(ROOT).as_posix() for name in FOLDERS for path in (ROOT / name).rglob("*.py"))
    return sorted(name for name in paths if not name.startswith(NOT_READ))


def messages_of(module: str) -> list[str]:
    """Texts of a module that are long enough to be read as sentences."""
    tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
    long = [text for text in texts(tree) if len(re.findall(r"[^\W\d_]{2,}", text)) >= FEWEST_WORDS]
    return [text for text in long if not re.match(SQL, text)]


def helps() -> Iterator[tuple[str, str]]:
    """Every help text, with the command and parameter that it belongs to."""
    group = typer.main.get_command(app)
    for name, command in {"drupe": group, **group.commands}.items():
        yield name, command.help or ""
        yield f"{name} in short", command.get_short_help_str(limit=200)
        for parameter in command.params:
            record = getattr(parameter, "help", None)
            if record:
                yield f"{name} {parameter.name}", record


def sentences(text: str) -> list[str]:
    plain = " ".join(re.sub(r"<[^>]+>", "", text).split())
    return re.split(rf"(?<=[.!?;])(?:\s+|(?={PLACEHOLDER}))", plain)


def too_long(text: str) -> list[str]:
    return [sentence for sentence in sentences(text) if len(sentence.split()) > MOST_WORDS]


def banned(text: str) -> list[str]:
    return [match[0] for term in BANNED for match in re.finditer(rf"\b(?:{term})\b", text, re.IGNORECASE)]


def test_every_sentence_of_every_help_text_is_short_and_plain():
    texts_of_help = dict(helps())
    assert len(texts_of_help) > 100
    assert {name: faults for name, text in texts_of_help.items() if (faults := too_long(text))} == {}
    assert {name: faults for name, text in texts_of_help.items() if (faults := banned(text))} == {}


def test_every_option_of_a_measure_states_its_unit():
    lacking = [
        f"{name} {parameter.name}"
        for name, command in typer.main.get_command(app).commands.items()
        for parameter in command.params
        if (unit := re.search(r"_(mm|N|MPa)$", parameter.name or ""))
        and not re.search(rf"\b{unit[1]}\b", parameter.help)
    ]
    assert lacking == []


@pytest.mark.parametrize("outcome", list(Outcome), ids=lambda outcome: outcome.code)
def test_every_ending_of_a_fruit_is_short_and_plain(outcome):
    template = outcome.sentence(PLACEHOLDER)
    assert too_long(template) == []
    assert banned(template) == []


@pytest.mark.parametrize("module", modules())
def test_every_message_is_short_and_plain(module):
    messages = messages_of(module)
    assert [sentence for text in messages for sentence in too_long(text)] == []
    if not module.startswith(FILE_GUARDS):
        assert [f"{term}: {text}" for text in messages for term in banned(text)] == []


def test_every_template_of_a_page_is_short_and_plain():
    for path in sorted((ROOT / "reports" / "templates").glob("*.j2")):
        plain = re.sub(r"<(style|script)\b.*?</\1>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        keyed = re.findall(r'say(?:_html)?\(\s*"([^"]*)"', plain)
        shown = re.sub(r"\{%.*?%\}|</?\w[^>]*>", "\n", re.sub(r"\{\{.*?\}\}", PLACEHOLDER, plain))
        for text in (*keyed, *(line for line in shown.split("\n") if PLACEHOLDER in line or " " in line)):
            text = re.sub(r"\{\w+\}", PLACEHOLDER, text)
            assert too_long(text) == [], path.name
            assert banned(text) == [], path.name
