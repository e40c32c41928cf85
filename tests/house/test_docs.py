"""What the documents name is there: links, files, headings and line counts."""

import re
import subprocess
import tomllib
from functools import cache
from inspect import signature
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel
from typer.main import get_command

from pipeline.batch.fruits_table import COLUMNS
from pipeline.batch.settings import Settings
from pipeline.cli import app
from pipeline.commands.convert import convert
from pipeline.recordings.conversion import KINDS
from reports.tables import RANKING_COLUMNS
from tactile.readers.field_tables import COLUMNS as MARKER_COLUMNS
from tactile.readers.recording import read_recording
from tactile.readers.tac3d import FIELDS
from tactile.readers.trace_columns import FORCE, TRAVEL

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"))
)
GUIDES = [name for name in DOCUMENTS if name.startswith("docs/how-to/")]
ROOMS = ("pipeline", "recon", "tactile", "fem", "reports", "samples", "drupe", "tests", "benchmarks", "docs")
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
NAMED = re.compile(rf"(?<![\w/.-])((?:{'|'.join(ROOMS)})/[\w./-]*\w)")
"""A path from the root, in running text or code, with or without its suffix."""
BARE = re.compile(r"(?<![\w/.-])(\w+\.py)\b")
"""A source file without its folder."""
MODULE = re.compile(rf"(?<![\w/.`-])((?:{'|'.join(ROOMS[:6])})(?:\.[a-z]\w*)+)")
"""A dotted module, or something in it."""
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
FOREIGN = {"ProcessPool", "ProcessPoolExecutor"}
"""Classes of libraries."""
MOST_README_LINES = 90


