"""The control chart of a gripper: what it read of its reference bodies, batch by batch, in a CSV of its own.

`[reference] chart` in batch.toml names the file. It is the one file outside the results that `drupe grade`
writes, and the user names it for this alone: rows of other batches stay as they are, and a file that is no
such table is refused.
"""

import csv
import hashlib
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.write_guard import batch_trees, require_file_apart
from pipeline.files.lock_file import WAIT_S, holder_of, locked_within
from pipeline.files.plain_file import NotReadable, read_text
from pipeline.files.whole_file import put
from pipeline.problem import BatchRefused, refused
from tactile.io.decimal_number import decimal_number, meant

MOST_BYTES = 4_000_000
"""As fruits.csv: at 200 bytes a row, 50 batches a day for a year."""
ALLOWED_FOLDERS = "DRUPE_CHARTS"
"""Environment variable with folders in which charts may lie, separated as PATH is."""
FAR_SD, NEAR_SD = 3.0, 2.0
"""Action and warning limits of a Shewhart chart (Montgomery, Introduction to Statistical Quality Control)."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """One reference body in one batch; the columns of the table, in order."""

    time_utc: str
    lot: str
    reference_id: str
    E_known_MPa: float
    E_found_MPa: float
    ratio: float
    ratio_sd: float
    recordings_sha256: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Of the batch's own row: the same recordings graded again take its place."""
        return self.lot, self.reference_id, self.recordings_sha256

    @property
    def graded_at(self) -> datetime:
        """When it was first graded."""
        return datetime.fromisoformat(self.time_utc)

    @property
    def z(self) -> float:
        """ln r over its standard deviation."""
        return math.log(self.ratio) * self.ratio / self.ratio_sd


COLUMNS = tuple(field.name for field in fields(Point))
HEADER = ",".join(COLUMNS)


@dataclass(frozen=True, kw_only=True)
class ControlChart:
    """The table as it stands: its points, and each one's own lines as they are in the file."""

    points: tuple[Point, ...] = ()
    lines: tuple[str, ...] = ()


def chart_path(folder: BatchFolder, named: str, *, environment: Mapping[str, str] = os.environ) -> Path:
    """Where the chart lies: its name is relative to batch.toml.

    Somebody else may have written batch.toml, so that it may name a file inside the batch's folder, directly
    in the folder around it, where batches share a chart, or in a folder that the environment variable
    DRUPE_CHARTS lists. Raises BatchRefused for every other place; links are followed before.
    """
    path, root = folder.root / named, folder.root.resolve()
    if "\0" in named:
        raise refused(folder.settings, '"reference.chart" contains a null character; remove it.')
    place = path.parent.resolve()
    allowed = [
        Path(directory).resolve()
        for directory in environment.get(ALLOWED_FOLDERS, "").split(os.pathsep)
        if directory
    ]
    if place == root.parent or any(place.is_relative_to(parent) for parent in (root, *allowed)):
        return path
    sentence = (
        f'"reference.chart": found {named[:200]!r}, which is in {place}; expected a file in the batch '
        'or beside its folder ("../gripper.csv"). To allow another folder, list it in the '
        f"environment variable {ALLOWED_FOLDERS}."
    )
    raise refused(folder.settings, sentence)


