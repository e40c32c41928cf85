"""Sphinx: `sphinx-build -W docs build/docs` makes web pages; `_toc.yml` orders them."""

import json
import re
from importlib import metadata

import typer
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from typer.cli import get_docs_for_click

from pipeline.batch.settings import Settings
from pipeline.cli import app as drupe

project = "drupe"
version = release = metadata.version("drupe")
extensions = ["myst_parser", "sphinx_external_toc", "sphinx.ext.autodoc"]
html_theme = "furo"
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_math_renderer = "mathml"  # no script from the network
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as GitHub shows it
suppress_warnings = [
    "misc.highlighting_failure"
]  # a diagram is its own source here: no script from the network
default_role = "code"  # docstrings write `name`
autodoc_typehints = "none"  # signatures show names; docstrings give shapes and units


def commands(page):
    """Every command's help."""
    command = typer.main.get_command(drupe)
    text = get_docs_for_click(
        obj=command, ctx=command.context_class(command, info_name="drupe"), name="drupe"
    )
    return "\n## " + text.split("\n## ", 1)[1]


def modules(page):
    """The docstrings of every module that the page lists."""
    names = re.findall(r"`((?:fem|recon|tactile)\.[\w.]+)`", page)
    return "".join(
        f"\n## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```\n" for name in names
    )


def settings(page):
    """A table of every key of batch.toml."""
    schema = Settings.model_json_schema()
    rows = "\n".join(settings_rows(schema, schema["properties"], ""))
    return f"\n| table | key | type | default | least | most |\n|---|---|---|---|---|---|\n{rows}\n"


def settings_rows(schema, properties, table):
    """A row for each key; the keys of an inner table follow."""
    for key, entry in properties.items():
        kinds = [kind for kind in entry.get("anyOf", [entry]) if kind.get("type") != "null"]
        inner = next((kind["$ref"] for kind in (k.get("items", k) for k in kinds) if "$ref" in kind), None)
        if inner:
            name = f"{table}.{key}".strip(".")
            yield from settings_rows(schema, schema["$defs"][inner.rpartition("/")[2]]["properties"], name)
            continue
        words = [
            ", ".join(f"`{json.dumps(word)}`" for word in k["enum"])
            if "enum" in k
            else k.get("format", k["type"])
            for k in kinds
        ]
        bounds = [next((k[b] for k in kinds if b in k), "") for b in ("minimum", "maximum")]
        default = "" if entry.get("default") is None else f"`{json.dumps(entry['default'])}`"
        yield f"| {table} | `{key}` | {' or '.join(words)} | {default} | {bounds[0]} | {bounds[1]} |"


GENERATED = {"reference/command-line": commands, "reference/python": modules, "reference/settings": settings}
"""What follows the text of a page."""


def generate(app, docname, source):
    if docname in GENERATED:
        source[0] += GENERATED[docname](source[0])


def escape_formulas(app, what, name, obj, options, lines):
    """In docstrings, | and * are signs of formulas."""
    lines[:] = [line if ">>>" in line else re.sub(r"(?<!`)([|*])", r"\\\1", line) for line in lines]


def formula(translator, node):
    translator.body.append(tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def setup(app):
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("source-read", generate)
    app.connect("autodoc-process-docstring", escape_formulas)
