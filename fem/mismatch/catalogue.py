"""All effects that the finder knows. Adding physics is adding a file to effects/ and its line here."""

from fem.mismatch.effect import Effect
from fem.mismatch.effects import (
    anisotropy,
    clock_lag,
    damage,
    graded_modulus,
    gripper_compliance,
    loose_pit,
    pit_offset,
    pit_size,
    plastic_set,
    poisson_ratio,
    pose_error,
    sensor_drift,
    sensor_gain,
    skin,
    slip,
    soft_spot,
    stiffening,
    viscoelastic,
)

EFFECTS: tuple[Effect, ...] = tuple(
    module.EFFECT
    for module in (
        viscoelastic,
        stiffening,
        skin,
        graded_modulus,
        soft_spot,
        anisotropy,
        poisson_ratio,
        pit_offset,
        pit_size,
        loose_pit,
        slip,
        plastic_set,
        damage,
        sensor_gain,
        sensor_drift,
        gripper_compliance,
        clock_lag,
        pose_error,
    )
)
