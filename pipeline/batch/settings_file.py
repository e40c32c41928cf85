"""Reads a file of settings strictly: each fault states its key, the value found and what was expected."""

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from pipeline.batch.batch_place import require_folder
from pipeline.batch.settings import Settings
from pipeline.files.plain_file import NotReadable, printable, read_text, toml_of
from pipeline.problem import BatchRefused, Problem, nearest, plain_message, refused
from recon.cameras.photos import photo_paths
from tactile.readers.decimal_number import meant

MOST_BYTES = 1_000_000
"""Most bytes of a settings file: the longest in use has 4 kB; drupe reads 1 MB in 0.1 s."""
Model = TypeVar("Model", bound=BaseModel)
_AT_LINE = re.compile(r"\(at line (\d+), column \d+\)")
_LIST_HEADER = re.compile(r"[ \t]*\[\[([^\]]*)\]\]")
_DECIMAL_COMMA = re.compile(r"(?:^|[{,])[ \t]*[\w.-]+[ \t]*=[ \t]*([+-]?\d*),(\d+)\b(?!\.)")
"""A value with a decimal comma; in a list (`[0,45]`) no = precedes the number."""


def read_settings(path: Path) -> Settings:
    """The settings in `path`; raises BatchRefused with every wrong key and value at once."""
    require_folder(path.parent)
    if path.with_name("case.toml").is_file():
        return read_toml(path, Settings, missing=_A_CASE)
    photos = _PHOTOS if photo_paths(path.parent) or any(map(photo_paths, _folders(path.parent))) else ""
    return read_toml(path, Settings, missing=photos.format(folder=path.parent) or _MISSING)


def require_settings_file(path: Path) -> None:
    """Raises BatchRefused if the file is missing or cannot be read as text. Keys are not checked."""
    require_folder(path.parent)
    if not path.exists():
        read_settings(path)
    try:
        read_text(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise refused(path, f"{error}; put the batch's settings there.") from None


def _folders(root: Path) -> list[Path]:
    return [place for path in root.iterdir() if path.is_dir() for place in (path, path / "photos")]


def read_toml(path: Path, model: type[Model], *, missing: str) -> Model:
    """The file at `path` as `model`; raises BatchRefused with every fault, or `missing` without a file."""
    if not path.is_symlink() and not path.exists():
        raise refused(path, missing)
    text = ""
    try:
        text = read_text(path, most_bytes=MOST_BYTES)
        return model.model_validate(toml_of(text))
    except NotReadable as error:
        fault = _decimal_comma(text, str(error)) or f"{error}{_remedy(str(error))}"
        raise refused(path, f"{fault}.") from None
    except ValidationError as error:
        table, headers = toml_of(text), _list_headers(text)
        said = dict.fromkeys(_sentence(e, model, table, headers) for e in error.errors())
        raise BatchRefused([Problem(str(path), sentence) for sentence in said]) from None


_MISSING = (
    'does not exist. Write one with at least the line category = "nectarine", or create an '
    "example with `drupe sample DIR`."
)
_PHOTOS = (
    "does not exist, but this folder has photos. Create a batch with `drupe new BATCH --photos "
    "{folder}`, then grade that batch."
)
_A_CASE = "does not exist, but a case.toml does: this is a single case; use `drupe explain`."


def _decimal_comma(text: str, fault: str) -> str:
    """A sentence if the line that `fault` names has a decimal comma; else empty."""
    at = _AT_LINE.search(fault)
    comma = at and _DECIMAL_COMMA.search(text.split("\n")[int(at[1]) - 1])
    return f"line {at[1]} has a decimal comma: write {comma[1] or 0}.{comma[2]}" if at and comma else ""


def _remedy(fault: str) -> str:
    """Advice on a file whose bytes are no text, or whose text is no TOML."""
    if "TOML" in fault:
        return "; correct it there"
    return "; save it again as UTF-8 text" if "text" in fault else ""


def _sentence(error: Any, model: type[BaseModel], table: Any, headers: Mapping[str, Sequence[int]]) -> str:
    """One validation error as a sentence that names the key, what was found and what was expected."""
    location = [part for part in error["loc"] if isinstance(part, str | int)]
    key = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in location)[1:]
    where = _entry_named(location, table, headers)
    if error["type"] == "missing":
        example = ', for example category = "nectarine"' if key == "category" else ""
        return f'the required key "{key}"{where} is missing; add it{example}.'
    if error["type"] == "extra_forbidden":
        known = _known_keys(location[:-1], model)
        hint = f"known keys here: {', '.join(known)}."
        return f'unknown key "{key}"{where}; {nearest(str(location[-1]), known, hint)}'
    slip = _likely_slip(str(location[-1]), error["input"])
    return f'"{key}"{where}: {_expected(error)}{slip or "."}'


