"""Slow drift of the load with which the finger is pressed on."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import number
from ..grid import as_real


class SinusoidalLoad(eqx.Module):
    """The load is 1 + d(t) times the nominal one, d = fraction sin(2 pi t/period + phase).

    Traction, and with it the charge Q of the whole field, its uniform mean included, is scaled by
    1 + d. That is exact for tractions that go with the load. On a profile pressed into the skin it
    is an idealisation: in full contact only the mean pressure follows the load, in partial contact
    the contact grows with it.

    Raises `BadInput` for a fraction outside [0, 1], beyond which the load would pull, and for a
    period that is not positive.
    """

    fraction: Float[Array, ""]
    period_s: Float[Array, ""]
    phase_rad: Float[Array, ""]

    def __init__(self, fraction, period_s, phase_rad=0.0):
        wanted = "a number between 0 and 1"
        self.fraction = as_real(number("drift.fraction", fraction, wanted, least=0, most=1))
        wanted = "a positive time in seconds"
        self.period_s = as_real(number("drift.period_s", period_s, wanted, above=0))
        self.phase_rad = as_real(number("drift.phase_rad", phase_rad, "an angle in radians"))

    def load(self, time_s: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """1 + d: the load over the nominal one."""
        return 1 + self.fraction * jnp.sin(self._angle(time_s))

    def load_rate(self, time_s: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """d' [1/s]."""
        turn = 2 * jnp.pi / self.period_s
        return self.fraction * turn * jnp.cos(self._angle(time_s))

    @compiled
    def __call__(
        self,
        time_s: Float[Array, " sample"],
        signal: Float[Array, "e sample"],
        charge_signal: Float[Array, "e sample"] | None = None,
    ) -> Float[Array, "e sample"]:
        """The signal, less its offset, under the drifting load, from that under the nominal one.

        A rate signal R_f dQ/dt becomes R_f d/dt[(1 + d) Q] = (1 + d) signal + d' charge_signal,
        with `charge_signal` = R_f Q in the signal's unit times s: the load's change gives a signal
        at a standstill too. A readout of the charge itself (an amplifier of order 0) has no
        `charge_signal`: it becomes (1 + d) signal.
        """
        drifted = self.load(time_s)[None] * signal
        if charge_signal is None:
            return drifted
        return drifted + self.load_rate(time_s)[None] * charge_signal

    def _angle(self, time_s: Float[Array, " sample"]) -> Float[Array, " sample"]:
        return 2 * jnp.pi * time_s / self.period_s + self.phase_rad
