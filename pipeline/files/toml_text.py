"""Writes texts, numbers, lists and tables as TOML."""

import re
from datetime import date
from typing import Any


def as_toml(values: dict[str, Any], prefix: str = "") -> str:
    """The lines of a table; tables in it, and lists of tables, follow under their own headers.

    >>> as_toml({"name": "gel", "camera": {"k1": 0.5}})
    'name = "gel"\\n\\n[camera]\\nk1 = 0.5\\n'
    """
    lines = [f"{_key(key)} = {toml_value(value)}" for key, value in values.items() if not _is_table(value)]
    for key, value in values.items():
        header = prefix + _key(key)
        if isinstance(value, dict):
            lines += ["", f"[{header}]", as_toml(value, f"{header}.").rstrip()]
        elif _is_table(value):
            for entry in value:
                lines += ["", f"[[{header}]]", as_toml(entry, f"{header}.").rstrip()]
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    """A TOML key: bare if it has only ASCII letters, digits, _ and -, else in quotation marks."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def toml_value(value: Any) -> str:
    """A value on one line; a table becomes an inline table.

    >>> toml_value({"pad": "left", "shift_mm": (0.5, 1.0)})
    '{ pad = "left", shift_mm = [0.5, 1.0] }'
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(entry)}" for key, entry in value.items()) + " }"
    return value.isoformat() if isinstance(value, date) else repr(value)
