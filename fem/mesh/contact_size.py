"""How fine a mesh must be where something touches: by the contact's own width."""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

#: edges in a contact, and how far around it they stay as short, as shares of its width
EDGE_SHARE, RADIUS_SHARE = 0.2, 0.1
#: edges in a contact of any size, mm
SHORTEST_MM, LONGEST_MM = 0.2, 1.7
#: points closer than this, or than this many times the usual distance to the next one, share a contact
GAP_MM, GAPS = 3.0, 1.5


def contact_size(
    points_mm: Float[np.ndarray, "q 3"],
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Edge length wanted at each contact point, and the distance from it up to which it is: both in mm.

    Points that lie together make one contact. Its width is the least extent along the surface; a single
    point or a line counts as 1 mm wide.
    """
    width = np.empty(len(points_mm))
    contact = _together(points_mm)
    for k in range(contact.max() + 1):
        width[contact == k] = _width_mm(points_mm[contact == k])
    return np.clip(EDGE_SHARE * width, SHORTEST_MM, LONGEST_MM), RADIUS_SHARE * width


def _together(points_mm: Float[np.ndarray, "q 3"]) -> np.ndarray:
    """A number for each point, the same for those that chains of short gaps join."""
    tree = cKDTree(points_mm)
    apart = np.asarray(tree.query(points_mm, k=[min(2, len(points_mm))])[0])
    reach = max(GAP_MM, GAPS * float(np.median(apart)))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    near = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=2 * (len(points_mm),))
    return np.asarray(connected_components(near, directed=False)[1])


def _width_mm(points_mm: Float[np.ndarray, "q 3"]) -> float:
    """The least extent in any direction along the plane of the points (to 2 %), at least 1 mm."""
    off = points_mm - points_mm.mean(axis=0)
    plane = np.linalg.svd(off, full_matrices=True)[2][:2]
    turn = np.radians(np.arange(0, 180, 2))
    extent = np.ptp(off @ (np.column_stack([np.cos(turn), np.sin(turn)]) @ plane).T, axis=0)
    return max(float(extent.min()), 1.0)
