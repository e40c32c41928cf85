"""Where photos were taken around a fruit, seen from above, and where the next ones should be."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.files.plain_file import listed

WIDE_DEG = 75.0
"""Widest azimuth gap without advice; above 120 degrees a shape is refused (recon/checks/quality.py)."""
STEP_DEG = 45.0
"""Advised step between neighbours: eight photos once around."""


def missing_views(
    names: Sequence[str],
    places: Float[np.ndarray, "v 3"],
    middle: Float[np.ndarray, "3"],
    *,
    given: Sequence[str],
    unplaced: Sequence[str] = (),
) -> str:
    """Sentences on sides without photos, on photos without a pose, and what to take; empty for enough views.

    `names` are the photos taken at `places` around `middle` (z up), of all the `given` ones in order.
    Azimuths count from the first of `names`. Each gap over WIDE_DEG gets photos at most STEP_DEG apart. A
    photo without a pose (`unplaced`) adds one photo midway between its neighbours in order, if any gap is
    named.
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
    neighbours = {name: _neighbours(name, given, at) for name in unplaced}
    for before, after in neighbours.values():
        if before is not None and after is not None:
            between = (at[before] + ((at[after] - at[before]) % 360.0) / 2) % 360.0
            if all(abs((between - s + 180) % 360 - 180) > STEP_DEG / 3 for s in stand):
                stand.append(float(between))
    said = []
    if gaps:
        sides = " and ".join(f"between {a:.0f} and {b:.0f} degrees" for a, b in gaps)
        degrees = ", ".join(f"{s:.0f}" for s in sorted(stand))
        said.append(
            f"No photo covers {sides}, counted from {names[0]} to the right around the fruit: "
            f"take photos at {degrees} degrees."
        )
    for name in unplaced[:3]:
        before, after = neighbours[name]
        where = " and ".join(x for x in (before, after) if x is not None)
        apart = before and after and before != after
        how = f"it, and take another between {where}" if apart else f"it closer to {where}"
        said.append(f"{name} overlaps too little with the other photos: retake {how}.")
    if len(unplaced) > 3:
        said.append(f"The same applies to {listed(unplaced[3:])}.")
    return " ".join(said)


def _neighbours(name: str, given: Sequence[str], placed: dict[str, float]) -> tuple[str | None, str | None]:
    """The nearest photos with a pose before and after one, in order around."""
    i = list(given).index(name)
    around = [*given[i + 1 :], *given[:i]]
    after = next((n for n in around if n in placed), None)
    before = next((n for n in reversed(around) if n in placed), None)
    return before, after
