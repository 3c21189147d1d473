"""A rare branch gives in a batch what it gives alone, and is left out where nobody needs it."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax

from kedge.numerics.branching import whenever


def draw(flag, key, scale):
    return whenever(
        flag,
        lambda: {"x": scale * jr.normal(key, (3,)), "n": jnp.asarray(1)},
        lambda: {"x": scale + jnp.zeros(3), "n": jnp.asarray(0)},
    )


def test_alone_and_in_a_batch():
    keys, scales = jr.split(jr.key(0), 4), jnp.arange(4.0)
    for flags in ([False] * 4, [True] * 4, [False, True, False, True]):
        batch = jax.jit(jax.vmap(draw))(jnp.array(flags), keys, scales)
        for i, flag in enumerate(flags):
            alone = draw(jnp.asarray(flag), keys[i], scales[i])
            np.testing.assert_array_equal(batch["x"][i], alone["x"])
            assert batch["n"][i] == flag


def test_what_is_not_batched_is_shared_and_scans_nest():
    def run(scale):
        def body(total, flag):
            return total + draw(flag, jr.key(1), scale)["x"], None

        return lax.scan(body, jnp.zeros(3), jnp.array([True, False, False]))[0]

    together = jax.vmap(run)(jnp.arange(3.0))
    np.testing.assert_allclose(together, jnp.stack([run(s) for s in jnp.arange(3.0)]))


def test_the_rare_side_stays_a_branch():
    """Its cosine stands inside a conditional of the batched program, and nowhere else."""

    def one(flag, x):
        return whenever(flag, lambda: jnp.cos(x), lambda: x)

    text = str(jax.make_jaxpr(jax.vmap(one))(jnp.zeros(4, bool), jnp.ones(4)))
    assert text.count("cos ") == 1
    assert "cond[" in text
    assert text.index("cond[") < text.index("cos ")
