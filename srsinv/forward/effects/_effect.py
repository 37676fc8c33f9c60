"""What an effect is: something that can be added to a scenario, and bounded without doing so."""

import abc
import math
from enum import IntEnum
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..scenario import Scenario
from ._reference import ReferenceSpectra


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
    def saturation(self) -> float:
        """Beyond which, in signal units, it leaves nothing of a sample."""
        return math.inf

    @property
    def max_gain(self) -> float:
        """By how much it may raise the signal for a while."""
        return 1.0

    def load(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        """The load over the nominal one."""
        return np.ones_like(time_s)

    @abc.abstractmethod
    def apply(self, scenario: Scenario) -> Scenario:
        """The scenario with this effect."""

    @abc.abstractmethod
    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        """A bound on what it changes of the signal, beside the effects that the reference is with:
        rms change over rms signal."""


class MultiplicativeEffect(Effect):
    """An effect that multiplies the signal's spectrum, and so takes of what others change, too.

    `is_exact`: whether it does nothing else.
    """

    is_exact: ClassVar[bool] = True

    @abc.abstractmethod
    def factor(
        self, reference: ReferenceSpectra
    ) -> Complex[np.ndarray, "e k"] | Float[np.ndarray, "e k"]:
        """What it multiplies the spectrum of every element by; of modulus 1 at most."""

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        return reference.relative_rms((self.factor(reference) - 1) * reference.signal)


class NoiseEffect(Effect):
    """An effect that adds noise of its own, which passes film, skin and electronics, too."""

    @abc.abstractmethod
    def noise(self, reference: ReferenceSpectra) -> ReferenceSpectra:
        """Of the noise alone, its spectrum along the line that of the charge."""

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        noise = self.noise(reference)
        return noise.relative_rms(noise.signal)


class Resampling(Effect):
    """An effect that sets the recorder's own rate."""

    rate_hz: eqx.AbstractVar[float]


class Rounding(Effect):
    """An effect that rounds samples, and makes a step of its own of a small change."""

    @abc.abstractmethod
    def relative_quantisation_step(self, reference: ReferenceSpectra) -> float:
        """The step over the signal's rms."""
