"""An amplifier that runs into its rails."""

from typing import ClassVar

from ..forward.sampling import Saturation as Rails
from ..forward.scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class Clipping(Effect):
    """Samples are clipped at +-`limit`, in signal units; clipped ones are a bound only. Raises
    `BadInput` for a limit that is not positive."""

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    saturation_stage: Rails

    def __init__(self, limit):
        self.saturation_stage = Rails(limit)

    def apply(self, scenario: Scenario) -> Scenario:
        # The rails come before the converter's levels, whatever is named first.
        return scenario.with_recorder(
            conversions=(self.saturation_stage, *scenario.recorder.conversions)
        )

    @property
    def saturation(self) -> float:
        return float(self.saturation_stage.limit)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        return reference.relative_excess(self.saturation)
