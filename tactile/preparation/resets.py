"""Steps that a zeroed display or load cell makes in one quantity, distinguished from the specimen's own."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from tactile.noise import noise_sd
from tactile.preparation.rows import Values

NEIGHBOURS = 5
"""Steps on each side of a reset to which its own is compared, and rows of a level."""
ABOVE_NOISE, ABOVE_SPREAD = 8.0, 3.0
"""A reset exceeds this multiple of the noise's standard deviation and of the spread of the steps near it."""
CLEAR, STAYS = 6.0, 3
"""Standard deviations, and rows, by which the force leaves its no-contact level."""
AGREES, NONE_LEFT = 0.15, 0.3
"""Shares of the step: within the first the shift in air equals the step, below the second there is no
shift."""
LOCAL = 10
"""Rows on each side over which a slope is fitted."""
SAME_SLOPE = 0.2
"""Share by which the slopes dF/ds before and after a reset may differ."""
MOST, MOST_RESETS, UNUSUAL = 5, 2, 3.0
"""Most steps of a force that is not serrated; most steps of the travel of a machine that does not move in
steps, and multiples of their median that a reset exceeds."""


@dataclass(frozen=True, kw_only=True)
class Reset:
    """`row`: the first one after the step of `quantity` (force or travel); `step`: the step's size."""

    quantity: str
    row: int
    step: float


class Ambiguous(Exception):
    """A step of the force that may be a reset or the specimen's: the first row after it, its size, and the
    shift of the force in air (N; None: no frames in air follow).
    """

    def __init__(self, row: int, step_N: float, shift_N: float | None) -> None:
        super().__init__(row, step_N, shift_N)
        self.row, self.step_N, self.shift_N = row, step_N, shift_N


def resets(time_s: Values, travel: Values, force_N: Values) -> list[Reset]:
    """Resets of the travel and of the force, in this order.

    Raises Ambiguous if frames in air show only part of a step of the force, or do not follow it.
    """
    if len(time_s) < 4 * NEIGHBOURS:
        return []
    of_travel, of_force = _impulses(time_s, travel), _impulses(time_s, force_N)
    size = np.abs(np.diff(travel)[of_travel])
    usual = np.median(size) if len(size) > MOST_RESETS else 0.0
    alone = np.setdiff1d(of_travel[size > UNUSUAL * usual], of_force)
    travel_resets = _of_travel(time_s, travel, force_N, alone)
    scaled = travel.copy()
    for reset in travel_resets:
        scaled[reset.row :] -= reset.step
    steps = np.setdiff1d(of_force, of_travel)
    return [*travel_resets, *(_of_force(time_s, scaled, force_N, steps) if 0 < len(steps) <= MOST else [])]


