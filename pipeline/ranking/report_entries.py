"""From records to the reports' entries."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect_spec import EffectWords
from fem.mismatch.result import UNKNOWN
from pipeline.batch.firmness_columns import firmness_readings
from pipeline.batch.layout import FruitResults, Results
from pipeline.batch.opening import Batch
from pipeline.batch.provenance import versions
from pipeline.batch.records import DiagnosisRecord, FruitRecord, read_as
from pipeline.batch.settings import Grading
from pipeline.batch.verdicts import Trail, Verdict, read_trail
from pipeline.ranking.batch_faults import BatchFault, old_calibrations
from pipeline.ranking.decisions import decide
from pipeline.ranking.error_parts import COMMON_SCALE, about_error
from pipeline.ranking.maturity import Rank, agreement, standings
from pipeline.ranking.reference_ratio import ReferenceFinding
from pipeline.ranking.report_pictures import fruit_pictures
from pipeline.ranking.run_summary import decimals
from pipeline.ranking.verified_scale import shared_gain, with_own_gain
from reports.entries import (
    OR,
    BatchEntry,
    FruitEntry,
    ReferenceEntry,
    ScreenEntry,
    ShoreCorrelation,
    Suspect,
    Unfinished,
    VerdictEntry,
)
from reports.words import with_sd

SCREEN_WORDS: Mapping[str, EffectWords] = {
    UNKNOWN: EffectWords(
        short="an effect that drupe does not know",
        meaning="The recordings differ from the model by more than noise.",
        advice="Do not trust E until drupe explain identifies the cause.",
    ),
}
"""Names of the screen that are no effect of the catalogue."""
RANK_FIELDS = ("rank", "rank_probability", "rank_low", "rank_high", "p_softer_than_next")
"""Fields that an entry copies from a fruit's rank."""
SETTING_FIELDS = ("cultivar", "lot", "packer", "harvest_date", "measured_on", "pulp_temperature_C")
"""Fields that an entry copies from the batch's settings."""
RANKING_SEED = 20260814
"""Seed of the draws behind the ranking's intervals; any number does, a fixed one makes runs repeat."""


def batch_entry(
    batch: Batch,
    records: Sequence[FruitRecord],
    *,
    results: Results,
    inputs: Mapping[str, str],
    started: datetime,
    finished: datetime,
    exit_status: int | None,
    finding: ReferenceFinding | None = None,
    faults: Sequence[BatchFault] = (),
    unfinished: Unfinished | None = None,
) -> BatchEntry:
    """The batch as the reports show it, ranked softest first.

    `records` and `finding` as `against_references` returns them; `unfinished`: progress of a run whose
    `records` are not all.
    """
    graded = [r for r in records if r.graded and not r.given.reference]
    moduli = [r.modulus for r in graded if r.modulus]
    of_all = min(map(shared_gain, moduli), default=0.0)
    moduli = [with_own_gain(modulus, of_all) for modulus in moduli]
    E, sd, common, scale = (
        np.array([(m.E_MPa, m.E_sd_MPa, m.common_sd_MPa, m.scale_sd_MPa) for m in moduli]).reshape(-1, 4).T
    )
    places = standings(
        E,
        sd,
        common,
        scale_sd_MPa=scale,
        classes=batch.settings.grading.classes,
        rng=np.random.default_rng(RANKING_SEED),
    )
    place_of = {r.fruit_id: place for r, place in zip(graded, places, strict=True)}
    settings, trail = batch.settings, read_trail(results.verdicts)
    firmness = firmness_readings(results)
    return BatchEntry(
        name=batch.folder.root.resolve().name,
        category=batch.category,
        **{name: getattr(settings, name) for name in SETTING_FIELDS},
        classes=tuple((c.name, c.E_max_MPa) for c in settings.grading.classes),
        columns=tuple(settings.columns.items()),
        readings=firmness.columns,
        reading_titles=firmness.titles,
        settings=tuple(sorted(_flat(settings.model_dump(mode="json", exclude_none=True)))),
        versions=tuple(versions().items()),
        inputs=tuple(inputs.items()),
        started_utc=started,
        finished_utc=finished,
        exit_status=exit_status,
        unfinished=unfinished,
        ships=None if settings.grading.shipped is None else _ships(settings.grading),
        ships_by_default=_ships(settings.grading, by_default=True),
        certainty=settings.grading.certainty,
        mean_E_MPa=float(np.mean(E)) if len(E) else None,
        between_sd_MPa=float(np.std(E, ddof=1)) if len(E) > 1 else None,
        shore=_shore(graded),
        reference=None
        if finding is None
        else ReferenceEntry(sentences=finding.sentences, alarm=finding.alarm, bodies=finding.bodies),
        faults=(
            *(fault.sentence for fault in faults),
            *old_calibrations(batch.folder.root, settings, graded_on=started.date()),
            *([trail.fault] if trail.fault else []),
        ),
        screened=any(r.screen is not None and r.screen.p_value is not None for r in records),
        fruits=tuple(
            replace(
                _fruit_entry(
                    record, place_of.get(record.fruit_id), results, settings.grading, len(batch.rows)
                ),
                verdicts=verdicts_on(record.fruit_id, record.key, trail),
                readings=firmness.of(record),
            )
            for record in records
        ),
    )


