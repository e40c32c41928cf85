"""`drupe firmness`: simulates standard tests on graded fruit, and writes lines, a table and a page."""

import math
import os
import statistics
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import pandas as pd

from fem.estimation.error_budget import ErrorBudget
from fem.fem_failure import FemFailure, FemProblem
from fem.firmness.simulated_presses import FruitPresses, simulated_presses, spheroid_presses
from fem.firmness.trade_tests import TradeTest, modulus_at, reading
from pipeline.batch.firmness_columns import ERROR
from pipeline.batch.fruits_table import SAFE_ID
from pipeline.batch.layout import FruitResults, Results, write_whole
from pipeline.batch.provenance import require_finished
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.write_guard import require_free, results_lock
from pipeline.files.plain_file import printable
from pipeline.problem import nearest, refused
from recon.recon_failure import ReconFailure
from recon.surface.mesh_file import read_mesh
from reports.language import ENGLISH
from reports.tables import safe_cell
from reports.trade_page import SizeEffect, TradeFruit, trade_html
from reports.words import with_sd

DIAMETERS_mm = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
"""Diameters of the page's round fruit: from cherries to large peaches."""
PIT_SHARES = (0.0, 0.3, 0.45, 0.6)
"""Their pits' diameters over their own, up to the end of the table of spheroids."""
POISSON_RATIO = 0.45
"""Poisson's ratio of the page's round fruit."""
BALL_FROM_mm = 50.0
"""Smaller fruit, and pits, change the reading of the ball. In a fruit of 20 mm and 0.6 MPa with a pit of 0.6,
its depth is 0.66 mm by mesh, not 0.79 mm."""
PENDING = "not simulated yet: run drupe firmness again"

Limit = tuple[TradeTest, float]
"""A test and a limit in its unit."""


def trade_numbers(
    out: Path,
    tests: Sequence[TradeTest],
    limits: Sequence[str],
    *,
    now: datetime,
    language: str = ENGLISH,
) -> Iterator[str]:
    """Simulates the tests fruit by fruit and yields a line for each. After each, writes firmness.csv and
    firmness.html in `out`, with a reason for every fruit without readings.

    `limits`: texts TEST=VALUE. `language`: of the page. Raises BatchRefused before any computation if
    results or options are invalid, and NotWritten.
    """
    results = Results(out)
    said = require_finished(results)
    names = _fruit_names(results, said.get("outcomes"))
    asked = [_limit(text, tests) for text in limits]
    graded_utc = str(said.get("finished_utc") or "")
    done: list[TradeFruit] = []
    with results_lock(out):
        targets = (results.firmness, results.firmness_page)
        require_free(targets, "drupe grade --out")
        if not os.access(out, os.W_OK):
            raise refused(out, "cannot be written; ask for the right to write there.")
        for name in names:
            done.append(_simulated(name, results.fruit(name), tests, asked))
            waiting = [TradeFruit(fruit_id=later, reason=PENDING) for later in names[len(done) :]]
            _write(results, [*done, *waiting], tests, now=now, graded_utc=graded_utc, language=language)
            yield _line(done[-1], tests)
    yield from (_limit_line(limit, done) for limit in asked)
    simulated = sum(not fruit.reason for fruit in done)
    yield f"{results.firmness} and {results.firmness_page.name}: {simulated} of {len(done)} fruit"


def _fruit_names(results: Results, outcomes: object) -> list[str]:
    """The fruit_ids in batch.json; raises BatchRefused if it is damaged or has an invalid name."""
    if not isinstance(outcomes, dict):
        sentence = "is damaged or from another version (outcomes is no table); grade the batch again."
        raise refused(results.provenance, sentence)
    if not outcomes:
        raise refused(results.root, "contains no fruit's record; run `drupe grade` first.")
    for name in outcomes:
        if not SAFE_ID.fullmatch(name):
            sentence = f'contains a fruit_id that drupe never writes, "{printable(name[:80])}"; grade again.'
            raise refused(results.provenance, sentence)
    return list(outcomes)