def read_chart(path: Path) -> ControlChart:
    """The table at `path`, empty where there is no file; raises BatchRefused where it is no control chart."""

    def no_chart(sentence: str) -> BatchRefused:
        return refused(path, f"{sentence}; name another file in [reference] chart.")

    if path.suffix.lower() != ".csv":
        raise no_chart('is not a valid name for a control chart; expected a name that ends in ".csv"')
    if not path.parent.is_dir():
        raise no_chart(f"cannot be written: there is no folder {path.parent}")
    if path.is_symlink():
        raise no_chart("is a link, and drupe does not write through links; name the target file")
    if not path.exists():
        return ControlChart()
    try:
        text = read_text(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise no_chart(str(error)) from None
    lines = text.splitlines()
    if not lines or lines[0].removeprefix("\ufeff") != HEADER:
        first_line = lines[0][:120] if lines else ""
        raise no_chart(
            f'is not a control chart of drupe: its first line is "{first_line}", expected "{HEADER}"; '
            "drupe does not overwrite it"
        )
    kept = [line for line in lines[1:] if line.strip()]
    try:
        points = tuple(_point(row, k) for k, row in enumerate(csv.reader(kept, strict=True), 2))
    except (ValueError, csv.Error) as error:
        raise no_chart(f"is a damaged control chart: {error}") from None
    if len(points) != len(kept):
        raise no_chart("is a damaged control chart: one row spans several lines; expected one line per row")
    return ControlChart(points=points, lines=tuple(kept))


def _point(row: Sequence[str], line: int) -> Point:
    """A row of the chart as a point; raises ValueError that names the row and the cell."""
    if len(row) != len(COLUMNS):
        raise ValueError(
            f"row {line} has {len(row)} cells, expected {len(COLUMNS)}; correct or remove the row"
        )
    cells: dict[str, str] = dict(zip(COLUMNS, row, strict=True))
    numbers = {}
    for name in ("E_known_MPa", "E_found_MPa", "ratio", "ratio_sd"):
        numbers[name] = decimal_number(cells[name]) or 0.0
        if not numbers[name] > 0:
            raise ValueError(
                f'row {line}: {name} is "{cells[name][:40]}", expected a number above '
                f"zero{meant(cells[name])}; correct or remove the row"
            )
    try:
        aware = datetime.fromisoformat(cells["time_utc"]).tzinfo is not None
    except ValueError:
        aware = False
    if not aware:
        raise ValueError(
            f'row {line}: time_utc is "{cells["time_utc"][:40]}", expected a time such as '
            "2026-08-14T09:30:00Z; correct or remove the row"
        )
    return Point(
        time_utc=cells["time_utc"],
        lot=cells["lot"],
        reference_id=cells["reference_id"],
        recordings_sha256=cells["recordings_sha256"],
        **numbers,
    )


def require_chart_place(path: Path, folder: BatchFolder, results: Results, inputs: Sequence[Path]) -> None:
    """Raises BatchRefused where the chart is an input, or lies among the fruit or in the results."""
    advice = "name another file in [reference] chart."
    require_file_apart(path, inputs=inputs, folders=batch_trees(folder)[1:], advice=advice)
    if path.resolve().is_relative_to(results.root.resolve()):
        sentence = (
            f"lies in the results folder {results.root}, and each run replaces the files there; {advice}"
        )
        raise refused(path, sentence)


def recordings_sha256(inputs: Mapping[str, str], fruit_id: str) -> str:
    """Of its one recording, or of the list of the hashes of several."""
    hashes = sorted(sha for path, sha in inputs.items() if path.startswith(f"fruits/{fruit_id}/grasps/"))
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def with_points(chart: ControlChart, batch_points: Sequence[Point]) -> ControlChart:
    """The chart with the batch's rows at its end, or in place of those it had, whose time they keep."""
    points, lines = list(chart.points), list(chart.lines)
    for point in batch_points:
        at = next((k for k, charted_point in enumerate(points) if charted_point.key == point.key), None)
        if at is None:
            points.append(point)
            lines.append(_line(point))
        else:
            points[at] = replace(point, time_utc=points[at].time_utc)
            lines[at] = _line(points[at])
    return ControlChart(points=tuple(points), lines=tuple(lines))


def _line(point: Point) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(astuple(point))
    return out.getvalue()


def update_chart(path: Path, batch_points: Sequence[Point]) -> ControlChart:
    """Writes the batch's rows into the chart, whole or not at all, while no other run of drupe does.

    Raises BatchRefused where the file is no such table, and NotWritten.
    """
    with _alone_in(path.parent):
        before = read_chart(path)
        after = with_points(before, batch_points)
        if after != before:
            put(path, ("\n".join([HEADER, *after.lines]) + "\n").encode())
    return after


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """While no other run of drupe writes a chart in this folder, where its file system has locks.

    Raises BatchRefused where a process still holds the folder's lock after WAIT_S.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        if not locked_within(handle, WAIT_S):
            sentence = (
                f"another process{holder_of(handle)} locked this folder for more than {WAIT_S:.0f} s, "
                "so drupe did not update the control chart in it. End that process, and run the "
                "report again."
            )
            raise refused(folder, sentence)
        yield
    finally:
        os.close(handle)


def history_of(chart: ControlChart, reference_id: str) -> list[Point]:
    """The points of one reference body, oldest first."""
    return sorted(
        (point for point in chart.points if point.reference_id == reference_id),
        key=lambda charted_point: charted_point.graded_at,
    )


def out_of_control(z: Float[np.ndarray, " n"]) -> str:
    """What a chart's last point says, "" where the process is in control.

    `z`: ln r over its standard deviation, oldest first. Western Electric's first two rules (Montgomery,
    Introduction to Statistical Quality Control, ch. 5): the last beyond 3; the last and one of the two before
    it beyond 2 on the same side.

    >>> out_of_control(np.array([2.1, -0.3, 2.4]))
    'two of the last three batches deviate by more than 2 standard deviations on the same side'
    """
    last = float(z[-1])
    if abs(last) > FAR_SD:
        return f"the last batch deviates by more than {FAR_SD:g} standard deviations ({last:+.1f})"
    same_side = z[-3:] * math.copysign(1.0, last) > NEAR_SD
    if same_side[-1] and same_side.sum() >= 2:
        return (
            f"two of the last three batches deviate by more than {NEAR_SD:g} standard deviations "
            "on the same side"
        )
    return ""
