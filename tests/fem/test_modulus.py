"""A modulus planted by another discretisation is found again, with an honest error bar.

The truth is a body of revolution, solved in two dimensions by quadratic quadrilaterals; the estimate uses
tetrahedra of the mesher.
"""

from dataclasses import replace

import numpy as np
import pytest
from axisymmetric import Revolved, cored_ball, cylinder
from fem_shapes import ball

from fem.failure import FemFailure, FemProblem
from fem.forward import UnitModulusSolid
from fem.mesh import tetrahedralise
from fem.modulus import estimate_modulus
from fem.modulus_budget import ErrorBudget
from fem.modulus_combine import combine_grasps
from fem.modulus_inputs import GraspHistory, PadHistory
from fem.modulus_thinning import MOST_FRAMES, spacing, thinned

NU = 0.45
E_MPA = 0.3
RADIUS_MM, CORE_MM, HEIGHT_MM = 25.0, 10.0, 20.0
BUDGET = ErrorBudget()
RADII_MM = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 7.0, 6.0, 5.0, 3.5])
PHASES = ("load",) * 5 + ("hold",) + ("unload",) * 3
AXIS = np.arange(-8.0, 8.5)
MARKERS = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)


def pressure_MPa(r_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    """A smooth bowl that grows and steepens with its radius."""
    return 0.005 * radius_mm * np.maximum(1 - (r_mm / radius_mm) ** 2, 0.0) ** 2


def height_of(body: Revolved, r_mm: np.ndarray) -> np.ndarray:
    """z of the loaded surface."""
    edge = body.nodes[:, -1]
    return np.interp(r_mm, edge[:, 0], edge[:, 1])


def truth(body: Revolved) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the markers for E = 1, and their forces, frame by frame, for a pad above."""
    tractions = [lambda r, a=a: -pressure_MPa(r, a) for a in RADII_MM]
    surface = body.surface_displacement(tractions)
    r = np.linalg.norm(MARKERS, axis=1)
    unit = np.zeros((len(RADII_MM), len(r), 3))
    force = np.zeros_like(unit)
    slope = np.gradient(body.nodes[:, -1, 1], body.nodes[:, -1, 0])
    stretch = np.sqrt(1 + np.interp(r, body.nodes[:, -1, 0], slope) ** 2)
    for frame, radius in enumerate(RADII_MM):
        radial, down = (np.interp(r, body.nodes[:, -1, 0], surface[frame, :, k]) for k in range(2))
        unit[frame, :, :2] = (radial / np.maximum(r, 1e-9))[:, None] * MARKERS
        unit[frame, :, 2] = down
        force[frame, :, 2] = -pressure_MPa(r, radius) * stretch
    return unit, force


def recorded(
    body: Revolved,
    sides: tuple[float, ...],
    rng: np.random.Generator,
    *,
    noise: float = 1.0,
    surface_mm: float = 0.1,
    moves: bool = True,
) -> GraspHistory:
    """What sensors would have seen: noise, scale errors, a scanned surface that is off, a fruit that
    moves."""
    unit, force = TRUTH[id(body)] if id(body) in TRUTH else TRUTH.setdefault(id(body), truth(body))
    shift = rng.normal(size=(len(RADII_MM), 1, 3)) * 0.2 * moves
    touching = np.linalg.norm(MARKERS, axis=1) < RADII_MM[:, None]
    pads = []
    for name, side in zip(("left", "right"), sides, strict=False):
        mirror = np.array([1.0, 1.0, side])
        place = np.column_stack([MARKERS, height_of(body, np.linalg.norm(MARKERS, axis=1))]) * mirror
        gel = -mirror * force / 0.2 * [0, 0, 1]
        gel_seen = gel * (1 + 0.004 * noise * rng.normal(size=(len(place), 1)))
        seen = place + mirror * unit / E_MPA + shift + [0, 0, surface_mm * side] + (gel_seen - gel)
        force_seen = mirror * force * (1 + 0.01 * noise * rng.normal(size=(len(place), 1)))
        pads.append(
            PadHistory(
                name=name,
                rest_mm=np.column_stack([MARKERS, np.zeros(len(place))]),
                surface_mm=place,
                position_mm=seen + 0.004 * noise * rng.normal(size=seen.shape),
                gel_displacement_mm=gel_seen,
                force_N=force_seen + 1e-4 * noise * rng.normal(size=force.shape),
                episode=np.where(touching, 0, -1),
                displacement_sd_mm=0.004 * noise,
                force_sd_N=1e-4 * noise,
                lag1=0.0,
            )
        )
    return GraspHistory(time_s=np.arange(len(RADII_MM)) * 0.1, phase=PHASES, pads=tuple(pads))


TRUTH: dict[int, tuple[np.ndarray, np.ndarray]] = {}
BALL = cored_ball(RADIUS_MM, CORE_MM, NU)
PUCK = cylinder(RADIUS_MM, HEIGHT_MM, NU)
BOTH = (1.0, -1.0)


@pytest.fixture(scope="module")
def ball_mesh():
    return tetrahedralise(
        *ball(6000, semi_axes_mm=3 * (RADIUS_MM,)),
        *ball(3000, semi_axes_mm=3 * (CORE_MM,)),
        edge_mm=6.0,
        refine_at_mm=np.array([[0, 0, RADIUS_MM], [0, 0, -RADIUS_MM]]),
        refine_radius_mm=7.0,
        refine_edge_mm=2.0,
    )


@pytest.fixture(scope="module")
def free_ball(ball_mesh):
    return UnitModulusSolid.factorise(ball_mesh, poisson_ratio=NU, support="free")


def grasp(seed: int = 0, **options) -> GraspHistory:
    return recorded(BALL, BOTH, np.random.default_rng(seed), **options)


def puck_surface(n: int = 72) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder's surface: rings on bottom, wall and top."""
    across = np.linspace(0, RADIUS_MM, 13)[1:]
    up = np.linspace(0, HEIGHT_MM, 10)
    profile = [(r, 0.0) for r in across] + [(RADIUS_MM, z) for z in up[1:-1]]
    profile += [(r, HEIGHT_MM) for r in across[::-1]]
    turn = 2 * np.pi * np.arange(n) / n
    rings = [np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(n, z)]) for r, z in profile]
    vertices = np.vstack([*rings, [[0, 0, 0], [0, 0, HEIGHT_MM]]])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    faces = [np.column_stack([j, i, np.full(n, len(vertices) - 2)])]
    for k in range(len(profile) - 1):
        a, b = k * n, (k + 1) * n
        faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    last = (len(profile) - 1) * n
    faces += [np.column_stack([last + i, last + j, np.full(n, len(vertices) - 1)])]
    return vertices, np.vstack(faces)


