"""Column blocks: the product of what they were made of, and what culling leaves out."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.operators.clustered import clustered
from jaxrelight.operators.clustering import cluster
from jaxrelight.operators.column_blocks import ColumnBlocks

ROWS, COLUMNS = 16, 64


def some(channels: int, groups: int = 5):
    """Groups of which one holds nothing, and rows that fall off."""
    random = np.random.default_rng(0)
    rows = random.normal(size=(groups, ROWS, channels, COLUMNS)) * 0.9 ** np.arange(COLUMNS)
    rows[2] = 0
    every = [cluster(one.astype(np.float32), np.ones(COLUMNS, np.float32), 0.05)[0] for one in rows]
    return every, jnp.asarray(random.normal(size=(COLUMNS, 3)) * 0.8 ** np.arange(COLUMNS)[:, None], jnp.float32)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("bits", [8, 16])
def test_the_product_is_that_of_the_clusters(channels, bits):
    every, light = some(channels)
    made = ColumnBlocks(every, COLUMNS, bits)
    wanted = clustered(every, COLUMNS).apply(light)
    product, count = made.apply(light)
    assert made.shape == (5 * ROWS, COLUMNS, channels)
    assert count == made.count == sum(len(one.support) for one in every)
    assert np.linalg.norm(product - wanted) < 2.0 ** (2 - bits) * np.linalg.norm(wanted)
    assert not product[2 * ROWS : 3 * ROWS].any()


def test_culling_trades_error_for_blocks():
    every, light = some(1)
    made = ColumnBlocks(every, COLUMNS, 16)
    whole, count = made.apply(light)
    errors, counts = [], [count]
    for culling in (1e-3, 0.03, 0.1, 0.3):
        product, count = made.apply(light, culling)
        errors.append(float(jnp.linalg.norm(product - whole) / jnp.linalg.norm(whole)))
        counts.append(count)
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < 0.5 * counts[0]
    assert errors == sorted(errors)
    assert errors[0] < 1e-2 < errors[-1] < 0.5


def test_without_light_nothing_is_added():
    every, light = some(3)
    product, count = ColumnBlocks(every, COLUMNS).apply(0 * light, 0.1)
    assert count == 0
    assert not product.any()


def test_light_of_another_shape_is_refused():
    every, light = some(3)
    with pytest.raises(ValueError, match="light has 63 coefficients, the operator 64"):
        ColumnBlocks(every, COLUMNS).apply(light[1:])
    with pytest.raises(ValueError, match="light has 2 channels, the operator 3"):
        ColumnBlocks(every, COLUMNS).apply(light[:, :2])
