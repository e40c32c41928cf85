"""Squeezes by closed forms: a rig that is a spring in series with Hertz's contact of its pads, and an object.

Travel is a sum of approaches under one force: F/k of the machine, (F/a)^(2/3) of the pads. No mechanics of
tactile or fem is used.
"""

from dataclasses import dataclass

import numpy as np
from injected_grasp import held_by

from tactile.readers.recording import IndenterPad


@dataclass(frozen=True)
class SeriesRig:
    """`spring_N_per_mm` of the machine; `pads` in N/mm^1.5."""

    spring_N_per_mm: float = 8.0
    pads: float = 10.0

    def give_mm(self, force_N):
        force = np.maximum(force_N, 0.0)
        return force / self.spring_N_per_mm + (force / self.pads) ** (2 / 3)


def press(
    rng,
    rig,
    *,
    peak_N=20.0,
    scale=1.0,
    onset_mm=0.4,
    noise_N=0.01,
    noise_mm=0.002,
    zero_N=0.05,
    frames=80,
    hold=10,
    back=True,
    relaxes=0.0,
    own_mm=None,
    friction_mm=0.0,
):
    """time_s, force_N, travel_mm: air, a way in at even travel, a hold, a way out."""
    level = np.linspace(0, 1, 4000) ** 2 * peak_N
    whole = scale * rig.give_mm(level) + (0.0 if own_mm is None else own_mm(level))
    air = np.linspace(0, onset_mm, 15, endpoint=False)
    way = np.linspace(0, whole[-1], frames)
    force_in = np.interp(way, whole, level)
    travel = np.r_[air, onset_mm + way, np.full(hold, onset_mm + whole[-1])]
    kept = peak_N * (1 - relaxes * np.linspace(0, 1, hold))
    force = np.r_[np.zeros(len(air)), force_in, kept]
    if back:
        travel = np.r_[
            travel, onset_mm + way[::-1] + friction_mm * np.sin(np.pi * way[::-1] / whole[-1]), air[::-1]
        ]
        force = np.r_[force, force_in[::-1] * kept[-1] / peak_N, np.zeros(len(air))]
    time = np.arange(len(force)) / 20.0
    return (
        time,
        force + zero_N + noise_N * rng.standard_normal(len(force)),
        travel + noise_mm * rng.standard_normal(len(force)),
    )


def bare_press(time_s, force_N, travel_mm):
    """The recording of a ball of 5 mm on a load cell."""
    pad = IndenterPad(
        name="tip",
        pose=np.broadcast_to(np.eye(4), (len(time_s), 4, 4)).copy(),
        force_z_N=force_N,
        indenter="ball",
        radius_mm=5.0,
    )
    return held_by((pad,), time_s, travel_mm, loading="press")