def _write(
    results: Results,
    fruit: Sequence[TradeFruit],
    tests: Sequence[TradeTest],
    *,
    now: datetime,
    graded_utc: str,
    language: str,
) -> None:
    table = _table(fruit, tests, graded_utc)
    write_whole(results.firmness, table.to_csv(index=False, lineterminator="\n"))
    moduli = [row.E_MPa for row in fruit if row.readings and row.E_MPa]
    page = trade_html(
        tests,
        fruit,
        _sizes(tests, E_MPa=statistics.median(moduli or [0.5])),
        made_utc=now,
        graded_utc=graded_utc,
        folder=printable(str(results.root)),
        language=language,
    )
    write_whole(results.firmness_page, page)


def _limit(text: str, tests: Sequence[TradeTest]) -> Limit:
    name, _, value = text.partition("=")
    test = {test.name: test for test in tests}.get(name.strip())
    quotation = f'found "{printable(text[:80])}"'
    if test is None:
        names = [test.name for test in tests]
        known = nearest(name, names, f"known tests: {', '.join(names)}.")
        raise refused("--limit", f"{quotation}; {known}")
    with suppress(ValueError):
        if 0 < float(value) < math.inf:
            return test, float(value)
    raise refused("--limit", f"{quotation}, expected {test.name}=NUMBER, above 0.")


def _simulated(
    name: str, folder: FruitResults, tests: Sequence[TradeTest], limits: Sequence[Limit]
) -> TradeFruit:
    record = read_record(folder.record)
    if record is None:
        return TradeFruit(fruit_id=name, reason="its record.json is missing or cannot be read; grade again")
    if record.given.reference:
        return TradeFruit(fruit_id=name, reason="it is a reference body, no fruit")
    E_MPa, E_sd_MPa = record.ranked_modulus
    if E_MPa is None or E_sd_MPa is None or record.modulus is None:
        return TradeFruit(fruit_id=name, reason=record.reason or record.outcome)
    if not 0 < E_MPa < math.inf:
        return TradeFruit(fruit_id=name, reason=f"its E is {E_MPa:g} MPa")
    E_sd_MPa = math.hypot(E_sd_MPa, _scale_sd(record) * E_MPa)
    try:
        presses = fruit_presses(record, folder)
    except (FemFailure, ReconFailure) as failure:
        return TradeFruit(fruit_id=name, reason=str(failure))
    return TradeFruit(
        fruit_id=name,
        E_MPa=E_MPa,
        E_sd_MPa=E_sd_MPa,
        diameter_mm=presses[0].diameters_mm[0],
        pit_share=presses[0].pit_share,
        readings={test.name: reading(test, presses, E_MPa=E_MPa, E_sd_MPa=E_sd_MPa) for test in tests},
        E_at={_column(limit): modulus_at(limit[0], presses[0], limit[1]) for limit in limits},
        doubt=" ".join(record.doubts),
    )


def _scale_sd(record: FruitRecord) -> float:
    """Relative standard deviation of E by the sensor's scale, after reference bodies if there are any."""
    if record.reference is not None:
        return record.reference.E_scale_sd_MPa / record.reference.E_MPa
    return 0.0 if record.modulus is None else record.modulus.scale_sd_MPa / record.modulus.E_MPa


def fruit_presses(record: FruitRecord, folder: FruitResults) -> tuple[FruitPresses, ...]:
    """Presses of the fruit's mesh and pit, with grading's errors. Raises FemFailure and ReconFailure.

    Records of earlier versions have the pit's error only if several grasps inferred the pit.
    """
    if record.flesh is None or record.mesh is None:
        raise FemFailure(FemProblem.BAD_LOAD, "it has diameters, but no mesh")
    sought = record.modulus and record.modulus.pit_found
    pit_size_sd = (record.pit and record.pit.size_sd) or (sought and sought.size_prior_sd)
    surface_sd = record.mesh.surface_sd_mm
    return simulated_presses(
        read_mesh(folder.fruit_ply),
        read_mesh(folder.pit_ply) if record.pit else None,
        poisson_ratio=record.flesh.poisson_ratio,
        poisson_ratio_sd=record.flesh.poisson_ratio_sd,
        pit_size_sd=pit_size_sd or ErrorBudget.pit_size_sd,
        surface_sd_mm=ErrorBudget.surface_sd_mm if surface_sd is None else surface_sd,
    )


