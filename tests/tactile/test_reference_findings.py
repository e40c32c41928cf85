"""Prints on references, and prints without a force, are findings and no results."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactile.checks.finding import FindingKind
from tactile.checks.of_recording import recording_findings
from tactile.checks.reference import print_without_force, reference_findings
from tactile.contact import find_contact
from tactile.io.recording import GelPad, Recording
from tactile.tactile_failure import TactileFailure, TactileProblem


def changed(recording: Recording, act: Callable[[GelPad], dict[str, Any]]) -> Recording:
    """The left pad with other fields."""
    left, *others = recording.pads
    return replace(recording, pads=(replace(left, **act(left)), *others))


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
    ("fields", "values", "cause"), [one[1:] for one in CONTRADICTIONS], ids=[one[0] for one in CONTRADICTIONS]
)
def test_a_print_without_a_force_is_a_contradiction_with_its_cause(
    sound: Recording, fields: dict[str, Any], values: float, cause: str
) -> None:
    broken = changed(sound, lambda pad: shown(values)(pad) | fields)
    found = recording_findings(broken, None, None)
    assert [one.kind for one in found] == [FindingKind.PRINT_WITHOUT_FORCE]
    assert found[0].refused
    assert found[0].pads == ("left",)
    assert cause in found[0].sentence
    assert "reference = ... in grasp.toml" in found[0].sentence
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

    (found,) = recording_findings(changed(sound, act), None, None)
    assert "pictures show a contact imprint (3.0 times the limit for an empty gel)" in found.sentence
    assert "of another gel, or shear exceeds pressure" in found.sentence


def test_an_estimate_that_is_too_coarse_is_not_advised_again(sound: Recording) -> None:
    def act(pad: GelPad) -> dict[str, Any]:
        return shown(2.0)(pad) | {"reference_sd_mm": np.full(len(pad.rest_mm), 0.1)}

    (found,) = recording_findings(changed(sound, act), None, None)
    assert (
        "the estimate of the untouched gel has a standard deviation of 0.1 mm, "
        "too coarse for the force of this imprint" in found.sentence
    )
    assert found.sentence.endswith(
        "name a picture or a clip of the empty gel (reference = ... in grasp.toml)"
    )


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
    found = recording_findings(changed(sound, lambda pad: {"reference_print": evidence}), None, None)
    one = next(one for one in found if one.kind is FindingKind.REFERENCE_PRINT)
    assert one.refused is refused
    assert one.relative_sd == 0.5
    assert one.hides_touch
    assert f"the left pad's reference shows a contact imprint ({evidence:.1f} times" in one.sentence
