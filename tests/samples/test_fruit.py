"""Fruit of the samples, meshed in bricks that are halved towards the skin, and skins from scans."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from ball_fruit import ball
from mismatch_ball import drawn_ball, grasp_along_x, grasped_ball, linear_body, motion, rough, total_N

from fem.sparse.solver import factorise
from recon.pit.priors import load_prior
from recon.triangle_mesh import volume_mm3
from samples.appearance import linear_rgb
from samples.brick_flesh import assembled, flesh_of, rigid_tie, shape_gradients
from samples.cubed_sphere import even_sphere
from samples.fruit import (
    PIT_OVER_BOX,
    PIT_RAISED,
    POISSON_RATIO,
    SampleFruit,
    box_mm,
    fruit_of_seed,
    fruits_of_seed,
    triple,
)
from samples.graded_bricks import BrickGrading, graded_bricks, touched_skin_mm
from samples.hexahedra import COARSE, Bricks, Fineness, flesh_bricks, lagrange
from samples.mismatch.meshed_fruit import meshed_fruit, patch_of
from samples.mismatch.nonlinear_body import whole_fruit
from samples.scanned_skin import ScannedSkin, read_scan, skin_of_scan
from samples.scenes.draw import draw_scene, scene_mapping


def test_cubed_sphere_is_closed_and_outward() -> None:
    sphere = even_sphere(12)
    triangles = sphere.triangles()
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts == 2)
    assert abs(volume_mm3(sphere.directions, triangles) / (4 / 3 * np.pi) - 1) < 0.02


def test_fruit_stands_on_the_mat_at_its_centre() -> None:
    for fruit in fruits_of_seed(4, seed=1):
        low, high = box_mm(fruit.skin)
        assert np.allclose((low + high)[:2], 0, atol=1e-6)
        assert abs(low[2]) < 1e-6
        assert np.all((high - low > 50) & (high - low < 68))


def test_category_prior_and_samples_speak_of_the_same_pit() -> None:
    prior = load_prior("nectarine")
    assert prior.axis_ratios == PIT_OVER_BOX
    assert prior.raised == PIT_RAISED
    assert prior.poisson_ratio == POISSON_RATIO


def test_true_pit_lies_near_the_category_prior_and_inside_the_fruit() -> None:
    offsets, sizes = [], []
    for seed in range(12):
        fruit = fruit_of_seed("a", seed=seed, E_MPa=1.0)
        low, high = box_mm(fruit.skin)
        half = (high - low) / 2
        prior_centre = (low + high) / 2 + np.array(PIT_RAISED) * half
        offsets.append(np.array(fruit.pit.centre_mm) - prior_centre)
        sizes.append(np.array(fruit.pit.semi_axes_mm) / (np.array(PIT_OVER_BOX) * half) - 1)
        directions = even_sphere(12).directions
        pit, skin = fruit.pit.points_mm(directions), fruit.skin.points_mm(directions)
        assert np.linalg.norm(skin - pit, axis=1).min() > 5.0
    assert 0.18 < np.std(offsets) < 0.42
    assert 0.012 < np.std(sizes) < 0.028


X = np.array([1.0, 0.0, 0.0])
EVEN = Fineness(degrees=(0, 15, 30, 45), along=6, depths=(0, 0.25, 0.6, 1))


def test_bricks_fill_the_flesh() -> None:
    fruit = ball(30.0, 12.0, 1.0, 0.45)
    volume = flesh_of(flesh_bricks(fruit, X, EVEN), E_MPa=1.0, poisson_ratio=0.45).volumes.sum()
    assert volume == pytest.approx(4 / 3 * np.pi * (30.0**3 - 12.0**3), rel=1e-4)


def test_shell_round_a_rigid_core_under_pressure_shrinks_as_lame_says() -> None:
    # u = a r + b / r^2 with u(core) = 0 and radial stress -p at the skin (Timoshenko and Goodier, art. 136)
    R, core, E, nu, p = 30.0, 12.0, 0.8, 0.45, 0.02
    flesh = flesh_of(flesh_bricks(ball(R, core, E, nu), X, EVEN), E_MPa=E, poisson_ratio=nu)
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
    shrunk = np.einsum("ni,ni->n", u[skin], flesh.bricks.nodes_mm[skin] / R)
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


SMALL = BrickGrading(cells=3, layers=2, levels=2)
FINE_AND_EVEN = Fineness(degrees=(0, 4.3, 8.6, 13, 25, 45), along=2, depths=(0, 0.1, 0.3, 0.6, 1))


@pytest.fixture(scope="module")
def fruit() -> SampleFruit:
    return drawn_ball().fruit


@pytest.fixture(scope="module")
def bricks(fruit: SampleFruit) -> Bricks:
    grasp = grasp_along_x(drawn_ball(), motion([-0.1, 0.6]))
    touched = [
        touched_skin_mm(fruit, turn, touch_mm=touch, overlap_mm=0.5)
        for turn, touch in zip(grasp.hold.turns, grasp.hold.touch_mm, strict=True)
    ]
    return graded_bricks(fruit, np.array([1.0, 0.0, 0.0]), SMALL, touched_mm=np.concatenate(touched))


def test_hanging_nodes_follow_the_larger_brick_in_place_too(bricks: Bricks) -> None:
    assert bricks.follows is not None
    hanging = len(bricks.nodes_mm) - len(bricks.free_nodes) - len(bricks.pit_nodes)
    assert hanging > 100
    assert bricks.follows @ bricks.nodes_mm == pytest.approx(bricks.nodes_mm, abs=1e-12)
    assert bricks.follows @ np.ones(len(bricks.nodes_mm)) == pytest.approx(1.0, abs=1e-12)
    assert (bricks.follows @ bricks.follows - bricks.follows).max() == pytest.approx(0.0, abs=1e-12)


def test_displacement_is_continuous_between_large_and_small_bricks(bricks: Bricks) -> None:
    # any motion of the free nodes: what a small face's nodes do lies on the large face's own interpolation
    assert bricks.follows is not None
    moved = bricks.follows @ np.random.default_rng(0).normal(size=len(bricks.nodes_mm))
    slopes, volumes = shape_gradients(bricks.nodes_mm[bricks.cells])
    # the divergence theorem, integral of grad u = integral of u over the border, holds for continuous u only
    inside = np.einsum("mg,mgni,mn->i", volumes, slopes, moved[bricks.cells])
    outer = _flux(bricks, bricks.skin_cells.reshape(-1, 9), moved)
    inner_cells = bricks.cells[np.all(np.isin(bricks.cells[:, :9], bricks.pit_nodes), axis=1), :9]
    assert inside == pytest.approx(outer - _flux(bricks, inner_cells, moved), rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("by_mm", [(0.0, 0.0, 28.0), (30.0, -10.0, 5.0)])
def test_a_fruit_elsewhere_has_the_same_bricks(fruit: SampleFruit, by_mm: tuple[float, ...]) -> None:
    def moved(place_mm: tuple[float, float, float]) -> tuple[float, float, float]:
        return triple(np.add(place_mm, by_mm))

    skin = replace(fruit.skin, centre_mm=moved(fruit.skin.centre_mm))
    elsewhere = replace(fruit, skin=skin, pit=replace(fruit.pit, centre_mm=moved(fruit.pit.centre_mm)))
    touched_mm = fruit.skin.points_mm(X[None])
    here = graded_bricks(fruit, X, SMALL, touched_mm=touched_mm)
    there = graded_bricks(elsewhere, X, SMALL, touched_mm=touched_mm + by_mm)
    np.testing.assert_array_equal(there.cells, here.cells)
    np.testing.assert_allclose(there.nodes_mm - by_mm, here.nodes_mm, atol=1e-9)


def _flux(bricks: Bricks, cells: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Integral of u times the outward area vector over nine-node cells."""
    at, weight = np.polynomial.legendre.leggauss(4)
    value, slope = lagrange(at)
    x, f = bricks.nodes_mm[cells].reshape(-1, 3, 3, 3), u[cells].reshape(-1, 3, 3)
    first = np.einsum("pi,qj,kijc->kpqc", slope, value, x)
    second = np.einsum("pi,qj,kijc->kpqc", value, slope, x)
    here = np.einsum("pi,qj,kij->kpq", value, value, f)
    return np.einsum("p,q,kpq,kpqc->c", weight, weight, here, np.cross(first, second))


