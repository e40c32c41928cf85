"""What is never a finding: what is not known exactly of any fruit, pad and mesh, as columns with priors.

Common to all recordings: the pit's place and size within the category's spread, Poisson's ratio within its
own. Each recording's own: waves of the scanned surface, the pads' places on it. And, since no model is right
to the last micrometre, each pad of each recording may depart by DEPARTURE of its response in ways of its own:
larger, larger at great force, at the surface more than in the depth, as a whole, along the skin, with a lag.
An effect acts on all recordings by one law; these do not, which is what parts them.
"""

import numpy as np

from fem.grasp_sensitivity import POISSON_RATIO, SURFACE, mean_normal, tangents
from fem.mismatch.baseline import Seen
from fem.mismatch.fields import Column, Field
from fem.mismatch.flesh_strain import elastic_stress
from fem.mismatch.ground import Ground, over_all_frames
from fem.mismatch.inner_changes import inner_changes
from fem.mismatch.lagging import lagging
from fem.mismatch.pads import own_markers, slid_response
from fem.modulus_budget import ErrorBudget

DEPARTURE = 0.005
"""Standard deviation of each pad's own departures, as a share of its response."""
SMALLEST_POISSON_SD = 0.002
LAG_S = 1.0


def nuisances(ground: Ground) -> list[Column]:
    """All of them for a case."""
    budget = ground.base.case.budget
    grasps = ground.base.grasps
    columns: list[Column] = []
    inner = [_inner(ground, seen) for seen in grasps]
    for name in dict.fromkeys(name for own in inner for name in own):
        if name not in SURFACE:
            columns.append(Column(name=name, sd=_sd(name, budget), fields=[own.get(name) for own in inner]))
    for k, seen in enumerate(grasps):
        own = [(name, _sd(name, budget), field) for name, field in inner[k].items() if name in SURFACE]
        own += [(name, budget.pose_sd_mm, field) for name, field in _places(ground, seen)]
        own += [(name, DEPARTURE, field) for name, field in _departures(ground, seen)]
        for name, sd, field in own:
            alone = [field if j == k else None for j in range(len(grasps))]
            columns.append(Column(name=f"{seen.case.name} {name}", sd=sd, fields=alone))
    return columns


def _sd(name: str, budget: ErrorBudget) -> float:
    sd = budget.sd_of(name)
    return max(sd, SMALLEST_POISSON_SD) if name == POISSON_RATIO else sd


def _inner(ground: Ground, seen: Seen) -> dict[str, Field]:
    return {
        cause: Field(markers=ground.compliance * change)
        for cause, change in inner_changes(ground, seen).items()
    }


def _places(ground: Ground, seen: Seen) -> list[tuple[str, Field]]:
    """Each pad across and along the skin."""
    found = []
    for pad, link in enumerate(seen.links):
        for name, way in zip(("across", "along"), tangents(link.place.normal), strict=True):
            field = Field(markers=ground.compliance * slid_response(ground, seen, pad, way))
            found.append((f"{seen.pad_names[pad]} {name}", field))
    return found


def _departures(ground: Ground, seen: Seen) -> list[tuple[str, Field]]:
    """What each pad leaves of any model, each as large as the pad's response."""
    response = ground.compliance * seen.tracks.unit_displacement
    load = np.linalg.norm(seen.force_N, axis=2).sum(axis=1)
    load = load / load.max()
    stress = elastic_stress(
        ground.strains[ground.base.grasps.index(seen)], poisson_ratio=ground.poisson_ratio
    )
    depth = (2 * ground.depth - 1)[None, :, :, None]
    deep = ground.compliance * seen.over_time(ground.moved_by_stress(seen, depth * stress))
    crept = over_all_frames(seen, response)
    crept = (crept - lagging(crept, seen.case.history.time_s, LAG_S))[seen.used]
    found = []
    for pad, name in enumerate(seen.pad_names):
        normal = mean_normal(seen.links[pad].place.normal)
        along = response - (response @ normal)[..., None] * normal
        whole = load[:, None, None] * np.broadcast_to(normal, response.shape)
        ways = {
            "larger": response,
            "at great force": response * load[:, None, None],
            "in the depth": deep,
            "as a whole": whole,
            "along the skin": along,
            "late": crept,
        }
        own = own_markers(seen, pad)
        size = np.sqrt(np.sum(np.where(own, response, 0.0) ** 2))
        for way, field in ways.items():
            masked = np.where(own, field, 0.0)
            scale = size / max(float(np.sqrt(np.sum(masked**2))), 1e-12)
            found.append((f"{name} {way}", Field(markers=scale * masked)))
    return found
