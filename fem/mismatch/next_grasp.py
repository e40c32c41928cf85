"""What to record next: what parts the explanations that are left."""

from fem.mismatch.result import NONE, UNKNOWN

TURNED = (
    "grasp the same spots once more with the fruit turned by 180 degrees between the jaws: what belongs to a "
    "sensor or jaw stays with it, what belongs to the fruit moves along"
)
CYCLES = (
    "grasp one spot twice in a row to the same depth, with a slow unloading: damage shows in the second load"
)
SPEEDS = "grasp one spot at two speeds that differ tenfold, each with a hold of ten seconds"
DEPTHS = "grasp one spot to two depths that differ by half, at the same speed"
ACROSS = "grasp across the last direction, and along the stem if the jaws allow it"
DRY = "grasp once more with a dry, wiped skin and a sideways move during the hold"
SEPARATORS: dict[frozenset[str], str] = {
    frozenset(("stiffening", "damage")): CYCLES,
    frozenset(("plastic_set", "damage")): CYCLES,
    frozenset(("stiffening", "plastic_set")): CYCLES,
    frozenset(("pit_size", "gripper_compliance")): DEPTHS,
    frozenset(("gripper_compliance", "stiffening")): DEPTHS,
    frozenset(("gripper_compliance", "skin")): DEPTHS,
    frozenset(("stiffening", "skin")): DEPTHS,
    frozenset(("stiffening", "poisson_ratio")): DEPTHS,
    frozenset(("stiffening", "graded_modulus")): DEPTHS,
    frozenset(("viscoelastic", "clock_lag")): SPEEDS,
    frozenset(("viscoelastic", "sensor_drift")): SPEEDS,
    frozenset(("skin", "poisson_ratio")): ACROSS,
    frozenset(("skin", "graded_modulus")): ACROSS,
    frozenset(("pit_size", "graded_modulus")): ACROSS,
    frozenset(("anisotropy", "pit_offset")): ACROSS,
    frozenset(("soft_spot", "sensor_gain")): TURNED,
    frozenset(("pit_offset", "sensor_gain")): TURNED,
    frozenset(("slip", "pose_error")): DRY,
}
MEASURED = {"sensor_gain", "sensor_drift", "gripper_compliance", "clock_lag", "pose_error"}


def next_grasp(verdict: str | tuple[str, ...], *, grasps: int) -> str | None:
    """A sentence, or None where nothing is left to tell apart.

    The separators are those of what each pair leaves the same and what not; a turned fruit parts every effect
    of the jaws from every effect of the fruit.
    """
    if isinstance(verdict, str):
        if verdict == UNKNOWN:
            return f"nothing in the catalogue explains this; first {SPEEDS}; then {TURNED}"
        if verdict != NONE and grasps < 2:
            return f"one recording alone cannot be checked against another: {ACROSS}; then {TURNED}"
        return None
    for one in verdict:
        for other in verdict:
            found = SEPARATORS.get(frozenset((one, other)))
            if found is not None:
                return found
    if len(MEASURED & set(verdict)) not in (0, len(verdict)):
        return TURNED
    return ACROSS
