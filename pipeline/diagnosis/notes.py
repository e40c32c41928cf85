"""Caveats about a case's recordings for readers of the answer."""

from collections.abc import Sequence
from pathlib import Path

from fem.mismatch.result import NONE, Explanation
from pipeline.batch.settings import SensorSettings
from pipeline.diagnosis.diagnosed_case import Case
from pipeline.fruit.grasped import GraspedFruit, owner_of
from pipeline.fruit.input_doubts import implausible_E
from pipeline.fruit.placed_grasp import PlacedGrasp
from pipeline.fruit.recording_owner import owner_findings
from pipeline.fruit.sensor_scale import sensor_scale
from pipeline.problem import refused
from tactile.noise import FEWEST_NO_CONTACT_FRAMES
from tactile.readers.recording import IndenterPad, Recording, read_recording
from tactile.tactile_failure import TactileFailure

ONE_RECORDING = (
    "There is only one recording. It cannot distinguish effects of the fruit (a soft spot, the "
    "pit) from effects of the jaws (a gain, a pad's place). Nothing is held out to test the "
    "answer."
)
FEW_RECORDINGS = (
    "There are {count} recordings: weak effects may stay hidden. Four recordings that differ in "
    "place, speed and hold distinguish more effects; turn the fruit for one of them."
)
FEW = 3
"""Grasps up to which a note asks for more: the cases that calibrated the model error have four."""
CATEGORY_PIT = (
    "There is no pit.ply, so drupe uses the category's pit; a different true pit may appear as an effect."
)


def require_one_fruit(case: Case) -> None:
    """Refuses recordings that name different fruit, and a bare indenter's curve that names another fruit of
    the batch; raises BatchRefused that names both.

    A recording that cannot be read is left to the stage that reads it. So are pads' recordings of a batch's
    fruit: that stage knows whose they may be.
    """
    first: tuple[str, str] | None = None
    files = case.task.folder.grasp_files()
    if not files and not case.task.folder.raw_grasp_folders():
        where = case.task.folder.grasps
        raise refused(where, "holds no recording (*.h5); record a grasp and put its .h5 there.")
    for path in files:
        try:
            recording = read_recording(path)
        except TactileFailure:
            continue
        named = recording.fruit_id
        if case.batch is not None:
            if any(isinstance(pad, IndenterPad) for pad in recording.pads):
                _require_own(case, path, recording)
            continue
        if first is not None and named != first[1]:
            sentence = (
                f'belongs to fruit "{named}", but {first[0]} belongs to fruit "{first[1]}"; a '
                "case holds recordings of one fruit. Move the others away."
            )
            raise refused(path, sentence)
        first = first or (path.name, named)


def _require_own(case: Case, path: Path, recording: Recording) -> list[str]:
    """Doubts about whether the recording belongs to the case's fruit. Raises BatchRefused if it names another
    fruit of the batch.
    """
    said = recording.fruit_id, recording.category
    try:
        findings = owner_findings(*said, owner_of(case.task), source=path.name, field="attribute fruit_id")
    except TactileFailure as failure:
        raise refused(path, failure.detail) from None
    return [f"{path.name}: {finding.sentence}." for finding in findings]


def notes_on_trace(case: Case) -> list[str]:
    """Doubts about whose a bare indenter's curves are, if the case is a batch's fruit."""
    files = case.task.folder.grasp_files() if case.batch is not None else ()
    return [note for path in files for note in _require_own(case, path, read_recording(path))]


def notes_on(case: Case, fruit: GraspedFruit, warnings: Sequence[str]) -> list[str]:
    """Notes of the pipeline: what it ignored, and the source of the noise."""
    return [
        *warnings,
        *([ONE_RECORDING] if len(fruit.placed) == 1 else []),
        *([FEW_RECORDINGS.format(count=len(fruit.placed))] if 1 < len(fruit.placed) <= FEW else []),
        *([CATEGORY_PIT] if fruit.pit.record and not case.task.folder.pit_ply.is_file() else []),
        *case.notes,
        *(note for grasp in fruit.placed for note in _air(grasp)),
        *_scale(fruit.placed, case.task.settings.sensor),
    ]


def _scale(placed: Sequence[PlacedGrasp], settings: SensorSettings | None) -> list[str]:
    """The note on E's error by the sensors' scales."""
    scale = sensor_scale([grasp.recording for grasp in placed], settings)
    if not scale.sd:
        return []
    return [
        f"The sensor's scales add ± {scale.sd:.1%} to E, the same in all grasps ({scale.common:.1%} of "
        "it from a common factor on force and gel stiffness). The intervals here exclude it."
    ]


def doubts_of_modulus(case: Case, explanation: Explanation) -> tuple[str, ...]:
    """A sentence if E, without an effect or with it, is one that no flesh of the category has."""
    if explanation.withheld is not None:
        return ()
    values = {"E": explanation.before.value}
    if explanation.verdict != NONE:
        values = {"E without an effect": explanation.before.value, "E with it": explanation.after.value}
    wrong = implausible_E(values, case.task.prior)
    return () if wrong is None else (wrong,)


def _air(grasp: PlacedGrasp) -> list[str]:
    frames = grasp.contact.no_contact_frames
    if frames - 1 >= FEWEST_NO_CONTACT_FRAMES:
        return []
    count = f"only {frames} frames" if frames else "no frame"
    return [
        f"{grasp.name}: {count} before first contact. drupe estimates noise from frames in contact "
        f"and may miss weaker effects; record at least {FEWEST_NO_CONTACT_FRAMES + 1} frames in the air."
    ]
