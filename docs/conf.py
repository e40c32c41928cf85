"""Sphinx: `sphinx-build -W docs build/docs` makes web pages; `_toc.yml` orders them."""

import re
from importlib import metadata

import typer
from typer.cli import get_docs_for_click

from pipeline.cli import app as drupe

project = "drupe"
version = release = metadata.version("drupe")
extensions = ["myst_parser", "sphinx_external_toc", "sphinx.ext.autodoc", "sphinxcontrib.mermaid"]
html_theme = "furo"
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math", "mermaid"]  # as GitHub shows them
default_role = "code"  # docstrings write `name`
autodoc_typehints = "none"  # signatures show names; docstrings give shapes and units


def add_options(app, docname, source):
    """Every command's help, below the table of commands."""
    if docname == "reference/command-line":
        command = typer.main.get_command(drupe)
        context = command.context_class(command, info_name="drupe")
        _, commands = get_docs_for_click(obj=command, ctx=context, name="drupe").split("\n## ", 1)
        source[0] += f"\n## {commands}"


def escape_formulas(app, what, name, obj, options, lines):
    """In docstrings, | and * are signs of formulas."""
    lines[:] = [line if ">>>" in line else re.sub(r"(?<!`)([|*])", r"\\\1", line) for line in lines]


def setup(app):
    app.connect("source-read", add_options)
    app.connect("autodoc-process-docstring", escape_formulas)
