"""Presses as loggers write them: sound ones of many kinds, and what a logger can do to one."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press as a table: columns of numbers, how they are written, and the law's exponent."""

    time_s: np.ndarray
    travel_mm: np.ndarray
    force_N: np.ndarray
    exponent: float = 1.5
    gap: bool = False
    names: tuple[str, str, str] = ("time_s", "travel_mm", "force_N")
    empty: str = ""
    decimals: int = 5
    breaks: tuple[int, ...] = ()
    tell: dict = field(default_factory=dict)

    def write(self, path: Path) -> None:
        """The table, its header again before each row of `breaks`."""
        lines = [",".join(self.names)]
        for k, row in enumerate(zip(self.time_s, self.travel_mm, self.force_N, strict=True)):
            if k in self.breaks:
                lines.append(lines[0])
            lines.append(",".join(self.empty if np.isnan(v) else f"{v:.{self.decimals}f}" for v in row))
        path.write_text("\n".join(lines) + "\n")


def course(rng: np.random.Generator, *, hold: bool = True, unload: bool = True, rate: float | None = None):
    """Time and travel of ramps: in, hold, out; and where the phases change."""
    deep, speed = rng.uniform(1.0, 3.0), rng.uniform(0.1, 0.8)
    back = speed * rng.choice([1.0, 1.0, rng.uniform(0.5, 2.0)])
    rate = rate or rng.uniform(120, 1100) / (deep / speed + deep / back)
    waits = rng.choice([0.0, rng.uniform(0.5, 3.0)]) if hold else 0.0
    lead = rng.choice([0.0, rng.uniform(0.2, 1.0)])
    corners = np.cumsum([0.0, lead, deep / speed, waits, deep / back if unload else 0.0])
    time = np.arange(0, corners[-1] + 1e-9, 1 / rate)
    travel = np.interp(time, corners, [0, 0, deep, deep, 0.0 if unload else deep])
    return time, travel, corners


def press(rng: np.random.Generator, *, travel=None, time=None, change=None, **options) -> Press:
    """A press of an elastic specimen, with noise; `change(force)` may alter the specimen."""
    if travel is None:
        time, travel, _ = course(rng, **options)
    exponent = float(rng.choice([1.5, 1.5, 1.0, 1.3]))
    onset = rng.uniform(0.15, 0.45) * travel.max()
    depth = np.maximum(travel - onset, 0.0)
    peak = 10 ** rng.uniform(0.3, 1.7)
    force = peak * (depth / depth.max()) ** exponent
    if change is not None:
        force = change(force)
    white = rng.standard_normal(len(time) + 20)
    colour = rng.choice([0.0, 0.6])
    noise = white.copy()
    for k in range(1, len(noise)):
        noise[k] = colour * noise[k - 1] + white[k]
    sd = peak * 10 ** rng.uniform(-3.3, -2.3)
    force = force + sd * noise[20:] * np.sqrt(1 - colour**2)
    return Press(
        time_s=time,
        travel_mm=travel + rng.choice([0.0, 2e-4]) * rng.standard_normal(len(time)),
        force_N=force,
        exponent=exponent,
        tell={"peak": peak, "onset": onset, "sd": sd},
    )


# --- faults: each gives the press as the logger wrote it, and the words of the note


