"""A finger that stops on its way, and goes on."""

from ..forward.speed_profile import StandstillProfile
from ._motion import InterruptionEffect


class Standstill(InterruptionEffect):
    """A rest of `duration_s` from `at_s` on, slowing down and speeding up over `ramp_s`. Raises
    `BadInput` as the speed profile does."""

    def __init__(self, at_s, duration_s, ramp_s=0.02):
        self.speed_profile = StandstillProfile(at_s, duration_s, ramp_s)
