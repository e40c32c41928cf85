"""One name for one thing: no two modules, and no two classes, of the same name outside of the tests."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
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
