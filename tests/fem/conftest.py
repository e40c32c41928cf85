"""Meshes that several tests share: a nectarine-size fruit, a ball with a ball in it, a plain ball."""

import pytest
from fem_shapes import ball

from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise


@pytest.fixture(scope="session")
def nectarine() -> FleshMesh:
    outer = ball(4000, semi_axes_mm=(30.5, 29.5, 28.5))
    pit = ball(2000, semi_axes_mm=(15, 10, 12.5), centre_mm=(0.5, -0.4, 0.8))
    return tetrahedralise(*outer, *pit, edge_mm=6.0)


@pytest.fixture(scope="session")
def cored_ball() -> FleshMesh:
    """A ball of radius 30 with a concentric core of radius 10."""
    return tetrahedralise(
        *ball(12000, semi_axes_mm=(30, 30, 30)), *ball(6000, semi_axes_mm=(10, 10, 10)), edge_mm=6.0
    )


@pytest.fixture(scope="session")
def solid_ball() -> FleshMesh:
    """A ball of radius 20 without a core."""
    return tetrahedralise(*ball(4000, semi_axes_mm=(20, 20, 20)), None, None, edge_mm=6.0)
