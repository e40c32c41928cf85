"""A recording without a fault passes every check; each mistake made on it is named by its cause.

The recording is tests/data/nectarine-grasp: another solver's, with noise, on a scanned mesh (SOURCE.md).
"""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from injected_grasp import gel_pad, with_pads
from recording_mistakes import (
    MISTAKES,
    SHIPPED,
    findings,
    force,
    kept,
    naming,
    on_pads,
    picked,
    said_of,
    slab_pad,
    without,
)
from refusals import refused

from samples.fruit import fruits_of_seed, scanned_mesh
from tactile.consistency.faults import (
    dead_markers,
    missing_markers,
    noise_findings,
    print_without_force,
    reference_findings,
)
from tactile.consistency.finding import Finding, FindingKind, shared
from tactile.consistency.of_recording import recording_findings
from tactile.consistency.pressing import MOST_FOR_SLAB, displacement_of, noise_shares, pressing_of
from tactile.consistency.relations import gain_of
from tactile.consistency.transformations import QUARTERS
from tactile.contact import find_contact
from tactile.readers.recording import GelPad, Recording, read_recording
from tactile.tactile_failure import TactileFailure, TactileProblem


def test_a_sound_recording_passes(nectarine_grasp):
    assert findings(*nectarine_grasp) == []


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_shipped_sample_passes_on_its_scans(number):
    fruit = fruits_of_seed(4, seed=1)[number - 1]
    mesh = scanned_mesh(fruit, cells=28, error_mm=0.1)
    for path in sorted((SHIPPED / "fruits" / fruit.fruit_id / "grasps").glob("*.h5")):
        assert findings(read_recording(path), mesh) == [], path


AMONG_SEVERAL = {
    "force x 1.3", "one pad's force x 0.5", "displacement x 0.5",
    "half of the markers missing", "poses of another day", "another fruit's recording",
    "another fruit's mesh", "mesh x 1.1", "mesh x 0.95",
}  # fmt: skip
"""Mistakes that the first sentence lists among other causes."""
UNSEEN = {
    "force 2 frames early", "force in 6 steps", "noise x 10", "every third frame dropped", "mesh mirrored",
    "mesh turned by 90 degrees",
}  # fmt: skip
"""On this recording: its frames are few, its noise is low, its fruit is nearly round, and E hardly changes by
steps and lost frames."""
MILD = {
    "every second frame a copy", "no first touch", "no unloading",
    "gel 5 frames late on jaws", "time in ms", "aperture in cm", "picture scale 1.1", "picture scale 0.9",
    "Poisson's ratio 0.30",
    "Poisson's ratio 0.39", "a plum's category", "an apricot's category", "a cherry's category",
    "pads' signals exchanged", "pads' poses exchanged", "mesh lying on its side", "pit moved 6 mm",
    "pit x 1.4", "pit turned by 90 degrees", "force x 1.3", "another fruit's mesh",
}  # fmt: skip
"""Mistakes that leave the recording of use."""


@pytest.mark.parametrize(
    "mistake",
    [mistake for mistake in MISTAKES if not mistake.covered and mistake.name not in UNSEEN],
    ids=lambda mistake: mistake.name,
)
def test_a_mistake_is_named_first_and_refused_where_no_modulus_would_mean_anything(mistake):
    said = said_of(mistake)
    assert naming(said[0], mistake) == ("among several" if mistake.name in AMONG_SEVERAL else "named")
    assert any(finding.refused for finding in said) == (mistake.name not in MILD)


def drifting(recording):
    time = recording.time_s
    grown = (time - time[0])[:, None, None] / (time[-1] - time[0]) * np.array([0.0, 0.0, 1.8 / 400])
    return on_pads(lambda pad: replace(pad, force_N=pad.force_N + grown), "left")(recording)


@pytest.mark.parametrize(
    ("change", "words", "refused"),
    [
        (force(0.5, "right"), "the right pad's force is 0.50 times", True),
        (drifting, "the left pad's force drifts", False),
    ],
)
def test_gains_and_drift_are_said_with_their_size(nectarine_grasp, change, words, refused):
    recording, mesh = nectarine_grasp
    said = findings(change(recording), mesh)
    assert any(words in finding.sentence for finding in said)
    assert any(finding.refused for finding in said) == refused


