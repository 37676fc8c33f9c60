"""Which fact of the rig, if it were another, would explain what looks like correlated noise.

Each of the usual causes is a model of its own, with one number: a gain, an angle, an offset or a
low-pass of one element beside the others, the depth, a saturation. The signals have a likelihood
under each (see whittle.py), its number the likeliest, with noise that is white. A cause that makes
the signals as probable as correlated noise does may be what the misfit comes from.

One element shows none of this: another traction makes up for each of these causes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Complex, Float

from ... import false_alarm
from ...forward.scan import ConstantSpeed
from ...forward.sensor import Sensor
from ...quantities import quantity, significant
from ..line.problem import LineProblem, of_pressure
from ..rig.setup import Setup, number_of_films
from .whittle import CellSignals, Likelihood, NoiseParameters, SpectralBands

MOST_CELLS = 2048  # of the line that responses are computed on; they are smooth in the wavenumber
CLOSE = 0.02  # of the range of a cause's number: where its search ends
TRIALS = 14  # of it in each of so many
ROUNDS = 3
ENOUGH = 0.5  # of what correlated noise explains: a cause that explains less is not named
AS_GOOD = 0.9  # of what the best one explains: another that is named with it
# How far a fact may be from what is stated: factors, degrees, and lengths in depths.
GAINS, DEPTHS, ANGLES_DEG, OFFSETS, LOW_PASSES = (
    (0.3, 3.0), (0.6, 1.6), (-40.0, 40.0), (-1.0, 1.0), (0.0, 1.5)
)  # fmt: skip
SATURATIONS = (0.0, 2.0)  # the largest sample's loss, over what is left of it
LEAST_LAG = 1e-6  # depths
NODES = 9  # of a fact, between which responses are interpolated

Bounds = tuple[float, float]
Gain = Complex[np.ndarray, "e c k"]


class LikelyCause(NamedTuple):
    """A cause by its name, `gain_2`, `angle_2_deg`, `offset_2_m`, `depth_m`, `low_pass_2_Hz` (of
    all elements `low_pass_Hz`), `saturation`, `constant`, `drift`, `jump_s`, `hum_Hz` or `load_m`,
    and the value that explains the signals best: a gain as a factor on what is stated, a low-pass
    as its cut-off frequency, a saturation as the fraction that the largest sample has lost, a
    constant and a drift as the degree of a polynomial, a jump as the seconds from the first sample,
    a further load as its place."""

    name: str
    value: float

    @property
    def words(self) -> str:
        """The cause in a sentence: `an angle of element 2 of 80.1 degrees`."""
        name, *rest = self.name.replace("low_pass", "low-pass").split("_")
        if name == "saturation":
            return f"a saturation, by {100 * self.value:.0f} % at the largest sample"
        if name in SIGNALS:
            return SIGNALS[name]
        if name == "depth":
            return f"a depth of {quantity(self.value, 'm')}"
        if name == "jump":
            return f"a jump of the signals at {quantity(self.value, 's')} from the first sample"
        if name == "hum":
            return f"hum at {quantity(self.value, 'Hz')}"
        if name == "load":
            return f"a further load, or one of another shape, at x = {quantity(self.value, 'm')}"
        if name == "low-pass" and rest == ["Hz"]:
            return f"a low-pass at {quantity(self.value, 'Hz')}"
        element = f"element {rest[0]}"
        if name == "gain":
            times = significant(self.value)
            return f"a gain of {element} that is {times} times what is stated, beside element 1"
        if name == "angle":
            return f"an angle of {element} of {self.value:.3g} degrees"
        if name == "offset":
            return f"an offset of {element} of {quantity(self.value, 'm')}"
        return f"a low-pass of {element} at {quantity(self.value, 'Hz')}"

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return REMEDIES.get(self.name.partition("_")[0], "Measure it, and state what it is")


SIGNALS = {"constant": "a constant on the signals", "drift": "a drift of the signals"}
REMEDIES = {
    **dict.fromkeys([*SIGNALS, "jump"], "Give recording.drift=auto"),
    "hum": "Give its frequency as recording.mains_Hz",
    "load": "Fit a further feature, or another",
    "saturation": "Record it with less gain",
}


def in_words(causes: Sequence[LikelyCause]) -> str:
    """Causes and what to do."""
    listed = " or ".join(cause.words for cause in causes)
    return ". ".join([listed, *dict.fromkeys(cause.remedy for cause in causes)])


class Cause(NamedTuple):
    """A cause with its number within `bounds`; what value that is, and what the signals are taken
    for with it."""

    name: str
    bounds: Bounds
    value: Callable[[float], float]
    signals: Callable[[float], CellSignals]
    changes_data: bool = False


def causes_of_noise(
    problem: LineProblem, signals: CellSignals, bands: SpectralBands, gained: float
) -> tuple[LikelyCause, ...]:
    """The causes that may explain a problem's signals, the likeliest first; none where all of them
    explain little, and of one element. `gained`: of the likelihood's logarithm by correlated
    noise."""
    return _likely(problem, signals, bands, ENOUGH * gained)


def causes_of_wiring(
    problem: LineProblem, depth_m: float, fault: Callable[[Gain], Gain]
) -> tuple[LikelyCause, ...]:
    """The causes that explain a problem's signals better than a fault of the wiring does, the
    likeliest first; `fault`: the responses (e, c, k) with it, from those without."""
    signals = CellSignals.of(problem, depth_m)
    if not signals.stretches:
        return ()
    bands = SpectralBands.of(signals)
    gained = gained_by_wiring(signals, bands, fault, has_tail=False)
    return _likely(problem, signals, bands, gained - float(np.log(false_alarm.NOISE_PART)))


def gained_by_wiring(
    signals: CellSignals, bands: SpectralBands, fault: Callable[[Gain], Gain], has_tail: bool
) -> float:
    """By how much a fault of the wiring makes the likelihood's logarithm greater, with a correlated
    part of the noise (`has_tail`) or without."""
    level = np.sqrt(signals.white)[:, None, None]
    wired = bands.with_gain(signals._replace(gain=fault(signals.gain * level) / level))
    cost, of = Likelihood(bands, has_tail, False).greatest()
    return cost - Likelihood(wired, has_tail, False).greatest(of)[0]


def _likely(
    problem: LineProblem, signals: CellSignals, bands: SpectralBands, least: float
) -> tuple[LikelyCause, ...]:
    """The causes that make the likelihood's logarithm greater by more than `least`, and about as
    much as the best of them."""
    sensor, scan = problem.sensor, problem.scan
    if sensor is None or scan is None or number_of_films(sensor) < 2:
        return ()
    alone = Likelihood(bands, False, False)
    cost, of = alone.greatest()
    found: list[tuple[float, LikelyCause]] = []
    for cause in _causes(signals, problem, sensor, scan):
        less, at = _best(cause, bands, of, alone.unit)
        found.append((cost - less, LikelyCause(cause.name, cause.value(at))))
    found.sort(reverse=True)
    chance = -float(np.log(false_alarm.NOISE_PART / len(found)))
    enough = max(least, chance, AS_GOOD * found[0][0])
    return tuple(cause for gain, cause in found if gain > enough)


def _best(
    cause: Cause, bands: SpectralBands, of: NoiseParameters, unit: Float[np.ndarray, " c"]
) -> tuple[float, float]:
    """Minus the logarithm of the greatest likelihood with a cause, and its number there; `of`,
    `unit`: the parameters without it, and the unit of their levels."""

    def likelihood(at: float) -> Likelihood:
        own = cause.signals(at)
        changed = SpectralBands.of(own) if cause.changes_data else bands.with_gain(own)
        return Likelihood(changed, False, False, unit)

    # The number with all else held, then all else with the number held: they are little coupled,
    # and most of the time is in the latter.
    low, high = cause.bounds
    best = (np.inf, 0.0)
    options = {"xatol": CLOSE * (high - low), "maxiter": TRIALS}
    for _ in range(ROUNDS):
        held = np.concatenate(of)
        end: Any = scipy.optimize.minimize_scalar(
            lambda at, held=held: likelihood(at)(held)[0],
            bounds=cause.bounds, method="bounded", options=options,
        )  # fmt: skip
        least, of = likelihood(float(end.x)).greatest(of)
        best = min(best, (least, float(end.x)))
    return best


def _causes(
    signals: CellSignals, problem: LineProblem, sensor: Sensor, scan: ConstantSpeed
) -> Iterator[Cause]:
    """All causes of a sensor of several elements."""
    line, mu = problem.line, problem.friction
    depth, films = float(sensor.depth_m), number_of_films(sensor)
    short = type(line)(min(line.n, MOST_CELLS), line.cell_m, line.start_m)
    waves = np.asarray(short.k, float)
    level = np.sqrt(signals.white)[:, None, None]

    def response(setup: Setup) -> Gain:
        operator = setup.sensor.operator(short, scan)
        operator = operator if mu is None else of_pressure(operator, mu)
        return np.asarray(operator.circulant().transfer, complex) / level

    def with_gain(gain: Gain) -> CellSignals:
        rows = gain.reshape(-1, waves.size)
        onto = np.stack([np.interp(signals.kz / depth, waves, row) for row in rows])
        return signals._replace(gain=onto.reshape(*gain.shape[:2], -1))

    stated = response(Setup(sensor))

    def times(element: int, factor: Callable[[float], Any]) -> Callable[[float], CellSignals]:
        """Responses of one element with another factor at every wavenumber."""

        def signals_of(at: float) -> CellSignals:
            gain = stated.copy()
            gain[element::films] *= factor(at)
            return with_gain(gain)

        return signals_of

    def of_fact(name: str, value: float, by: Callable[[float], float], bounds: Bounds):
        """Responses by a fact, interpolated between some of its values."""
        low, high = bounds
        nodes = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
        setups = [Setup(sensor).changed(name, value, by(at)) for at in nodes.tolist()]
        gains = scipy.interpolate.BarycentricInterpolator(
            nodes, np.stack([response(each) for each in setups])
        )
        return lambda at: with_gain(gains(at))

    def undone(share: float) -> CellSignals:
        # Amplifiers end at the same voltage in all channels.
        size = np.abs(signals.data) * level[..., 0]
        return signals._replace(data=signals.data * (1 + share * (size / np.nanmax(size)) ** 2))

    def cut_off(at: float) -> float:
        return abs(float(scan.speed_m_per_s)) / (2 * np.pi * depth * max(at, LEAST_LAG))

    yield Cause("saturation", SATURATIONS, lambda at: at / (1 + at), undone, changes_data=True)
    by_depth = of_fact("depth_m", depth, lambda at: (at - 1) * depth, DEPTHS)
    yield Cause("depth_m", DEPTHS, lambda at: at * depth, by_depth)
    for n, film in enumerate(sensor.elements[:films], 1):
        lags = times(n - 1, lambda at: 1 / (1 + 1j * waves * at * depth))
        yield Cause(f"low_pass_{n}_Hz", LOW_PASSES, cut_off, lags)
        if n == 1:  # from which gains, angles and offsets count
            continue
        low, high = np.log(GAINS).tolist()
        yield Cause(f"gain_{n}", (low, high), lambda at: float(np.exp(at)), times(n - 1, np.exp))
        name, angle = f"angle_{n}_deg", float(np.rad2deg(film.angle_rad))
        turned = of_fact(name, angle, lambda at: at, ANGLES_DEG)
        yield Cause(name, ANGLES_DEG, lambda at, own=angle: own + at, turned)
        name, offset = f"offset_{n}_m", float(film.offset_m)
        moved = times(n - 1, lambda at: np.exp(1j * waves * at * depth))
        yield Cause(name, OFFSETS, lambda at, own=offset: own + at * depth, moved)
