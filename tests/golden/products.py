"""Values of the models, and products of their Jacobians with fixed random vectors, forward and in
reverse.

Numbers enter as factors on their values, so that derivatives have the size of the values; one
compiled program gives all of a model.
"""

import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tests.golden.entries import Entries, entry
from tests.golden.models import MODELS, Model, Numbers


def entries(name: str) -> Entries:
    """Value, J v and w J of a model, the latter for each of its numbers."""
    make, numbers = MODELS[name]
    products = _products(make(), numbers, np.random.default_rng(zlib.crc32(name.encode())))
    return {key: entry(value) for key, value in products.items()}


def _products(model: Model, numbers: Numbers, rng: np.random.Generator) -> dict[str, Any]:
    turns = {key: rng.uniform(0.5, 1.5, np.shape(value)) for key, value in sorted(numbers.items())}

    def flat(factors):
        value = model({key: factors[key] * jnp.asarray(numbers[key]) for key in numbers})
        rows = [leaf.ravel() / jax.lax.stop_gradient(_rms(leaf)) for leaf in jax.tree.leaves(value)]
        return jnp.concatenate(rows), [_rms(leaf) for leaf in jax.tree.leaves(value)]

    ones = {key: np.ones(np.shape(value)) for key, value in numbers.items()}
    size = jax.eval_shape(flat, ones)[0].size
    weights = rng.uniform(-1, 1, size)

    @jax.jit
    def solve(ones, turns, weights):
        value, forward, sizes = jax.jvp(flat, (ones,), (turns,), has_aux=True)
        pull = jax.vjp(flat, ones, has_aux=True)[1]
        return {"value": value, "forward": forward, "size": jnp.stack(sizes)} | {
            f"reverse {key}": back for key, back in pull(weights)[0].items()
        }

    return jax.device_get(solve(ones, turns, weights))


def _rms(leaf):
    return jnp.sqrt(jnp.mean(leaf**2))
