"""Contradictions in one recording: simple faults of its values, then relations that it breaks.

A recording that obeys every relation is valid. Otherwise the search undoes each transformation
(tactile/consistency/transformations.py), and compares the likelihoods of the whole recording with and without
it. If the best log Bayes factor exceeds LIMIT, the search names that transformation, and those that explain
about as much. It goes on in the corrected recording, so that it names two mistakes one after the other. A
relation that no transformation corrects is named itself.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from tactile.consistency.faults import (
    edge_findings,
    missing_findings,
    noise_findings,
    reference_findings,
    value_findings,
)
from tactile.consistency.finding import Finding, FindingKind, doubted
from tactile.consistency.footprint import mesh_misfits
from tactile.consistency.misfit import CAUSES, LIMIT, Misfit, Situation
from tactile.consistency.pressing import (
    DEEPEST,
    FEWEST_PRESSED,
    PRESSED_SD,
    QUIET_OVER,
    QUIET_SHARE,
    Pressing,
    pressing_of,
)
from tactile.consistency.relations import signal_misfits
from tactile.consistency.transformations import Transformation, of_machine, of_mesh, of_signals
from tactile.contact import STARTS_IN_CONTACT
from tactile.readers.recording import GelPad, Recording
from tactile.readers.sensor_model import PublishedGel
from tactile.rig.rig_curve import RigCurve, first_touch

UNSURE = 0.3
"""Standard deviation of the jaws' displacement under force over the fruit's, above which E is a lower bound,
as for a bare indenter (fem.indentation.rig_share.UNSURE). Set by hand."""
TOUCHED = 0.05
"""Share of the largest force from which the pads are in contact. Set by hand."""


def jaw_share_findings(recording: Recording, rig: RigCurve) -> list[Finding]:
    """Whether the rig is too uncertain for a recording that was corrected for it; empty if it is not.

    The fruit's deformation is the travel from the first touch to the largest force minus the gels'
    indentation. E's error holds the spread itself (pipeline.fruit.repeated_modulus), so that the finding adds
    none.
    """
    pads = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    if len(pads) != len(recording.pads):
        return []
    force = np.mean([pad.force_N[:, :, 2].sum(axis=1) for pad in pads], axis=0)
    peak, touch = int(np.argmax(force)), first_touch(force, TOUCHED)
    closing = -1.0 if recording.loading == "grasp" else 1.0
    travel = closing * float(recording.aperture_mm[peak] - recording.aperture_mm[touch])
    gels = sum(float(np.quantile(-pad.displacement_mm[peak, :, 2], DEEPEST)) for pad in pads)
    fruit = travel - gels
    jaws, sd = (float(of(force[peak : peak + 1])[0]) for of in (rig.give, rig.sd))
    said = (
        f"at {force[peak]:.3g} N the machine compliance takes {jaws:.2g} ± {sd:.1g} mm and the "
        f"fruit {fruit:.2g} mm"
    )
    findings = []
    if sd > UNSURE * max(fruit, 0.0):
        says = f"{said}: it is too stiff for this rig, and E is a lower bound"
        findings.append(Finding(FindingKind.STIFFER_THAN_RIG, says))
    if force[peak] > rig.largest_N:
        says = (
            f"the rig calibration ends at {rig.largest_N:.3g} N; drupe extrapolated it to {force[peak]:.3g} N"
        )
        findings.append(Finding(FindingKind.BEYOND_RIG, says, remark=True))
    return findings


IN_CONTACT, E_WITHOUT_TOUCH = 0.15, 0.2
"""Share of the peak, of displacement and of force, above which the first or the last frame is in contact:
valid recordings have 0.09 and less (benchmarks/field_spreads.py). Relative standard deviation of E without
the first touch: the mesh's surface replaces it, as far as its error is known."""
TARE_SHARE, E_OF_A_TARE = 0.1, 0.05
"""Force at rest over the peak if the tare is missing; E's relative standard deviation after the
correction."""
FEWEST_QUIET, DRIFT_SHARE, DRIFT_SD, E_PER_DRIFT = 3, 0.04, 6.0, 0.5
"""Fewest quiet frames before and after; change of the force over the peak, and over its noise. Valid
recordings change by up to 0.026 of the peak, with small forces by 4.6 times the noise. Relative error of E
per share of the peak: a drift that grows evenly has reached half of it at the peak."""
SPEED_MM_PER_S = (0.008, 300.0)
"""Fastest closing of jaws: grippers have 0.1 to 100, testing machines 0.017 (1 mm/min) and more."""


