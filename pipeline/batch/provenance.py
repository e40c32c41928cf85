"""`batch.json`: versions, settings, inputs and times of a result, so that it is reproducible."""

import json
import platform
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from pipeline.batch.batch_place import not_there
from pipeline.batch.cache import ROOMS, code_version, file_hash, library_versions
from pipeline.batch.layout import BatchFolder, Results, write_whole
from pipeline.files.manifest import json_in
from pipeline.files.plain_file import composed_texts
from pipeline.problem import refused

FORMAT = "drupe-batch-result"
RUN_FORMAT = "drupe-run"


def versions() -> dict[str, str]:
    """Versions of drupe, its code (a hash), Python, the platform, and the numerical libraries."""
    return {
        "drupe": metadata.version("drupe"),
        "drupe code": code_version(ROOMS)[:16],
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        **library_versions(),
    }


def input_hashes(root: Path, files: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of each input file, by its path inside the batch, or its absolute path if it is outside."""
    return {_inside(path, root): file_hash(path) for path in files}


def _inside(path: Path, root: Path) -> str:
    around = next((place for place in (root, root.resolve()) if path.is_relative_to(place)), None)
    return (path.absolute() if around is None else path.relative_to(around)).as_posix()


def write_provenance(path: Path, content: Mapping[str, Any]) -> None:
    """Writes batch.json: `content` (docs/formats.md) and the versions. Raises NotWritten."""
    whole = {"format": FORMAT, "version": 1, "versions": versions(), **content}
    write_whole(path, json.dumps(whole, indent=1, default=str) + "\n")


def read_provenance(results: Results) -> dict[str, Any] | None:
    """The content of batch.json, its settings with composed letters; None if it is missing or invalid."""
    said = json_in(results.provenance)
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        return None
    return said | {"settings": composed_texts(said["settings"])} if "settings" in said else said


def require_provenance(results: Results) -> dict[str, Any]:
    """The content of batch.json; if there is none, raises BatchRefused and suggests the likely folder."""
    if (said := read_provenance(results)) is not None:
        return said
    if not results.root.is_dir():
        raise not_there(
            results.root, holding=results.provenance.name, otherwise="give the folder from --out."
        )
    inside = results.root / "results"
    if Results(inside).provenance.is_file():
        hint = f"did you mean {inside}?"
    elif BatchFolder(results.root).settings.is_file():
        hint = "it is a batch that is not graded yet: run drupe grade on it first."
    else:
        hint = "give the folder from --out."
    raise refused(results.root, f"contains no results of drupe grade (batch.json); {hint}")


def require_finished(results: Results) -> dict[str, Any]:
    """The content of batch.json; raises BatchRefused if there is none, or if the run did not finish."""
    said = require_provenance(results)
    if said.get("exit_status") is None:
        raise refused(results.provenance, "belongs to an unfinished run; let `drupe grade` finish it first.")
    return said


def write_run(results: Results, *, mark: str) -> None:
    """Writes the mark of a run, by which another machine recognises the same folder.

    Raises NotWritten.
    """
    write_whole(results.run, json.dumps({"format": RUN_FORMAT, "version": 2, "mark": mark}) + "\n")


def is_marked(run: Path, mark: str) -> bool:
    """Whether `write_run` wrote the file `run` with this mark."""
    held = json_in(run)
    return isinstance(held, dict) and (held.get("format"), held.get("mark")) == (RUN_FORMAT, mark)


def utc_text(at: datetime) -> str:
    """A time in UTC by ISO 8601, to the second."""
    return at.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