@cache
def text_of(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


@cache
def sources() -> set[str]:
    return {path.name for room in ROOMS for path in (ROOT / room).rglob("*.py")}


@cache
def words_of_the_code() -> set[str]:
    """Every name with a capital letter in the source of the rooms."""
    return {
        word
        for room in ROOMS[:7]
        for path in (ROOT / room).rglob("*.py")
        for word in re.findall(r"\b[A-Z]\w+", path.read_text(encoding="utf-8"))
    }


def headings(document: str) -> set[str]:
    """Anchors as GitHub makes them: lower case, punctuation dropped, blanks to hyphens."""
    titles = re.findall(r"^#+ (.+)$", CODE.sub("", text_of(document)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_relative_link_leads_to_a_file_and_a_heading_of_it(document):
    dead = []
    for target in LINK.findall(CODE.sub("", text_of(document))):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, heading = target.partition("#")
        path = (ROOT / document).parent / name if name else ROOT / document
        page = path.resolve().relative_to(ROOT).as_posix()
        if not path.exists() or (heading and heading not in headings(page)):
            dead.append(target)
    assert dead == []


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_that_is_named_exists(document):
    named = {name for name in NAMED.findall(text_of(document)) if "NAME" not in name}
    bare = {name for name in BARE.findall(text_of(document)) if name != "NAME.py"}
    missing = {name for name in named if not (ROOT / name).exists()} | (bare - sources())
    assert missing == set()


@pytest.mark.parametrize("document", [name for name in DOCUMENTS if name != "docs/glossary.md"])
def test_every_constant_and_class_that_is_named_exists(document):
    text = CODE.sub("", text_of(document))
    named = set(re.findall(r"`([A-Z][A-Z0-9]*_[A-Z0-9_]+|[A-Z][a-z]+[A-Z][A-Za-z]+)`", text))
    assert named - words_of_the_code() - FOREIGN == set()


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_module_that_is_named_exists(document):
    missing = []
    for name in MODULE.findall(text_of(document)):
        parts = name.split(".")
        places = [ROOT.joinpath(*parts[:k]) for k in range(len(parts), 1, -1)]
        if not any(place.is_dir() or place.with_suffix(".py").is_file() for place in places):
            missing.append(name)
    assert missing == []


def test_every_page_is_reached_from_the_readme():
    reached, left = set(), ["README.md"]
    while left:
        document = left.pop()
        reached.add(document)
        for target in LINK.findall(text_of(document)):
            path = ((ROOT / document).parent / target.partition("#")[0]).resolve()
            if path.is_file() and path.suffix == ".md" and path.is_relative_to(ROOT):
                name = path.relative_to(ROOT).as_posix()
                left += [name] if name not in reached else []
    assert set(DOCUMENTS) <= reached


def test_every_decision_stands_in_the_index():
    pages = {path.name for path in (ROOT / "docs" / "decisions").glob("[0-9]*.md")}
    assert pages == set(LINK.findall(text_of("docs/decisions/README.md")))


def test_the_readme_is_short():
    assert len(text_of("README.md").splitlines()) <= MOST_README_LINES


@pytest.mark.parametrize("marker", ["grade", "tests"])
def test_the_readme_holds_the_commands_that_continuous_integration_reads(marker):
    command = re.search(rf"^<!-- {marker} -->\n```sh\n(.+)\n```$", text_of("README.md"), re.MULTILINE)
    assert command is not None
    assert command[1].endswith({"grade": "--out sample-results", "tests": "/bin/pytest"}[marker])
    assert subprocess.run(["bash", "-n", "-c", command[1]], check=False).returncode == 0


def test_the_readme_shows_columns_of_the_ranking():
    header = re.search(r"^```\n(rank +fruit_id .+)$", text_of("README.md"), re.MULTILINE)
    assert header is not None
    assert set(header[1].split()) <= set(RANKING_COLUMNS)


def test_the_citation_names_the_version_and_licence_of_the_package():
    citation = yaml.safe_load(text_of("CITATION.cff"))
    project = tomllib.loads(text_of("pyproject.toml"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= citation.keys()
    assert [citation["version"], citation["license"]] == [project["version"], project["license"]]


def keys_of(model: type[BaseModel]) -> set[str]:
    """The names of a table's keys, those of the tables in it too."""
    names = set(model.model_fields)
    for field in model.model_fields.values():
        kinds = [field.annotation, *getattr(field.annotation, "__args__", ())]
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                names |= keys_of(kind)
    return names


@pytest.mark.parametrize(
    "names",
    [RANKING_COLUMNS, COLUMNS, keys_of(Settings)],
    ids=["columns of ranking.csv", "columns of fruits.csv", "keys of batch.toml"],
)
def test_every_name_in_a_file_is_defined_in_formats(names):
    pages = "".join(map(text_of, ("docs/formats.md", *GUIDES)))
    assert [name for name in names if not re.search(rf"\b{name}\b", pages)] == []


def section_of(document: str, heading: str) -> str:
    """From its heading to the next of the same level."""
    return text_of(document).partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def options_of(command) -> set[str]:
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}


def test_every_option_that_the_documents_name_exists():
    """After a command's name, each option is that command's; alone, it is an option of some command."""
    commands = get_command(app).commands
    inner = {name: getattr(command, "commands", {}).values() for name, command in commands.items()}
    known = {
        name: set().union(options_of(command), *map(options_of, inner[name]))
        for name, command in commands.items()
    }
    unknown, seen = [], 0
    for document in DOCUMENTS:
        for name, rest in re.findall(r"\bdrupe ([a-z]+)([^\n`|#]*)", text_of(document)):
            if name in known:
                named = re.findall(r"(?<!\S)--[a-z][a-zA-Z-]*", rest.partition("drupe ")[0])
                seen += len(named)
                unknown += [(document, name, option) for option in named if option not in known[name]]
        alone = re.findall(r"`(--[a-z][a-zA-Z-]*)", text_of(document))
        every = {"--help"}.union(*known.values())
        unknown += [(document, option) for option in alone if option not in every]
    assert unknown == []
    assert seen > 50


def test_every_source_of_convert_has_its_row_in_formats_and_every_option_is_named_there():
    section = section_of("docs/formats.md", "Sources of `drupe convert`")
    first_table = section.partition("|---")[2].partition("\n\n")[0]
    assert re.findall(r"^\| (.+?) \|", first_table, re.MULTILINE) == list(KINDS)
    options = [f"--{name.replace('_', '-')}" for name in signature(convert).parameters]
    assert [name for name in options if name not in section] == ["--source", "--out"]


def test_every_file_and_column_that_convert_reads_is_named_under_its_sources():
    section = section_of("docs/formats.md", "Sources of `drupe convert`")
    arrays = [f"{name}.npy" for name in ("index", "sendTimestamp", *FIELDS)]
    columns = [*MARKER_COLUMNS, *TRAVEL, *FORCE]
    assert [name for name in (*arrays, *columns) if f"`{name}`" not in section] == []


def test_the_program_for_a_gripper_writes_a_recording(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    program = re.search(r"^```python\n(.+?)^```", text_of("docs/how-to/connect-your-gripper.md"), re.M | re.S)
    exec(program[1], {})
    recording = read_recording(tmp_path / "grasp-1.h5")
    ways = [pad.pose[-1, :3, 3] - pad.pose[0, :3, 3] for pad in recording.pads]
    assert [pad.pose[0, :3, 2] @ way for pad, way in zip(recording.pads, ways, strict=True)] == [1.5, 1.5]


def test_every_effect_has_its_row_in_formats_and_its_name_in_the_guides():
    rows = set(re.findall(r"^\| `(\w+)` \|", text_of("docs/formats.md"), re.MULTILINE))
    names = {path.stem for path in (ROOT / "fem" / "mismatch" / "effects").glob("[a-z]*.py")}
    assert "viscoelastic" in names
    assert names <= rows
    assert {
        name for name in names if f"`{name}`" not in text_of("docs/how-to/find-missing-physics.md")
    } == set()
