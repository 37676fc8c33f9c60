"""What an effect is: something that can be added to a setup, and bounded without doing so."""

import abc
import math
from enum import IntEnum
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..setup import Setup
from ._glance import Glance


class Order(IntEnum):
    """When an effect is added: from the film outwards, as later ones act on what is there."""

    FILM = 0
    SKIN = 1
    DIRECTION = 2
    SLIDING = 3
    ELECTRONICS = 4
    MOTION = 5
    LOAD = 6
    RECORD = 7


class Effect(eqx.Module):
    """Something that acts beside the ideal sensor.

    `order`: when it is added. `of_sensor`: whether it belongs to the sensor and its skin, so that
    recordings are inverted with it too; else to a simulated scene and its recording.
    """

    order: ClassVar[Order]
    of_sensor: ClassVar[bool]

    @property
    def rail(self) -> float:
        """Beyond which, in signal units, it leaves nothing of a sample."""
        return math.inf

    @property
    def swing(self) -> float:
        """By how much it may raise the signal for a while."""
        return 1.0

    @abc.abstractmethod
    def added(self, setup: Setup) -> Setup:
        """The setup with this effect."""

    @abc.abstractmethod
    def share(self, glance: Glance) -> float:
        """A bound on how much of the signal it changes: rms change over rms signal."""


class Factor(Effect):
    """An effect that multiplies the signal's spectrum, and so takes of what others change, too.

    `is_exact`: whether it does nothing else.
    """

    is_exact: ClassVar[bool] = True

    @abc.abstractmethod
    def factor(self, glance: Glance) -> Complex[np.ndarray, "e k"] | Float[np.ndarray, "e k"]:
        """What it multiplies the spectrum of every element by."""

    def share(self, glance: Glance) -> float:
        return glance.share((self.factor(glance) - 1) * glance.signal)


class Bursting(Effect):
    """An effect that adds noise of its own, which passes film, skin and electronics, too."""

    @abc.abstractmethod
    def bursts(self, glance: Glance) -> Glance:
        """A look at the noise alone, its spectrum along the line that of what films feel."""

    def share(self, glance: Glance) -> float:
        noise = self.bursts(glance)
        return noise.share(noise.signal)


class Resampling(Effect):
    """An effect that sets the recorder's own rate."""

    rate_hz: eqx.AbstractVar[float]


class Rounding(Effect):
    """An effect that rounds samples, and makes a step of its own of a small change."""

    @abc.abstractmethod
    def grain(self, glance: Glance) -> float:
        """The step over the signal's rms. Where a change of d turns a sample over, which it does
        to d/step of them, it makes a step of it: rms sqrt(d step)."""