def _impulses(time_s: Values, values: Values) -> Int[np.ndarray, " k"]:
    """Rows after which the value jumps in one step that the steps before and after it do not explain.

    A change of speed has different steps on its two sides, none beyond both. A break in the recording is as
    long as its step, and a clock that jitters has even steps by row.
    """
    step, sd = np.diff(time_s), noise_sd(values)
    beyond = np.ones(len(step), dtype=bool)
    for length in (np.ones(len(step)), np.maximum(step / float(np.median(step)), 0.2)):
        rate = np.pad(np.diff(values) / length, NEIGHBOURS, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(rate, 2 * NEIGHBOURS + 1)
        near = np.delete(windows, NEIGHBOURS, axis=1)
        low, high, middle = near.min(axis=1), near.max(axis=1), windows[:, NEIGHBOURS]
        off = np.maximum(np.maximum(middle - high, low - middle), 0.0)
        beyond &= off * length > np.maximum(ABOVE_NOISE * sd, ABOVE_SPREAD * (high - low) * length)
    peaks = np.flatnonzero(beyond)
    return peaks[(peaks >= 2) & (peaks <= len(step) - 3)]


def _touch_and_levels(travel: Values, force_N: Values) -> tuple[int, float | None, float | None]:
    """The first row in contact, and no-contact levels of the force before the touch and after the release
    (None: not recorded).
    """
    sd = noise_sd(force_N)
    clear = np.abs(force_N - float(np.median(force_N[:NEIGHBOURS]))) > CLEAR * sd
    stays = np.flatnonzero(np.convolve(clear, np.ones(STAYS), "valid") == STAYS)
    touch = int(stays[0]) if len(stays) else len(force_N)
    before = float(np.median(force_N[: max(touch - 1, 1)])) if touch >= NEIGHBOURS else None
    if touch in (0, len(force_N)):
        return touch, before, None
    forward = _direction(travel, touch)
    behind = forward * travel < forward * travel[touch]
    tail = force_N[len(behind) - int(np.argmin(np.r_[behind[::-1], False])) :]
    return touch, before, float(np.median(tail)) if len(tail) >= STAYS else None


def _direction(travel: Values, touch: int) -> float:
    """1 if the travel grows towards the touch, -1 if it falls (a gap), by the signs of its steps."""
    return 1.0 if np.sign(np.diff(travel))[: touch + NEIGHBOURS].sum() >= 0 else -1.0


def _of_travel(time_s: Values, travel: Values, force_N: Values, steps: Int[np.ndarray, " k"]) -> list[Reset]:
    """Resets of the travel: steps while the force continues. In air a jump that approaches before the touch,
    or retreats after the release, is the machine's.
    """
    if not len(steps):
        return []
    sd, (touch, before, _) = noise_sd(force_N), _touch_and_levels(travel, force_N)
    forward = _direction(travel, touch)
    level = float(np.median(force_N[:NEIGHBOURS])) if before is None else before
    travel_resets = []
    for k in steps.tolist():
        step = _step_of(time_s, travel, k)
        if (np.abs(force_N[max(k - 2, 0) : k + 4] - level) < CLEAR * sd).all():
            is_reset = (forward * step > 0) != (k < touch)
        else:  # a motion by this step would have changed the force
            slopes = [abs(slope) for slope, _ in _slopes(travel, force_N, k, sd)]
            is_reset = max(slopes, default=0.0) * abs(step) > CLEAR * sd
        if is_reset:
            travel_resets.append(Reset(quantity="travel", row=k + 1, step=step))
    return travel_resets


def _of_force(time_s: Values, travel: Values, force_N: Values, steps: Int[np.ndarray, " k"]) -> list[Reset]:
    """Resets of the force: steps that frames in air show afterwards.

    Raises Ambiguous if these show only part of a step, or if none follow a step to zero with an unchanged
    slope.
    """
    sd, (_, known_before, after) = noise_sd(force_N), _touch_and_levels(travel, force_N)
    sizes = np.array([_step_of(time_s, force_N, k) for k in steps.tolist()])
    zeroed = np.array([_is_zeroed(travel, force_N, k, sd) for k in steps.tolist()])
    if after is None:
        if zeroed.any():
            k = int(np.argmax(zeroed))
            raise Ambiguous(int(steps[k]) + 1, float(sizes[k]), None)
        return []
    shift = after - (known_before or 0.0)
    if abs(shift) <= max(CLEAR * sd, NONE_LEFT * float(np.abs(sizes).max())):
        return []
    for chosen in (np.ones(len(steps), dtype=bool), zeroed, *np.eye(len(steps), dtype=bool)):
        total = float(sizes[chosen].sum())
        if chosen.any() and abs(shift - total) <= max(CLEAR * sd, AGREES * abs(total)):
            rest = 0.0 if known_before is None else (shift - total) / np.abs(sizes[chosen]).sum()
            return [
                Reset(quantity="force", row=int(k) + 1, step=float(size + rest * abs(size)))
                for k, size in zip(steps[chosen], sizes[chosen], strict=True)
            ]
    raise Ambiguous(int(steps[0]) + 1, float(sizes[0]), shift)


def _slopes(travel: Values, force_N: Values, k: int, sd: float) -> list[tuple[float, float]]:
    """dF/ds on those sides of row k on which the travel changes, each with its standard deviation."""
    sides = [slice(max(k + 1 - LOCAL, 0), k + 1), slice(k + 1, k + 1 + LOCAL)]
    return [
        (float(np.polyfit(travel[side], force_N[side], 1)[0]), sd * (12 / LOCAL) ** 0.5 / float(span))
        for side in sides
        if (span := np.ptp(travel[side])) > 0
    ]


def _is_zeroed(travel: Values, force_N: Values, k: int, sd: float) -> bool:
    """Whether the step leads to a force of zero, and the slope over travel is the same before and after
    it."""
    slopes = _slopes(travel, force_N, k, sd)
    if len(slopes) < 2:
        return False
    (before, before_sd), (behind, behind_sd) = slopes
    same = abs(behind - before) <= SAME_SLOPE * abs(before) + 3 * np.hypot(before_sd, behind_sd)
    return bool(same and abs(before) > 5 * before_sd and abs(force_N[k + 1]) <= 4 * sd)


def _step_of(time_s: Values, values: Values, k: int) -> float:
    """The step between rows k and k + 1: the offset between lines through the rows on both sides."""
    middle = (time_s[k] + time_s[k + 1]) / 2
    before, behind = (
        np.polyfit(time_s[side] - middle, values[side], 1)[1]
        for side in (slice(max(k + 1 - NEIGHBOURS, 0), k + 1), slice(k + 1, k + 1 + NEIGHBOURS))
    )
    return float(behind - before)
