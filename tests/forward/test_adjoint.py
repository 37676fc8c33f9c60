"""Adjoint identity <y, A r> = <A^T y, r> of every operator, with every effect named."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.forward.setups import AMPLIFIERS, LINES, SCAN, full_sensor, zoned_sensor
from tests.tiers import quick

STAGES = {
    "stress": full_sensor().stress(),
    "charge": full_sensor().charge(),
    "current": full_sensor().current(SCAN),
    "zone": zoned_sensor().current(SCAN),
    **{name: full_sensor(amplifier).output(SCAN) for name, amplifier in AMPLIFIERS.items()},
}
DRAW = np.random.default_rng(7).normal(size=(14, 64))


@cache
def three_ways(name):
    """A r, A^T y by `adjoint` and by transposing A, for every stage in one compiled program."""
    line = LINES[name]

    @eqx.filter_jit
    def solve(line, stages, draw):
        r, signals = draw[:2], draw[2:]

        def one(stage):
            operator = line.operator(stage)
            forward = operator(r)
            y = signals[: forward.shape[0]]
            return forward, operator.adjoint(y), jax.linear_transpose(operator, r)(y)[0]

        return {name: one(stage) for name, stage in stages.items()}

    return jax.device_get(solve(line, STAGES, jnp.asarray(DRAW[:, : line.n])))


@pytest.mark.parametrize("line", quick(LINES, "periodic_even", "open_odd"))
@pytest.mark.parametrize("stage", STAGES)
def test_adjoint_identity(line, stage):
    forward, adjoint, transposed = three_ways(line)[stage]
    r, y = DRAW[:2, : LINES[line].n], DRAW[2 : 2 + len(forward), : LINES[line].n]
    scale = np.linalg.norm(forward) * np.linalg.norm(y)
    assert abs(np.vdot(y, forward) - np.vdot(adjoint, r)) < 1e-12 * scale
    np.testing.assert_allclose(adjoint, transposed, atol=1e-12 * np.abs(transposed).max(), rtol=0)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_adjoint_identity_of_differences(line, order):
    draw = np.random.default_rng(8).normal
    r = jnp.asarray(draw(size=(2, line.n)))
    differ = eqx.filter_jit(lambda r: line.differences(r, order))
    forward = differ(r)
    y = jnp.asarray(draw(size=forward.shape))
    (adjoint,) = jax.linear_transpose(differ, r)(y)
    assert abs(float(jnp.vdot(y, forward) - jnp.vdot(adjoint, r))) < 1e-12 * line.n


@pytest.mark.full
@pytest.mark.parametrize("name", ["periodic_even", "open_odd"])
def test_symbol_is_the_spectrum_of_the_kernel(name):
    """The signals of unit cells at both ends hold every lag of an open line's kernel; on a periodic
    one the symbol at its wavenumbers is the transfer."""
    line, stage = LINES[name], STAGES["current"]
    k = np.linspace(0.0, np.pi / 1e-4, 7) if name.startswith("open") else line.k
    operator = line.operator(stage)
    symbol = np.asarray(operator.symbol(jnp.asarray(k)))
    if operator.is_circular:
        expected = operator.transfer
    else:
        ends = jnp.zeros((2, 2, 2, line.n))  # end, component, of which component is the unit
        ends = ends.at[0, 0, 0, 0].set(1).at[0, 1, 1, 0].set(1)
        ends = ends.at[1, 0, 0, -1].set(1).at[1, 1, 1, -1].set(1)
        onwards, back = (np.stack([operator(unit) for unit in end], 1) for end in ends)
        lags = np.arange(line.n)
        expected = onwards @ np.exp(-1j * np.outer(lags, k) * 1e-4)
        expected = expected + back[..., ::-1][..., 1:] @ np.exp(1j * np.outer(lags[1:], k) * 1e-4)
    np.testing.assert_allclose(symbol, expected, atol=1e-12 * np.abs(expected).max(), rtol=0)
