"""Every sentence that the code can put into a fruit's warnings, doubts or reason, as a template."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("fem/estimation", "fem/mesh", "pipeline/fruit", "pipeline/ranking", "recon", "tactile")
MAKERS = frozenset(
    {
        "Doubt", "FemFailure", "Finding", "FruitEnded", "ModulusWarning", "Outcome", "ReconFailure",
        "TactileFailure", "warnings",
    }
)  # fmt: skip
"""What takes a sentence that a report shows."""
ALSO = (
    "pipeline/batch/outcome.py", "pipeline/ranking/batch_faults.py",
    "pipeline/ranking/error_parts.py", "recon/checks/quality.py", "recon/checks/surface_verdict.py",
    "recon/checks/verdict.py", "recon/surface/fruit_frame.py",
)  # fmt: skip
"""Modules that give such sentences back as plain text."""


def modules() -> list[Path]:
    """Those whose code names one of MAKERS, and ALSO."""
    every = {path for room in ROOMS for path in (ROOT / room).rglob("*.py") if _names(path) & MAKERS}
    return sorted({*every, *(ROOT / name for name in ALSO)})


def _names(path: Path) -> set[str]:
    return {node.id for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Name)}


def templates(path: Path) -> Iterator[str]:
    """Texts of four words or more in a module, but for docstrings; what varies is {0}, {1}, ..."""
    tree = ast.parse(path.read_text("utf-8"))
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    inside |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in inside:
            text = _template(node)
            if " " in text and len(re.findall(r"[A-Za-z]{2,}", re.sub(r"\{\d\}", " ", text))) >= 4:
                yield text


def _template(node: ast.Constant | ast.JoinedStr) -> str:
    if isinstance(node, ast.Constant):
        text = node.value if isinstance(node.value, str) else ""
        pieces = re.split(r"\{\w*\}", text)
    else:
        pieces = [""]
        for part in node.values:
            pieces[-1] += str(part.value) if isinstance(part, ast.Constant) else ""
            pieces += [] if isinstance(part, ast.Constant) else [""]
    return pieces[0] + "".join(f"{{{k}}}{piece}" for k, piece in enumerate(pieces[1:]))
