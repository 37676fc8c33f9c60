"""Markov chains of a posterior by the No-U-Turn sampler of blackjax (Hoffman and Gelman 2014)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...compiled import compiled
from ...errors import BadInput
from ...grid import as_real
from ...progress import steps
from ._posterior import FreeDensity

MOST_DENSE = 32  # parameters up to which the metric is a full matrix
SPREADS = (2.0, 1.0, 0.3, 0.1, 0.0)  # standard deviations about the mode, where chains may begin
# A start is taken where its log density is less below that of the mode than of nearly all draws at
# twice the standard deviation from it: 2 m in the mean, of m parameters.
DEEPEST = 10.0, 5.0


class Sampled(NamedTuple):
    """Chains of draws: parameters `z` (chain, draw, m), and the sampler's numbers for each
    (chain, draw). `is_divergent`: the trajectory's energy was lost; `step_size` (chain,)."""

    z: Float[np.ndarray, "chain draw m"]
    log_density: Float[np.ndarray, "chain draw"]
    is_divergent: Bool[np.ndarray, "chain draw"]
    acceptance: Float[np.ndarray, "chain draw"]
    energy: Float[np.ndarray, "chain draw"]
    leapfrogs: Int[np.ndarray, "chain draw"]
    step_size: Float[np.ndarray, " chain"]


def check_sampler() -> None:
    """Refuse to sample where blackjax is not installed."""
    try:
        import blackjax  # noqa: F401
    except ImportError as error:
        raise BadInput(
            "Sampling needs blackjax, which is not installed: type pip install 'srsinv[sample]'."
        ) from error


def sampled(
    density: FreeDensity, draws: int, chains: int, warmup: int, acceptance: float, seed: int
) -> Sampled:
    """Chains that begin about the centre of a density of finite value there."""
    keys = jax.random.split(jax.random.PRNGKey(seed), chains + 1)
    starts, parts = _starts(density, keys[0], chains), []
    is_dense = starts.shape[1] <= MOST_DENSE
    # One after the other: side by side each step would wait for the chain of most leapfrogs, and
    # jaxlib's batched LAPACK can deadlock.
    with steps("sampling the posterior", range(chains)) as each:
        for c in each:
            made = _chain(density, keys[c + 1], starts[c], draws, warmup, as_real(acceptance),
                          is_dense)  # fmt: skip
            parts.append(jax.device_get(made))
    return Sampled(*map(np.stack, zip(*parts, strict=True)))


def _starts(density: FreeDensity, key: Array, chains: int) -> Float[Array, "chain m"]:
    """Scattered points to begin at, nearer to the centre where a density is low at the far ones."""
    m = density.root.shape[0]
    scatter = jax.random.normal(key, (chains, 1, m), density.centre.dtype)
    spreads = np.asarray(SPREADS, density.centre.dtype)[None, :, None]
    points = np.asarray(scatter) * spreads
    heights = np.asarray(_heights(density, as_real(points.reshape(-1, m))))
    heights = heights.reshape(chains, len(SPREADS))
    lowest = heights[:, -1:] - DEEPEST[0] - DEEPEST[1] * m
    chosen = np.argmax(heights >= lowest, axis=1)
    return as_real(points[np.arange(chains), chosen])


@compiled
def _heights(density: FreeDensity, points: Float[Array, "p m"]) -> Float[Array, " p"]:
    return jax.lax.map(density.value, points)


@compiled
def _chain(
    density: FreeDensity, key: Array, start, draws: int, warmup: int, acceptance, is_dense: bool
) -> tuple[Array, ...]:
    """The numbers of `Sampled` for one chain."""
    import blackjax
    from blackjax.adaptation.base import get_filter_adapt_info_fn

    to_adapt, to_draw = jax.random.split(key)
    adaptation = blackjax.window_adaptation(
        blackjax.nuts,
        density,
        is_mass_matrix_diagonal=not is_dense,
        target_acceptance_rate=acceptance,
        adaptation_info_fn=get_filter_adapt_info_fn(),
    )
    run: Any = adaptation.run
    (state, tuned), _ = run(to_adapt, start, warmup)
    step: Any = blackjax.nuts(density, **tuned).step

    def one(state, key):
        state, info = step(key, state)
        own = density.parameters(state.position), state.logdensity, info.is_divergent
        return state, (*own, info.acceptance_rate, info.energy, info.num_integration_steps)

    _, made = jax.lax.scan(one, state, jax.random.split(to_draw, draws))
    return *made, jnp.asarray(tuned["step_size"])