@pytest.mark.parametrize("count", [2, 3])
def test_every_second_or_third_marker_is_among_the_causes_of_its_gain(nectarine_grasp, count):
    recording, mesh = nectarine_grasp
    first, *_ = findings(without(lambda pad: np.arange(len(pad.rest_mm)) % count != 0)(recording), mesh)
    assert first.refused
    assert f"Another possible cause: the arrays hold only one of every {count} markers" in first.sentence


def test_two_mistakes_are_named_one_after_the_other(nectarine_grasp):
    recording, mesh = nectarine_grasp
    in_metres = on_pads(lambda pad: replace(pad, displacement_mm=pad.displacement_mm / 1e3))
    said = findings(in_metres(force(0.22481)(recording)), mesh)
    assert (said[0].field, said[0].detail) == ("displacement", "metres")
    assert "Cause: forces look like pounds" in said[1].sentence


def test_a_marker_order_by_columns_is_told_from_any_other(nectarine_grasp):
    """The contact is moved off the grid's diagonal, on which both orders are the same."""
    recording, mesh = nectarine_grasp
    grid = np.arange(400).reshape(20, 20)
    aside = np.roll(grid, 4, axis=1).ravel()
    moved = on_pads(
        lambda pad: replace(
            pad,
            force_N=pad.force_N[:, aside][:, grid.T.ravel()],
            displacement_mm=pad.displacement_mm[:, aside],
        )
    )
    first, *_ = findings(moved(recording), mesh)
    assert first.kind is FindingKind.MARKERS_ORDER
    assert "the marker order of force_N is transposed (columns for rows)" in first.sentence


@pytest.mark.parametrize(("from_share", "refused"), [(0.4, True), (0.99, False)])
def test_markers_that_may_be_a_pitch_off_while_the_pad_presses_are_refused(
    nectarine_grasp, from_share, refused
):
    """In the last frames the jaws are open again: whatever the markers are, nothing is taken from them."""
    recording, mesh = nectarine_grasp
    frames = len(recording.time_s)
    certainty = np.where(np.arange(frames) < from_share * frames, 1.0, 0.2)
    unsure = on_pads(lambda pad: replace(pad, certainty=certainty), only="right")(recording)
    said = findings(unsure, mesh)
    assert [finding.kind for finding in said if finding.refused] == refused * [FindingKind.MARKERS_PITCH_OFF]
    if refused:
        assert f"(a grid pitch) from frame {np.flatnonzero(certainty < 1)[0]} on" in said[0].sentence


@pytest.mark.parametrize("side", [lambda p: p.rest_mm[:, 0] > 0.2, lambda p: p.rest_mm[:, 1] < 0.0])
def test_half_of_the_gel_missing_is_refused_without_a_mesh_too(nectarine_grasp, side):
    """As `drupe check` meets a photographed fruit, whose mesh nobody has yet."""
    recording, _ = nectarine_grasp
    assert findings(recording, (None, None)) == []
    first, *_ = findings(without(side)(recording), (None, None))
    assert (first.kind, first.refused) == (FindingKind.OVER_EDGE, True)
    assert "so some force is missing; markers are missing" in first.sentence


def test_a_cut_gel_of_both_pads_is_said_once(nectarine_grasp):
    recording, mesh = nectarine_grasp
    for choose in (lambda p: p.rest_mm[:, 0] > 0.2, lambda p: picked(len(p.rest_mm))):
        (finding,) = findings(without(choose)(recording), mesh)
        assert finding.sentence.startswith("both pads' ")


