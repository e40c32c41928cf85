"""The fruit frame: stem end up z, suture to +x, origin under the middle on the support plane."""

import numpy as np
from jaxtyping import Float

from recon.cameras.similarity import affine
from recon.surface.orientation import Orientation

SURE = 0.5
"""Confidence from which an orientation by shape counts against the convention. Set by hand."""
MOST_TILT_DEG = 15.0
"""Degrees that the stem may be off the vertical unsaid: fruit do not stand straight. Set by hand."""
MOST_TURN_DEG = 20.0
"""Degrees that the suture may be off the arrow unsaid: so well it is laid by eye. Set by hand."""


def to_fruit_frame(
    vertices: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "4 4"]]:
    """A mesh photographed on a mat (or as on one) in its fruit frame, and `fruit_from_mesh`.

    The origin goes to the centre of the mesh's box in x and y and to its lowest point in z.

    >>> to_fruit_frame(np.array([[1.0, 2.0, 3.0], [3.0, 6.0, 4.0]]))[0].tolist()
    [[-1.0, -2.0, 0.0], [1.0, 2.0, 1.0]]
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return vertices + shift, affine(np.eye(3), shift)


def orientation_warnings(orientation: Orientation) -> tuple[str, ...]:
    """Sentences where the shape of the mesh, in the fruit frame, contradicts the convention of placement.

    The frame stays as placed: the recordings' poses are written in it.
    """
    out = []
    if orientation.stem_confidence >= SURE and orientation.tilt_deg > MOST_TILT_DEG:
        out.append(
            f"The stem axis appears tilted by {orientation.tilt_deg:.0f} degrees (a hollow "
            f"{orientation.hollow_mm:.1f} mm deep; confidence {orientation.stem_confidence:.2f}), but "
            "drupe placed the pit for an upright fruit. Set the fruit upright, photograph and grasp "
            "it again, or give its pit as pit.ply."
        )
    elif orientation.suture_confidence >= SURE and abs(orientation.turn_deg) > MOST_TURN_DEG:
        side = "left" if orientation.turn_deg > 0 else "right"
        out.append(
            f"The suture appears turned by {abs(orientation.turn_deg):.0f} degrees to the {side} of "
            f"the mat's arrow, or of +x (a groove {orientation.groove_mm:.1f} mm deep; confidence "
            f"{orientation.suture_confidence:.2f}). drupe placed the pit for a suture along the "
            "arrow. Turn the fruit, photograph and grasp it again, or give its pit as pit.ply."
        )
    return tuple(out)