def test_a_grasp_gives_the_planted_modulus_both_ways(free_ball):
    found = estimate_modulus(grasp(noise=0.5), free_ball, budget=BUDGET)
    assert found.form == "first-touch"
    assert found.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert found.energy is not None
    assert found.energy.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert found.warnings == ()


def test_a_press_on_a_base_gives_the_planted_modulus():
    mesh = tetrahedralise(
        *puck_surface(),
        None,
        None,
        edge_mm=6.0,
        refine_at_mm=np.array([[0, 0, HEIGHT_MM]]),
        refine_radius_mm=7.0,
        refine_edge_mm=2.0,
    )
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="base")
    history = recorded(PUCK, BOTH[:1], np.random.default_rng(0), moves=False)
    found = estimate_modulus(history, solid, budget=BUDGET)
    assert found.E_MPa == pytest.approx(E_MPA, rel=0.015)
    assert found.energy is not None
    assert found.energy.E_MPa == pytest.approx(E_MPA, rel=0.015)


def test_the_error_bar_covers_the_truth(free_ball):
    found = [estimate_modulus(grasp(s), free_ball, budget=BUDGET) for s in range(8)]
    own = np.array([f.least_squares.own_sd_MPa for f in found])
    values = np.array([f.E_MPa for f in found])
    assert (np.abs(values - E_MPA) < 2 * np.array([f.E_sd_MPa for f in found])).all()
    assert 0.3 < np.std(values) / own.mean() < 1.5
    assert np.abs(np.array([f.energy.E_MPa for f in found]) - E_MPA).max() < 0.02 * E_MPA


def test_every_frame_and_pad_has_its_own_modulus(free_ball):
    found = estimate_modulus(grasp(noise=0.1), free_ball, budget=BUDGET)
    assert {f.pad for f in found.frames} == {"all", "left", "right"}
    assert len(found.frames) == 3 * len(RADII_MM)
    heavy = [f for f in found.frames if RADII_MM[f.frame] >= 4]
    assert np.array([f.E_MPa for f in heavy]) == pytest.approx(E_MPA, rel=0.02)
    assert [f.phase for f in found.frames if f.pad == "all"] == list(PHASES)


