"""How uncertain E is because the sensors' own scales are: what their descriptions state under [spread]."""

from collections.abc import Sequence

import numpy as np

from pipeline.fruit.placed_grasp import PlacedGrasp
from tactile.io.recording import GelPad, Recording

IN_CONTACT = 0.05
"""Share of the peak force from which the pads touch, and of a marker's greatest from which it does (set by
hand)."""
LEAST_OWN = 0.1
"""Share of the jaws' travel that the fruit is taken to give at least, where gels give nearly all (set by
hand)."""


def sensor_scale_sd(grasps: Sequence[PlacedGrasp]) -> float:
    """Relative standard deviation of E that all grasps by these sensors share; 0 where nothing is stated.

    E goes with the force's scale, and with that of the gel's displacement times the gel's part of the travel
    over the fruit's: what the gel gives is taken off the jaws' travel. Sensors of one kind err alike, so that
    pads and grasps do not make it less.
    """
    each = [_of_recording(grasp.recording) for grasp in grasps]
    return float(np.mean(each)) if each else 0.0


def _of_recording(recording: Recording) -> float:
    pads = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    if not any(pad.force_scale_sd or pad.displacement_scale_sd for pad in pads):
        return 0.0
    force = np.mean([pad.force_scale_sd for pad in pads])
    displacement = np.mean([pad.displacement_scale_sd for pad in pads])
    return float(np.hypot(force, displacement * _gel_over_fruit(recording, pads)))


def _gel_over_fruit(recording: Recording, pads: Sequence[GelPad]) -> float:
    """Travel that the gels give between first touch and peak, over what the fruit gives."""
    normal = np.sum([np.abs(pad.force_N[:, :, 2].sum(axis=1)) for pad in pads], axis=0)
    peak = int(np.argmax(normal))
    touch = int(np.argmax(normal > IN_CONTACT * normal[peak]))
    closed = abs(float(recording.aperture_mm[touch] - recording.aperture_mm[peak]))
    gels = 0.0
    for pad in pads:
        pressed = pad.force_N[peak, :, 2] > IN_CONTACT * pad.force_N[peak, :, 2].max()
        if pressed.any():
            gels += max(0.0, -float(np.mean(pad.displacement_mm[peak, pressed, 2])))
    return gels / max(closed - gels, LEAST_OWN * closed, 1e-6)
