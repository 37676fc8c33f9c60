"""Effects of one part that the configuration names: a filter, a speed profile, an effect along the
line of every film, or an envelope that the finger presses through."""

import dataclasses
import math
from typing import ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Complex, Float

from ..compiled import compiled
from ..forward.envelope import Envelope
from ..forward.film import LineEffect
from ..forward.filter import Filter
from ..forward.scenario import Scenario
from ..forward.sensor import FilmSignal
from ..forward.speed_profile import SpeedProfile
from ..grid import Periodic, as_real
from ._effect import Effect, MultiplicativeEffect, Order
from ._reference import ReferenceSpectra

# The reference's contact is accurate to 1 % behind the rubber over the film. Short waves, which the
# edge of a contact zone lets through, are off by more: bounds would fall short by 5 %.
SHORT_WAVES = 1.1
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


class EnvelopeEffect(Effect):
    """A further envelope, which the finger presses the surface's traction through."""

    order: ClassVar[Order] = Order.CONTACT
    of_sensor: ClassVar[bool] = True
    envelope: Envelope

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.replace(sensor=scenario.sensor.with_envelope(self.envelope))

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        return change_within_envelopes(self, reference)


def change_within_envelopes(effect: Effect, reference: ReferenceSpectra) -> float:
    """A bound on the change by an effect of the films or of an envelope.

    By the very transfers of the sensor with and without it, within the film, skin and contact that
    all effects make, on the reference's traction. What acts at the films does so before an
    envelope, and is no factor behind one.
    """
    if reference.scenario.scene is None:  # bursts, which are loads of their own
        return 0.0
    every = [*(each for each in reference.named.values() if each is not effect), effect]
    every.sort(key=lambda each: each.order)
    whole = without = reference.scenario
    factors = []
    for each in every:
        if each.order <= Order.SLIDING:
            whole = each.apply(whole)
            without = without if each is effect else each.apply(without)
        elif (factor := each.factor(reference)) is not None:
            factors.append(factor)
    charges = (each.sensor.film_signal(as_real(1.0), 0) for each in (whole, without))
    transfers = _transfers(*charges, k=as_real(reference.k))
    behind = math.prod(factors, start=np.ones_like(reference.charge))
    traction = _all_of_traction(reference)
    signal, other = (
        behind * reference.read(np.einsum("eck,ck->ek", np.asarray(each), traction))
        for each in transfers
    )
    raised = SHORT_WAVES if reference.has_contact else 1.0
    return raised * reference.relative_difference(signal, other)


def _all_of_traction(reference: ReferenceSpectra) -> Complex[np.ndarray, "2 k"]:
    """The traction's spectrum as a line takes it: on a periodic one with the background, and of the
    function that has these cell averages. The short waves count at the edge of a zone."""
    line = reference.line
    if not isinstance(line, Periodic):
        return reference.traction
    whole = reference.traction.copy()
    whole[:, 0] += reference.background_Pa * line.n
    return whole / np.sinc(reference.k * np.asarray(line.cell_m) / (2 * np.pi))


@compiled
def _transfers(whole: FilmSignal, without: FilmSignal, k: Float[Array, " k"]):
    return whole.transfer(k), without.transfer(k)


class SpeedProfileEffect(Effect, Generic[Profile]):
    """One more departure from constant speed."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    speed_profile: Profile

    def apply(self, scenario: Scenario) -> Scenario:
        profiles = (*scenario.recorder.speed_profiles, self.speed_profile)
        return scenario.with_recorder(speed_profiles=profiles)
