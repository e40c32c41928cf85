"""What to record next: advice that follows from what the effects of a verdict state of themselves."""

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import NONE, UNKNOWN

TURNED = (
    "grasp the same spots once more with the fruit turned by 180 degrees between the jaws: what belongs "
    "to a sensor or jaw stays with it, what belongs to the fruit moves along"
)
TWICE = (
    "grasp one spot twice in a row and record the unloading too: what lasts shows in the unloading and in "
    "the second grasp"
)
SPEEDS = "grasp one spot at two speeds that differ tenfold, each with a hold of ten seconds"
ACROSS = "grasp across the last direction, and along the stem if the jaws allow it"


def next_grasp(verdict: str | tuple[str, ...], *, grasps: int) -> str | None:
    """A sentence, or None where nothing is left to tell apart. `grasps`: recordings so far.

    The first difference between the remaining effects decides: whether they stay with a jaw, whether they
    last in the flesh, whether they depend on time.
    """
    if isinstance(verdict, str):
        if verdict == UNKNOWN:
            return f"nothing in the catalogue explains this; first {SPEEDS}; then {TURNED}"
        if verdict != NONE and grasps < 2:
            return f"one recording alone cannot be checked against another: {ACROSS}; then {TURNED}"
        return None
    specs = [SPECS[part] for name in verdict for part in name.split("+") if part in SPECS]
    if len({spec.of_the_jaws for spec in specs}) > 1:
        return TURNED
    if len({spec.remembers_grasps for spec in specs}) > 1:
        return TWICE
    return SPEEDS if any(spec.knows_time for spec in specs) else ACROSS
