"""The stiffness changes with the shape as assembly on moved nodes has it, and as closed forms do."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh

from fem.elements.assembly import assemble
from fem.mesh.surface_points import skin_quadrature
from fem.solid.closed_forms import cored_sphere_shrinkage_mm
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.shape_derivative import pit_velocities, skin_velocities, stiffness_change, work_of_change


def smooth_fields(mesh):
    """Two displacement fields that strain the flesh everywhere."""
    x = mesh.nodes_mm / 10
    return np.stack([np.sin(x @ np.diag([1.0, 2, 0.5]) + [0, 1, 2]), np.cos(x[:, [1, 2, 0]]) * x])


def change_of_energy(mesh, velocity):
    """u' (dK/de) v for all pairs of the smooth fields."""
    fields = smooth_fields(mesh)
    change = stiffness_change(mesh, NU, fields, velocity[None])[0]
    return np.einsum("fnx,gnx->fg", fields, change)


@pytest.mark.parametrize("which", ["pit y", "pit size", "wave along x", "wave along z"])
def test_energy_changes_as_on_moved_nodes(which):
    mesh = fruit_mesh()
    velocity = {
        "pit y": pit_velocities(mesh)[1],
        "pit size": pit_velocities(mesh)[3],
        "wave along x": skin_velocities(mesh)[0],
        "wave along z": skin_velocities(mesh)[5],
    }[which]
    step = 1e-3
    fields = smooth_fields(mesh)
    flat = fields.reshape(2, -1)
    ends = []
    for sign in (1, -1):
        moved = replace(mesh, nodes_mm=mesh.nodes_mm + sign * step * velocity)
        ends.append(flat @ (assemble(moved.nodes_mm, moved.tets).for_unit_modulus(poisson_ratio=NU) @ flat.T))
    wanted = (ends[0] - ends[1]) / (2 * step)
    change = change_of_energy(mesh, velocity)
    assert np.abs(change - wanted).max() < 1e-3 * np.abs(wanted).max()
    assert np.abs(change - change.T).max() < 1e-9 * np.abs(change).max()


def test_work_of_pairs_of_fields_is_that_of_the_changed_forces():
    mesh = fruit_mesh()
    velocities = np.concatenate([pit_velocities(mesh), skin_velocities(mesh)])
    u, v = smooth_fields(mesh), smooth_fields(mesh)[::-1]
    wanted = np.einsum("pfnx,fnx->pf", stiffness_change(mesh, NU, u, velocities), v)
    work_of_pairs = work_of_change(mesh, NU, u, v, velocities)
    np.testing.assert_allclose(work_of_pairs, wanted, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45])
def test_a_larger_core_stiffens_a_ball_under_pressure_as_lame_says(cored_ball, poisson_ratio):
    """J = p 4 pi b^2 u(b) is the work of pressure p; dJ / d ln a = -U' (dK / d ln a) U."""
    pressure_MPa, radius_mm, core_mm = 0.1, 30.0, 10.0

    def work(ln_size):
        shrunk_mm = cored_sphere_shrinkage_mm(
            E_MPa=1.0,
            poisson_ratio=poisson_ratio,
            core_radius_mm=core_mm * np.exp(ln_size),
            radius_mm=radius_mm,
            pressure_MPa=pressure_MPa,
        )
        return 4 * np.pi * radius_mm**2 * pressure_MPa * shrunk_mm

    points, area_mm2 = skin_quadrature(cored_ball)
    load = points.point_load((-pressure_MPa * area_mm2[:, None] * points.normal)[None])
    solid = UnitModulusSolid.factorise(cored_ball, poisson_ratio=poisson_ratio, support="free")
    moved = solid.displacement(load)
    growth = pit_velocities(cored_ball)[3:]
    rise = -np.vdot(moved, stiffness_change(cored_ball, poisson_ratio, moved, growth))
    assert rise == pytest.approx((work(1e-4) - work(-1e-4)) / 2e-4, rel=0.01)


def test_the_pit_moves_whole_and_the_skin_stays():
    mesh = fruit_mesh()
    velocities = pit_velocities(mesh)
    middle = mesh.nodes_mm[mesh.pit_nodes].mean(axis=0)
    shift = np.broadcast_to(np.eye(3)[:, None], (3, len(mesh.pit_nodes), 3))
    np.testing.assert_allclose(velocities[:3, mesh.pit_nodes], shift)
    np.testing.assert_allclose(velocities[3, mesh.pit_nodes], mesh.nodes_mm[mesh.pit_nodes] - middle)
    assert not velocities[:, mesh.outer_nodes].any()
    assert not skin_velocities(mesh)[:, mesh.pit_nodes].any()


def test_waves_of_a_skin_add_up_to_the_same_spread_everywhere():
    """Six independent amounts of variance sd^2 / 3, as the budget has them."""
    mesh = fruit_mesh()
    waves = skin_velocities(mesh)[:, mesh.outer_nodes]
    np.testing.assert_allclose((waves**2).sum(axis=(0, 2)) / 3, 1.0, rtol=1e-12)
