"""Sound presses that look like what a logger does."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from drawn_traces import Press, course, press


def relaxing(rng: np.random.Generator) -> Press:
    """Hold with relaxation."""
    time, travel, corners = course(rng)
    late = np.clip((time - corners[2]) / max(corners[-1] - corners[2], 1e-9), 0, None)
    return press(rng, time=time, travel=travel, change=lambda f: f * (0.6 + 0.4 * np.exp(-6 * late)))


def ruptured(rng: np.random.Generator) -> Press:
    """Flesh breaks within one to four rows; then it is softer; the air reads zero. Some never unload."""
    time, travel, _ = course(rng, unload=rng.random() < 0.7)

    def broken(force):
        k = int(np.argmax(force > rng.uniform(0.3, 0.9) * force.max()))
        wide = int(rng.integers(1, 5))
        factor = np.interp(np.arange(len(force)), [k, k + wide], [1.0, rng.uniform(0.1, 0.7)])
        return force * factor

    return press(rng, time=time, travel=travel, change=broken)


def released(rng: np.random.Generator) -> Press:
    """Sudden release: the travel falls back within one to five rows, and the force with it; then air."""
    time, travel, _ = course(rng, unload=False)
    step, wide = np.median(np.diff(time)), int(rng.integers(1, 6))
    time = np.r_[time, time[-1] + step * np.arange(1, 60)]
    travel = np.r_[travel, np.interp(np.arange(1, 60), [0, wide], [travel[-1], 0.0])]
    return press(rng, time=time, travel=travel)


def cyclic(rng: np.random.Generator) -> Press:
    """Several cycles on one clock."""
    time, travel, _ = course(rng)
    count, n = int(rng.integers(2, 5)), len(time)
    step = np.median(np.diff(time))
    return press(rng, time=step * np.arange(count * n), travel=np.tile(travel, count))


def serrated(rng: np.random.Generator) -> Press:
    """Stick and slip: teeth that rise slowly and fall within a row."""
    time, travel, _ = course(rng)

    def teeth(force):
        period = rng.integers(4, 40)
        tooth = (np.arange(len(force)) % period) / period
        return force * (1 - rng.uniform(0.05, 0.3) * tooth)

    return press(rng, time=time, travel=travel, change=teeth)


def quantised(rng: np.random.Generator) -> Press:
    """A display of few digits, of the travel or the force."""
    p = press(rng)
    if rng.random() < 0.5:
        step = float(rng.choice([0.01, 0.02, 0.05]))
        return replace(p, travel_mm=np.round(p.travel_mm / step) * step)
    step = 10 ** np.floor(np.log10(p.tell["peak"]) - 2) * float(rng.choice([1, 2, 5]))
    return replace(p, force_N=np.round(p.force_N / step) * step)


def backlash(rng: np.random.Generator) -> Press:
    """The travel turns before the tip does."""
    time, travel, _ = course(rng)
    slack = 0.05 * travel.max()
    tip = travel.copy()
    for k in range(1, len(tip)):
        tip[k] = min(max(tip[k - 1], travel[k] - slack), travel[k] + 0.0)
    p = press(rng, time=time, travel=tip)
    return replace(p, travel_mm=travel)


def stepwise(rng: np.random.Generator) -> Press:
    """A machine that moves in steps and waits after each; the flesh relaxes a little."""
    each, steps = int(rng.integers(6, 30)), int(rng.integers(15, 40))
    size = rng.uniform(0.03, 0.1)
    rows = np.arange(each * 2 * steps)
    stairs = np.minimum(rows // each, 2 * steps - 1 - rows // each)
    late = np.exp(-(rows % each) / 4)
    return press(rng, time=0.02 * rows, travel=size * stairs, change=lambda f: f * (0.95 + 0.05 * late))


def quick(rng: np.random.Generator) -> Press:
    """A fast approach, then slow; few rows; jitter of the clock."""
    time, travel, _ = course(rng)
    touch = 0.15 * travel.max()
    k = int(np.argmax(travel > 0.8 * touch))
    keep = np.r_[np.arange(0, k, 8), np.arange(k, len(time))]
    time = np.arange(len(keep)) * np.median(np.diff(time))
    time = time + rng.uniform(-0.3, 0.3, len(time)) * np.median(np.diff(time))
    return press(rng, time=np.sort(time), travel=travel[keep])


def in_contact(rng: np.random.Generator) -> Press:
    """Begins in contact, or ends pressed."""
    p = press(rng, unload=rng.random() < 0.5)
    k = int(np.argmax(p.travel_mm > p.tell["onset"] + 0.1)) if rng.random() < 0.5 else 0
    return replace(p, time_s=p.time_s[k:], travel_mm=p.travel_mm[k:], force_N=p.force_N[k:])


def standing(rng: np.random.Generator) -> Press:
    """A slow ramp, a hold and a fast return onto a standing machine; a coarse display and quiet air."""
    rate, back = float(rng.choice([10, 20, 50, 100])), float(rng.choice([5, 10, 20, 40]))
    deep, waits = rng.uniform(1.5, 3.5), rng.choice([0.0, 2.0])
    corners = np.cumsum([0, rng.choice([0.0, 1.0]), deep / rng.uniform(0.3, 0.6), waits, deep / back, 3.0])
    time = np.arange(0, corners[-1], 1 / rate)
    end = rng.choice([0.0, 0.0, -1.0])
    travel = np.interp(time, corners, [0, 0, deep, deep, end, end])
    p = press(rng, time=time, travel=travel)
    display = p.tell["peak"] / rng.uniform(40, 160)
    clear = np.where(travel > p.tell["onset"], p.force_N, 0.0)
    force = np.round(clear / display) * display
    start = rng.choice([0.0, 0.0, 20.0])
    return replace(p, travel_mm=np.round(travel, 3) + start, force_N=np.maximum(force, 0.0))


def stepped(rng: np.random.Generator) -> Press:
    """A sensor that shows zero in the air stands there; one step, and relaxation; at times a step back."""
    still, rows = int(rng.integers(8, 60)), int(rng.integers(150, 500))
    late = np.arange(rows) - still
    pressed = (late >= 0) & (late < rows - still - rng.choice([0, 40]))
    peak = rng.uniform(2, 20)
    force = peak * (0.5 + 0.5 * np.exp(-late / rng.uniform(20, 80)))
    force += 1e-3 * peak * rng.standard_normal(rows)
    return Press(
        time_s=np.arange(rows) / float(rng.choice([10, 30, 100])),
        travel_mm=np.where(pressed, rng.uniform(1, 3), 0.0),
        force_N=np.where(pressed, force, 0.0),
        tell={"peak": peak},
    )


def tapped(rng: np.random.Generator) -> Press:
    """Two taps of one to three rows before the press: travel and force leave and come back at once."""
    time, travel, _ = course(rng)
    wait = np.median(np.diff(time)) * 60
    time, travel = np.r_[np.linspace(0, wait, 60, endpoint=False), time + wait], np.r_[np.zeros(60), travel]
    for k in rng.choice([10, 20, 30, 40], size=2, replace=False):
        wide = int(rng.integers(1, 4))
        travel[k : k + wide] = travel.max() * rng.uniform(0.6, 0.9, wide)
    p = press(rng, time=time, travel=travel)
    return replace(p, travel_mm=travel)


def cracked(rng: np.random.Generator) -> Press:
    """Crisp flesh: cracks of one or two rows unload it in part, and it is loaded again."""
    time, travel, _ = course(rng)

    def cracks(force):
        loaded = np.flatnonzero((force > 0.2 * force.max()) & (np.gradient(travel) > 0))
        for k in loaded[:: max(len(loaded) // 10, 4)][1:]:
            wide = int(rng.integers(1, 3))
            force[k : k + wide] *= 1 - rng.uniform(0.1, 0.6)
        return force

    return press(rng, time=time, travel=travel, change=cracks)


SOUND: dict[str, Callable[[np.random.Generator], Press]] = {
    "plain": press, "relaxing": relaxing, "ruptured": ruptured, "released": released, "cyclic": cyclic,
    "serrated": serrated, "quantised": quantised, "backlash": backlash, "stepwise": stepwise, "quick": quick,
    "in contact": in_contact, "standing": standing, "stepped": stepped, "tapped": tapped, "cracked": cracked,
}  # fmt: skip