def reserved(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Rows at one end or both that were allocated and never written."""
    offset_mm, offset_N = rng.choice([0.0, rng.uniform(5, 60)]), rng.choice([0.05, 0.3]) * p.tell["peak"]
    fill = float(rng.choice([0.0, -999.0, np.nan, 65535.0]))
    if fill == 0.0:
        offset_mm += 4.0
    step = np.median(np.diff(p.time_s))
    parts = []
    for end in (0, 1):
        rows = int(rng.integers(3, 150)) if rng.random() < 0.6 or (end and not parts[0]) else 0
        parts.append(rows)
    a, b = parts
    stamp = rng.choice(["runs", "fill"])
    time = np.r_[np.arange(a) * step, p.time_s + a * step, p.time_s[-1] + (a + 1 + np.arange(b)) * step]
    if stamp == "fill":
        time[:a], time[len(time) - b :] = 0.0, 0.0
    blocks = [np.full(a, fill), np.full(b, fill)]
    out = replace(
        p,
        time_s=time,
        travel_mm=np.r_[blocks[0], p.travel_mm + offset_mm, blocks[1]],
        force_N=np.r_[blocks[0], p.force_N + offset_N, blocks[1]],
        empty=str(rng.choice(["", "NaN"])),
    )
    return out, r"rows? at the (start|end).*left out"


def wild(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Single wild readings, or two in a row, of force, travel or both; up to 1.5 % of the rows."""
    force, travel = p.force_N.copy(), p.travel_mm.copy()
    n = len(force)
    for _ in range(int(rng.integers(1, max(2, min(6, n // 150)) + 1))):
        k = int(rng.integers(3, n - 4))
        wide = int(rng.choice([1, 1, 2]))
        which = rng.choice(["force", "force", "travel"])
        for j in range(wide):
            if which == "force":
                force[k + j] = rng.choice([-1, 1]) * p.tell["peak"] * 10 ** rng.uniform(0.3, 2)
            else:
                travel[k + j] = rng.choice([-55.0, -999.0, 1000.0, 6553.5])
    return replace(p, force_N=force, travel_mm=travel), "wild reading"


def stale(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Travel (or force) read slowly and repeated."""
    each = rng.uniform(3, max(len(p.time_s) / 60, 4))
    first = np.floor(np.arange(len(p.time_s)) / each + rng.choice([0.0, rng.random()]))
    at = np.searchsorted(first, np.unique(first))
    held = at[np.searchsorted(np.unique(first), first)]
    if rng.random() < 0.7:
        return replace(p, travel_mm=p.travel_mm[held]), "travel was read"
    return replace(p, force_N=p.force_N[held]), "force was read"


def even_press(rng: np.random.Generator) -> Press:
    """A press whose ramps and hold are whole periods of a slow reading: all its steps are equal."""
    each, readings = int(rng.integers(4, 30)), int(rng.integers(25, 60))
    step = float(rng.choice([0.05, 0.02, 0.1, 0.0625, 0.0333]))
    wait, back = int(rng.choice([0, rng.integers(2, 12)])), readings
    at = each * np.cumsum([0, readings, wait, back])
    rows = np.arange(at[-1] + 1)
    travel = np.interp(rows, at, np.array([0, 1, 1, 0]) * readings * step)
    return replace(
        press(rng, time=rows * 0.2 / each, travel=travel),
        travel_mm=travel,
        tell={"each": each, "sd": 0, "peak": 1},
    )


def stale_even(p: Press, _: np.random.Generator) -> tuple[Press, str]:
    """A slow reading, of equal steps as a display's."""
    each = p.tell["each"]
    return replace(p, travel_mm=p.travel_mm[np.arange(len(p.travel_mm)) // each * each]), "travel was read"


def topics(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Two topics of two rates in one table, in the order of time or one below the other."""
    ratio = rng.choice([rng.uniform(0.08, 0.6), rng.uniform(1.2, 5)])
    count = max(int(ratio * len(p.time_s)), 40)
    shift = rng.uniform(0, 1) * np.ptp(p.time_s) / count
    times = np.linspace(0, p.time_s[-1] - shift, count) + shift
    travel = np.interp(times, p.time_s, p.travel_mm)
    time = np.r_[p.time_s, times]
    order = np.argsort(time, kind="stable") if rng.random() < 0.8 else np.arange(len(time))
    gap = rng.random() < 0.5
    return replace(
        p,
        time_s=time[order],
        force_N=np.r_[p.force_N, np.full(count, np.nan)][order],
        travel_mm=np.r_[np.full(len(p.time_s), np.nan), 70 - travel if gap else travel][order],
        names=("time_s", "gap_mm" if gap else "travel_mm", "force_N"),
        gap=gap,
    ), "two topics"


def zeroed(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """The travel's display zeroed (or set) at a preload."""
    force = p.force_N - np.median(p.force_N[:5])
    level = rng.uniform(0.01, 0.6) * p.tell["peak"]
    k = int(np.argmax(force > max(level, 4 * p.tell["sd"]))) + 1
    travel = p.travel_mm.copy()
    travel[k:] -= travel[k] + rng.choice([0.0, 0.0, rng.uniform(-20, 20)])
    return replace(p, travel_mm=travel), "travel was zeroed"


def tared(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """The load cell zeroed under load, while loading, holding or unloading."""
    force = p.force_N + rng.choice([0.0, rng.uniform(-1, 1)]) * p.tell["peak"]
    rel = p.force_N - np.median(p.force_N[:5])
    good = np.flatnonzero(rel > rng.uniform(0.1, 0.7) * p.tell["peak"])
    k = int(good[0] if rng.random() < 0.5 else good[int(len(good) * rng.uniform(0.4, 0.98))])
    if np.abs(force[k]) < 0.1 * p.tell["peak"]:
        force = p.force_N.copy()
    force = force.copy()
    force[k:] -= force[k]
    return replace(p, force_N=force), "zeroed under load"


def missing(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Empty or NaN cells here and there."""
    force, travel = p.force_N.copy(), p.travel_mm.copy()
    for k in rng.choice(np.arange(2, len(force) - 2), size=max(1, int(0.005 * len(force))), replace=False):
        (force if rng.random() < 0.5 else travel)[k] = np.nan
    return replace(
        p, force_N=force, travel_mm=travel, empty=str(rng.choice(["", "NaN", "nan"]))
    ), "empty cell"


def several(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Two or three faults in one file."""
    chosen = rng.choice(["stale", "tared", "zeroed", "missing"], size=2, replace=False).tolist()
    if {"stale", "tared"} <= set(chosen) or {"stale", "zeroed"} <= set(chosen):
        chosen = ["stale", "missing"]
    words = []
    for name in [fault for fault in ("tared", "zeroed", "stale", "missing") if fault in chosen]:
        p, said = FAULTS[name](p, rng)
        words.append(said)
    if rng.random() < 0.5:
        p, said = wild(p, rng)
        words.append(said)
    if "stale" not in chosen or rng.random() < 0.5:
        p, said = reserved(p, rng)
        words.append(said)
    return p, "".join(f"(?=.*{word})" for word in words)


def several_topics(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Two topics of two rates, the force zeroed under load, maybe with reserved rows."""
    p, tared_said = tared(p, rng)
    p, topics_said = topics(p, rng)
    words = [tared_said, topics_said]
    if rng.random() < 0.5 and (np.diff(p.time_s) >= 0).all():
        p, reserved_said = reserved(p, rng)
        words.append(reserved_said)
    return p, "".join(f"(?=.*{word})" for word in words)


def runs(p: Press, rng: np.random.Generator) -> tuple[Press, str]:
    """Two to five runs one below the other."""
    count = int(rng.integers(2, 6))
    n = len(p.time_s)
    start = float(rng.choice([0.0, 5.0]))
    header = rng.random() < 0.4
    force = [p.force_N + 0.5 * p.tell["sd"] * rng.standard_normal(n) for _ in range(count)]
    return replace(
        p,
        time_s=np.tile(p.time_s + start, count),
        travel_mm=np.tile(p.travel_mm, count),
        force_N=np.concatenate(force),
        breaks=tuple(n * k for k in range(1, count)) if header else (),
    ), f"REFUSED.*{('two', 'three', 'four', 'five')[count - 2]} runs"


FAULTS: dict[str, Callable[[Press, np.random.Generator], tuple[Press, str]]] = {
    "reserved": reserved, "wild": wild, "stale": stale, "stale even": stale_even, "topics": topics,
    "zeroed": zeroed, "tared": tared, "missing": missing, "several": several,
    "several topics": several_topics, "runs": runs,
}  # fmt: skip