def _line(fruit: TradeFruit, tests: Sequence[TradeTest]) -> str:
    if fruit.reason:
        return f"{fruit.fruit_id}: not simulated: {printable(fruit.reason)}"
    doubt = f"; in doubt: {printable(fruit.doubt)}" if fruit.doubt else ""
    read = [f"{with_sd(*fruit.readings[t.name])} {t.unit} ({t.title})" for t in tests]
    return f"{fruit.fruit_id}: E {with_sd(fruit.E_MPa, fruit.E_sd_MPa)} MPa; {'; '.join(read)}{doubt}"


def _limit_line(limit: Limit, done: Sequence[TradeFruit]) -> str:
    sound = [fruit for fruit in done if not fruit.doubt]
    reached = [E for fruit in sound if math.isfinite(E := fruit.E_at.get(_column(limit), math.nan))]
    named = f"{limit[1]:g} {limit[0].unit} ({limit[0].title})"
    doubted = ", ".join(fruit.fruit_id for fruit in done if fruit.doubt)
    without = f" Left out, because in doubt: {doubted}." if doubted else ""
    if not reached:
        return f"{named}: no simulated E of these fruit reads it.{without}"
    middle = statistics.median(reached)
    warning = f" {limit[0].caveat}: E is up to 2.8 times too large." if limit[0].caveat else ""
    return (
        f"{named}: these fruit read it at E = {middle:.3g} MPa (median; {min(reached):.3g} to "
        f"{max(reached):.3g} by size and pit). In batch.toml: E_max_MPa = {middle:.3g}"
        f"{'.' * bool(without or warning)}{without}{warning}"
    )


def _column(limit: Limit) -> str:
    return f"E_MPa_at_{limit[1]:g}_{limit[0].name}"


def _table(done: Sequence[TradeFruit], tests: Sequence[TradeTest], graded_utc: str) -> pd.DataFrame:
    rows = []
    for fruit in done:
        numbers = {name: getattr(fruit, name) for name in ("E_MPa", "E_sd_MPa", "diameter_mm", "pit_share")}
        for test in tests:
            value, sd = fruit.readings.get(test.name, (math.nan, math.nan))
            numbers |= {test.name: value, f"{test.name}{ERROR}": sd}
        shown: dict[str, Any] = {
            name: None if x is None else float(f"{x:.4g}") for name, x in {**numbers, **fruit.E_at}.items()
        }
        words = {"doubt": safe_cell(fruit.doubt), "reason": safe_cell(fruit.reason)}
        when = safe_cell(graded_utc)
        rows.append({"fruit_id": safe_cell(fruit.fruit_id), **shown, "finished_utc": when, **words})
    table = pd.DataFrame(rows)
    last = ["finished_utc", "doubt", "reason"]
    return table[[name for name in table if name not in last] + last]


def _sizes(tests: Sequence[TradeTest], *, E_MPa: float) -> SizeEffect:
    """Readings of round fruit of one E by diameter, for each pit share."""
    values: dict[str, list[list[float]]] = {test.name: [] for test in tests}
    for share in PIT_SHARES:
        fruit = [
            spheroid_presses((d, d, d), pit_share=share, poisson_ratio=POISSON_RATIO) for d in DIAMETERS_mm
        ]
        for test in tests:
            values[test.name].append(
                [
                    math.nan
                    if test.under_ball and (share > 0 or diameter < BALL_FROM_mm)
                    else test.read(presses, E_MPa)[0]
                    for diameter, presses in zip(DIAMETERS_mm, fruit, strict=True)
                ]
            )
    return SizeEffect(
        E_MPa=E_MPa,
        poisson_ratio=POISSON_RATIO,
        diameters_mm=DIAMETERS_mm,
        pit_shares=PIT_SHARES,
        values=values,
    )