def test_even_strain_leaves_no_force_inside(bricks: Bricks) -> None:
    flesh = flesh_of(bricks, E_MPa=0.5, poisson_ratio=0.45)
    u = bricks.nodes_mm @ np.random.default_rng(0).normal(size=(3, 3)).T
    full = assembled(
        bricks.cells, flesh.slopes, flesh.volumes, flesh.mu_MPa, flesh.lam_MPa, len(bricks.nodes_mm)
    )
    force = (rigid_tie(bricks, flesh.free_nodes, flesh.pit_centre_mm).T @ (full @ u.ravel()))[:-6]
    force = force.reshape(-1, 3)
    on_skin = np.isin(flesh.free_nodes, bricks.skin_cells)
    assert np.abs(force[on_skin]).max() > 1.0
    assert force[~on_skin] == pytest.approx(0.0, abs=1e-10)


def test_bricks_are_small_where_the_pads_touch_and_no_pad_meets_a_hanging_node(bricks: Bricks) -> None:
    grasp = grasp_along_x(drawn_ball(), motion([-0.1, 0.6]))
    hanging = np.setdiff1d(np.arange(len(bricks.nodes_mm)), np.r_[bricks.free_nodes, bricks.pit_nodes])
    edge = np.linalg.norm(
        bricks.nodes_mm[bricks.skin_cells[:, 2, 1]] - bricks.nodes_mm[bricks.skin_cells[:, 0, 1]], axis=1
    )
    for turn, touch in zip(grasp.hold.turns, grasp.hold.touch_mm, strict=True):
        patch = patch_of(bricks, turn, touch_mm=touch, overlap_mm=0.5)
        assert not np.isin(patch.nodes, hanging).any()
        assert edge[np.isin(bricks.skin_cells, patch.nodes).all(axis=(1, 2))].max() < 0.3 * edge.max()


