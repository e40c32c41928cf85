"""Where markers lie and what they touch: turned and moved meshes, lattices, a slab's law, prints."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from injected_grasp import with_pads
from recording_mistakes import findings, slab_pad

from tactile.consistency.faults import missing_markers, print_without_force, reference_findings
from tactile.consistency.finding import FindingKind
from tactile.consistency.of_recording import recording_findings
from tactile.consistency.pressing import MOST_FOR_SLAB, displacement_of, pressing_of
from tactile.consistency.relations import gain_of
from tactile.consistency.transformations import QUARTERS
from tactile.contact import find_contact
from tactile.readers.recording import GelPad, Recording
from tactile.tactile_failure import TactileFailure, TactileProblem


@pytest.mark.parametrize("turn", QUARTERS[:4])
def test_a_mesh_that_lies_on_its_side_is_named(nectarine_grasp, turn):
    recording, (vertices, faces) = nectarine_grasp
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (finding,) = findings(recording, (middle + (vertices - middle) @ turn, faces))
    assert finding.kind is FindingKind.MESH_TURNED
    assert "rotated by 90 degrees" in finding.sentence


def test_a_mesh_moved_along_the_pads_is_said(nectarine_grasp):
    recording, (vertices, faces) = nectarine_grasp
    aside = recording.pads[0].pose[0, :3, 0]
    said = findings(recording, (vertices + 3.0 * aside, faces))
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
    with pytest.raises(TactileFailure) as caught:
        find_contact(broken, source="g.h5")
    assert caught.value.problem is TactileProblem.IMPLAUSIBLE_RECORDING
    assert "never touches" not in str(caught.value)
    assert cause in str(caught.value)


def test_a_print_that_comes_later_without_a_force_names_the_other_causes(sound: Recording) -> None:
    def act(pad: GelPad) -> dict[str, Any]:
        fields = shown(0.3)(pad)
        fields["print_shown"][len(pad.force_N) // 2 :] = 3.0
        return fields

    (finding,) = recording_findings(changed(sound, act), None, None)
    assert "pictures show a contact imprint (3.0 times the limit for an empty gel)" in finding.sentence
    assert "of another gel, or shear exceeds pressure" in finding.sentence


def test_a_pad_without_a_print_still_never_touches(sound: Recording) -> None:
    with pytest.raises(TactileFailure, match="close the jaws farther") as caught:
        find_contact(changed(sound, shown(0.6)), source="g.h5")
    assert caught.value.problem is TactileProblem.NEVER_TOUCHES
    assert "If it does touch, the reference may be under the same load as the frames" in str(caught.value)
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
