"""The ring and the sum tree: what they hold, how often they give it, and that size costs nothing."""

import time
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.learn import replay


def filled(capacity=64, rows=64):
    ring = replay.ring_init(capacity, 2)
    batch = jnp.arange(rows, dtype=jnp.float32)[:, None] * jnp.ones((1, 2))
    return replay.ring_add(ring, batch)


def test_layout_packs_and_unpacks():
    layout = replay.RowLayout((("observation", 2), ("reward", 1)))
    rows = layout.pack({"observation": jnp.ones((3, 2)), "reward": jnp.arange(3)})
    assert rows.shape == (3, layout.width) == (3, 3)
    np.testing.assert_array_equal(layout.unpack(rows)["reward"][:, 0], [0, 1, 2])


def test_ring_writes_over_the_oldest():
    ring = replay.ring_init(6, 1)
    for k in range(4):
        ring = replay.ring_add(ring, jnp.full((2, 1), k, jnp.float32))
    np.testing.assert_array_equal(ring.rows[:, 0], [3, 3, 1, 1, 2, 2])
    assert (int(ring.position), int(ring.size)) == (2, 6)


def test_ring_gives_only_what_is_there_and_evenly():
    ring = filled(capacity=64, rows=16)
    rows, where = replay.ring_sample(ring, jax.random.key(0), 40_000)
    np.testing.assert_array_equal(rows[:, 0], where.astype(jnp.float32))
    counts = np.bincount(np.asarray(where), minlength=64)
    assert counts[16:].sum() == 0
    # 16 equal shares of 40000: 2500 +- 5 standard deviations of 48.4
    assert np.all(np.abs(counts[:16] - 2_500) < 242)


@pytest.mark.parametrize("capacity", [1, 7, 8, 9, 64, 65, 1_000])
def test_tree_sums(capacity):
    values = jax.random.uniform(jax.random.key(capacity), (capacity,))
    tree = replay.tree_set(replay.tree_init(capacity), jnp.arange(capacity), values)
    assert len(tree[-1]) == replay.BRANCHES
    for lower, upper in pairwise(tree):
        sums = np.asarray(lower).reshape(-1, 8).sum(1)
        np.testing.assert_allclose(upper[: len(sums)], sums, rtol=1e-6)
    assert float(replay.tree_total(tree)) == pytest.approx(float(values.sum()), rel=1e-5)


def test_tree_finds_the_leaf_under_each_point():
    # Leaves 1, 0, 2, 0, 3: cumulated 1, 1, 3, 3, 6.
    tree = replay.tree_set(replay.tree_init(20), jnp.arange(5), jnp.asarray([1.0, 0.0, 2.0, 0.0, 3.0]))
    points = jnp.asarray([0.0, 0.999, 1.0, 2.999, 3.0, 5.999, 6.0, 7.0])
    indices, values = replay.tree_find(tree, points)
    np.testing.assert_array_equal(indices, [0, 0, 2, 2, 4, 4, 4, 4])
    np.testing.assert_array_equal(values, tree[0][indices])


def test_prioritised_proportions_and_weights():
    memory = replay.prioritised_add(replay.prioritised_init(64, 1), jnp.arange(8, dtype=jnp.float32)[:, None])
    priorities = jnp.asarray([1.0, 2.0, 3.0, 4.0, 0.5, 0.25, 0.0, 5.25])
    memory = replay.prioritised_update(memory, jnp.arange(8), priorities)
    rows, where, weight = replay.prioritised_sample(memory, jax.random.key(1), 64_000, 0.5)
    np.testing.assert_array_equal(rows[:, 0], where.astype(jnp.float32))
    share = np.bincount(np.asarray(where), minlength=8) / 64_000
    # Total 16. Stratified draws: each count is within a few of its expectation.
    np.testing.assert_allclose(share, np.asarray(priorities) / 16, atol=2e-3)
    # (N P)^-0.5 over the largest, which is the rarest that occurs: P = 0.25 / 16.
    expected = (np.asarray(priorities)[np.asarray(where)] / 0.25) ** -0.5
    np.testing.assert_allclose(weight, expected, rtol=1e-5)


def test_new_rows_get_the_highest_priority():
    memory = replay.prioritised_add(replay.prioritised_init(8, 1), jnp.ones((2, 1)))
    memory = replay.prioritised_update(memory, jnp.asarray([0]), jnp.asarray([7.0]))
    memory = replay.prioritised_add(memory, jnp.ones((2, 1)))
    np.testing.assert_array_equal(memory.tree[0][:4], [7, 1, 7, 7])


@pytest.mark.parametrize("prioritised", [False, True])
def test_step_time_does_not_grow_with_the_memory(prioritised):
    """Ten thousand or a million rows: one step costs the same, within a generous factor."""

    def seconds_a_step(capacity, steps=400):
        def run(memory, key):
            def one(memory, step_key):
                if not prioritised:
                    memory = replay.ring_add(memory, jnp.ones((1, 12)))
                    return memory, replay.ring_sample(memory, step_key, 64)[0].sum()
                memory = replay.prioritised_add(memory, jnp.ones((1, 12)))
                rows, where, weight = replay.prioritised_sample(memory, step_key, 64, 0.5)
                return replay.prioritised_update(memory, where, weight), rows.sum()

            return jax.lax.scan(one, memory, jax.random.split(key, steps))

        make = replay.prioritised_init if prioritised else replay.ring_init
        memory = make(capacity, 12)
        compiled = jax.jit(run, donate_argnums=0).lower(memory, jax.random.key(0)).compile()
        memory, out = jax.block_until_ready(compiled(memory, jax.random.key(0)))
        best = np.inf
        for _ in range(4):
            start = time.process_time()
            memory, out = jax.block_until_ready(compiled(memory, jax.random.key(1)))
            best = min(best, time.process_time() - start)
        assert np.isfinite(out).all()
        return best / steps

    # A copy of a million rows would cost some 5 ms a step, a hundred times what a step takes.
    assert seconds_a_step(1_000_000) < 4.0 * seconds_a_step(10_000) + 20e-6
