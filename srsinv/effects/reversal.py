"""A finger that slides back on its way, and on again."""

from ..forward.speed_profile import ReversalProfile
from ._motion import InterruptionEffect


class Reversal(InterruptionEffect):
    """Sliding backwards for `duration_s` from `at_s` on, turning over `ramp_s`; friction turns with
    it. Raises `BadInput` as the speed profile does."""

    def __init__(self, at_s, duration_s, ramp_s=0.02):
        self.speed_profile = ReversalProfile(at_s, duration_s, ramp_s)
