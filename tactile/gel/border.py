"""Shading tells depth only below the border of the image: what the border itself does, the slab says.

Integrated with a border held at zero, a face that displaces by w is seen as w - H w_b, where w_b is w on the
border and H carries a border's values inward as a harmonic function. Both w and w_b are linear in the forces,
so the inverse takes the seen depth as (G_z - H B) t, B the compliance of the border, and puts H B t back.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RegularGridInterpolator

from tactile.gel.grid import GelGrid, with_smooth
from tactile.gel.photometric import laplacian_eigenvalues, poisson
from tactile.gel.slab import GelLayer, tent_compliance
from tactile.gel_camera import on_face, project
from tactile.sensors import GelCamera

CELLS = 48
"""Cells along the longer side of the image for the harmonic functions: they are smooth."""
PER_SIDE = 12
"""Places along each side of the image at which the border's rise is taken, in straight lines between: it is
as smooth as the gel is thick. Set by hand."""


def border_observation(
    layer: GelLayer, grid: GelGrid, camera: GelCamera
) -> tuple[Float[np.ndarray, "d u"], Float[np.ndarray, "n e"]]:
    """What shading sees of nodal forces and smooth fields, and the border's share H B of depth (mm/N)."""
    width, height = camera.image_px
    edge = _ring(width, height)
    places = on_face(camera, edge)[:, :2]
    made = -tent_compliance(layer, places, grid.nodes_mm, pitch_mm=grid.pitch_mm)
    at_border = with_smooth(grid, made.reshape(3 * len(edge), -1), places)[2::3]
    carried = _harmonic(camera, grid.rest_mm[:, :2], width, height) @ at_border
    observed = with_smooth(grid, grid.compliance, grid.rest_mm[:, :2])
    observed[2::3] -= carried
    return observed, carried[:, : 3 * len(grid.nodes_mm)]


def _ring(width: int, height: int) -> Float[np.ndarray, "r 2"]:
    """Pixels along the border, clockwise from the first."""
    share = np.arange(PER_SIDE) / PER_SIDE
    right, down = width - 1.0, height - 1.0
    return np.concatenate(
        [
            np.column_stack([share * right, 0 * share]),
            np.column_stack([right + 0 * share, share * down]),
            np.column_stack([(1 - share) * right, down + 0 * share]),
            np.column_stack([0 * share, (1 - share) * down]),
        ]
    )


def _harmonic(
    camera: GelCamera, at_mm: Float[np.ndarray, "n 2"], width: int, height: int
) -> Float[np.ndarray, "n r"]:
    """H: values at the ring's pixels (linear in between) to values at points of the face."""
    columns = CELLS + 1
    rows = round(CELLS * height / width) + 1
    x, y = np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)
    pixels = project(camera, np.column_stack([at_mm, np.zeros(len(at_mm))]))
    position = np.arange(4 * PER_SIDE)
    out = np.empty((len(at_mm), len(position)))
    for k in position:
        tent = np.zeros(4 * PER_SIDE + 1)
        tent[k] = 1.0
        tent[-1] = tent[0]

        def side(first: int, share: np.ndarray, tent: np.ndarray = tent) -> np.ndarray:
            return np.asarray(np.interp((first + share) * PER_SIDE, np.arange(4 * PER_SIDE + 1), tent))

        grid = np.zeros((rows, columns))
        along, down = x / x[-1], y / y[-1]
        grid[0], grid[:, -1] = side(0, along), side(1, down)
        grid[-1], grid[:, 0] = side(2, 1 - along), side(3, 1 - down)
        filled = _laplace(grid)
        read = RegularGridInterpolator((y, x), filled, bounds_error=False, fill_value=None)
        out[:, k] = read(pixels[:, ::-1])
    return out


def _laplace(border: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """The discrete harmonic function with these border values (sine transform)."""
    pull = border[2:, 1:-1] + border[:-2, 1:-1] + border[1:-1, 2:] + border[1:-1, :-2]
    rows, columns = border.shape
    out = border.copy()
    out[1:-1, 1:-1] = poisson(-pull, laplacian_eigenvalues((rows, columns)))
    return out
