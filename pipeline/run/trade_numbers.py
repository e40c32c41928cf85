"""`drupe firmness`: standard tests simulated on graded fruit, as lines, a table and a page."""

import math
import statistics
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import pandas as pd

from fem.estimation.error_budget import ErrorBudget
from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.simulated_presses import FruitPresses, simulated_presses, spheroid_presses
from fem.indentation.trade_tests import TradeTest, modulus_at, reading
from pipeline.batch.layout import FruitResults, Results, write_whole
from pipeline.batch.provenance import require_provenance
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.write_guard import require_free
from pipeline.files.plain_file import printable
from pipeline.problem import nearest, refused
from recon.pit.priors import load_prior
from recon.recon_failure import ReconFailure
from recon.surface.mesh_file import read_mesh
from reports.tables import safe_cell
from reports.trade_page import SizeEffect, TradeEntry, TradeFruit, TradeWords, trade_html
from reports.words import with_sd

DIAMETERS_mm = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
"""Of the page's round fruit: from cherries to large peaches."""
PIT_SHARES = (0.0, 0.3, 0.45, 0.6)
"""Their pits' diameters over their own: as far as the table of spheroids goes."""

Limit = tuple[TradeTest, float]
"""A test and a limit in its unit."""


def trade_numbers(
    out: Path, tests: Sequence[TradeTest], limits: Sequence[str], *, now: datetime
) -> Iterator[str]:
    """Simulates the tests fruit by fruit, a line each; then writes firmness.csv and firmness.html in `out`.

    `limits`: texts TEST=VALUE. Raises BatchRefused before anything is computed where results or options are
    not sound; and NotWritten.
    """
    results = Results(out)
    said = require_provenance(results)
    asked = [_limit(text, tests) for text in limits]
    require_free(results, [], "drupe grade --out", tables=(results.firmness, results.firmness_page))
    folders = [results.fruit(str(name)) for name in said.get("outcomes") or ()]
    done: list[TradeFruit] = []
    for folder in folders:
        if (record := read_record(folder.record)) is not None:
            done.append(_simulated(record, folder, said.get("settings") or {}, tests, asked))
            yield _line(done[-1], tests)
    yield from (_limit_line(limit, done) for limit in asked)
    write_whole(results.firmness, _table(done, tests).to_csv(index=False, lineterminator="\n"))
    moduli = [fruit.E_MPa for fruit in done if fruit.readings and fruit.E_MPa]
    entry = TradeEntry(
        made_utc=now,
        folder=printable(str(out)),
        tests=tuple(TradeWords(name=t.name, title=t.title, unit=t.unit, source=t.source) for t in tests),
        fruit=tuple(done),
        sizes=_sizes(tests, E_MPa=statistics.median(moduli or [0.5])),
    )
    write_whole(results.firmness_page, trade_html(entry))
    yield f"{results.firmness} and {results.firmness_page.name}: {len(moduli)} of {len(done)} fruit"


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
    record: FruitRecord,
    folder: FruitResults,
    settings: dict[str, Any],
    tests: Sequence[TradeTest],
    limits: Sequence[Limit],
) -> TradeFruit:
    E_MPa, E_sd_MPa = record.ranked_modulus
    if E_MPa is None or E_sd_MPa is None or record.modulus is None:
        return TradeFruit(fruit_id=record.fruit_id, reason=record.reason or record.outcome)
    E_sd_MPa = math.hypot(E_sd_MPa, record.modulus.scale_sd_MPa / record.modulus.E_MPa * E_MPa)
    try:
        presses = _presses(record, folder, settings)
    except (FemFailure, ReconFailure) as failure:
        return TradeFruit(fruit_id=record.fruit_id, reason=str(failure))
    return TradeFruit(
        fruit_id=record.fruit_id,
        E_MPa=E_MPa,
        E_sd_MPa=E_sd_MPa,
        diameter_mm=presses[0].diameters_mm[0],
        pit_share=presses[0].pit_share,
        readings={test.name: reading(test, presses, E_MPa=E_MPa, E_sd_MPa=E_sd_MPa) for test in tests},
        E_at={_column(limit): modulus_at(limit[0], presses[0], limit[1]) for limit in limits},
    )


