"""Base classes of effects: each is added to a scenario, or bounded without doing so."""

import abc
import math
from collections.abc import Mapping
from enum import IntEnum
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..errors import of_kind, refuse
from ..forward.scenario import Scenario
from ._reference import ReferenceSpectra


class Order(IntEnum):
    """Order in which effects are added: from the film outwards, as later ones act on earlier
    ones."""

    FILM = 0
    SKIN = 1
    CONTACT = 2
    DIRECTION = 3
    SLIDING = 4
    ELECTRONICS = 5
    MOTION = 6
    LOAD = 7
    RECORD = 8


class Effect(eqx.Module):
    """Base of effects: an edit of a scenario that departs from the ideal sensor.

    - `order`: when it is added, a member of `srsinv.effects.Order`.
    - `of_sensor`: whether it belongs to the sensor and its skin, so that recordings are inverted
      with it too; else to a simulated scene and its recording.
    - `is_exact`: whether its `factor` is its whole effect.

    `apply` is to be defined.
    """

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    is_exact: ClassVar[bool] = False

    @property
    def sampling_rate_hz(self) -> float | None:
        """The recorder's own rate [Hz], where it sets one."""
        return None

    @property
    def saturation(self) -> float:
        """Saturation level, in signal units."""
        return math.inf

    @property
    def max_gain(self) -> float:
        """The largest factor by which it may raise the signal for a while."""
        return 1.0

    def load(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        """The load over the nominal one."""
        return np.ones_like(time_s)

    def is_defined_in(self, scenario: Scenario) -> bool:
        """Whether the scenario's own definition has what it adds, so that it cannot be added."""
        del scenario
        return False

    @abc.abstractmethod
    def apply(self, scenario: Scenario) -> Scenario:
        """The scenario with this effect."""

    def factor(
        self, reference: ReferenceSpectra
    ) -> Complex[np.ndarray, "e k"] | Float[np.ndarray, "e k"] | None:
        """The factor on the spectrum of every element; None where it is not known to be one."""
        del reference

    def noise(self, reference: ReferenceSpectra) -> ReferenceSpectra | None:
        """Reference spectra of the noise that it adds, alone; None where it adds none."""
        del reference

    def relative_quantisation_step(self, reference: ReferenceSpectra) -> float:
        """The step that samples are rounded to, which may turn a small change into a whole step,
        over the signal's rms; 0 where it rounds none."""
        del reference
        return 0.0

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        """A bound on its change of the signal, rms over rms, beside the effects in the reference.

        Infinite where none is known, so that `effects=auto` keeps the effect on.
        """
        del reference
        return math.inf


class MultiplicativeEffect(Effect):
    """An effect that multiplies the signal's spectrum, and so attenuates the changes by others,
    too."""

    is_exact: ClassVar[bool] = True

    @abc.abstractmethod
    def factor(
        self, reference: ReferenceSpectra
    ) -> Complex[np.ndarray, "e k"] | Float[np.ndarray, "e k"]:
        """The factor on the spectrum of every element."""

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        return reference.relative_rms((self.factor(reference) - 1) * reference.signal)


class NoiseEffect(Effect):
    """An effect that adds noise of its own, which passes film, skin and electronics, too."""

    @abc.abstractmethod
    def noise(self, reference: ReferenceSpectra) -> ReferenceSpectra | None:
        """Reference spectra of the noise alone, its spectrum along the line that of the charge;
        None where there is none."""

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        noise = self.noise(reference)
        return 0.0 if noise is None else noise.relative_rms(noise.signal)


def add_effects(scenario: Scenario, named: Mapping[str, Effect]) -> Scenario:
    """The scenario with these effects, one after another. Raises `BadInput` for one that its skin
    defines already."""
    for name, effect in named.items():
        of_kind(f"effects.{name}", effect, Effect, "an effect, as srsinv.effects has them")
        refuse(
            effect.is_defined_in(scenario),
            f"effects names {name}, but skin defines one already "
            f"({scenario.sensor.skin.words}): leave the effect out, or give "
            "skin=half_space.",
        )
        what, wanted = f"what effects.{name} makes", "the scenario with the effect"
        made = of_kind(what, effect.apply(scenario), Scenario, wanted)
        refuse((made.scene is None) != (scenario.scene is None), f"{what} has no scene: keep it.")
        scenario = made
    return scenario
