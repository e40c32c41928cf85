"""`verdicts.jsonl`: people's verdicts on fruit, one line each; drupe only ever adds lines."""

import hashlib
import io
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from importlib import metadata
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from pipeline.batch.records import FruitRecord
from pipeline.files.manifest import writing_alone
from pipeline.files.plain_file import NotReadable, printable, read_text
from pipeline.files.whole_file import put
from pipeline.problem import refused

MOST_BYTES = 50_000_000
"""Most bytes of the file: ten verdicts on each of 2000 fruit, of 1 kB each, are 20 MB."""
MOST_NAME, MOST_WHY = 80, 1000
"""Most characters of a name and of a reason. Set by hand: a reason is a sentence or two."""


class Verdict(BaseModel):
    """A person's class for a fruit. `key`, `E_MPa`, `E_sd_MPa`: of the result that the person judged.

    `device`: the device of the network that sent it; empty if none did. `after`: SHA-256 of all earlier
    lines, which reveals a changed or removed line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    fruit_id: str
    judged_class: str
    by: str
    why: str
    at_utc: datetime
    drupe: str
    device: str = ""
    key: str
    E_MPa: float | None
    E_sd_MPa: float | None
    after: str


@dataclass(frozen=True, kw_only=True)
class Trail:
    """Verdicts by fruit, the oldest first. `fault`: why the file is not reliable; empty if it is."""

    of_fruit: Mapping[str, tuple[Verdict, ...]] = field(default_factory=dict)
    fault: str = ""


def read_trail(path: Path) -> Trail:
    """The verdicts in `path`, up to the first faulty line; empty if there is no file."""
    if not path.is_symlink() and not path.exists():
        return Trail()
    of_fruit: dict[str, list[Verdict]] = defaultdict(list)
    fault = ""
    try:
        lines, before = io.StringIO(read_text(path, most_bytes=MOST_BYTES), newline="\n"), hashlib.sha256()
        for number, line in enumerate(lines, 1):
            verdict = Verdict.model_validate_json(line)
            if verdict.after != before.hexdigest() or not line.endswith("\n"):
                raise ValueError(f"line {number} does not follow the lines before it")
            of_fruit[verdict.fruit_id].append(verdict)
            before.update(line.encode())
    except ValidationError:
        fault = f"line {number} is no verdict"
    except (NotReadable, ValueError) as error:
        fault = str(error)
    if fault:
        fault = (
            f"{path.name}: {fault}; somebody changed the file, and drupe adds no verdict to it. Restore it "
            "from a copy, or move it away."
        )
    return Trail(of_fruit={name: tuple(said) for name, said in of_fruit.items()}, fault=fault)


def add_verdict(
    path: Path,
    record: FruitRecord,
    *,
    judged_class: str,
    by: str,
    why: str,
    now: datetime,
    device: str = "",
) -> Verdict:
    """Adds a person's verdict on the fruit of `record` to the file at `path`.

    Raises BatchRefused if a text is empty or too long, or if somebody changed the file; and NotWritten.
    """
    texts = {"class": (judged_class, MOST_NAME), "by": (by, MOST_NAME), "why": (why, MOST_WHY)}
    said = {name: " ".join(printable(text).split()) for name, (text, _) in texts.items()}
    for name, (_, most) in texts.items():
        if not 0 < len(said[name]) <= most:
            raise refused(f"--{name}", f"has {len(said[name])} characters; expected 1 to {most}.")
    E_MPa, E_sd_MPa = record.ranked_modulus
    with writing_alone(path.parent):
        if fault := read_trail(path).fault:
            raise refused(path, fault.removeprefix(f"{path.name}: "))
        before = read_text(path, most_bytes=MOST_BYTES) if path.exists() else ""
        verdict = Verdict(
            fruit_id=record.fruit_id,
            judged_class=said["class"],
            by=said["by"],
            why=said["why"],
            at_utc=now,
            drupe=metadata.version("drupe"),
            device=device,
            key=record.key,
            E_MPa=E_MPa,
            E_sd_MPa=E_sd_MPa,
            after=hashlib.sha256(before.encode()).hexdigest(),
        )
        put(path, f"{before}{verdict.model_dump_json()}\n".encode())
    return verdict
