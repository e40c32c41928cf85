"""Every example in a docstring is right."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("drupe", "pipeline", "recon", "tactile", "fem", "reports", "samples")
FILES = [
    path.relative_to(ROOT)
    for folder in (*PACKAGES, "benchmarks", "tests")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if re.search(r"^ *>>> ", path.read_text(encoding="utf-8"), re.MULTILINE)
]


@pytest.mark.parametrize("file", FILES, ids=str)
def test_the_examples_in_docstrings_are_right(file, monkeypatch):
    if file.parts[0] in PACKAGES:
        name = ".".join(file.with_suffix("").parts).removesuffix(".__init__")
    else:
        monkeypatch.syspath_prepend(ROOT / file.parents[1])
        monkeypatch.syspath_prepend(ROOT / file.parent)
        name = file.stem
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
