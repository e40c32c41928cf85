"""Contradictions in one recording: simple faults of its values, then relations that it breaks.

A recording that obeys every relation is valid. Otherwise the search undoes each transformation
(tactile/consistency/transformations.py), and compares the likelihoods of the whole recording with and without
it. If the best log Bayes factor exceeds LIMIT, the search names that transformation, and those that explain
about as much. It goes on in the corrected recording, so that it names two mistakes one after the other. A
relation that no transformation corrects is named itself.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import numpy as np
from jaxtyping import Float, Int

from tactile.consistency.faults import edge_findings, missing_findings, noise_findings, value_findings
from tactile.consistency.finding import Finding, FindingKind, doubted
from tactile.consistency.footprint import mesh_misfits
from tactile.consistency.misfit import CAUSES, LIMIT, Misfit, Situation
from tactile.consistency.pressing import pressing_of
from tactile.consistency.reference_findings import reference_findings
from tactile.consistency.relations import signal_misfits
from tactile.consistency.time_findings import time_findings
from tactile.consistency.transformations import Transformation, of_machine, of_mesh, of_signals
from tactile.readers.recording import GelPad, Recording
from tactile.readers.sensor_model import PublishedGel

MOST_MISTAKES = 3
"""In one recording; the search for each removes the ones before."""
LAW = frozenset({FindingKind.SCALE, FindingKind.OUT_OF_STEP, FindingKind.OTHER_MARKERS})
"""Relations that do not depend on poses, aperture and clock."""

Losses = dict[tuple[object, ...], float]


def recording_findings(
    recording: Recording,
    vertices: Float[np.ndarray, "v 3"] | None,
    faces: Int[np.ndarray, "f 3"] | None,
    *,
    E_range_MPa: tuple[float, float] | None = None,
    surface_sd_mm: float = 0.0,
    gels: Sequence[PublishedGel] = (),
) -> list[Finding]:
    """Contradictions in `recording` of the fruit with this mesh; if any refuse it, only those.

    A bare indenter's curve is not checked. Without a mesh (None) only the recording itself is.

    `E_range_MPa`: range of moduli of the category; `surface_sd_mm`: the mesh's error; `gels`: published
    values of the sensor's gels.
    """
    pads = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    if len(pads) != len(recording.pads):
        return []
    pressings = tuple(pressing_of(pad) for pad in pads)
    findings = reference_findings(pads)
    for stage in (value_findings, missing_findings, partial(time_findings, recording)):
        if not _refused(findings):
            findings += stage(pressings)
    situation = Situation(
        recording=recording,
        pressings=pressings,
        vertices=vertices,
        faces=faces,
        E_range_MPa=E_range_MPa,
        surface_sd_mm=surface_sd_mm,
        gels=tuple(gels),
        touch_is_seen=not any(finding.hides_touch for finding in findings),
    )
    if _refused(findings):
        return _what_counts(findings)
    explained, left = _explained(situation, signal_misfits, _of_signals_and_machine)
    findings += explained
    if not explained:
        findings += noise_findings(pressings)
    if situation.touch_is_seen and not _refused(findings):
        findings += edge_findings(left.pressings)
    if situation.touch_is_seen and all(finding.undone for finding in findings if finding.refused):
        findings += _explained(left, mesh_misfits, of_mesh)[0]
    return _what_counts(findings)


def _refused(findings: Sequence[Finding]) -> bool:
    return any(finding.refused for finding in findings)


def _what_counts(findings: Sequence[Finding]) -> list[Finding]:
    """The findings that refuse the recording, as the rest may follow from them; all if none does."""
    return [finding for finding in findings if finding.refused] or list(findings)


def _of_signals_and_machine(situation: Situation, failing: Sequence[Misfit]) -> Iterator[Transformation]:
    names = list(dict.fromkeys(name for misfit in failing for name in misfit.pads))
    if names:
        yield from of_signals(situation, names)
    kinds = {misfit.kind for misfit in failing}
    if kinds - LAW and situation.vertices is not None:
        yield from of_machine(situation, late=FindingKind.CLOCKS_APART in kinds)


def _explained(
    situation: Situation,
    judge: Callable[[Situation], list[Misfit]],
    candidates: Callable[[Situation, Sequence[Misfit]], Iterator[Transformation]],
) -> tuple[list[Finding], Situation]:
    """Findings that explain the failing relations, and the situation with these causes removed."""
    findings: list[Finding] = []
    named: set[FindingKind] = set()
    for _ in range(MOST_MISTAKES):
        misfits = judge(situation)
        failing = [misfit for misfit in misfits if misfit.fails and misfit.kind not in named]
        if not failing:
            break
        before = _losses(misfits)
        comparisons = [
            _compared(before, _losses(judge(transformation.undone)), transformation)
            for transformation in candidates(situation, failing)
        ]
        comparisons.sort(key=attrgetter("log_factor"), reverse=True)
        if comparisons and (best := comparisons[0].log_factor) > LIMIT:
            ties = [comparison for comparison in comparisons if comparison.log_factor > best - LIMIT]
            findings.append(_named(failing, ties))
            situation = ties[0].transformation.undone
            continue
        worst = max(failing, key=lambda misfit: misfit.loss)
        named.add(worst.kind)
        findings.append(_unexplained(worst, failing))
        if findings[-1].refused:
            break
    return findings, situation


@dataclass(frozen=True, kw_only=True)
class _Comparison:
    """A transformation with its log Bayes factor, and by how much it reduces each relation's loss."""

    transformation: Transformation
    log_factor: float
    improvement: Losses