def verdicts_on(fruit_id: str, key: str, trail: Trail) -> tuple[VerdictEntry, ...]:
    """Verdicts of people on the fruit whose result has this key, the latest last."""
    return tuple(verdict_entry(verdict, key) for verdict in trail.of_fruit.get(fruit_id, ()))


def verdict_entry(verdict: Verdict, key: str) -> VerdictEntry:
    """The verdict as reports show it beside the result with this key."""
    shown = {"judged_class", "by", "why", "at_utc", "E_MPa", "E_sd_MPa"}
    return VerdictEntry(**verdict.model_dump(include=shown), earlier=verdict.key != key)


def _ships(grading: Grading, *, by_default: bool = False) -> tuple[str, ...]:
    """Names of the shipped classes; `by_default`: only the classes that are shipped by default."""
    both = zip(grading.classes, grading.shipped or (), strict=False)
    return tuple(c.name for c, goes in both if goes and (c.ship is None or not by_default))


def _fruit_entry(
    record: FruitRecord, place: Rank | None, results: Results, grading: Grading, fruits: int
) -> FruitEntry:
    files = results.fruit(record.fruit_id)
    mesh, modulus = record.mesh, record.modulus if record.graded else None
    explained, temperature = _explained(record, files), record.temperature
    answer = None if explained is None else OR.join(explained.names)
    mismatch = record.mismatch or answer
    return FruitEntry(
        fruit_id=record.fruit_id,
        ok=record.graded,
        outcome=record.outcome,
        reason=record.reason,
        **{} if place is None else {name: getattr(place, name) for name in RANK_FIELDS},
        E_MPa=modulus.E_MPa if modulus else None,
        E_sd_MPa=modulus.E_sd_MPa if modulus else None,
        E_scale_sd_MPa=(modulus.scale_sd_MPa or None) if modulus else None,
        maturity=place.maturity if place and not record.doubts else None,
        maturity_probability=place.maturity_probability if place and not record.doubts else None,
        class_withheld=place is not None and place.maturity is not None and bool(record.doubts),
        height_mm=mesh.height_mm if mesh else record.given.height_mm,
        volume_mm3=_volume_mm3(record),
        grasps=sum(g.failure is None for g in record.grasps),
        **vars(decide(record, place, grading, mismatch=mismatch, explained=explained)),
        mismatch=mismatch,
        mismatch_taken=record.mismatch is not None,
        screen=_screen(record),
        reference=record.given.reference,
        E_uncorrected_MPa=_uncorrected_MPa(record),
        E_at_pulp_MPa=temperature.E_at_pulp_MPa if temperature else None,
        E_at_pulp_sd_MPa=temperature.E_at_pulp_sd_MPa if temperature else None,
        shore_oo=record.given.shore_oo,
        warnings=tuple(warning for warning in record.warnings if warning not in record.doubts),
        doubts=record.doubts,
        forced=record.forced,
        pictures=fruit_pictures(results, files, fruits=fruits, measured=mesh is not None),
        has_pit=record.pit is not None,
        recordings=tuple(g for g in record.grasps if g.failure is None),
        smaller_error="" if record.modulus is None else about_error(record.modulus),
        columns=record.given.columns,
        facts=tuple(_facts(record, place)),
        seconds=record.seconds,
        peak_memory_MiB=record.peak_memory_MiB,
    )


