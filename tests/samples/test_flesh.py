from dataclasses import replace

import numpy as np
import pytest
from ball_fruit import ball

from samples.brick_flesh import Law, flesh_of
from samples.cubed_sphere import even_sphere
from samples.factors import factorise
from samples.fruit import fruit_of_seed
from samples.hexahedra import COARSE, Fineness, flesh_bricks

X = np.array([1.0, 0.0, 0.0])
EVEN = Fineness(degrees=(0, 15, 30, 45), along=6, depths=(0, 0.25, 0.6, 1))


def test_bricks_fill_the_flesh() -> None:
    fruit = ball(30.0, 12.0, 1.0, 0.45)
    volume = flesh_of(flesh_bricks(fruit, X, EVEN), E_MPa=1.0, poisson_ratio=0.45, law="linear").volumes.sum()
    assert volume == pytest.approx(4 / 3 * np.pi * (30.0**3 - 12.0**3), rel=1e-4)


def test_shell_round_a_rigid_core_under_pressure_shrinks_as_lame_says() -> None:
    # u = a r + b / r^2 with u(core) = 0 and radial stress -p at the skin (Timoshenko and Goodier, art. 136)
    R, core, E, nu, p = 30.0, 12.0, 0.8, 0.45, 0.02
    fruit = ball(R, core, E, nu)
    flesh = flesh_of(flesh_bricks(fruit, X, EVEN), E_MPa=E, poisson_ratio=nu, law="linear")
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
    u = flesh.displacement(factorise(flesh.stiffness)(load[:, None])[:, 0])
    skin = np.unique(cells)
    outward = flesh.bricks.nodes_mm[skin] / R
    shrunk = np.einsum("ni,ni->n", u[skin], outward)
    assert shrunk == pytest.approx(expected, rel=0.015)
    assert shrunk.mean() == pytest.approx(expected, rel=4e-3)


@pytest.mark.parametrize("law", ["linear", "neo-hookean"])
def test_finite_strain_excess_is_of_second_order(law: Law) -> None:
    fruit = fruit_of_seed("a", seed=2, E_MPa=0.6)
    flesh = flesh_of(flesh_bricks(fruit, X, COARSE), E_MPa=0.6, poisson_ratio=0.45, law=law)
    q = np.random.default_rng(0).normal(size=flesh.unknowns) * 1e-3
    q[-3:] *= 0.01
    large, small = np.linalg.norm(flesh.excess(q)), np.linalg.norm(flesh.excess(q / 10))
    if law == "linear":
        assert large == 0
    else:
        assert large / small == pytest.approx(100, rel=0.1)


def test_turning_the_whole_fruit_costs_nothing_at_finite_strain() -> None:
    fruit = fruit_of_seed("a", seed=2, E_MPa=0.6)
    flesh = flesh_of(flesh_bricks(fruit, X, COARSE), E_MPa=0.6, poisson_ratio=0.45, law="neo-hookean")
    turn = np.array([0.3, -0.5, 0.2])
    q = np.zeros(flesh.unknowns)
    q[-3:] = turn
    arms = flesh.bricks.nodes_mm - flesh.pit_centre_mm
    from scipy.spatial.transform import Rotation

    q[:-6] = (Rotation.from_rotvec(turn).apply(arms) - arms)[flesh.free_nodes].ravel()
    total = flesh.excess(q) + flesh.stiffness @ q
    assert np.abs(total[:-6]).max() < 1e-10


def test_neo_hookean_stress_of_a_plain_stretch() -> None:
    fruit = replace(ball(30.0, 12.0, 0.8, 0.4))
    flesh = flesh_of(flesh_bricks(fruit, X, COARSE), E_MPa=0.8, poisson_ratio=0.4, law="neo-hookean")
    stretch = 1.1
    u = flesh.bricks.nodes_mm * (stretch - 1)
    mu, lam = 0.8 / 2.8, 0.8 * 0.4 / (1.4 * 0.2)
    P = mu * (stretch - 1 / stretch) + lam * 3 * np.log(stretch) / stretch
    force = flesh._internal_force(u)
    skin = np.unique(flesh.bricks.skin_cells)
    outward = np.einsum("ni,ni->", force[skin], flesh.bricks.nodes_mm[skin] / 30.0)
    assert outward == pytest.approx(P * 4 * np.pi * 30.0**2, rel=2e-3)
    assert even_sphere(2).directions.shape == (26, 3)


def test_inside_out_bricks_are_refused() -> None:
    with pytest.raises(ValueError, match="inside out"):
        flesh_of(
            flesh_bricks(ball(30.0, 31.0, 1.0, 0.4), X, COARSE), E_MPa=1.0, poisson_ratio=0.4, law="linear"
        )