def _entry_named(location: Sequence[str | int], table: Any, headers: Mapping[str, Sequence[int]]) -> str:
    """Name and first line of the list's table that a key is in; empty if the key is in no list."""
    place = next((k for k, part in enumerate(location) if isinstance(part, int)), len(location))
    lines = headers.get(".".join(map(str, location[:place])), ())
    if place == len(location):
        return ""
    for part in location[:place]:
        table = table[part]
    if len(table) != len(lines) or not isinstance(entry := table[int(location[place])], dict):
        return ""  # written without headers, or a text contains a header
    name, line = printable(str(entry.get("name", entry.get("effect", ""))))[:40], lines[int(location[place])]
    return f' ("{name}", line {line})' if name else f" (line {line})"


def _list_headers(text: str) -> dict[str, list[int]]:
    """Lines of the headers [[list]], by the list's name."""
    headers = defaultdict[str, list[int]](list)
    for number, line in enumerate(text.split("\n"), 1):
        if header := _LIST_HEADER.match(line):
            headers["".join(header[1].split())].append(number)
    return headers


def shown(value: object) -> str:
    """The repr of a value, cut to 80 characters."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


WORDS = {
    "bool": "true or false",
    "date": "a date like 2026-08-14",
    "dict": "a table",
    "float": "a number (with a decimal point)",
    "int": "a whole number",
    "model": "a table",
    "string": "a text in quotes",
    "tuple": "a list in [ ]",
}
"""What drupe expects, by the first word of a pydantic error's type."""
LIMITS = {"ge": "{} or more", "gt": "more than {}", "le": "at most {}", "lt": "less than {}"}
"""What drupe expects of a number or date outside its limits, by pydantic's name of the limit."""


def _expected(error: Any) -> str:
    """What was found and what was expected, in plain words."""
    kind, limits, value = error["type"], error.get("ctx", {}), error["input"]
    plain = plain_message(str(error["msg"])).replace("Input should be", "expected")
    message = plain[:1].lower() + plain[1:]
    if kind == "value_error" and isinstance(value, dict | list):
        return plain
    if kind == "too_long":
        return f"holds {limits['actual_length']} entries; expected at most {limits['max_length']}"
    if kind == "string_too_long":
        return f"is longer than {limits['max_length']} characters; shorten it"
    if kind == "string_too_short":
        message = "expected a non-empty text"
    elif kind.startswith("float") and isinstance(value, str):
        message = f"expected a number, without quotes{meant(value)}"
    elif (word := kind.partition("_")[0]) in WORDS:
        message = f"expected {WORDS[word]}"
    for name, words in LIMITS.items():
        if name in limits:
            limit = limits[name]
            message = f"expected {words.format(f'{limit:g}' if isinstance(limit, float) else limit)}"
    return f"found {shown(value)}; {message}"


def _likely_slip(key: str, value: Any) -> str:
    """A question with the likely unit of a number outside its limits; empty if no unit fits."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        return ""
    if key == "pulp_temperature_C":
        if 263 <= value <= 323:
            return f": is it in kelvin ({value - 273.15:.1f} C)?"
        return f": is it in Fahrenheit ({(value - 32) / 1.8:.1f} C)?" if 50 < value <= 122 else ""
    if key in {"certainty", "inspect_below_p"}:
        return f": is it in per cent ({value / 100:g})?" if 1 < value <= 100 else ""
    shares = {"poisson_ratio", "poisson_ratio_sd", "size_sd", "common_scale_sd", "picture_scale_sd"}
    if key in shares | {"gel_scale_sd", "force_scale_sd", "gel_stiffness_sd"}:
        return f": is it in per cent ({value / 100:g})?" if 0.5 < value <= 50 else ""
    return ""


def _known_keys(location: list[str | int], model: type[BaseModel]) -> list[str]:
    for part in location:
        if isinstance(part, str):
            model = _table(model.model_fields[part].annotation)
    return sorted(model.model_fields)


def _table(annotation: Any) -> type[BaseModel]:
    """The model in a field's type: `PitSettings`, `SensorSettings | None`, `tuple[GradingClass, ...]`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(_table(part) for part in get_args(annotation) if part not in (type(None), Ellipsis))