def turned(history: GraspHistory, turn: np.ndarray, shift: np.ndarray) -> GraspHistory:
    pads = tuple(
        replace(
            pad,
            surface_mm=pad.surface_mm @ turn.T + shift,
            position_mm=pad.position_mm @ turn.T + shift,
            gel_displacement_mm=pad.gel_displacement_mm @ turn.T,
            force_N=pad.force_N @ turn.T,
        )
        for pad in history.pads
    )
    return replace(history, pads=pads)


def test_the_frame_of_reference_does_not_matter(ball_mesh, free_ball):
    history = grasp()
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([100.0, -20.0, 5.0])
    moved = replace(ball_mesh, nodes_mm=ball_mesh.nodes_mm @ turn.T + shift)
    there = UnitModulusSolid.factorise(moved, poisson_ratio=NU, support="free")
    a = estimate_modulus(history, free_ball, budget=BUDGET)
    b = estimate_modulus(turned(history, turn, shift), there, budget=BUDGET)
    assert b.E_MPa == pytest.approx(a.E_MPa, rel=1e-6)
    assert b.energy.E_MPa == pytest.approx(a.energy.E_MPa, rel=1e-6)


def test_twice_the_force_is_twice_the_modulus(free_ball):
    history = grasp()
    stiff = replace(history, pads=tuple(replace(p, force_N=2 * p.force_N) for p in history.pads))
    a = estimate_modulus(history, free_ball, budget=BUDGET)
    b = estimate_modulus(stiff, free_ball, budget=BUDGET)
    assert b.E_MPa == pytest.approx(2 * a.E_MPa, rel=1e-9)


def one_frame(history: GraspHistory, frame: int) -> GraspHistory:
    only = slice(frame, frame + 1)
    pads = tuple(
        replace(
            pad,
            position_mm=pad.position_mm[only],
            gel_displacement_mm=pad.gel_displacement_mm[only],
            force_N=pad.force_N[only],
            episode=pad.episode[only],
        )
        for pad in history.pads
    )
    return GraspHistory(time_s=history.time_s[only], phase=history.phase[only], pads=pads)


def test_one_loaded_frame_falls_back_on_the_surface(free_ball):
    exact = grasp(surface_mm=0.0, noise=0.1)
    found = estimate_modulus(one_frame(exact, 4), free_ball, budget=BUDGET)
    assert found.form == "absolute"
    assert found.E_MPa == pytest.approx(E_MPA, rel=0.02)
    assert "only one frame" in found.warnings[0]


def test_a_noisy_recording_falls_back_on_the_surface_and_says_why(free_ball):
    exact = grasp(surface_mm=0.0, noise=0.1)
    noisy = tuple(replace(pad, displacement_sd_mm=1.0) for pad in exact.pads)
    found = estimate_modulus(replace(exact, pads=noisy), free_ball, budget=BUDGET)
    assert found.form == "absolute"
    (warning,) = found.warnings
    assert "noise leaves the comparison of 9 loaded frames" in warning
    assert "only one frame is loaded" not in warning


def test_a_long_recording_is_thinned_evenly(free_ball):
    history = grasp(noise=0.5)
    frames = 450
    at = np.linspace(0, len(RADII_MM) - 1, frames)
    before, share = np.minimum(at.astype(int), len(RADII_MM) - 2), at % 1
    share[-1] = 1.0

    def between(values):
        return values[before] + share[:, None, None] * (values[before + 1] - values[before])

    pads = tuple(
        replace(
            pad,
            position_mm=between(pad.position_mm),
            gel_displacement_mm=between(pad.gel_displacement_mm),
            force_N=between(pad.force_N),
            episode=np.minimum(pad.episode[before], pad.episode[before + 1]),
            lag1=0.9,
        )
        for pad in history.pads
    )
    long = GraspHistory(time_s=np.arange(frames) / 30, phase=tuple(PHASES[b] for b in before), pads=pads)
    found = estimate_modulus(long, free_ball, budget=BUDGET)
    used = np.flatnonzero(found.loaded)
    assert len(used) == MOST_FRAMES
    assert (used[0], used[-1]) == (0, frames - 1)
    assert set(np.diff(used)) == {3, 4}
    assert {frame.frame for frame in found.frames} == set(used)
    assert found.residual_mm.shape[0] == MOST_FRAMES
    assert found.E_MPa == pytest.approx(E_MPA, rel=0.01)


