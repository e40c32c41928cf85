"""Steps that a zeroed display or load cell makes in one quantity, told from what a specimen does."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.noise import noise_sd

Values: TypeAlias = Float[np.ndarray, " t"]

NEIGHBOURS = 5
"""Steps on each side of a reset with which its own is compared."""
ABOVE_NOISE, ABOVE_SPREAD = 8.0, 3.0
"""Standard deviations of noise, and multiples of the spread of the steps near it, that a reset exceeds."""
CLEAR, STAYS = 6.0, 3
"""Standard deviations, and rows, by which the force leaves its level in the air."""
AGREES, NONE_LEFT = 0.15, 0.3
"""Shares of the step: within the first the shift in the air is the step, below the second there is none."""
LOCAL = 10
"""Rows on each side over which a slope is fitted."""
SAME_SLOPE = 0.2
"""Share by which the slopes dF/ds before and after a reset may differ."""
MOST = 5
"""Steps beyond which a force is serrated."""
MOST_RESETS, UNUSUAL = 2, 3.0
"""Steps of the travel beyond which a machine moves in steps, and multiples of these that a reset exceeds."""


@dataclass(frozen=True, kw_only=True)
class Reset:
    """`row`: the first one behind the step of `quantity` (force or travel); `step`: what it added."""

    quantity: str
    row: int
    step: float


class Ambiguous(Exception):
    """A step of the force that may be a reset or the specimen's: behind which row, its size, and the shift of
    the force in the air (N; None: no air was recorded afterwards).
    """

    def __init__(self, row: int, step_N: float, shift_N: float | None) -> None:
        super().__init__(row, step_N, shift_N)
        self.row, self.step_N, self.shift_N = row, step_N, shift_N


@dataclass(frozen=True, kw_only=True)
class Air:
    """Levels of the force in the air before the touch and after the release (None: not recorded), and the
    first row in contact.
    """

    before_N: float | None
    after_N: float | None
    touch: int


def resets(time_s: Values, travel: Values, force_N: Values) -> list[Reset]:
    """Resets of the travel and of the force, in this order.

    Raises Ambiguous for a step of the force of which the air afterwards shows some part, or is not recorded.
    """
    if len(time_s) < 4 * NEIGHBOURS:
        return []
    of_travel, of_force = impulses(time_s, travel), impulses(time_s, force_N)
    size = np.abs(travel[of_travel + 1] - travel[of_travel])
    usual = np.median(size) if len(size) > MOST_RESETS else 0.0
    alone = np.setdiff1d(of_travel[size > UNUSUAL * usual], of_force)
    travel_resets = _of_travel(time_s, travel, force_N, alone)
    scaled = travel.copy()
    for reset in travel_resets:
        scaled[reset.row :] -= reset.step
    steps = np.setdiff1d(of_force, of_travel)
    return (
        [*travel_resets, *_of_force(time_s, scaled, force_N, steps)]
        if 0 < len(steps) <= MOST
        else travel_resets
    )


def impulses(time_s: Values, values: Values) -> Int[np.ndarray, " k"]:
    """Rows after which the value jumps in one step that those before and after it do not lead to.

    A change of speed has unlike steps on its two sides, none of them beyond both; a break in the recording is
    as long as its step, and a clock that jitters has even steps by row.
    """
    step = np.diff(time_s)
    usual = float(np.median(step))
    per_row = _beyond(np.diff(values), np.ones(len(step)), noise_sd(values))
    per_time = _beyond(np.diff(values), np.maximum(step / usual, 0.2), noise_sd(values))
    peaks = np.flatnonzero(per_row & per_time)
    return peaks[(peaks >= 2) & (peaks <= len(step) - 3)]


def _beyond(
    step: Float[np.ndarray, " d"], length: Float[np.ndarray, " d"], sd: float
) -> Bool[np.ndarray, " d"]:
    """Which steps, each over its length, are beyond those on both sides."""
    rate = step / length
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(rate, NEIGHBOURS, mode="edge"), 2 * NEIGHBOURS + 1
    )
    near = np.delete(windows, NEIGHBOURS, axis=1)
    low, high = near.min(axis=1), near.max(axis=1)
    beyond = np.maximum(np.maximum(rate - high, low - rate), 0.0) * length
    return np.asarray(beyond > np.maximum(ABOVE_NOISE * sd, ABOVE_SPREAD * (high - low) * length))


def air_levels(travel: Values, force_N: Values) -> Air:
    """The force before the first touch and after the release, where either was recorded."""
    sd = noise_sd(force_N)
    level = float(np.median(force_N[:NEIGHBOURS]))
    clear = np.abs(force_N - level) > CLEAR * sd
    stays = np.flatnonzero(clear[:-2] & clear[1:-1] & clear[2:])
    touch = int(stays[0]) if len(stays) else len(force_N)
    before = float(np.median(force_N[: max(touch - 1, 1)])) if touch >= NEIGHBOURS else None
    if touch in (0, len(force_N)):
        return Air(before_N=before, after_N=None, touch=touch)
    forward = direction(travel, touch)
    behind = forward * travel < forward * travel[touch]
    free = len(travel) - int(np.argmax(~behind[::-1])) if not behind.all() else len(travel)
    tail = force_N[free:]
    if len(tail) < STAYS:
        tail = _flat_tail(travel, force_N, sd)
    after = float(np.median(tail)) if len(tail) >= STAYS else None
    return Air(before_N=before, after_N=after, touch=touch)


def direction(travel: Values, touch: int) -> float:
    """1 where the travel grows towards the touch, -1 where it falls (a gap), by the signs of its steps."""
    return 1.0 if np.sign(np.diff(travel))[: touch + NEIGHBOURS].sum() >= 0 else -1.0


def _flat_tail(travel: Values, force_N: Values, sd: float) -> Float[np.ndarray, " k"]:
    """The last forces, where they stay level while the travel moves on."""
    calm = np.abs(force_N - float(np.median(force_N[-STAYS:]))) < CLEAR * sd
    first = len(calm) - int(np.argmax(~calm[::-1])) if not calm.all() else 0
    tail = force_N[first:]
    if len(tail) < STAYS:
        return tail
    moves = np.ptp(travel[first:]) > 0.03 * np.ptp(travel)
    half = len(tail) // 2
    level = len(tail) > NEIGHBOURS and abs(float(np.median(tail[half:]) - np.median(tail[:half]))) < sd
    return tail if moves and level else tail[:0]


def _of_travel(time_s: Values, travel: Values, force_N: Values, steps: Int[np.ndarray, " k"]) -> list[Reset]:
    """Steps of the travel while the force goes on. In the air a jump that presses on before the touch, or
    draws back after the release, is the machine's.
    """
    if not len(steps):
        return []
    air, sd = air_levels(travel, force_N), noise_sd(force_N)
    forward = direction(travel, air.touch)
    level = air.before_N if air.before_N is not None else float(np.median(force_N[:NEIGHBOURS]))
    travel_resets = []
    for k in steps.tolist():
        step = _step_of(time_s, travel, k)
        near = force_N[max(k - 2, 0) : k + 4] - level
        in_air = bool((np.abs(near) < CLEAR * sd).all())
        presses = forward * step > 0
        if (presses != (k < air.touch)) if in_air else _felt(travel, force_N, k, step, sd):
            travel_resets.append(Reset(quantity="travel", row=k + 1, step=step))
    return travel_resets


def _felt(travel: Values, force_N: Values, k: int, step: float, sd: float) -> bool:
    """Whether a motion by this step would have changed the force clearly, by its slope around row k."""
    slopes = [0.0]
    for side in (slice(max(k + 1 - LOCAL, 0), k + 1), slice(k + 1, k + 1 + LOCAL)):
        moved = float(np.ptp(travel[side]))
        if moved > 0:
            slopes.append(abs(float(np.polyfit(travel[side], force_N[side], 1)[0])))
    return max(slopes) * abs(step) > CLEAR * sd


def _of_force(time_s: Values, travel: Values, force_N: Values, steps: Int[np.ndarray, " k"]) -> list[Reset]:
    """Steps of the force that the air shows afterwards.

    Raises Ambiguous where it shows some part, and for one to zero with the same slope behind it where no air
    follows.
    """
    air, sd = air_levels(travel, force_N), noise_sd(force_N)
    sizes = np.array([_step_of(time_s, force_N, k) for k in steps.tolist()])
    before = 0.0 if air.before_N is None else air.before_N
    level = max(float(np.abs(sizes).max()), 1e-12)
    zeroed = _zeroed(travel, force_N, steps, sd)
    if air.after_N is None:
        if zeroed.any():
            k = int(np.argmax(zeroed))
            raise Ambiguous(int(steps[k]) + 1, float(sizes[k]), None)
        return []
    shift = air.after_N - before
    if abs(shift) <= max(CLEAR * sd, NONE_LEFT * level):
        return []
    for chosen in (np.ones(len(steps), dtype=bool), zeroed, *np.eye(len(steps), dtype=bool)):
        total = float(sizes[chosen].sum())
        if chosen.any() and abs(shift - total) <= max(CLEAR * sd, AGREES * abs(total)):
            known = air.before_N is not None
            rest = (shift - total) * np.abs(sizes) / np.abs(sizes[chosen]).sum() if known else 0.0
            return _found(steps, sizes + rest, chosen)
    raise Ambiguous(int(steps[0]) + 1, float(sizes[0]), shift)


def _found(
    steps: Int[np.ndarray, " k"], sizes: Float[np.ndarray, " k"], chosen: Bool[np.ndarray, " k"]
) -> list[Reset]:
    return [
        Reset(quantity="force", row=k + 1, step=size)
        for k, size in zip(steps[chosen].tolist(), sizes[chosen].tolist(), strict=True)
    ]


def _zeroed(
    travel: Values, force_N: Values, steps: Int[np.ndarray, " k"], sd: float
) -> Bool[np.ndarray, " k"]:
    """Which steps lead to a force of zero, behind which it changes over the travel as it did before."""
    zeroed = []
    for k in steps.tolist():
        sides = [slice(max(k + 1 - LOCAL, 0), k + 1), slice(k + 1, k + 1 + LOCAL)]
        moved = [float(np.ptp(travel[side])) for side in sides]
        if min(moved) <= 0:
            zeroed.append(False)
            continue
        fits = [np.polyfit(travel[side] - travel[k], force_N[side], 1) for side in sides]
        slopes = [float(fit[0]) for fit in fits]
        errors = [sd * np.sqrt(12 / LOCAL) / span for span in moved]
        same = abs(slopes[1] - slopes[0]) <= SAME_SLOPE * abs(slopes[0]) + 3 * float(np.hypot(*errors))
        moves = abs(slopes[0]) > 5 * errors[0]
        zeroed.append(bool(same and moves and abs(force_N[k + 1]) <= 4 * sd))
    return np.array(zeroed, dtype=bool)


def _step_of(time_s: Values, values: Values, k: int) -> float:
    """The step between rows k and k + 1 beyond the course: lines through the rows on both sides."""
    middle = (time_s[k] + time_s[k + 1]) / 2
    ends = []
    for side in (slice(max(k + 1 - NEIGHBOURS, 0), k + 1), slice(k + 1, k + 1 + NEIGHBOURS)):
        time = time_s[side] - middle
        ends.append(float(np.polyval(np.polyfit(time, values[side], 1), 0.0)))
    return ends[1] - ends[0]
