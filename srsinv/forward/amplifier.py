"""Amplifiers: film charge to the recorded signal, while sliding at the speed u.

Every readout here is signal = gain(u) d^order/dx^order Q + offset. At constant speed that folds
into the transfer; along a measured motion the gain has one value for each sample. Both are exact.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import echo, is_number, number, refuse
from ..grid import Scalar, as_real


class Amplifier(eqx.Module):
    """Base of amplifiers: the signal is a gain times a derivative of the film's charge along x.

    - `order`: of the derivative, 0 for charge [C] and 1 for current [A].
    - `unit`: of the signal. `offset`: the signal at zero charge; None where it is not known.

    `gain` is to be defined.
    """

    order: ClassVar[int]
    unit: ClassVar[str]
    offset: eqx.AbstractVar[Any]

    @abc.abstractmethod
    def gain(self, speed_m_per_s: Float[Any, "*sample"]) -> Float[Any, "*sample"]:
        """Gain on the `order`-th derivative of charge along x, for each speed, or one for all."""

    def at_speed(self, speed_m_per_s: Float[Any, "*sample"]) -> Float[Any, "*sample"]:
        """The gain for each speed. Raises `BadInput` where an amplifier gives another number of
        them."""
        gain, shape = self.gain(speed_m_per_s), jnp.shape(speed_m_per_s)
        refuse(
            not (is_number(gain) or getattr(gain, "shape", None) in ((), shape)),
            f"{type(self).__name__}.gain gives {echo(gain)} for speeds of the shape {shape}: give "
            "a number for each speed, or one for all.",
        )
        return jnp.broadcast_to(gain, shape) if jnp.shape(gain) != shape else gain


def _positive_resistance(value) -> Float[Array, ""]:
    key, wanted = "amplifier.feedback_resistance_ohm", "a positive resistance in ohm"
    return as_real(number(key, value, wanted, above=0))


class CurrentAmplifier(Amplifier):
    """The rate signal v = R_f i, i = u dQ/dx: the paper's (2) and (3)."""

    order: ClassVar[int] = 1
    unit: ClassVar[str] = "V"
    feedback_resistance_ohm: Float[Array, ""]

    def __init__(self, feedback_resistance_ohm=1e6):
        self.feedback_resistance_ohm = _positive_resistance(feedback_resistance_ohm)

    def gain(self, speed_m_per_s: Float[Any, "*sample"]) -> Float[Any, "*sample"]:
        return self.feedback_resistance_ohm * speed_m_per_s

    @property
    def offset(self) -> Float[Array, ""]:
        return as_real(0.0)


class IntegratedCurrent(Amplifier):
    """The rate signal integrated along x, v_i = integral of v dx' = R_f u Q [V m]: (12).

    At constant speed only: `gain` raises `BadInput` for the speeds of a motion.
    """

    order: ClassVar[int] = 0
    unit: ClassVar[str] = "V m"
    feedback_resistance_ohm: Float[Array, ""]

    def __init__(self, feedback_resistance_ohm=1e6):
        self.feedback_resistance_ohm = _positive_resistance(feedback_resistance_ohm)

    def gain(self, speed_m_per_s: Float[Any, "*sample"]) -> Float[Any, "*sample"]:
        refuse(
            speed_m_per_s.ndim > 0,
            "amplifier=integrated needs a constant speed, not a measured motion of "
            f"{speed_m_per_s.size} samples: give amplifier=current, or a constant speed.",
        )
        return self.feedback_resistance_ohm * speed_m_per_s

    @property
    def offset(self) -> Float[Array, ""]:
        return as_real(0.0)


class ChargeReadout(Amplifier):
    """A slow, DC-coupled readout of the charge itself: signal = gain Q + offset.

    Pressure sensors are read this way. `gain_per_C` is in signal units per coulomb; `offset` in
    signal units, or None where it is not known: then the signal's mean is not observable. Raises
    `BadInput` for a gain of 0, and for values that are not numbers.
    """

    order: ClassVar[int] = 0
    unit: ClassVar[str] = "V"
    gain_per_C: Float[Array, ""]
    _offset: Float[Array, ""] | None

    def __init__(self, gain_per_C: Scalar = 1e6, offset=None):
        wanted = "a number other than 0, in the signal's unit per coulomb"
        gain_per_C = number("amplifier.gain_per_C", gain_per_C, wanted)
        refuse(
            is_number(gain_per_C) and gain_per_C == 0,
            f"amplifier.gain_per_C is {gain_per_C}: give {wanted}.",
        )
        if offset is not None:
            offset = number("amplifier.offset", offset, "a number in the signal's unit, or null")
        self.gain_per_C = as_real(gain_per_C)
        self._offset = None if offset is None else as_real(offset)

    def gain(self, speed_m_per_s: Float[Any, "*sample"]) -> Float[Any, "*sample"]:
        return jnp.broadcast_to(self.gain_per_C, speed_m_per_s.shape)

    @property
    def offset(self) -> Float[Array, ""] | None:
        return self._offset
