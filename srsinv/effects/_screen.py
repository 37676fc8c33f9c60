"""Screening of effects: a scene needs all but those whose joint change is below a tolerance.

The effects left out change the signal by no more than the sum of their own changes beside the
others, as a rms is a norm. Each effect bounds its own change on reference spectra of the scene; the
sum is raised by `INTERACTION` for interactions that the reference lacks.
"""

import math
import time
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import refuse, shown
from ..forward.scenario import Scenario
from ..forward.simulation import Simulation
from ..forward.skin import STRESSES
from ..grid import Line
from ._effect import Effect, Order, add_effects
from ._reference import TINY, ReferenceSpectra, reference

# Effects act on each other beyond their factors, and the reference's contact is accurate to 1 %.
# Over random scenes the measured change is at most tests/claims/results/screening.json's
# `error_over_bound_max` of the bound with this factor.
INTERACTION = 1.25
# Fraction of the signal that effects that stay on may change before it is simulated with them.
LARGEST_UNSIMULATED_CHANGE = 0.1
MOST_ROUNDS = 4  # each turns on more than the one before
LEAST_EXPECTED_FLIPS = 1e-3  # of samples over all of them: fewer do not happen

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


def screen_effects(
    sim: Simulation, effects: Mapping[str, Effect], tolerance: float
) -> tuple[Simulation, ScreeningResult]:
    """A simulation without effects, with those alone that its scene calls for; and what was found
    of each. One that the skin defines already is no effect to decide on."""
    ideal = sim.scenario.replace(noises=())
    addable = {name: e for name, e in effects.items() if not e.is_defined_in(ideal)}

    def only(names: Set[str]) -> Simulation:
        named = {name: effect for name, effect in addable.items() if name in names}
        return replace(sim, scenario=add_effects(sim.scenario, named))

    def simulated(names: Set[str]) -> tuple[np.ndarray, np.ndarray]:
        with_effects = only(names)
        signal = np.asarray(with_effects.signal())
        stress = np.asarray(with_effects.response(with_effects.sensor.stress()))
        return signal, stress.reshape(signal.shape[0], len(STRESSES), -1)

    screening = screen(ideal, sim.fine, addable, tolerance, simulated)
    return only(screening.on), screening


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
    spectra = _sampled(reference(scenario, line), effects)
    screening = _round(spectra, effects, set(effects), set(effects), tolerance)
    off = screening.off
    for _ in range(MOST_ROUNDS):
        on = effects.keys() - off
        unsure = sum((screening.bounds[n] for n in on if _alters(effects[n])), 0.0)
        if unsure > LARGEST_UNSIMULATED_CHANGE and simulate is not None:
            transfer = math.prod(
                _factors(spectra, effects, on).values(), start=spectra.transfer_of_others
            )
            beside = spectra.with_signal(*simulate(on), transfer)
            again = _round(beside, effects, off, off, tolerance)
        else:
            least = min(unsure, LARGEST_UNSIMULATED_CHANGE)
            again = _round(spectra, effects, off, set(effects), tolerance, least)
        screening = screening.updated(again)
        if again.off == off:
            break
        off = again.off
    bounds = dict(sorted(screening.bounds.items(), key=lambda each: -each[1]))
    return ScreeningResult(
        frozenset(effects.keys() - off), screening.bound, bounds, screening.times
    )


class _Round(NamedTuple):
    """Bounds by name, effects that are off, their joint bound, and the time of each bound [s]."""

    bounds: dict[str, float]
    off: set[str]
    bound: float
    times: dict[str, float]

    def updated(self, by: "_Round") -> "_Round":
        times = {n: spent + by.times.get(n, 0.0) for n, spent in self.times.items()}
        return _Round(self.bounds | by.bounds, by.off, by.bound, times)


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


def _round(
    spectra: ReferenceSpectra,
    effects: Mapping[str, Effect],
    screened: Set[str],
    acting: Set[str],
    tolerance: float,
    unsure: float = 0.0,
) -> _Round:
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
    spectra = spectra.replace(
        noise_peak=sum((noise.noise_peak for noise in noises), 0.0),
        max_gain_of_others=math.prod((each.max_gain for each in every_one), start=1 + unsure),
    )
    bounds, times = {}, {}
    for name in (n for n in effects if n in screened):  # a set has no order of its own
        start = time.perf_counter()
        others = (factor for n, factor in factors.items() if n != name)
        transfer = math.prod(others, start=spectra.transfer_of_others)
        beside = spectra.replace(transfer_of_others=transfer)
        of_noise = sum(_of_noise(effects[name], noise) for noise in noises)
        bounds[name] = _bound(name, effects[name], beside) + of_noise
        times[name] = time.perf_counter() - start
    off, bound = _left_out(bounds, effects, spectra.replace(transfer_of_others=every), tolerance)
    return _Round(bounds, off, bound, times)


def _bound(name: str, effect: Effect, beside: ReferenceSpectra) -> float:
    """The bound that the effect gives, which may be a stranger's."""
    bound: Any = effect.relative_change_bound(beside)
    is_one: Any = isinstance(bound, Real) or getattr(bound, "shape", None) == ()
    refuse(
        not (is_one and float(bound) >= 0),
        f"effects.{name} bounds its change by {shown(bound)}: give a number that is at least 0, "
        "infinite where none is known.",
    )
    return float(bound)


def _factors(spectra: ReferenceSpectra, effects: Mapping[str, Effect], names: Set[str]):
    factors = {name: effects[name].factor(spectra) for name in names}
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
    for name in sorted(bounds, key=lambda each: bounds[each]):
        total += INTERACTION * bounds[name]
        together = rounded(spectra, total, max(rounding.values(), default=0.0))
        if not together <= tolerance:
            break
        off.add(name)
        bound = together
    return off, bound


def rounded(spectra: ReferenceSpectra, change: float, step: float) -> float:
    """A bound on the rms of a `change` once samples are rounded to multiples of `step`, all over
    the signal's rms.

    A change of d turns a sample over where a tie is within d, by a step beyond the change itself:
    in all, d^2 + step^2 times the fraction of samples that turn. The signal is known but for an
    offset, so that this is the fraction within d at the worst one; samples that are always rounded
    to zero do not turn.
    """
    samples = np.fft.irfft(spectra.transfer_of_others * spectra.signal, spectra.line.n).ravel()
    turned = _turned_part(samples / spectra.signal_rms, change, step) if step > 0 else 0.0
    return math.sqrt(change**2 + step**2 * turned)


def _turned_part(samples: Float[np.ndarray, " n"], change: float, step: float) -> float:
    if not step < math.inf or change / step * samples.size < LEAST_EXPECTED_FLIPS:
        return 0.0
    if change >= step:
        return change / step
    can = np.abs(samples) * (1 + LARGEST_UNSIMULATED_CHANGE) + change >= step / 2
    phases = np.sort(samples[can] / step % 1.0)
    twice = np.concatenate([phases, phases + 1])
    most = np.searchsorted(twice, phases + change / step, side="right") - np.arange(phases.size)
    return max(float(most.max(initial=0)) / samples.size, change / step)
