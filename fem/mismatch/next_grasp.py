"""What to record next: what parts the explanations that are left."""

from fem.mismatch.catalogue import SEPARATORS, SPECS
from fem.mismatch.effect_spec import NextGrasp
from fem.mismatch.result import NONE, UNKNOWN


def next_grasp(verdict: str | tuple[str, ...], *, grasps: int) -> str | None:
    """A sentence, or None where nothing is left to tell apart.

    The separators are those of what each pair leaves the same and what not; a turned fruit parts every effect
    of the jaws from every effect of the fruit.
    """
    if isinstance(verdict, str):
        if verdict == UNKNOWN:
            return (
                f"nothing in the catalogue explains this; first {NextGrasp.SPEEDS}; then {NextGrasp.TURNED}"
            )
        if verdict != NONE and grasps < 2:
            return (
                "one recording alone cannot be checked against another: "
                f"{NextGrasp.ACROSS}; then {NextGrasp.TURNED}"
            )
        return None
    for one in verdict:
        for other in verdict:
            found = SEPARATORS.get(frozenset((one, other)))
            if found is not None:
                return found
    of_the_jaws = [one in SPECS and SPECS[one].of_the_jaws for one in verdict]
    if any(of_the_jaws) and not all(of_the_jaws):
        return NextGrasp.TURNED
    return NextGrasp.ACROSS
