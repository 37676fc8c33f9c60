"""Screening of effects: a scene needs all but those whose joint change is below a tolerance.

The effects left out change the signal by no more than the sum of their own changes beside the
others, as a rms is a norm. Each effect bounds its own change on reference spectra of the scene; the
sum is raised by `INTERACTION` for interactions that the reference lacks.
"""

import math
import time
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..errors import echo, refuse
from ..forward.scenario import Scenario
from ..grid import Line
from ._effect import Effect, Order
from ._reference import TINY, ReferenceSpectra, reference
from ._rounding import LARGEST_UNSIMULATED_CHANGE, RoundedSignal
from .general import EnvelopeEffect, change_within_envelopes

# Effects act on each other beyond their factors, and the reference's contact is accurate to 1 %.
# Over random scenes the measured change is at most tests/claims/results/screening.json's
# `error_over_bound_max` of the bound with this factor.
INTERACTION = 1.25
MOST_ROUNDS = 4  # each turns on more than the one before

Simulate = Callable[[Set[str]], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ScreeningResult:
    """The effects that are `on`, and a `bound` on the joint change by the others: rms change over
    rms signal with all of them.

    - `relative_change_bounds` of every effect by itself, the largest first; `times_s` each took.
    """

    on: frozenset[str]
    bound: float
    relative_change_bounds: Mapping[str, float]
    times_s: Mapping[str, float]


def screen(
    scenario: Scenario,
    line: Line,
    effects: Mapping[str, Effect],
    tolerance: float,
    simulate: Simulate | None = None,
) -> ScreeningResult:
    """Screen every effect, for a `scenario` without any.

    Effects are left out from the smallest on, as long as the bound on what they change together is
    within `tolerance`. Where those that stay on may change the signal by more than
    `LARGEST_UNSIMULATED_CHANGE`, `simulate` gives it with the named ones, (e, n) along the line,
    and the stress at the films (e, 4, n), and the rest is screened again beside it.
    """
    spectra = _sampled(reference(scenario, line).replace(named=effects), effects)
    weighed = _weighed(spectra, effects, set(effects), set(effects))
    bounds, times_s = weighed.bounds, weighed.times_s
    off, bound = _left_out(bounds, effects, weighed.spectra, tolerance)
    for _ in range(MOST_ROUNDS):
        on = effects.keys() - off
        unsure = sum((bounds[n] for n in effects if n in on and _alters(effects[n])), 0.0)
        if unsure > LARGEST_UNSIMULATED_CHANGE and simulate is not None:
            transfer = math.prod(
                _factors(spectra, effects, on).values(), start=spectra.transfer_of_others
            )
            beside = spectra.with_signal(*simulate(on), transfer)
            weighed = _weighed(beside, effects, off, off)
        elif unsure > 0:  # else all is as it was weighed first
            least = min(unsure, LARGEST_UNSIMULATED_CHANGE)
            weighed = _weighed(spectra, effects, off, set(effects), least)
        bounds, times_s = bounds | weighed.bounds, weighed.added_to(times_s)
        again, bound = _left_out(
            {n: weighed.bounds[n] for n in effects if n in off}, effects, weighed.spectra, tolerance
        )
        if again == off:
            break
        off = again
    ordered = dict(sorted(bounds.items(), key=lambda each: -each[1]))
    return ScreeningResult(frozenset(effects.keys() - off), bound, ordered, times_s)


class _Weighed(NamedTuple):
    """Bounds by name, the time of each [s], and the reference behind all factors."""

    bounds: dict[str, float]
    times_s: dict[str, float]
    spectra: ReferenceSpectra

    def added_to(self, times_s: Mapping[str, float]) -> dict[str, float]:
        return {n: spent + self.times_s.get(n, 0.0) for n, spent in times_s.items()}


def _sampled(spectra: ReferenceSpectra, effects: Mapping[str, Effect]) -> ReferenceSpectra:
    """The reference at the recorder's samples, under all effects of motion, load and sampling."""
    scenario, rates = spectra.scenario, []
    for each in effects.values():
        rate = each.sampling_rate_hz
        if each.order in (Order.MOTION, Order.LOAD) or rate is not None:
            scenario = each.apply(scenario)
        if rate is not None:
            rates.append(rate)
    interval = min([spectra.interval_s, *(1 / rate for rate in rates)])
    if not scenario.recorder.samples_in_time:
        return spectra.replace(interval_s=interval)
    motion = scenario.recorder.motion(spectra.line, spectra.line, scenario.scan)
    time_s = np.asarray(motion.time_s)
    load = math.prod((each.load(time_s) for each in effects.values()), start=np.ones_like(time_s))
    return spectra.replace(interval_s=interval).with_motion(motion, load)


def _weighed(
    spectra: ReferenceSpectra,
    effects: Mapping[str, Effect],
    screened: Set[str],
    acting: Set[str],
    unsure: float = 0.0,
) -> _Weighed:
    """Bounds of the `screened` effects, beside the factors of the `acting` ones that are not in the
    signal yet, which may be off by the fraction `unsure`."""
    every_one = effects.values()
    factors = _factors(spectra, effects, acting)
    every = math.prod(factors.values(), start=spectra.transfer_of_others)
    limit = min((each.saturation for each in every_one), default=math.inf)
    rms = (1 - unsure) * spectra.saturated_rms(every, limit)
    spectra = spectra.replace(signal_rms=rms)
    noises = [noise for each in every_one if (noise := each.noise(spectra)) is not None]
    noises = [noise.replace(signal_rms=rms) for noise in noises]
    behind_all = spectra.replace(
        noise_peak=sum((noise.noise_peak for noise in noises), 0.0),
        max_gain_of_others=math.prod((each.max_gain for each in every_one), start=1 + unsure),
        transfer_of_others=every,
    )
    bounds, times = {}, {}
    for name in (n for n in effects if n in screened):  # a set has no order of its own
        start, beside = time.perf_counter(), behind_all
        if name in factors:
            others = (factor for n, factor in factors.items() if n != name)
            transfer = math.prod(others, start=spectra.transfer_of_others)
            beside = behind_all.replace(transfer_of_others=transfer)
        of_noise = sum(_of_noise(effects[name], noise) for noise in noises)
        bounds[name] = _bound(name, effects[name], beside) + of_noise
        times[name] = time.perf_counter() - start
    return _Weighed(bounds, times, behind_all)


def _bound(name: str, effect: Effect, beside: ReferenceSpectra) -> float:
    """The bound that the effect gives, which may be a stranger's; of one at the films that an
    envelope follows, also its change within."""
    bound: Any = effect.relative_change_bound(beside)
    is_one: Any = isinstance(bound, Real) or getattr(bound, "shape", None) == ()
    refuse(
        not (is_one and float(bound) >= 0),
        f"effects.{name} bounds its change by {echo(bound)}: give a number that is at least 0, "
        "infinite where none is known.",
    )
    if effect.order == Order.FILM and any(
        isinstance(each, EnvelopeEffect) for each in beside.named.values()
    ):
        return max(float(bound), change_within_envelopes(effect, beside))
    return float(bound)


def _factors(spectra: ReferenceSpectra, effects: Mapping[str, Effect], names: Set[str]):
    factors = {name: each.factor(spectra) for name, each in effects.items() if name in names}
    return {name: factor for name, factor in factors.items() if factor is not None}


def _alters(effect: Effect) -> bool:
    """Whether the signal with it is known no better than by its bound."""
    return effect.order <= Order.SLIDING and not effect.is_exact


def _of_noise(effect: Effect, noise: ReferenceSpectra) -> float:
    """Bound on the change by an effect of the noise that another one adds."""
    if effect.order <= Order.DIRECTION:
        return effect.relative_change_bound(noise)
    # In time, where the noise may have any spectrum.
    slid = abs(noise.speed_m_per_s) * noise.interval_s * noise.k[-1]
    faster = max(1.0, np.pi / max(slid, TINY))
    response = effect.factor(noise.replace(k=faster * noise.k))
    if response is None:
        return 0.0
    return float(np.abs(response - 1).max()) * noise.relative_rms(noise.signal)


def _left_out(
    bounds: Mapping[str, float],
    effects: Mapping[str, Effect],
    spectra: ReferenceSpectra,
    tolerance: float,
) -> tuple[set[str], float]:
    """Names of effects that can be left out together, from the smallest on, and a bound on their
    joint change."""
    # A rounding effect stays on where it has to: its step then enters the change by the others.
    steps = {n: each.relative_quantisation_step(spectra) for n, each in effects.items()}
    rounding = {n: step for n, step in steps.items() if step > 0}
    off, bound = _smallest(bounds, {n: rounding[n] for n in rounding if n not in bounds}, spectra,
                           tolerance)  # fmt: skip
    if staying := {n: step for n, step in rounding.items() if n not in off}:
        rest = {n: bound for n, bound in bounds.items() if n not in staying}
        off, bound = _smallest(rest, staying, spectra, tolerance)
    return off, bound


def _smallest(bounds, rounding, spectra, tolerance) -> tuple[set[str], float]:
    off, total, bound = set(), 0.0, 0.0
    signal = RoundedSignal(spectra, max(rounding.values(), default=0.0))
    for name in sorted(bounds, key=lambda each: bounds[each]):
        total += INTERACTION * bounds[name]
        together = signal.bound(total)
        if not together <= tolerance:
            break
        off.add(name)
        bound = together
    return off, bound
