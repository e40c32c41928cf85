"""Where photos were taken around a fruit, seen from above, and where the next ones should be."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.wording import listed

WIDE_DEG = 75.0
"""A side without photos that is said; from 120 degrees on a shape is refused (recon/checks/quality.py)."""
STEP_DEG = 45.0
"""What is advised between neighbours: eight photos once around."""


@dataclass(frozen=True, kw_only=True)
class ViewPlan:
    """Photos that could be placed, by name: `azimuth_deg` from the first photo on, anticlockwise from above,
    and `distance`, in any one unit. `unplaced` share too little with these. `gaps_deg`: sides (from, to)
    without a photo; `stand_deg`: where the next photos should be taken; `given`: all photos in order.
    """

    names: tuple[str, ...]
    azimuth_deg: tuple[float, ...]
    distance: tuple[float, ...]
    unplaced: tuple[str, ...]
    gaps_deg: tuple[tuple[float, float], ...]
    stand_deg: tuple[float, ...]
    given: tuple[str, ...]


def view_plan(
    names: Sequence[str],
    places: Float[np.ndarray, "v 3"],
    middle: Float[np.ndarray, "3"],
    *,
    given: Sequence[str],
    unplaced: Sequence[str] = (),
) -> ViewPlan:
    """The plan of photos `names` taken at `places` around `middle` (z up), of all the `given` ones in order.

    Azimuths count from the first of `names`. Each gap over WIDE_DEG gets photos at most STEP_DEG apart; a
    photo that could not be placed (`unplaced`) gets one more on each side of where its neighbours in order
    were taken.
    """
    away = places[:, :2] - middle[:2]
    angle = np.degrees(np.arctan2(away[:, 1], away[:, 0]))
    angle = (angle - angle[0] + 1e-9) % 360.0
    order = np.sort(angle)
    gaps = [
        (float(a), float(b))
        for a, b in zip(order, np.append(order[1:], order[0] + 360.0), strict=True)
        if b - a > WIDE_DEG
    ]
    stand = [
        float((a + (b - a) * k / count) % 360.0)
        for a, b in gaps
        for count in [int(np.ceil((b - a) / STEP_DEG))]
        for k in range(1, count)
    ]
    at = dict(zip(names, angle.tolist(), strict=True))
    for name in unplaced:
        before, after = _neighbours(name, given, at)
        if before is not None and after is not None:
            between = (at[before] + ((at[after] - at[before]) % 360.0) / 2) % 360.0
            if all(abs((between - s + 180) % 360 - 180) > STEP_DEG / 3 for s in stand):
                stand.append(float(between))
    return ViewPlan(
        names=tuple(names),
        azimuth_deg=tuple(angle.tolist()),
        distance=tuple(np.linalg.norm(places - middle, axis=1).tolist()),
        unplaced=tuple(unplaced),
        gaps_deg=tuple(gaps),
        stand_deg=tuple(sorted(stand)),
        given=tuple(given),
    )


def plan_words(plan: ViewPlan) -> str:
    """Which sides lack photos, which photos join none, and what to take."""
    said = []
    if plan.gaps_deg:
        sides = " and ".join(f"between {a:.0f} and {b:.0f} degrees" for a, b in plan.gaps_deg)
        stand = ", ".join(f"{s:.0f}" for s in plan.stand_deg)
        said.append(
            f"No photo covers {sides}, counted from {plan.names[0]} to the right around the fruit: "
            f"take photos at {stand} degrees."
        )
    at = dict(zip(plan.names, plan.azimuth_deg, strict=True))
    named = plan.unplaced[:3]
    for name in named:
        before, after = _neighbours(name, plan.given, at)
        where = " and ".join(x for x in (before, after) if x is not None)
        apart = before and after and before != after
        how = f"it, and take another between {where}" if apart else f"it closer to {where}"
        said.append(f"{name} overlaps too little with the other photos: retake {how}.")
    if len(plan.unplaced) > len(named):
        said.append(f"The same applies to {listed(plan.unplaced[len(named) :])}.")
    return " ".join(said)


def _neighbours(name: str, given: Sequence[str], placed: dict[str, float]) -> tuple[str | None, str | None]:
    """The placed photos taken before and after one, in order around."""
    i = list(given).index(name)
    around = [*given[i + 1 :], *given[:i]]
    after = next((n for n in around if n in placed), None)
    before = next((n for n in reversed(around) if n in placed), None)
    return before, after
