"""The loading of a recorded grasp, from first touch to its greatest load, at a few loads.

A candidate's forces are made of it: placed elsewhere, deeper, at another speed, held longer, twice. Deeper by
d, the pressure under each pad is that of a larger contact of the same shape (Hertz, Johnson 1985, Contact
Mechanics, section 4.2: radius as the root of the depth, pressure likewise, force as depth^1.5):

    f'(x) = sqrt(d) f(x / sqrt(d)),      x from the centre of force in the pad's plane
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from fem.mismatch.model.baseline import GraspResponse

LOADS = (0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)
"""Shares of the greatest load at which a candidate's loading and unloading have a frame. Set by hand."""
PLATEAU = 0.98
"""Share of the greatest load at which the loading has ended: in a hold noise and creep move the greatest. Set
by hand."""
STARTS = 0.05
"""Share of the greatest load below which loading has not begun. Set by hand."""
LEAST_STEP_S = 1e-3
"""Shortest loading, s, so that no speed is infinite."""


@dataclass(frozen=True, kw_only=True)
class LoadingCourse:
    """At LOADS: forces and gel displacement on the markers (pad axes: `turns`, columns), contacts, travel.

    `time_s`: since first touch; `travel_mm`: of each pad along its normal, zero at the greatest load;
    `speed_mm_per_s`: of its loading. `hold_s`: for how long it was held; `frame_s`: between frames; `frames`:
    of that contact.
    """

    force_N: Float[np.ndarray, "k n 3"]
    gel_mm: Float[np.ndarray, "k n 3"]
    touching: Bool[np.ndarray, "k n"]
    time_s: Float[np.ndarray, " k"]
    travel_mm: Float[np.ndarray, "p k"]
    speed_mm_per_s: Float[np.ndarray, " p"]
    hold_s: float
    frame_s: float
    frames: int

    @classmethod
    def of(cls, recording: GraspResponse) -> "LoadingCourse":
        """Of the cycle with the greatest load."""
        load, time = recording.load, recording.time_s
        peak = int(np.argmax(load >= PLATEAU * load.max()))
        first = peak
        numbers = np.flatnonzero(recording.used)
        while first > 0 and numbers[first] - numbers[first - 1] == 1 and load[first - 1] > STARTS:
            first -= 1
        last = peak
        while last + 1 < len(load) and numbers[last + 1] - numbers[last] == 1 and load[last + 1] > STARTS:
            last += 1
        frames = np.arange(first, peak + 1)
        rising = frames[load[frames] >= np.maximum.accumulate(load[frames])]
        mix = _between(load[rising], np.array(LOADS))
        turns, whose = recording.case.turns, recording.pad_of_marker
        axes = turns[whose]
        near = rising[np.abs(load[rising][None] - np.array(LOADS)[:, None]).argmin(axis=1)]
        force = np.tensordot(mix @ recording.shares[rising], recording.patterns, axes=1)
        gel = np.tensordot(mix, recording.tracks.gel_displacement_mm[rising], axes=1)
        normal = turns[:, :, 2]
        way = np.einsum("pfx,px->pf", recording.pose[:, :, :3, 3], normal)
        travel = (way[:, rising] - way[:, [peak]]) @ mix.T
        held = np.array([p == "hold" for p in np.array(recording.case.history.phase)[recording.used]])
        after = held & (np.arange(len(load)) >= peak) & (np.arange(len(load)) <= last)
        spent = max(float(time[peak] - time[first]), LEAST_STEP_S)
        return cls(
            force_N=np.einsum("knx,nxy->kny", force, axes),
            gel_mm=np.einsum("knx,nxy->kny", gel, axes),
            touching=recording.tracks.episode[near] >= 0,
            time_s=mix @ (time[rising] - time[first]),
            travel_mm=travel,
            speed_mm_per_s=(way[:, peak] - way[:, first]) / spent,
            hold_s=float(time[after].max() - time[peak]) if after.any() else 0.0,
            frame_s=max(float(np.median(np.diff(recording.case.history.time_s))), LEAST_STEP_S),
            frames=last + 1 - first,
        )

    def deeper(self, recording: GraspResponse, depth: float) -> "LoadingCourse":
        """The same with the pads `depth` times as deep."""
        if depth == 1.0:
            return self
        wide = np.sqrt(depth)
        force, gel, touching = (np.zeros_like(field) for field in (self.force_N, self.gel_mm, self.touching))
        for number, pad in enumerate(recording.case.history.pads):
            mine = np.flatnonzero(recording.pad_of_marker == number)
            flat = pad.rest_mm[:, :2]
            push = np.maximum(self.force_N[-1, mine, 2], 0.0)
            centre = (push[:, None] * flat).sum(axis=0) / max(float(push.sum()), 1e-12)
            come_from = centre + (flat - centre) / wide
            for values, deeper_field in ((self.force_N, force), (self.gel_mm, gel)):
                table = np.moveaxis(values[:, mine], 1, 0).reshape(len(mine), -1)
                moved = wide * LinearNDInterpolator(flat, table, fill_value=0.0)(come_from)
                deeper_field[:, mine] = np.moveaxis(moved.reshape(len(mine), len(values), 3), 0, 1)
            nearest = NearestNDInterpolator(flat, np.arange(len(mine)))(come_from).astype(np.int64)
            touching[:, mine] = self.touching[:, mine[nearest]]
        return LoadingCourse(
            force_N=force,
            gel_mm=gel,
            touching=touching,
            time_s=depth * self.time_s,
            travel_mm=depth * self.travel_mm,
            speed_mm_per_s=self.speed_mm_per_s,
            hold_s=self.hold_s,
            frame_s=self.frame_s,
            frames=self.frames,
        )


def _between(known: Float[np.ndarray, " f"], wanted: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k f"]:
    """Weights of linear interpolation at increasing places; below the first in proportion to it."""
    return (
        np.stack([np.interp(wanted, known, unit) for unit in np.eye(len(known))], axis=1)
        * np.minimum(1.0, wanted / max(float(known[0]), 1e-12))[:, None]
    )