def _volume_mm3(record: FruitRecord) -> float | None:
    """Volume of the mesh, or of the ellipsoid with the fruit's diameters."""
    if record.mesh is not None:
        return record.mesh.volume_mm3
    return None if record.pressed is None else np.pi / 6 * float(np.prod(record.pressed.diameters_mm))


def _uncorrected_MPa(record: FruitRecord) -> float | None:
    """E as measured, if the reference bodies corrected it."""
    reference = record.reference
    return reference.E_MPa * reference.ratio if reference is not None and reference.corrected else None


def _explained(record: FruitRecord, files: FruitResults) -> DiagnosisRecord | None:
    """The answer of `drupe explain` for the same inputs, settings and code."""
    said = read_as(files.mismatch, DiagnosisRecord)
    return None if said is None or said.key != record.key else said


def _screen(record: FruitRecord) -> ScreenEntry | None:
    said = record.screen
    if said is None or not record.graded:
        return None
    return ScreenEntry(
        p_value=said.p_value,
        p_nominal=said.p_nominal,
        suspects=tuple(map(_suspect, said.names)),
        why_not=said.failure.rstrip("."),
        note=said.note,
    )


def _suspect(name: str) -> Suspect:
    """The words of one name; of a pair, those of both effects."""
    words = [SCREEN_WORDS[part] if part in SCREEN_WORDS else SPECS[part].words for part in name.split("+")]
    return Suspect(
        name=name,
        short=", and ".join(word.short for word in words),
        advice=words[0].advice if name in SCREEN_WORDS else "",
    )


def _facts(record: FruitRecord, place: Rank | None) -> Iterator[tuple[str, str]]:
    """(label, value) of a fruit's details in the report, in their order."""
    if (reference := record.reference) is not None and reference.corrected:
        by = (
            f"divided by {reference.ratio:.3f} ± {reference.ratio_sd:.3f}, from {', '.join(reference.bodies)}"
        )
        yield "E as measured", f"{reference.E_MPa * reference.ratio:.4g} MPa ({by})"
    if (at := record.temperature) is not None:
        measured = with_sd(at.E_at_pulp_MPa, at.E_at_pulp_sd_MPa)
        yield f"E at {at.pulp_C:g} °C, as measured", f"{measured} MPa"
        yield (
            "Reference temperature",
            f"{at.reference_C:g} °C; E there is {at.factor:.3f} times E as measured",
        )
    if place:
        span = f"{place.rank_low} to {place.rank_high}"
        yield "Rank, 90 % range", span if place.rank_low < place.rank_high else str(place.rank)
        yield "Probability of exactly this rank", f"{place.rank_probability:.2f}"
    if (mesh := record.mesh) is not None:
        box = " × ".join(f"{side:.1f}" for side in mesh.box_mm)
        yield "Size (x × y × z)", f"{box} mm"
        yield "Surface", f"{mesh.faces} triangles from {mesh.source}"
        if mesh.scale_sd is not None:
            yield "Scale, standard error", f"{100 * mesh.scale_sd:.2f} %"
        yield from (
            (f"Shape: {_QUALITY.get(name, name)}", _shown(value)) for name, value in mesh.quality.items()
        )
    if (pit := record.pit) is not None:
        box = " × ".join(f"{side:.1f}" for side in pit.box_mm)
        yield "Pit", f"{box} mm, from {pit.source}"
        yield "Thinnest flesh", f"{pit.thinnest_flesh_mm:.1f} mm"
    if (pressed := record.pressed) is not None:
        size = " × ".join(f"{side:g}" for side in pressed.diameters_mm)
        along = " and ".join(pressed.compressed_along)
        yield "Diameters (a × b × c)", f"{size} mm, squeezed along {along}; there is no mesh"
        yield "Pit", f"{pressed.pit_share:.2f} of the diameter, from {pressed.pit_source}"
    if (flesh := record.flesh) is not None:
        yield "Finite elements", f"{flesh.tets} quadratic tetrahedra, {flesh.nodes} nodes"
        ratio = f"{flesh.poisson_ratio:g} ± {flesh.poisson_ratio_sd:g}"
        yield "Poisson's ratio", f"{ratio} ({flesh.poisson_ratio_source})"
    if record.modulus is not None:
        places = decimals(record.modulus.E_sd_MPa)
        for name, sd_MPa in record.modulus.parts_sd_MPa.items():
            if sd_MPa >= 0.5 * 10.0**-places:
                yield f"Error bar: {name}", f"± {sd_MPa:.{places}f} MPa"
        if (scale := record.modulus.scale_sd_MPa) > 0:
            yield f"In addition to the error bar: {COMMON_SCALE}", f"± {scale:.{places}f} MPa"
        if (pit_place := record.modulus.pit_found) is not None:
            places_mm = zip(pit_place.offset_mm, pit_place.offset_sd_mm, strict=True)
            offset = ", ".join(f"{round(x, 1) + 0.0:+.1f} ± {sd:.1f}" for x, sd in places_mm)
            before = ", ".join(f"{sd:.1f}" for sd in pit_place.offset_prior_sd_mm)
            yield "Pit relative to the prior (x, y, z)", f"{offset} mm (prior ± {before})"
            size = f"{pit_place.size:.3f} ± {pit_place.size_sd:.3f} (prior 1 ± {pit_place.size_prior_sd:.3f})"
            yield "Pit size relative to the prior", size
    yield from ((f"Recording {g.grasp}", g.failure) for g in record.grasps if g.failure is not None)
    given = record.given
    if given.reference and given.reference_E_MPa is not None and given.reference_E_sd_MPa is not None:
        yield "Known modulus", f"{given.reference_E_MPa:g} ± {given.reference_E_sd_MPa:g} MPa"
    if given.mass_g is not None:
        yield "Mass", f"{given.mass_g:g} g"
    if given.notes:
        yield "Notes", given.notes