def test_few_frames_are_all_used():
    loaded = np.arange(300) % 3 == 0
    np.testing.assert_array_equal(thinned(loaded), loaded)
    assert spacing(loaded) == 3.0
    assert spacing(np.arange(5) == 2) == 1.0


@pytest.mark.parametrize("surface_mm", [-0.1, 0.1])
def test_the_absolute_forms_error_bar_knows_of_the_surface(free_ball, surface_mm):
    scanned = grasp(surface_mm=surface_mm)
    found = estimate_modulus(one_frame(scanned, 4), free_ball, budget=BUDGET)
    assert abs(found.E_MPa / E_MPA - 1) > 0.03
    assert abs(found.E_MPa - E_MPA) < 2.5 * found.E_sd_MPa


def test_forces_that_pull_are_refused(free_ball):
    history = grasp()
    pulled = replace(history, pads=tuple(replace(p, force_N=-p.force_N) for p in history.pads))
    with pytest.raises(FemFailure, match="check the signs") as caught:
        estimate_modulus(pulled, free_ball, budget=BUDGET)
    assert caught.value.problem is FemProblem.NO_MODULUS


def test_no_touch_is_refused(free_ball):
    history = grasp()
    air = replace(history, pads=tuple(replace(p, episode=0 * p.episode - 1) for p in history.pads))
    with pytest.raises(FemFailure) as caught:
        estimate_modulus(air, free_ball, budget=BUDGET)
    assert caught.value.problem is FemProblem.NO_LOAD


def test_a_gain_of_one_pad_is_said(free_ball):
    history = grasp()
    left, right = history.pads
    uneven = replace(history, pads=(replace(left, force_N=1.15 * left.force_N), right))
    found = estimate_modulus(uneven, free_ball, budget=BUDGET)
    assert any("do not balance" in sentence for sentence in found.warnings)


def test_a_lag_of_the_forces_is_said_and_widens_the_error_bar(free_ball):
    history = grasp()
    late = tuple(replace(p, force_N=np.concatenate([p.force_N[:1], p.force_N[:-1]])) for p in history.pads)
    plain = estimate_modulus(history, free_ball, budget=BUDGET)
    found = estimate_modulus(replace(history, pads=late), free_ball, budget=BUDGET)
    assert found.warnings
    assert found.least_squares.own_sd_MPa > 3 * plain.least_squares.own_sd_MPa


def test_grasps_that_agree_sharpen_and_grasps_that_do_not_widen(free_ball):
    found = [estimate_modulus(grasp(s), free_ball, budget=BUDGET) for s in range(3)]
    together = combine_grasps(found)
    assert together.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert together.E_sd_MPa < found[0].E_sd_MPa
    assert together.between_sd_MPa == 0.0
    odd = replace(found[0], E_MPa=1.3 * found[0].E_MPa)
    apart = combine_grasps([odd, *found[1:]])
    assert apart.E_sd_MPa > 3 * together.E_sd_MPa
    assert "disagree" in apart.warnings[0]
    assert combine_grasps(found[:1]).E_MPa == pytest.approx(found[0].E_MPa)


def test_the_budget_adds_up():
    none = ErrorBudget(pit_offset_sd_mm=0.0, pit_size_sd=0.0, surface_sd_mm=0.0)
    assert none.model_sd == pytest.approx(0.003)
    assert replace(none, pit_size_sd=0.04).model_sd == pytest.approx(np.hypot(0.003, 0.014))
    assert replace(none, poisson_ratio_sd=0.02).model_sd == pytest.approx(np.hypot(0.003, 0.021))


def test_poisson_ratio_moves_the_modulus_as_the_budget_says(ball_mesh, free_ball):
    other = UnitModulusSolid.factorise(ball_mesh, poisson_ratio=NU + 0.02, support="free")
    here = estimate_modulus(grasp(), free_ball, budget=BUDGET)
    there = estimate_modulus(grasp(), other, budget=BUDGET)
    spread = replace(BUDGET, pit_offset_sd_mm=0, pit_size_sd=0, surface_sd_mm=0, poisson_ratio_sd=0.02)
    assert 1 - there.E_MPa / here.E_MPa == pytest.approx(spread.model_sd, rel=0.35)
