"""Detection: the signal strength that a matched filter needs against noise.

A signal's strength is d' = sqrt(signal^T N^-1 signal), its size over that of the noise along it; in
white noise sqrt(sum of squares)/rms.
"""

from typing import Any

from scipy.optimize import brentq
from scipy.stats import chi2, ncx2, norm

from ..errors import number

STRONGEST = 100.0  # d'; a stronger one is never missed


def needed_known(false_alarm: float, detection: float) -> float:
    """The d' that a matched filter needs, for a signal known but for its presence.

    Noise alone passes the threshold with probability `false_alarm`, the signal with `detection`.
    """
    _check(false_alarm, detection)
    return float(norm.isf(false_alarm) + norm.isf(1 - detection))


def needed_wave(false_alarm: float, detection: float) -> float:
    """The d' that a sine wave of known pitch and unknown phase needs: its cosine and sine parts
    are estimated, and their squares are chi-square of two degrees of freedom."""
    _check(false_alarm, detection)
    threshold = chi2.isf(false_alarm, 2)
    root: Any = brentq(lambda d: ncx2.sf(threshold, 2, d**2) - detection, 1e-6, STRONGEST)
    return float(root)


def _check(false_alarm: float, detection: float) -> None:
    wanted = "a probability, above 0 and below 0.5"
    number("false_alarm", false_alarm, wanted, above=0, below=0.5)
    number("detection", detection, "a probability, from 0.5 to below 1", least=0.5, below=1)