def test_the_same_fault_of_both_pads_is_one_finding_whatever_its_numbers(nectarine_grasp):
    recording, mesh = nectarine_grasp
    left, right = (on_pads(lambda p: replace(p, force_N=p.force_N[..., ::-1]), n) for n in ("left", "right"))
    (finding,) = findings(left(recording), mesh)
    (both,) = findings(right(left(recording)), mesh)
    assert (finding.kind, finding.field, finding.pads) == (FindingKind.AXES, "force", ("left",))
    assert (both.kind, both.field, both.pads) == (FindingKind.AXES, "force", ("left", "right"))
    assert "force has its axes exchanged: its columns are zyx" in both.sentence


def test_findings_are_told_apart_by_kind_field_and_detail_and_not_by_words():
    def finding(pad, kind=FindingKind.DELAY, field=None, detail="5", says="as it is"):
        return Finding(kind=kind, says=says, pads=(pad,), field=field, detail=detail)

    (merged,) = shared([finding("left"), finding("right", says="in other words")])
    assert merged.sentence == "both pads' as it is"
    for other in ({"kind": FindingKind.SIGN}, {"field": "force"}, {"detail": "6"}):
        two = [finding("left"), finding("right", **other)]
        assert shared(two) == two


def test_a_force_of_noise_alone_is_dead_and_a_pad_that_feels_nothing_is_left_to_the_contact(nectarine_grasp):
    recording, mesh = nectarine_grasp
    rng = np.random.default_rng(2)
    dead = on_pads(lambda p: replace(p, force_N=rng.normal(0, 0.008, p.force_N.shape)))(recording)
    assert "force is dead" in findings(dead, mesh)[0].sentence
    silent = on_pads(lambda p: replace(p, displacement_mm=rng.normal(0, 0.004, p.force_N.shape)))(dead)
    assert findings(silent, mesh) == []


def test_markers_beside_a_patch_are_not_dead_where_nothing_is_noisy():
    """Their zeros repeat exactly, frame by frame, while two of their four neighbours are pressed."""
    line = np.arange(20) - 9.5
    rest = np.stack([*np.meshgrid(line, line, indexing="ij"), np.zeros((20, 20))], axis=-1).reshape(-1, 3)
    depth = np.concatenate([np.zeros(10), 1.2 * -np.expm1(-np.arange(1, 61) / 8)])[:, None]
    held = np.maximum(depth - (rest[:, :2] ** 2).sum(axis=1) / 80, 0)
    normal = held[..., None] * np.array([0.0, 0.0, 1.0])
    pad = gel_pad("left", rest, -normal, 0.22 * normal, kn=0.22, kt=0.055)
    assert not dead_markers(pressing_of(pad)).any()
    stuck = pad.displacement_mm.copy()
    stuck[:, 210] = 0.0  # in the middle of the patch
    assert dead_markers(pressing_of(replace(pad, displacement_mm=stuck))).nonzero()[0].tolist() == [210]
    out_of_order = rest[np.random.default_rng(4).permutation(len(rest))]
    assert not dead_markers(pressing_of(replace(pad, rest_mm=out_of_order))).any()


def test_a_block_of_dead_markers_is_found_where_there_is_noise(nectarine_grasp):
    recording, _ = nectarine_grasp
    pad = recording.pads[0]
    middle = int(np.abs(pad.force_N[:, :, 2]).max(axis=0).argmax())
    block = np.argsort(np.linalg.norm(pad.rest_mm - pad.rest_mm[middle], axis=1))[:4]
    moved = pad.displacement_mm.copy()
    moved[:, block] = 0.0
    dead = dead_markers(pressing_of(replace(pad, displacement_mm=moved)))
    assert set(block) >= set(dead.nonzero()[0])
    assert dead.sum() >= 3


def test_a_gain_widens_the_error_by_what_it_may_do(nectarine_grasp):
    recording, mesh = nectarine_grasp
    (of_one_pad,) = findings(force(1.2, "left")(recording), mesh)
    (of_both_pads,) = findings(force(1.2)(recording), mesh)
    assert "force is 1.20 times" in of_both_pads.sentence
    assert not of_both_pads.refused
    assert of_both_pads.relative_sd == pytest.approx(0.7 * np.log(1.2), rel=0.05)
    assert of_one_pad.relative_sd == pytest.approx(of_both_pads.relative_sd / 2, rel=0.1)


