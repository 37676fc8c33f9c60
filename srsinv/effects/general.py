"""Effects of one part that the configuration names: a filter, a speed profile, or an effect along
the line of every film."""

import dataclasses
from typing import ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Complex

from ..forward.film import LineEffect
from ..forward.filter import Filter
from ..forward.scenario import Scenario
from ..forward.speed_profile import SpeedProfile
from ..grid import as_real
from ._effect import Effect, MultiplicativeEffect, Order
from ._reference import ReferenceSpectra

Profile = TypeVar("Profile", bound=SpeedProfile)


class FilmEffect(MultiplicativeEffect):
    """The same effect along the line at every film."""

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True
    line_effect: LineEffect

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_films(lambda film: film.with_effect(self.line_effect))

    def factor(self, reference: ReferenceSpectra) -> Complex[np.ndarray, "e k"]:
        factor = np.asarray(self.line_effect.transfer(as_real(reference.k)))
        return factor[None] * np.ones_like(reference.transfer_of_others)


class FilterEffect(MultiplicativeEffect):
    """A further filter behind the amplifier."""

    order: ClassVar[Order] = Order.ELECTRONICS
    of_sensor: ClassVar[bool] = True
    filter: Filter

    def apply(self, scenario: Scenario) -> Scenario:
        sensor = scenario.sensor
        return scenario.replace(
            sensor=dataclasses.replace(sensor, filters=(*sensor.filters, self.filter))
        )

    def factor(self, reference: ReferenceSpectra) -> Complex[np.ndarray, "e k"]:
        by = jax.tree.map(lambda leaf: float(leaf) if eqx.is_array(leaf) else leaf, self.filter)
        return by.response(reference.k * reference.speed_m_per_s, np)[None] * np.ones_like(
            reference.transfer_of_others
        )


class SpeedProfileEffect(Effect, Generic[Profile]):
    """One more departure from constant speed."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    speed_profile: Profile

    def apply(self, scenario: Scenario) -> Scenario:
        profiles = (*scenario.recorder.speed_profiles, self.speed_profile)
        return scenario.with_recorder(speed_profiles=profiles)
