"""Bricks of flesh against closed forms."""

import numpy as np
import pytest
from ball_fruit import ball

from fem.sparse.solver import factorise
from samples.brick_flesh import flesh_of
from samples.fruit import fruit_of_seed
from samples.hexahedra import COARSE, Fineness, flesh_bricks
from samples.mismatch.nonlinear_body import whole_fruit

X = np.array([1.0, 0.0, 0.0])
EVEN = Fineness(degrees=(0, 15, 30, 45), along=6, depths=(0, 0.25, 0.6, 1))


def test_bricks_fill_the_flesh() -> None:
    fruit = ball(30.0, 12.0, 1.0, 0.45)
    volume = flesh_of(flesh_bricks(fruit, X, EVEN), E_MPa=1.0, poisson_ratio=0.45).volumes.sum()
    assert volume == pytest.approx(4 / 3 * np.pi * (30.0**3 - 12.0**3), rel=1e-4)


def test_shell_round_a_rigid_core_under_pressure_shrinks_as_lame_says() -> None:
    # u = a r + b / r^2 with u(core) = 0 and radial stress -p at the skin (Timoshenko and Goodier, art. 136)
    R, core, E, nu, p = 30.0, 12.0, 0.8, 0.45, 0.02
    fruit = ball(R, core, E, nu)
    flesh = flesh_of(flesh_bricks(fruit, X, EVEN), E_MPa=E, poisson_ratio=nu)
    bulk, shear = E / (3 * (1 - 2 * nu)), E / (2 * (1 + nu))
    a = -p / (3 * bulk + 4 * shear * core**3 / R**3)
    expected = a * R - a * core**3 / R**2
    nodal = np.zeros_like(flesh.bricks.nodes_mm)
    slope = np.array([[-1.5, 2.0, -0.5], [-0.5, 0.0, 0.5], [0.5, -2.0, 1.5]])
    cells = flesh.bricks.skin_cells
    corners = flesh.bricks.nodes_mm[cells]
    along, across = np.einsum("pi,kijc->kpjc", slope, corners), np.einsum("qj,kijc->kiqc", slope, corners)
    weight = np.outer([1, 4, 1], [1, 4, 1]) / 9
    np.add.at(nodal, cells, -p * np.cross(along, across) * weight[..., None])
    load = np.zeros(flesh.unknowns)
    load[:-6] = nodal[flesh.free_nodes].ravel()
    u = flesh.displacement(factorise(flesh.stiffness).solve(load[:, None])[:, 0])
    skin = np.unique(cells)
    outward = flesh.bricks.nodes_mm[skin] / R
    shrunk = np.einsum("ni,ni->n", u[skin], outward)
    assert shrunk == pytest.approx(expected, rel=0.015)
    assert shrunk.mean() == pytest.approx(expected, rel=4e-3)


def test_forces_of_hookes_stress_are_those_of_the_assembled_stiffness() -> None:
    fruit = fruit_of_seed("a", seed=2, E_MPa=0.6)
    flesh = flesh_of(flesh_bricks(fruit, X, COARSE), E_MPa=0.6, poisson_ratio=0.45)
    q = 1e-3 * np.random.default_rng(0).normal(size=flesh.unknowns)
    q[-3:] = 0.0  # a turn of the pit is finite, the stiffness is not

    def hooke(H: np.ndarray) -> np.ndarray:
        strain = (H + np.swapaxes(H, -1, -2)) / 2
        volume = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
        return np.asarray(2 * flesh.mu_MPa * strain + flesh.lam_MPa * volume * np.eye(3))

    left = whole_fruit(flesh, np.arange(3)).excess(q, hooke)
    assert np.abs(left).max() < 1e-10 * np.abs(flesh.stiffness @ q).max()


def test_inside_out_bricks_are_refused() -> None:
    with pytest.raises(ValueError, match="inside out"):
        flesh_of(flesh_bricks(ball(30.0, 31.0, 1.0, 0.4), X, COARSE), E_MPa=1.0, poisson_ratio=0.4)
