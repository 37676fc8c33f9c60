"""How the finger moves over the surface."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import refuse
from ..grid import Line, as_real


class ConstantSpeed(eqx.Module):
    """Sliding at u [m/s]: x(t) = x0 + u t, d/dt = u d/dx (the paper's (3)).

    A negative speed slides towards -x, and friction turns with it. Zero is a static touch: the
    rate signal is then nothing. Raises `BadInput` for a speed that is not finite.
    """

    speed_m_per_s: Float[Array, ""]

    def __init__(self, speed_m_per_s=0.05):
        if isinstance(speed_m_per_s, (int, float)):
            refuse(
                not np.isfinite(speed_m_per_s),
                f"scan.speed_m_per_s is {speed_m_per_s}: give a finite speed in m/s.",
            )
        self.speed_m_per_s = as_real(speed_m_per_s)

    @property
    def direction(self) -> Float[Array, ""]:
        """sign(u): the sign with which Coulomb friction enters q = sign(u) mu p."""
        return jnp.sign(self.speed_m_per_s)

    def time_s(self, line: Line) -> Float[Array, " n"]:
        """When the sensor stands at each x, from zero at the first one met.

        NaN for a static touch, which stands at one x for ever.
        """
        time = (line.x - line.start_m) / self.speed_m_per_s
        return time - time.min()

    def sample_rate_hz(self, line: Line) -> Float[Array, ""]:
        """Samples per second, one for each cell."""
        return jnp.abs(self.speed_m_per_s) / line.cell_m
