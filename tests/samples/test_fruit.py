import numpy as np

from recon.pit.priors import load_prior
from recon.triangle_mesh import volume_mm3
from samples.cubed_sphere import even_sphere
from samples.fruit import (
    PIT_OVER_BOX,
    PIT_RAISED,
    POISSON_RATIO,
    box_mm,
    fruit_of_seed,
    fruits_of_seed,
)


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
