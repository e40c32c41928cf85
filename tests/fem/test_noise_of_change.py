"""What noise adds to the products of a model that holds an effect: beside draws of such noise."""

import numpy as np
import pytest
from jaxtyping import Float

from fem.mismatch.model.force_noise import NoiseOfChange, noise_of_change

DRAWS, NUMBERS = 4000, 30


def drawn() -> tuple[Float[np.ndarray, "p d"], Float[np.ndarray, "c p d"]]:
    """Noise e of the data, and of the columns 1/E and two signatures, which share a part of it; W is 1."""
    rng = np.random.default_rng(0)
    parts = rng.normal(size=(4, DRAWS, NUMBERS))
    e = parts[0] + 0.8 * parts[1]
    return e, np.stack(
        [parts[1] - 0.3 * parts[2], 0.5 * parts[1] + parts[2], 0.4 * parts[0] + 0.2 * parts[3]]
    )


def mean_product(a: Float[np.ndarray, "p d"], b: Float[np.ndarray, "p d"]) -> float:
    return float((a * b).sum(axis=1).mean())


def found_at(amounts: tuple[float, float]) -> NoiseOfChange:
    e, fields = drawn()
    bias = np.array([[mean_product(field, e) for field in fields]])
    products = np.array([[[mean_product(a, b) for b in fields] for a in fields]])
    return noise_of_change(bias, products, np.array(amounts))


@pytest.mark.parametrize("amounts", [(0.0, 0.0), (0.2, 0.1), (-0.4, -0.3), (-0.3, 0.2)])
def test_products_are_those_of_noise_that_the_effect_has_changed(amounts: tuple[float, float]) -> None:
    e, fields = drawn()
    changed = e - amounts[0] * fields[1] - amounts[1] * fields[2]
    plain = fields[0] + amounts[0] * fields[1] + amounts[1] * fields[2]
    noise = found_at(amounts)
    assert noise.square == pytest.approx(mean_product(e, e) - mean_product(changed, changed))
    assert noise.plain == pytest.approx(mean_product(plain, changed))
    for product, field in zip(noise.signatures[0], fields[1:], strict=True):
        assert product == pytest.approx(mean_product(field, changed))


def test_a_large_effect_leaves_no_more_noise_than_the_least_that_its_signatures_can() -> None:
    e, fields = drawn()
    product, square = mean_product(fields[1], e), mean_product(fields[1], fields[1])
    for large in (1.2, 30.0):
        noise = found_at((large * product / square, 0.0))
        assert noise.square == pytest.approx(product**2 / square)
        assert noise.signatures[0, 0] == pytest.approx(0.0, abs=1e-9 * product)