@pytest.mark.parametrize("times", [0.93, 1.1])
def test_a_mesh_of_another_size_is_refused_with_both_widths(nectarine_grasp, times):
    recording, (vertices, faces) = nectarine_grasp
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (finding,) = findings(recording, (middle + times * (vertices - middle), faces))
    assert finding.refused
    said = re.search(r"\(([0-9.]+) times\)", finding.sentence)
    assert float(said.group(1)) == pytest.approx(times, abs=0.005)
    assert "another fruit" in finding.sentence


def test_a_recording_that_ends_pressed_is_remarked_and_nothing_is_put_in_doubt(nectarine_grasp):
    recording, mesh = nectarine_grasp
    peak = int(np.argmax(recording.pads[0].force_N[:, :, 2].sum(axis=1)))
    (finding,) = findings(kept(slice(peak + 1))(recording), mesh)
    assert finding.kind is FindingKind.ENDS_PRESSED
    assert finding.remark
    assert finding.relative_sd == 0.0
    assert not finding.refused
    assert finding.pads == ("left", "right")


def closing_at(mm_per_s):
    """The recording with its clock stretched so that its jaws close so fast at most."""

    def change(recording):
        fastest = np.abs(np.diff(recording.aperture_mm) / np.diff(recording.time_s)).max()
        return replace(recording, time_s=recording.time_s * fastest / mm_per_s)

    return change


@pytest.mark.parametrize("mm_per_min", [1.0, 10.0, 500.0])
def test_a_testing_machines_speeds_are_sound(nectarine_grasp, mm_per_min):
    recording, mesh = nectarine_grasp
    assert findings(closing_at(mm_per_min / 60)(recording), mesh) == []


@pytest.mark.parametrize(("mm_per_s", "unit"), [(1.5e-3, "milliseconds"), (500.0, "minutes or hours")])
def test_a_clock_in_another_unit_is_remarked_of_jaws_alone_and_puts_nothing_in_doubt(
    nectarine_grasp, mm_per_s, unit
):
    recording, mesh = nectarine_grasp
    strange = closing_at(mm_per_s)(recording)
    (remark,) = findings(strange, mesh)
    assert remark.kind is FindingKind.TIME_UNIT
    assert f"time_s looks like {unit}" in remark.sentence
    assert remark.remark
    assert remark.relative_sd == 0.0
    pressed = replace(strange, loading="press", aperture_mm=-strange.aperture_mm)
    assert FindingKind.TIME_UNIT not in {finding.kind for finding in findings(pressed, mesh)}


def said_of_noise(share):
    """What the checks of noise say of a pad whose displacement has this share of noise."""
    pressing = replace(pressing_of(slab_pad()), force_sd_N=0.0)
    deep = noise_shares(pressing)[0] / pressing.felt_sd_mm
    return noise_findings([replace(pressing, felt_sd_mm=share / deep)])


def test_noise_as_of_the_softest_gel_share_is_sound_and_a_little_more_is_said():
    assert said_of_noise(0.0545) == []
    (finding,) = said_of_noise(0.066)
    assert finding.kind is FindingKind.NOISE
    assert not finding.refused
    assert finding.relative_sd == pytest.approx(6.0 * 0.066)
    assert said_of_noise(0.11)[0].refused


@pytest.mark.parametrize("turn", QUARTERS[:4])
def test_a_mesh_that_lies_on_its_side_is_named(nectarine_grasp, turn):
    recording, (vertices, faces) = nectarine_grasp
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (finding,) = findings(recording, (middle + (vertices - middle) @ turn, faces))
    assert finding.kind is FindingKind.MESH_TURNED
    assert "rotated by 90 degrees" in finding.sentence


def test_a_mesh_moved_along_the_pads_is_said(nectarine_grasp):
    recording, (vertices, faces) = nectarine_grasp
    said = findings(recording, (vertices + 3.0 * recording.pads[0].pose[0, :3, 0], faces))
    assert said
    assert "middle of the" in said[0].sentence
    assert not said[0].refused


