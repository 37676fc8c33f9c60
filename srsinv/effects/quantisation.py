"""Samples rounded to the levels of a converter."""

from typing import ClassVar

from ..forward.sampling import Quantiser as Levels
from ..forward.scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class Quantisation(Effect):
    """2^`bits` levels from -`full_scale` to `full_scale`, in signal units; values beyond are
    clipped. Raises `BadInput` as the converter does."""

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    quantiser: Levels

    def __init__(self, bits, full_scale):
        self.quantiser = Levels(bits, full_scale)

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_recorder(conversions=(*scenario.recorder.conversions, self.quantiser))

    def relative_quantisation_step(self, reference: ReferenceSpectra) -> float:
        return 2 * float(self.quantiser.full_scale) / 2**self.quantiser.bits / reference.signal_rms

    @property
    def saturation(self) -> float:
        # The highest level is a step below the full scale.
        return float(self.quantiser.full_scale) * (1 - 2.0 ** (1 - self.quantiser.bits))

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # Never more than half a step, the largest error of a signal below one step.
        return (
            reference.relative_excess(self.saturation)
            + self.relative_quantisation_step(reference) / 2
        )