_QUALITY = {
    "views_given": "photos given",
    "views_used": "photos used",
    "reprojection_px": "error of camera positions (px)",
    "silhouette_iou": "overlap of outlines with the mesh",
    "outline_rms_mm": "distance of outlines from the mesh, rms (mm)",
    "clear_outline_share": "share of the outlines that are clear",
    "focal_px": "focal length (px)",
    "focal_sd_px": "focal length, standard deviation (px)",
    "k1": "lens distortion k1",
    "widest_gap_deg": "widest gap between photos (degrees)",
    "seen_share": "share of the skin in sight of two photos",
    "unseen_mm2": "skin out of sight (mm²)",
    "decimation_rms_mm": "change by fewer triangles, rms (mm)",
    "relief_share": "share of the skin measured by its texture",
    "flipped_views": "photos of the fruit upside down",
    "flipped_miss_mm": "distance between upright and upside-down mesh, rms (mm)",
    "offset_rms_mm": "distance of the mesh from the photos, rms (mm)",
    "offset_local_mm": "distance that 2 % of the skin exceeds (mm)",
    "offset_volume_share": "the same as a share of the volume",
    "ground_known_share": "share of the rims with known ground behind them",
}
"""Labels of a mesh's measures; others have their own names."""


def _shown(value: object) -> str:
    if not isinstance(value, float):
        return _setting(value)
    return f"{value:.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


def _shore(graded: Sequence[FruitRecord]) -> ShoreCorrelation | None:
    """Correlation of the moduli with Shore readings; None for too few of them."""
    pairs = [
        (r.modulus.E_MPa, r.given.shore_oo) for r in graded if r.modulus and r.given.shore_oo is not None
    ]
    if not pairs:
        return None
    return agreement(*np.array(pairs, dtype=float).T)


def _flat(tree: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in tree.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list) and any(isinstance(part, dict) for part in value):
            for place, part in enumerate(value, start=1):
                rows += _flat(part, f"{prefix}{key} {place}: ")
        else:
            rows.append((f"{prefix}{key}", _setting(value)))
    return rows


def _setting(value: object) -> str:
    """A setting as a reader writes it: yes or no, the parts of a list between commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(_setting, value)) or "none"
    return str(value)
