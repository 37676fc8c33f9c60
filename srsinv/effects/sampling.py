"""Sampling in time at a rate of the recorder's own, not once a cell."""

from typing import ClassVar

import equinox as eqx
import numpy as np

from ..errors import number
from ..forward.scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class Sampling(Effect):
    """`rate_hz` samples a second. Raises `BadInput` for a rate that is not positive."""

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    rate_hz: float = eqx.field(static=True)

    def __init__(self, rate_hz):
        wanted = "a positive rate in Hz"
        self.rate_hz = float(number("effects.sampling.rate_hz", rate_hz, wanted, above=0))

    @property
    def sampling_rate_hz(self) -> float:
        return self.rate_hz

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_recorder(sample_rate_hz=self.rate_hz)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # Above half the rate the signal is aliased; the rest is resolved in full.
        folded = reference.k * abs(reference.speed_m_per_s) > np.pi * self.rate_hz
        return 2 * reference.relative_rms(np.where(folded, reference.signal, 0.0))