LINE = np.arange(20.0)
GRID = np.stack(np.meshgrid(LINE, LINE), axis=-1).reshape(-1, 2)
TO_HEXAGONS = np.array([[1.0, 0.0], [0.5, 0.75**0.5]])


def missing(rest_mm: np.ndarray) -> float:
    return float(missing_markers(rest_mm)[:, 3].sum())


@pytest.mark.parametrize(("middle", "half"), [(9.0, 0.5), (9.0, 1.5), (9.5, 4.0)])
@pytest.mark.parametrize("to_grid", [np.eye(2), TO_HEXAGONS], ids=["square", "hexagonal"])
def test_holes_of_a_grid_are_counted_and_a_whole_grid_has_none(
    middle: float, half: float, to_grid: np.ndarray
) -> None:
    """Holes of one marker, of three by three and of eight by eight."""
    rest = GRID @ to_grid
    out = (np.abs(GRID - middle) < half).all(axis=1)
    assert missing(rest) == 0
    assert missing(rest[~out]) == pytest.approx(out.sum(), abs=1e-6)


@pytest.mark.parametrize("uneven", [0.005, 0.02, 0.03])
def test_holes_of_an_uneven_hexagonal_grid_are_found(uneven: float) -> None:
    """Places off by so much of the pitch; the hole is three by three."""
    out = (np.abs(GRID - 9) < 1.5).all(axis=1)
    rest = GRID @ TO_HEXAGONS
    rest += uneven * np.random.default_rng(4).standard_normal(rest.shape)
    assert missing(rest) == 0
    assert missing(rest[~out]) == pytest.approx(9, abs=0.1)


@pytest.mark.parametrize("distortion", [0.08, 0.15])
def test_a_sound_grid_seen_through_a_lens_has_no_hole(distortion: float) -> None:
    """Radial distortion, at the corner so much of its distance from the middle."""
    grid = GRID / 9.5 - 1
    squared = (grid**2).sum(axis=1, keepdims=True) / 2
    assert missing(9.5 * grid * (1 - distortion * squared)) == 0


def test_markers_in_no_grid_miss_none() -> None:
    assert missing(np.random.default_rng(0).uniform(0, 20, (300, 2))) == 0


def test_a_slabs_forces_follow_its_own_law_and_not_that_of_springs() -> None:
    pad = slab_pad()
    assert gain_of(pressing_of(pad)) == pytest.approx(1.0, abs=0.03)
    assert gain_of(pressing_of(replace(pad, gel_E_MPa=None))) < 0.6


def test_a_slab_with_more_markers_than_its_law_is_computed_for_is_not_judged_by_that_of_springs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    side = int(np.ceil(np.sqrt(MOST_FOR_SLAB + 1)))
    line = 0.7 * np.arange(float(side))
    flat = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pad = slab_pad()
    force_N = np.ones((len(pad.pose), len(flat), 3))
    rest_mm = np.column_stack([flat, np.zeros(len(flat))])
    many = replace(pad, rest_mm=rest_mm, force_N=force_N, displacement_mm=force_N)
    assert displacement_of(many, force_N) is None
    assert displacement_of(replace(many, gel_E_MPa=None), force_N) is not None
    monkeypatch.setattr("tactile.consistency.pressing.MOST_FOR_SLAB", len(pad.rest_mm) - 1)
    assert gain_of(pressing_of(pad)) is None


def changed(recording: Recording, act: Callable[[GelPad], dict[str, Any]]) -> Recording:
    """The left pad with other fields."""
    return with_pads(recording, lambda pad: replace(pad, **act(pad)), "left")


def shown(values: float) -> Callable[[GelPad], dict[str, Any]]:
    """As many times what counts of a print in every frame, and no force but noise."""

    def act(pad: GelPad) -> dict[str, Any]:
        rng = np.random.default_rng(1)
        return {
            "force_N": rng.normal(scale=1e-4, size=pad.force_N.shape),
            "print_shown": np.full(len(pad.force_N), values),
        }

    return act


@pytest.fixture
def sound(nectarine_grasp: Any) -> Recording:
    recording: Recording = nectarine_grasp[0]
    return recording


