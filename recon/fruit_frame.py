"""The fruit frame: stem end up z, suture towards +x, origin under the middle of the fruit on its support
plane.
"""

import numpy as np
from jaxtyping import Float


def to_fruit_frame(
    vertices: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "4 4"]]:
    """A photographed mesh in its fruit frame, and `fruit_from_mesh` that takes it there.

    On a mat the fruit is laid stem end up, suture towards the mat's +x, so that the frame is the mat's,
    shifted: the origin goes to the centre of the mesh's box in x and y and to its lowest point in z.

    >>> to_fruit_frame(np.array([[1.0, 2.0, 3.0], [3.0, 6.0, 4.0]]))[0].tolist()
    [[-1.0, -2.0, 0.0], [1.0, 2.0, 1.0]]
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    fruit_from_mesh = np.eye(4)
    fruit_from_mesh[:3, 3] = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return vertices + fruit_from_mesh[:3, 3], fruit_from_mesh
