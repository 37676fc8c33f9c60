"""The amplifier's finite bandwidth, 1/(1 + i omega R_f C_f)."""

from ..errors import number
from ..forward.filter import FirstOrder
from .general import FilterEffect


class AmplifierBandwidth(FilterEffect):
    """A feedback resistor `resistance_ohm` beside the capacitance `capacitance_F` lags by their
    product. Raises `BadInput` for values that are not positive."""

    def __init__(self, resistance_ohm, capacitance_F):
        key = "effects.amplifier_bandwidth"
        wanted = "a positive resistance in ohm"
        resistance = number(f"{key}.resistance_ohm", resistance_ohm, wanted, above=0)
        wanted = "a positive capacitance in F"
        self.filter = FirstOrder(
            resistance * number(f"{key}.capacitance_F", capacitance_F, wanted, above=0)
        )