def _losses(misfits: Sequence[Misfit]) -> Losses:
    losses: Losses = defaultdict(float)
    for misfit in misfits:
        losses[misfit.kind, misfit.pads, misfit.field] += misfit.loss
    return losses


def _compared(before: Losses, after: Losses, transformation: Transformation) -> _Comparison:
    """A relation that cannot be computed afterwards keeps its loss; a new relation adds its loss."""
    improvement = {key: loss - after.get(key, loss) for key, loss in before.items()}
    new = sum(loss for key, loss in after.items() if key not in before)
    factor = sum(improvement.values()) - new + transformation.log_prior
    return _Comparison(transformation=transformation, log_factor=factor, improvement=improvement)


def _named(failing: Sequence[Misfit], ties: Sequence[_Comparison]) -> Finding:
    """The best transformation and those that explain about as much; E's error is the weighted RMS of all."""
    best = ties[0].transformation
    improvement = ties[0].improvement
    shown = max(failing, key=lambda misfit: improvement.get((misfit.kind, misfit.pads, misfit.field), 0.0))
    others = [comparison.transformation for comparison in ties]
    causes = list({(t.kind, t.field, t.detail): t.cause for t in reversed(others)}.values())[::-1]
    listed = "; or ".join(causes)
    weights = np.exp([comparison.log_factor - ties[0].log_factor for comparison in ties])
    sds = np.nan_to_num([t.relative_sd for t in others], nan=shown.relative_sd)
    same = [t for t in others if t.kind is best.kind]
    return doubted(
        best.kind,
        f"{shown.says}. {'Cause' if len(causes) == 1 else 'Possible causes'}: {listed}",
        relative_sd=float(np.sqrt(weights @ sds**2 / weights.sum())),
        pads=best.pads,
        field=best.field if len({t.field for t in same}) == 1 else None,
        detail=" or ".join(dict.fromkeys(t.detail for t in same if t.detail)),
        also=frozenset(t.kind for t in others) - {best.kind},
        has_effect=any(t.has_effect for t in others),
        undone=True,
    )


def _unexplained(worst: Misfit, failing: Sequence[Misfit]) -> Finding:
    """The finding for a relation that no transformation explains."""
    same = [misfit for misfit in failing if (misfit.kind, misfit.field) == (worst.kind, worst.field)]
    return doubted(
        worst.kind,
        f"{worst.says}. Possible cause: {CAUSES[worst.kind]}",
        relative_sd=worst.relative_sd,
        pads=tuple(name for misfit in same for name in misfit.pads),
        field=worst.field,
        has_effect=worst.kind is FindingKind.CLOCKS_APART,
    )
