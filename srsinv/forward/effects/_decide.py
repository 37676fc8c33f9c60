"""Which effects a scene calls for: those whose share of its signal is not small."""

import math
import time
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...grid import Line
from ..setup import Setup
from ._effect import Bursting, Effect, Factor, Order, Resampling, Rounding
from ._glance import TINY, Glance, glance

MARGIN = 1.25  # effects act on each other, and a look presses to a hundredth
SURE = 0.1  # of the signal: what effects that stay on may change of it before it is asked for
LOOKS = 4  # at most; each turns on more than the one before

SignalWith = Callable[[Set[str]], np.ndarray]


@dataclass(frozen=True)
class Verdict:
    """What was decided of one effect: `share` bounds what it changes, rms over rms of the signal;
    `time_s` is what the bound took."""

    name: str
    share: float
    on: bool
    time_s: float


def decide(
    setup: Setup,
    line: Line,
    effects: Mapping[str, Effect],
    tolerance: float,
    signal_with: SignalWith | None = None,
) -> tuple[Verdict, ...]:
    """A verdict on every effect, for a `setup` without any; the largest share first.

    Effects are left out from the smallest on, as long as the sum of their shares, times `MARGIN`,
    and what rounding makes of it, is within `tolerance`: what is left out together then changes the
    signal by no more. Where those that stay on may change the signal by more than `SURE`, it is
    asked for by `signal_with`, (e, sample) along the line with the named effects, and the rest is
    weighed again beside it.
    """
    seen = glance(setup, line)
    rates = [each.rate_hz for each in effects.values() if isinstance(each, Resampling)]
    seen = seen.but(interval_s=min([seen.interval_s, *(1 / rate for rate in rates)]))
    found = _weigh(seen, effects, set(effects), set(effects), tolerance)
    off = found.off
    for _ in range(LOOKS):
        on = effects.keys() - off
        unsure = sum((found.shares[n] for n in on if _alters(effects[n])), 0.0)
        if unsure > SURE and signal_with is not None:
            passed = math.prod(_factors(seen, effects, on).values(), start=seen.passed)
            again = _weigh(seen.heard(signal_with(on), passed), effects, off, off, tolerance)
        else:
            again = _weigh(seen, effects, off, set(effects), tolerance, min(unsure, SURE))
        found = found.updated(again)
        if again.off == off:
            break
        off = again.off
    largest_first = sorted(found.shares, key=lambda each: -found.shares[each])
    return tuple(Verdict(n, found.shares[n], n not in off, found.times[n]) for n in largest_first)


class _Weighed(NamedTuple):
    """Shares by name, what is off, and what each share took [s]."""

    shares: dict[str, float]
    off: set[str]
    times: dict[str, float]

    def updated(self, by: "_Weighed") -> "_Weighed":
        times = {n: spent + by.times.get(n, 0.0) for n, spent in self.times.items()}
        return _Weighed(self.shares | by.shares, by.off, times)


def _weigh(
    seen: Glance,
    effects: Mapping[str, Effect],
    judged: set[str],
    acting: set[str],
    tolerance: float,
    unsure: float = 0.0,
) -> _Weighed:
    """The shares of those that are `judged`, beside the factors of those that are `acting` and are
    not in the signal yet, which may be off by the part `unsure`."""
    every_one = effects.values()
    factors = _factors(seen, effects, acting)
    every = math.prod(factors.values(), start=seen.passed)
    size = seen.size_within(every, min((each.rail for each in every_one), default=math.inf))
    swing = math.prod((each.swing for each in every_one), start=1 + unsure)
    noises = [each.bursts(seen) for each in every_one if isinstance(each, Bursting)]
    noises = [noise.but(size=(1 - unsure) * size) for noise in noises]
    peak = sum((noise.peak for noise in noises), 0.0)
    seen = seen.but(size=(1 - unsure) * size, peak=peak, swing=swing)
    shares, times = {}, {}
    for name in (n for n in effects if n in judged):  # a set has no order of its own
        start = time.perf_counter()
        others = (factor for n, factor in factors.items() if n != name)
        beside = seen.but(passed=math.prod(others, start=seen.passed))
        of_noise = sum(_of_noise(effects[name], noise) for noise in noises)
        shares[name] = float(effects[name].share(beside) + of_noise)
        times[name] = time.perf_counter() - start
    grains = {n: each.grain(seen) for n, each in effects.items() if isinstance(each, Rounding)}
    there = [grain for n, grain in grains.items() if n not in judged]
    off = _left_out(shares, tolerance, max(there, default=0.0))
    if kept := grains.keys() - off:
        rest = {name: share for name, share in shares.items() if name not in kept}
        off = _left_out(rest, tolerance, max(grains[name] for name in kept))
    return _Weighed(shares, off, times)


def _factors(seen: Glance, effects: Mapping[str, Effect], names: Set[str]):
    named = {name: effects[name] for name in names}
    return {n: each.factor(seen) for n, each in named.items() if isinstance(each, Factor)}


def _alters(effect: Effect) -> bool:
    """Whether the signal with it is known no better than by its share."""
    exact = isinstance(effect, Factor) and effect.is_exact
    return effect.order <= Order.SLIDING and not exact


def _of_noise(effect: Effect, noise: Glance) -> float:
    """What an effect may change of the noise that another one adds."""
    if effect.order <= Order.DIRECTION:
        return effect.share(noise)
    if isinstance(effect, Factor):  # in time, where the noise may have any spectrum
        slid = abs(noise.speed_m_per_s) * noise.interval_s * noise.k[-1]
        faster = max(1.0, np.pi / max(slid, TINY))
        response = effect.factor(noise.but(k=faster * noise.k))
        return float(np.abs(response - 1).max()) * noise.share(noise.signal)
    return 0.0


def _left_out(shares: Mapping[str, float], tolerance: float, grain: float) -> set[str]:
    off, total = set(), 0.0
    for name in sorted(shares, key=lambda each: shares[each]):
        total += MARGIN * shares[name]
        if not total + math.sqrt(grain * total) <= tolerance:
            break
        off.add(name)
    return off
