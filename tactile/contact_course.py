"""The course of a contact: in every frame, of every pad, its force, its patch, and how much of it sticks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import Delaunay

from tactile.contact import Contact

BEYOND_NOISE = 4.0
"""Standard deviations of a marker's noise: one in 15,000 by chance."""
LAGS_BEHIND = 0.3
"""A marker slips when it misses the body's motion by more than this share of it (and than noise)."""
FEWEST = 4
"""Markers from which the motion of a body (three numbers) is taken: two tell it, two more judge it."""
SAMPLES = 24
"""Of RANSAC: where half of the markers stick, one draw of four in 16 is clean, and 24 miss it with
probability 21 %; the rounds after mend it."""
ROUNDS = 2
"""Of the body's motion and the markers that follow it. Set by hand."""
LAG_FRAMES = 3
"""Motion is compared over so many frames: one alone is lost in the noise of slow grasps."""
SCATTER_MM = 0.005
"""Single markers of a real gel (Tac3D) scatter by 2 to 20 µm from frame to frame, half of them by less
than 1 µm."""


def patch_area_mm2(rest_mm: Float[np.ndarray, "n 3"], touching: Bool[np.ndarray, " n"]) -> float:
    """Area of the patch that these markers tell: each edge from a touching marker to another is cut in half.

    A triangle of neighbouring markers then belongs to the patch wholly, by three quarters (two corners
    touch), by one quarter (one does), or not. The rim is known to half a spacing, without a bias: what counts
    the places between two markers as in or out is chance. `rest_mm` must not lie on a line.
    """
    plane = rest_mm[:, :2]
    triangles = Delaunay(plane).simplices
    corners, inside = plane[triangles], touching[triangles]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    whole = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    count = inside.sum(axis=1)
    return float((whole * np.array([0.0, 0.25, 0.75, 1.0])[count]).sum())


def stick_ratio(
    position: Float[np.ndarray, "t n d"], touching: Bool[np.ndarray, "t n"], *, noise: float, lag: int
) -> Float[np.ndarray, " t"]:
    """Share of the touching markers that moved, over the last `lag` frames, as the rigid body that most of
    them follow; 0 where none touch.

    Positions may be in the plane or in space, px or mm; `noise` is one coordinate's standard deviation in one
    frame. The body's motion is fitted to the markers that touch throughout and reweighted until outliers
    carry none of it (Cauchy's weights). What the gel cannot see it does not tell: a fruit that slides past
    all markers at the same time looks like one at rest. A marker that has touched for less than `lag` frames
    counts as sticking; a frame where fewer than four can be compared has all its touching markers stick.
    """
    frames = len(touching)
    sticks = touching.copy()
    seen = np.isfinite(position).all(axis=2)
    for t in range(lag, frames):
        both = touching[t] & touching[t - lag] & seen[t] & seen[t - lag]
        if both.sum() < FEWEST:
            continue
        before, after = position[t - lag, both], position[t, both]
        carried = _carried(before, after, noise=noise)
        follows = _within(before, after, carried, BEYOND_NOISE * noise * np.sqrt(2.0))
        sticks[t, np.flatnonzero(both)[~follows]] = False
    touched = touching.sum(axis=1)
    return np.asarray(sticks.sum(axis=1) / np.maximum(touched, 1))


def _carried(
    before: Float[np.ndarray, "n d"], after: Float[np.ndarray, "n d"], *, noise: float
) -> Float[np.ndarray, "n d"]:
    """`before` under the rigid motion that most markers follow: of a few markers' the one most agree
    with, fitted again to those.
    """
    rng = np.random.default_rng(len(before))
    least = BEYOND_NOISE * noise * np.sqrt(2.0)
    best, votes = before, -1
    for _ in range(SAMPLES):
        some = rng.choice(len(before), size=FEWEST, replace=False)
        carried = _rigid(before[some], after[some], before)
        within = _within(before, after, carried, least)
        for _ in range(ROUNDS):
            if within.sum() < FEWEST:
                break
            carried = _rigid(before[within], after[within], before)
            within = _within(before, after, carried, least)
        if within.sum() > votes:
            best, votes = carried, int(within.sum())
    return best


def _within(
    before: Float[np.ndarray, "n d"],
    after: Float[np.ndarray, "n d"],
    carried: Float[np.ndarray, "n d"],
    least: float,
) -> Bool[np.ndarray, " n"]:
    """Which markers arrive where the body's motion carries them."""
    moved = float(np.median(np.linalg.norm(carried - before, axis=1)))
    return np.asarray(np.linalg.norm(after - carried, axis=1) <= max(least, LAGS_BEHIND * moved))


def _rigid(
    before: Float[np.ndarray, "m d"], after: Float[np.ndarray, "m d"], points: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "n d"]:
    """`points` under the rotation and shift that take `before` to `after` best (Kabsch 1976)."""
    a, b = before.mean(axis=0), after.mean(axis=0)
    u, _, vt = np.linalg.svd((before - a).T @ (after - b))
    flip = np.ones(before.shape[1])
    flip[-1] = 1.0 if np.linalg.det(u @ vt) > 0 else -1.0
    return np.asarray(b + (points - a) @ (u * flip) @ vt)


@dataclass(frozen=True, kw_only=True)
class Course:
    """One pad, frame by frame; `stick_ratio` is the share of touching markers that stick, 0 in the air."""

    pad: str
    touches: Bool[np.ndarray, " t"]
    normal_N: Float[np.ndarray, " t"]
    patch_mm2: Float[np.ndarray, " t"]
    stick_ratio: Float[np.ndarray, " t"]


def contact_course(contact: Contact) -> tuple[Course, ...]:
    """Of all pads of a recording's contact (tactile.contact.find_contact)."""
    found = []
    for pad in contact.pads:
        touching = pad.episode >= 0
        noise_mm = max(pad.displacement_noise.sd, SCATTER_MM)
        found.append(
            Course(
                pad=pad.name,
                touches=np.asarray(touching.any(axis=1)),
                normal_N=pad.total_normal_N,
                patch_mm2=np.array([patch_area_mm2(pad.rest_mm, now) for now in touching]),
                stick_ratio=stick_ratio(pad.position_mm, touching, noise=noise_mm, lag=LAG_FRAMES),
            )
        )
    return tuple(found)


def said(course: Course, time_s: Float[np.ndarray, " t"]) -> str:
    """One line for people: when the pad touches, how hard, on how large a patch, and whether it slips."""
    at = np.flatnonzero(course.touches)
    starts = 1 + int((np.diff(at) > 1).sum())
    again = f" in {starts} contacts" if starts > 1 else ""
    hardest = int(course.normal_N.argmax())
    return (
        f"{course.pad}: contact from {time_s[at[0]]:.2f} to {time_s[at[-1]]:.2f} s{again}, up to "
        f"{course.normal_N[hardest]:.2f} N on {course.patch_mm2[hardest]:.0f} mm², where "
        f"{100 * course.stick_ratio[hardest]:.0f} % of the contact sticks"
    )