def test_contact_is_that_of_an_even_mesh() -> None:
    drawn, way = drawn_ball(), motion([-0.1, 0.3, 0.6])
    grasp, even = rough(drawn, way, FINE_AND_EVEN)
    graded = meshed_fruit(drawn.fruit, grasp, fineness=BrickGrading(cells=3, layers=2, levels=2))
    a, b = (grasped_ball(grasp, s, linear_body(s)) for s in (even, graded))
    assert total_N(b)[1:] == pytest.approx(total_N(a)[1:], rel=0.005)
    pressed = a.pads[0].force_N[2, :, 2] > 0
    miss = (a.pads[0].displacement_mm - b.pads[0].displacement_mm)[2][pressed]
    assert np.sqrt((miss**2).mean()) < 0.003


HALF_MM = np.array([30.0, 28.0, 26.0])
SIDE_PX = 256


def written_ellipsoid(folder: Path, *, turn: np.ndarray, closed: bool = True) -> tuple[Path, Path]:
    """An ellipsoid in metres, turned and shifted, as an OBJ file; red is 40 + 150 u, green 40 + 150 v."""
    sphere = even_sphere(24)
    triangles = sphere.triangles() if closed else sphere.triangles()[40:]
    points = (sphere.directions * HALF_MM) @ turn.T + [50.0, -20.0, 7.0]
    normals = (sphere.directions / HALF_MM) @ turn.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = (sphere.directions[:, :2] + 1) / 2
    lines = ["mtllib ../elsewhere.mtl"]
    lines += [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in (points / 1000).tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals.tolist()]
    lines += ["f " + " ".join(f"{k}/{k}/{k}" for k in corner) for corner in (triangles + 1).tolist()]
    mesh, texture = folder / "scan.obj", folder / "scan.png"
    mesh.write_text("\n".join(lines) + "\n")
    u, v = np.meshgrid((np.arange(SIDE_PX) + 0.5) / SIDE_PX, 1 - (np.arange(SIDE_PX) + 0.5) / SIDE_PX)
    picture = np.stack([np.full_like(u, 90.0), 40 + 150 * v, 40 + 150 * u], axis=2)
    cv2.imwrite(str(texture), np.rint(picture).astype(np.uint8))
    return mesh, texture


def turned() -> np.ndarray:
    return trimesh.transformations.rotation_matrix(1.1, [0.3, -0.8, 0.5])[:3, :3]


def skin(folder: Path, **options: bool) -> ScannedSkin:
    turn = turned()
    scan = read_scan(*written_ellipsoid(folder, turn=turn, **options), mm_per_unit=1000.0)
    middle = np.array([50.0, -20.0, 7.0])
    return skin_of_scan(scan, stem_mm=middle + turn @ [0, 0, 26.0], suture_mm=middle + turn @ [20.0, 0, -8.0])


def test_a_turned_scan_stands_stem_up_suture_to_x_on_the_plane(tmp_path: Path) -> None:
    made = skin(tmp_path)
    low, high = box_mm(made)
    assert (high - low) / 2 == pytest.approx(HALF_MM, rel=2e-3)
    assert low[2] == pytest.approx(0.0, abs=0.02)
    assert (low + high)[:2] == pytest.approx([0.0, 0.0], abs=0.02)
    assert made.centre_mm == pytest.approx([0.0, 0.0, 26.0], abs=0.03)


def test_its_surface_normals_and_colours_are_those_of_the_body(tmp_path: Path) -> None:
    made = skin(tmp_path)
    directions = np.random.default_rng(3).normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = 1 / np.linalg.norm(directions / HALF_MM, axis=1)
    assert np.abs(made.radius_mm(directions) - radius).max() < 0.05  # flat triangles, 1.9 mm wide
    normals = directions / HALF_MM**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.min(np.sum(made.normals(directions) * normals, axis=1)) > np.cos(
        np.radians(1.0)
    )  # those of flat triangles are off by up to 2.6 degrees
    place = radius[:, None] * directions / HALF_MM
    srgb = np.stack(
        [40 + 75 * (place[:, 0] + 1), 40 + 75 * (place[:, 1] + 1), np.full(len(place), 90.0)], axis=1
    )
    assert np.abs(made.colours(directions) - linear_rgb(srgb / 255)).max() < 0.01


@pytest.mark.parametrize("family", ["mat", "phone", "turntable"])
def test_a_scan_in_the_drawn_fruits_place_leaves_the_rest_of_the_scene(family: str, tmp_path: Path) -> None:
    drawn = draw_scene(4, photos=6, family=family)
    scanned = replace(drawn.fruit, skin=skin(tmp_path))
    scene = draw_scene(4, photos=6, family=family, fruit=("peach", scanned))
    before, after = scene_mapping(drawn), scene_mapping(scene)
    for factor in ("skin", "ground", "mat", "light", "turntable", "pipeline"):
        assert before[factor] == after[factor]
    assert after["fruit"]["size_mm"] == pytest.approx(2 * HALF_MM, rel=2e-3)