def time_findings(recording: Recording, pressings: Sequence[Pressing]) -> list[Finding]:
    """Findings of a recording that begins or ends in contact, of forces without a tare or with drift, and of
    a clock in another unit."""
    return [
        *(finding for press in pressings for finding in _start(press)),
        *(finding for press in pressings for finding in _drift(press)),
        *_remarks(recording, pressings),
    ]


def _raw_totals(press: Pressing) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Indentation and normal force as recorded, summed over the pressed markers."""
    use = press.touched
    return -press.pad.displacement_mm[:, use, 2].sum(axis=1), press.pad.force_N[:, use, 2].sum(axis=1)


def pressed_share(press: Pressing, frame: int) -> float:
    """The smaller of indentation and force in a frame, each over its peak; 0 if nothing is pressed."""
    if not press.touched.any():
        return 0.0
    return min(float(total[frame] / max(np.abs(total).max(), 1e-30)) for total in _raw_totals(press))


def _start(press: Pressing) -> Iterator[Finding]:
    """A recording that begins in contact, and forces without a tare."""
    if not press.touched.any():
        return
    totals = _raw_totals(press)
    u, F = (max(float(np.abs(total).max()), 1e-30) for total in totals)
    rest_u, rest_F = (float(np.median(total[press.quiet])) for total in totals)
    if pressed_share(press, 0) > IN_CONTACT:
        says = (
            f"recording starts in contact ({100 * totals[0][0] / u:.0f} % of its peak in the first frame): "
            "the frames before first contact are missing; start recording before the jaws touch"
        )
        yield doubted(
            FindingKind.STARTS_IN_CONTACT,
            says,
            relative_sd=E_WITHOUT_TOUCH,
            pads=press.pads,
            hides_touch=True,
        )
    elif abs(rest_F) / F > TARE_SHARE and abs(rest_u) / u < 0.3 * TARE_SHARE:
        # tactile.contact finds no no-contact frames if the whole pad's offset exceeds its own limit
        total = press.pad.force_N[:, :, 2].sum(axis=1)
        hidden = bool(np.median(total[press.quiet]) > 0.9 * STARTS_IN_CONTACT * total.max())
        says = (
            f"force has an offset of {rest_F:.2g} N in the contact's markers without contact (no tare); set "
            "the force to zero before the grasp"
        )
        yield Finding(FindingKind.NO_TARE, says, pads=press.pads, refused=hidden, relative_sd=E_OF_A_TARE)


def drift_of(press: Pressing) -> tuple[float, float, float] | None:
    """Change of the total force from before the grasp to after it, its noise, and the peak (N).

    None if either side has no quiet frames.
    """
    pressed = np.flatnonzero(
        (press.felt_mm[:, press.touched, 2] > PRESSED_SD * press.felt_sd_mm).sum(axis=1) >= FEWEST_PRESSED
    )
    if not len(pressed):
        return None
    still = np.sqrt((press.felt_mm**2).mean(axis=(1, 2)))
    quiet = np.flatnonzero(still <= QUIET_OVER * np.percentile(still, QUIET_SHARE))
    before, after = quiet[quiet < pressed[0]], quiet[quiet >= pressed[-1]]
    fewest = min(len(before), len(after))
    if fewest < FEWEST_QUIET:
        return None
    total = press.force_N[:, :, 2].sum(axis=1)
    change = float(np.median(total[after]) - np.median(total[before]))
    return change, float(total[before].std()) / float(np.sqrt(fewest / 2)), float(total.max())


def _drift(press: Pressing) -> Iterator[Finding]:
    """Findings of force that does not return to its value before the first touch, though the gel does."""
    change, noise, peak = drift_of(press) or (0.0, 0.0, 1.0)
    if abs(change) > max(DRIFT_SHARE * peak, DRIFT_SD * noise):
        says = (
            f"force drifts: without contact it differs by {change:+.2f} N between before and after the "
            f"grasp ({100 * change / peak:+.0f} % of the peak); let the sensor warm up"
        )
        sd = E_PER_DRIFT * abs(change) / peak
        yield Finding(FindingKind.FORCE_DRIFT, says, pads=press.pads, relative_sd=sd)


def _remarks(recording: Recording, pressings: Sequence[Pressing]) -> Iterator[Finding]:
    """Findings that cast no doubt: no unloading, a clock in another unit."""
    if pads := tuple(press.pad.name for press in pressings if pressed_share(press, -1) > IN_CONTACT):
        says = (
            "recording ends under load (there is no unloading). E needs none, but without it drupe cannot "
            "detect clock lag, force drift, creep or yield"
        )
        yield Finding(FindingKind.ENDS_PRESSED, says, pads=pads, remark=True)
    speed = np.abs(np.diff(recording.aperture_mm)) / np.diff(recording.time_s)
    fastest = float(speed.max(initial=0.0))
    low, high = SPEED_MM_PER_S
    if recording.loading == "grasp" and fastest != 0 and not low <= fastest <= high:
        unit = "milliseconds" if fastest < low else "minutes or hours"
        says = (
            f"time_s looks like {unit}: the jaws would close at {fastest:.2g} mm/s, expected {low:g} to "
            f"{high:g}; E does not depend on it"
        )
        yield Finding(FindingKind.TIME_UNIT, says, remark=True)


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
            (*_compared(before, _losses(judge(transformation.undone))), transformation)
            for transformation in candidates(situation, failing)
        ]
        factors = np.array([gain + other.log_prior for gain, _, other in comparisons])
        if factors.max(initial=0.0) > LIMIT:
            ties = [k for k in np.argsort(-factors, kind="stable") if factors[k] > factors.max() - LIMIT]
            _, improvement, best = comparisons[ties[0]]
            findings.append(_named(failing, [comparisons[k][2] for k in ties], factors[ties], improvement))
            situation = best.undone
            continue
        worst = max(failing, key=lambda misfit: misfit.loss)
        named.add(worst.kind)
        findings.append(_unexplained(worst, failing))
        if findings[-1].refused:
            break
    return findings, situation


def _losses(misfits: Sequence[Misfit]) -> Losses:
    losses: Losses = defaultdict(float)
    for misfit in misfits:
        losses[misfit.kind, misfit.pads, misfit.field] += misfit.loss
    return losses


def _compared(before: Losses, after: Losses) -> tuple[float, Losses]:
    """Log likelihood ratio, and by how much each relation's loss falls. A relation that cannot be computed
    afterwards keeps its loss; a new relation adds its loss.
    """
    improvement = {key: loss - after.get(key, loss) for key, loss in before.items()}
    new = sum(loss for key, loss in after.items() if key not in before)
    return sum(improvement.values()) - new, improvement


def _named(
    failing: Sequence[Misfit],
    others: Sequence[Transformation],
    log_factors: Float[np.ndarray, " n"],
    improvement: Losses,
) -> Finding:
    """The first of the transformations, which explain about as much; E's error is the weighted RMS of all.

    `log_factors`: log Bayes factors; `improvement`: by how much the first reduces each relation's loss.
    """
    best = others[0]
    shown = max(failing, key=lambda misfit: improvement.get((misfit.kind, misfit.pads, misfit.field), 0.0))
    causes = list({(t.kind, t.field, t.detail): t.cause for t in reversed(others)}.values())[::-1]
    first = f"Cause: {causes[0]}" if len(causes) == 1 else f"Possible cause: {causes[0]}"
    listed = ". Another possible cause: ".join([first, *causes[1:]])
    weights = np.exp(log_factors - log_factors[0])
    sds = np.nan_to_num([t.relative_sd for t in others], nan=shown.relative_sd)
    same = [t for t in others if t.kind is best.kind]
    return doubted(
        best.kind,
        f"{shown.says}. {listed}",
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
