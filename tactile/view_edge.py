"""Whether a contact runs out of what the sensor sees: force beyond the outermost markers is in no sum."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import Delaunay

MUCH = 0.2
"""More of the largest marker's push than this at an outermost marker: the contact goes on beyond it."""


def edge_said(
    rest_mm: Float[np.ndarray, "n 3"], force_N: Float[np.ndarray, "t n 3"], source: str
) -> list[str]:
    """A note where, in the frame of the greatest push, the outermost markers are pushed on too."""
    push = force_N[int(force_N[:, :, 2].sum(axis=1).argmax()), :, 2]
    if push.max() <= 0:
        return []
    mesh = Delaunay(rest_mm[:, :2])
    rows, across = np.nonzero(mesh.neighbors == -1)
    outermost = np.unique(np.concatenate([mesh.simplices[rows, (across + k) % 3] for k in (1, 2)]))
    share = float(push[outermost].max() / push.max())
    if share <= MUCH:
        return []
    return [
        (
            f"{source}: the contact reaches the edge of the markers ({share:.0%} of the maximum push "
            "there). The force beyond is missing: press closer to the middle, or less."
        )
    ]