def test_a_sound_recording_has_no_such_finding(sound: Recording) -> None:
    marked = changed(
        sound, lambda pad: {"print_shown": np.full(len(pad.force_N), 5.0), "reference_print": 0.9}
    )
    pads = [pad for pad in (*sound.pads, *marked.pads) if isinstance(pad, GelPad)]
    assert reference_findings(pads) == []


CONTRADICTIONS: list[tuple[str, dict[str, Any], float, str]] = [
    ("the reference bears it", {"reference_print": 1.4}, 0.3, "the reference shows a contact imprint itself"),
    ("loaded from the first frame", {"reference_print": 0.4}, 2.0, "the gel is under load from frame 0 on"),
    ("nothing is known of the reference", {}, 2.0, "the gel is under load from frame 0 on"),
]


@pytest.mark.parametrize(
    ("fields", "values", "cause"),
    [contradiction[1:] for contradiction in CONTRADICTIONS],
    ids=[contradiction[0] for contradiction in CONTRADICTIONS],
)
def test_a_print_without_a_force_is_a_contradiction_with_its_cause(
    sound: Recording, fields: dict[str, Any], values: float, cause: str
) -> None:
    broken = changed(sound, lambda pad: shown(values)(pad) | fields)
    said = recording_findings(broken, None, None)
    assert [finding.kind for finding in said] == [FindingKind.PRINT_WITHOUT_FORCE]
    assert said[0].refused
    assert said[0].pads == ("left",)
    assert cause in said[0].sentence
    assert "reference = ... in grasp.toml" in said[0].sentence
    with refused(TactileProblem.IMPLAUSIBLE_RECORDING, re.escape(cause)) as caught:
        find_contact(broken, source="g.h5")
    assert "never touches" not in str(caught.value)


def test_a_print_that_comes_later_without_a_force_names_the_other_causes(sound: Recording) -> None:
    def act(pad: GelPad) -> dict[str, Any]:
        fields = shown(0.3)(pad)
        fields["print_shown"][len(pad.force_N) // 2 :] = 3.0
        return fields

    (finding,) = recording_findings(changed(sound, act), None, None)
    assert "pictures show a contact imprint (3.0 times the limit for an empty gel)" in finding.sentence
    assert "of another gel, or shear exceeds pressure" in finding.sentence


def test_a_pad_without_a_print_still_never_touches(sound: Recording) -> None:
    words = "close the jaws farther.* If it does touch, the reference may be under the same load as"
    with refused(TactileProblem.NEVER_TOUCHES, words):
        find_contact(changed(sound, shown(0.6)), source="g.h5")
    with pytest.raises(TactileFailure, match=r"close the jaws farther\.$"):
        find_contact(changed(sound, lambda pad: {"force_N": shown(0.0)(pad)["force_N"]}), source="g.h5")


def test_a_force_that_is_pulled_by_the_print_on_the_reference_is_no_matter_of_sign(sound: Recording) -> None:
    def act(pad: GelPad) -> dict[str, Any]:
        return {"force_N": -np.abs(pad.force_N), "reference_print": 2.0}

    assert print_without_force(sound.pads[0]) is None  # type: ignore[arg-type]
    with pytest.raises(TactileFailure, match="the reference shows a contact imprint itself"):
        find_contact(changed(sound, act), source="g.h5")


@pytest.mark.parametrize(("evidence", "refused"), [(1.1, False), (1.5, True)])
def test_a_reference_that_bears_a_print_puts_the_modulus_in_doubt_or_takes_it(
    sound: Recording, evidence: float, refused: bool
) -> None:
    said = recording_findings(changed(sound, lambda pad: {"reference_print": evidence}), None, None)
    finding = next(
        contradiction for contradiction in said if contradiction.kind is FindingKind.REFERENCE_PRINT
    )
    assert finding.refused is refused
    assert finding.relative_sd == 0.5
    assert finding.hides_touch
    assert f"the left pad's reference shows a contact imprint ({evidence:.1f} times" in finding.sentence
