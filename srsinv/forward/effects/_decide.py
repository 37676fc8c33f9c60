"""Which effects a scene calls for: those whose share of its signal is not small."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...grid import Line
from ..setup import Setup
from ._effect import Bursting, Effect, Factor, Order, Rounding
from ._glance import Glance, glance

MARGIN = 1.25  # effects act on each other, and a look presses to a hundredth


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

    Effects are left out from the smallest on, as long as the sum of their shares, times `MARGIN`,
    and what rounding makes of it, is within `tolerance`: what is left out together then changes the
    signal by no more.
    """
    seen = glance(setup, line)
    factors = {n: each.factor(seen) for n, each in effects.items() if isinstance(each, Factor)}
    every = seen.passed * math.prod(factors.values())
    size = seen.size_within(every, min((each.rail for each in effects.values()), default=math.inf))
    noises = [each.bursts(seen) for each in effects.values() if isinstance(each, Bursting)]
    noises = [noise.but(size=size) for noise in noises]
    peak = sum((noise.peak for noise in noises), 0.0)
    shares, grains, times = {}, {}, {}
    for name, effect in effects.items():
        start = time.perf_counter()
        others = math.prod(factor for n, factor in factors.items() if n != name)
        beside = seen.but(passed=seen.passed * others, size=size, peak=peak)
        of_noise = sum(_of_noise(effect, noise) for noise in noises)
        shares[name] = float(effect.share(beside) + of_noise)
        if isinstance(effect, Rounding):
            grains[name] = effect.grain(beside)
        times[name] = time.perf_counter() - start
    off = _left_out(shares, tolerance, 0.0)
    if kept := set(grains) - off:
        rest = {name: share for name, share in shares.items() if name not in kept}
        off = _left_out(rest, tolerance, max(grains[name] for name in kept))
    largest_first = sorted(shares, key=lambda each: -shares[each])
    return tuple(Verdict(n, shares[n], n not in off, times[n]) for n in largest_first)


def _of_noise(effect: Effect, noise: Glance) -> float:
    """What an effect may change of the noise that another one adds."""
    if effect.order <= Order.DIRECTION:
        return effect.share(noise)
    if isinstance(effect, Factor):  # in time, where the noise may have any spectrum
        return float(np.abs(effect.factor(noise) - 1).max()) * noise.share(noise.signal)
    return 0.0


def _left_out(shares: Mapping[str, float], tolerance: float, grain: float) -> set[str]:
    off, total = set(), 0.0
    for name in sorted(shares, key=lambda each: shares[each]):
        total += MARGIN * shares[name]
        if not total + math.sqrt(grain * total) <= tolerance:
            break
        off.add(name)
    return off