def _presses(record: FruitRecord, folder: FruitResults, settings: dict[str, Any]) -> tuple[FruitPresses, ...]:
    """On the fruit's mesh. The pit's spread: found by grasps, stated in the batch, or its category's."""
    if record.flesh is None or record.mesh is None:
        raise FemFailure(FemProblem.BAD_LOAD, "it has diameters, but no mesh")
    pit_found = record.modulus and record.modulus.pit_found
    pit_size_sd = (
        pit_found.size_sd / pit_found.size if pit_found else (settings.get("pit") or {}).get("size_sd")
    )
    with suppress(ReconFailure):
        if pit_size_sd is None:
            pit_size_sd = load_prior(str(settings.get("category"))).size_sd
    surface_sd = record.mesh.surface_sd_mm
    return simulated_presses(
        read_mesh(folder.fruit_ply),
        read_mesh(folder.pit_ply) if folder.pit_ply.is_file() else None,
        poisson_ratio=record.flesh.poisson_ratio,
        poisson_ratio_sd=record.flesh.poisson_ratio_sd,
        pit_size_sd=ErrorBudget.pit_size_sd if pit_size_sd is None else pit_size_sd,
        surface_sd_mm=ErrorBudget.surface_sd_mm if surface_sd is None else surface_sd,
    )


def _line(fruit: TradeFruit, tests: Sequence[TradeTest]) -> str:
    if fruit.reason:
        return f"{fruit.fruit_id}: not simulated: {printable(fruit.reason)}"
    read = [f"{with_sd(*fruit.readings[t.name])} {t.unit} ({t.title})" for t in tests]
    return f"{fruit.fruit_id}: E {with_sd(fruit.E_MPa, fruit.E_sd_MPa)} MPa; {'; '.join(read)}"


def _limit_line(limit: Limit, done: Sequence[TradeFruit]) -> str:
    reached = [E for fruit in done if math.isfinite(E := fruit.E_at.get(_column(limit), math.nan))]
    named = f"{limit[1]:g} {limit[0].unit} ({limit[0].title})"
    if not reached:
        return f"{named}: no simulated E of these fruit reads it."
    middle = statistics.median(reached)
    return (
        f"{named}: these fruit read it at E = {middle:.3g} MPa (median; {min(reached):.3g} to "
        f"{max(reached):.3g} by size and pit). In batch.toml: E_max_MPa = {middle:.3g}"
    )


def _column(limit: Limit) -> str:
    return f"E_MPa_at_{limit[1]:g}_{limit[0].name}"


def _table(done: Sequence[TradeFruit], tests: Sequence[TradeTest]) -> pd.DataFrame:
    rows = []
    for fruit in done:
        numbers = {name: getattr(fruit, name) for name in ("E_MPa", "E_sd_MPa", "diameter_mm", "pit_share")}
        for test in tests:
            value, sd = fruit.readings.get(test.name, (math.nan, math.nan))
            numbers |= {test.name: value, f"{test.name}_sd": sd}
        shown = {
            name: None if x is None else float(f"{x:.4g}") for name, x in {**numbers, **fruit.E_at}.items()
        }
        rows.append({"fruit_id": safe_cell(fruit.fruit_id)} | shown | {"reason": safe_cell(fruit.reason)})
    table = pd.DataFrame(rows)
    return table[[name for name in table if name != "reason"] + ["reason"]]


def _sizes(tests: Sequence[TradeTest], *, E_MPa: float, poisson_ratio: float = 0.45) -> SizeEffect:
    """Readings of round fruit of one E over diameter, for each pit share."""
    values: dict[str, list[list[float]]] = {test.name: [] for test in tests}
    for share in PIT_SHARES:
        fruit = [
            spheroid_presses((d, d, d), pit_share=share, poisson_ratio=poisson_ratio) for d in DIAMETERS_mm
        ]
        for test in tests:
            values[test.name].append([test.read(presses, E_MPa)[0] for presses in fruit])
    return SizeEffect(
        E_MPa=E_MPa,
        poisson_ratio=poisson_ratio,
        diameters_mm=DIAMETERS_mm,
        pit_shares=PIT_SHARES,
        values=values,
    )
