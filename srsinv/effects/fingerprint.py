"""Parallel ridges on the finger's skin press harder than the grooves between them."""

from typing import Any

import numpy as np

from ..errors import number
from ..forward.envelope import FingerprintRidges
from .general import EnvelopeEffect


class Fingerprint(EnvelopeEffect):
    """Ridges `pitch_m` [m] apart, which modulate the pressure by the fraction `modulation`.

    - `phase_deg`: of the ridges at the finger's middle; 0: the top of a ridge.

    Raises `BadInput` for a modulation outside 0 to 1, and a pitch that is not positive.
    """

    def __init__(self, modulation: Any, pitch_m: Any, phase_deg: Any = 0.0):
        phase = number("effects.fingerprint.phase_deg", phase_deg, "an angle in degrees")
        self.envelope = FingerprintRidges(modulation, pitch_m, phase * np.pi / 180)
