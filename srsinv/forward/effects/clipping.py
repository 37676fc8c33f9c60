"""An amplifier that runs into its rails."""

from typing import ClassVar

from ..converter import Clipping as Rails
from ..scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class Clipping(Effect):
    """No sample is beyond `limit`, in signal units, and what stands there tells nothing more.
    Raises `BadInput` for a limit that is not positive."""

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    converter: Rails

    def __init__(self, limit):
        self.converter = Rails(limit)

    def apply(self, scenario: Scenario) -> Scenario:
        # The rails come before the converter's levels, whatever is named first.
        return scenario.with_recorder(converters=(self.converter, *scenario.recorder.converters))

    @property
    def saturation(self) -> float:
        return float(self.converter.limit)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        return reference.relative_excess(self.saturation)
