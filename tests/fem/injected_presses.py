"""Presses of a ball with a hidden effect: curves from finite elements, memory by Ting's own integrals.

Nothing of fem is used: no springs, no recursion, no Hertz. The curves (compressed_solid.py) are those of
a ball of 5 mm on a slab of 15 mm, for E = 1 MPa.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

RADIUS_MM, THICK_MM, NU, DEEPEST_MM = 5.0, 15.0, 0.45, 2.0
CURVES = Path(__file__).parents[1] / "data" / "pressed-slab.csv"


def curve(law):
    """Depths and forces of one law's press, in and out again."""
    with CURVES.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["law"] == law]
    return np.array([[float(row["depth_mm"]), float(row["force_N"])] for row in rows]).T


def loading(law):
    """Force per MPa over depth as a function, smooth and right at first touch."""
    depth, force = curve(law)
    turn = int(np.argmax(depth)) + 1
    depth, force = depth[:turn], force[:turn]
    over = force / depth**1.5
    spline = CubicSpline(np.r_[0, np.sqrt(depth[2:])], np.r_[4 / 3 / (1 - NU**2) * RADIUS_MM**0.5, over[2:]])
    return lambda d: np.maximum(d, 0) ** 1.5 * spline(np.sqrt(np.maximum(d, 0)))


def unloading(law):
    depth, force = curve(law)
    turn = int(np.argmax(depth))
    return lambda d: np.interp(d, np.r_[0, depth[turn:][::-1]], np.r_[0, force[turn:][::-1]])


def ting_force(time_s, depth_at, phi, g, tau_s, *, steps=3000):
    """Ting's force for one press in and out: quadrature of his two integrals on a fine grid.

    F(t) = int_0^{t1} R(t - s) d phi(d(s)); t1 = t while contact grows, later int_{t1}^t R(t - s) dd(s) = 0.
    """
    fine = np.linspace(time_s[0], time_s[-1], steps)
    depth = np.maximum(depth_at(fine), 0)
    middle = (fine[1:] + fine[:-1]) / 2
    age = time_s[:, None] - middle
    R = 1 - sum(g) + sum(gi * np.exp(-np.maximum(age, 0) / ti) for gi, ti in zip(g, tau_s, strict=True))
    R = np.where(age > 0, R, 0)
    top = fine[int(np.argmax(depth >= depth.max() - 1e-12))]
    went = np.cumsum(R * np.diff(depth_at(fine)), axis=1)
    force = np.cumsum(R * np.diff(phi(depth)), axis=1)
    inside = fine[1:] <= top
    out = np.empty(len(time_s))
    for i, t in enumerate(time_s):
        left = went[i, -1] - went[i, inside]
        if t <= top or left[-1] >= 0:
            out[i] = force[i, -1]
        else:
            touched = depth[1:][inside] > 0
            still = np.flatnonzero((left >= 0) & touched)
            if not len(still):
                out[i] = 0.0
                continue
            k = still[-1]
            part = left[k] / (left[k] - left[k + 1]) if k + 1 < len(left) else 0.0
            out[i] = force[i, k] + part * (force[i, min(k + 1, len(left) - 1)] - force[i, k])
    return out


@dataclass(frozen=True)
class Press:
    """When and how fast; all in s and mm. `onset_mm`: travel before the touch."""

    air_s: float = 3.0
    ramp_s: float = 4.0
    hold_s: float = 15.0
    after_s: float = 4.0
    unload: bool = True
    onset_mm: float = 0.2
    rate_hz: float = 10.0

    @property
    def time_s(self):
        end = self.air_s + self.ramp_s + self.hold_s + (self.ramp_s + self.after_s if self.unload else 0)
        return np.arange(int(end * self.rate_hz)) / self.rate_hz

    def travel(self, t):
        corner = np.cumsum([self.air_s, self.ramp_s, self.hold_s, self.ramp_s])
        full = DEEPEST_MM + self.onset_mm
        return np.interp(t, corner, [0, full, full, 0 if self.unload else full])

    def depth(self, t):
        return self.travel(t) - self.onset_mm


def injected(
    rng,
    *,
    E_MPa=0.3,
    noise_N=0.004,
    fade=0.0,
    press=None,
    law="linear",
    g=(),
    tau_s=(),
    mm_per_N=0.0,
    newton_per_s=0.0,
    zero_N=0.02,
    puncture=0.0,
):
    """time_s, force_N, travel_mm of a press, noise white or (fade) with a memory of a frame or so."""
    press = press or Press()
    time = press.time_s
    if g:
        force = E_MPa * ting_force(time, press.depth, loading(law), g, tau_s)
    else:
        back = time > press.air_s + press.ramp_s + press.hold_s / 2
        depth = np.maximum(press.depth(time), 0)
        force = E_MPa * np.where(back, unloading(law)(depth), loading(law)(depth))
    if puncture:
        depth = press.depth(time)
        broken = np.maximum.accumulate(depth) > 1.2
        force = force * (1 - puncture * broken * (1 + 0.5 * np.sin(6 * np.maximum(depth, 0))))
    noise = rng.standard_normal(len(time))
    for i in range(1, len(noise)):
        noise[i] = fade * noise[i - 1] + np.sqrt(1 - fade**2) * noise[i]
    recorded = force + zero_N + newton_per_s * time + noise_N * noise
    return time, recorded, press.travel(time) + mm_per_N * force
