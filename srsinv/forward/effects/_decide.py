"""Which effects a scene calls for: those whose share of its signal is not small."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

from ...grid import Line
from ..setup import Setup
from ._effect import Effect
from ._glance import glance

MARGIN = 1.25  # effects act on each other, and the look at them is on coarser cells


@dataclass(frozen=True)
class Verdict:
    """What was decided of one effect: `share` bounds what it changes, rms over rms of the signal;
    `time_s` is what the bound took."""

    name: str
    share: float
    on: bool
    time_s: float


def decide(
    setup: Setup, line: Line, effects: Mapping[str, Effect], tolerance: float
) -> tuple[Verdict, ...]:
    """A verdict on every effect, for a `setup` without any; the largest share first.

    Effects are left out from the smallest on, as long as the sum of their shares, and `MARGIN`, is
    within `tolerance`: what is left out together then changes the signal by no more.
    """
    seen = glance(setup, line)
    shares, times = {}, {}
    for name, effect in effects.items():
        start = time.perf_counter()
        shares[name] = float(effect.share(seen))
        times[name] = time.perf_counter() - start
    verdicts, left_out = [], 0.0
    for name in sorted(shares, key=lambda each: shares[each]):
        left_out += shares[name]
        verdicts.append(
            Verdict(name, shares[name], not MARGIN * left_out <= tolerance, times[name])
        )
    return tuple(reversed(verdicts))
