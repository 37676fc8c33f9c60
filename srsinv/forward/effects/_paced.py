"""What departures from constant speed have in common."""

import numpy as np

from ..pace import Pace
from ..setup import Setup
from ._glance import Glance


def paced(setup: Setup, by: Pace) -> Setup:
    """The setup with one more departure from constant speed."""
    return setup.recording(paces=(*setup.recorder.paces, by))


def moved_share(glance: Glance, moved_m: float) -> float:
    """Of a signal that comes from up to `moved_m` away: |exp(ika) - 1| is ka at most, and 2."""
    return glance.share(np.minimum(glance.k * moved_m, 2.0) * np.abs(glance.signal))
