"""Whether the elements' signals fit another wiring better than the one stated.

Each fault of the wiring is a model of its own: an element turned in sign, without signal, exchanged
with another, or giving another's signal. Under a Gaussian prior of p and q (a grid of levels,
lengths and frictions, all as probable) the data have an evidence Z under each. A fault is reported
where Z_fault / Z_stated exceeds 1/a: under the wiring as stated that happens with a probability of
at most a (Markov's inequality, as the ratio's mean is one). A gain, an angle, an offset or a
saturation can look like such a fault: where one of these explains the signals better it is reported
instead. A drift or a step can, too, at waves longer than those that elements tell a wiring by: the
ratio of Whittle's likelihoods, of tapered signals beside correlated noise, has to say the same.
Where both leave no doubt, an inversion or a fit is better by the wiring that was found than by the
one stated.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from ... import false_alarm
from ...forward.film import Film
from ...forward.sensor import Sensor
from ..line.problem import LineProblem
from ..noise.causes import causes_of_wiring, gained_by_wiring, in_words
from ..noise.nuisance import WithoutNuisance
from ..noise.whittle import CellSignals, SpectralBands
from .setup import number_of_films

LEVELS = 10.0 ** np.arange(-2.0, 2.1, 0.5)  # of p, in units of that which makes the data's power
LENGTHS = (1.0, 4.0)  # depths, over which p is correlated
# mu, and the part of q that is not mu p: apart, and hardly apart from friction.
SHEARS = ((0.0, 1.0), (0.0, 0.1), (0.25, 0.1), (-0.25, 0.1), (0.6, 0.1), (-0.6, 0.1))
DEEP = 12.0  # k z beyond which the skin transmits nothing
# Of a signal's power, at least: less noise is a float64's rounding, which would make the signals'
# covariance singular, and the evidence that of rounding.
LEAST_NOISE = 1e-12
DEAD = 4.0  # of the noise's power: twice its level, as that may be stated too low
MOST_DIGITS = 12  # of a ratio of probabilities in a sentence; beyond, there is no doubt
OF_WAVES = 0.01  # of the largest power of mains' waves: wavenumbers with more are left out
Gain = Complex[np.ndarray, "e c k"]


class ElementWiring(NamedTuple):
    """How the elements are wired: `films` (e,), the number of the film that each channel reads, the
    `signs` (e,) it has, 0 of a dead one, and a sentence about it."""

    films: tuple[int, ...]
    signs: tuple[float, ...]
    words: str

    def gain(self, stated: Gain) -> Gain:
        """The channels' responses, from those as stated."""
        return np.array(self.signs)[:, None, None] * stated[list(self.films)]

    def sensor(self, stated: Sensor) -> Sensor:
        """The sensor so wired."""

        def read(film: Film, sign: float) -> Film:
            return eqx.tree_at(
                lambda f: f.piezo, film, jax.tree.map(lambda d: sign * d, film.piezo)
            )

        count = number_of_films(stated)
        ways = [stated.elements[i : i + count] for i in range(0, len(stated.elements), count)]
        films = [
            read(own[n], sign)
            for own in ways
            for n, sign in zip(self.films, self.signs, strict=True)
        ]
        return dataclasses.replace(stated, elements=tuple(films))


class WiringFinding(NamedTuple):
    """What is found of the elements' wiring, as a sentence; `wiring`: the most probable one; None
    where another cause than the wiring is more probable; `is_certain`: beyond doubt."""

    words: str
    wiring: ElementWiring | None = None
    is_certain: bool = False


def wiring_finding(
    problem: LineProblem, names: Sequence[str], depth_m: float
) -> WiringFinding | None:
    """The most probable fault of the wiring, if there is one; `names` of the elements."""
    if len(names) < 2:
        return None
    k = np.asarray(problem.line.k)[1:]
    used = np.flatnonzero((k * depth_m < DEEP) & ~_of_waves(problem)[1:]) + 1
    given, problem = problem, WithoutNuisance.of(problem).problem
    together = problem.is_observed.all(axis=0)
    data = np.fft.rfft(np.where(together, np.asarray(problem.data), 0.0)) / np.sqrt(problem.line.n)
    white = data[:, used] / np.sqrt(np.asarray(problem.noise, float)[:, used])
    transfer = np.asarray(problem.forward.circulant().transfer, complex)
    gain = (transfer * np.asarray(problem.whitener)[:, None])[..., used]
    priors = list(_priors(gain, white, k[used - 1] * depth_m))
    stated = _log_evidence(gain, white, priors)
    power = np.mean(np.abs(white) ** 2, axis=1)
    faults = list(_faults(names, power))
    ratios = [_log_evidence(each.gain(gain), white, priors) - stated for each in faults]
    best = int(np.argmax(ratios))
    least = float(np.log(len(faults) / false_alarm.WIRING))
    if not ratios[best] > least:
        return None
    fault = faults[best]
    instead = causes_of_wiring(given, depth_m, fault.gain)
    if instead:
        return WiringFinding(
            f"The signals fit another rig than the one stated: {in_words(instead)}."
        )
    with_noise = _gained_with_noise(given, depth_m, fault)
    if with_noise < least:
        return None
    is_certain = bool(min(ratios[best], with_noise) > MOST_DIGITS * np.log(10))
    tens = ratios[best] / np.log(10)
    times = f"more than 10^{MOST_DIGITS}" if is_certain else f"10^{tens:.0f}"
    return WiringFinding(
        f"{fault.words} The signals are {times} times as probable with this fault as with the "
        "stated elements. If the wiring is correct, check gains, angles and depths, and hum.",
        fault,
        is_certain,
    )


def _gained_with_noise(problem: LineProblem, depth_m: float, fault: ElementWiring) -> float:
    """By how much a fault makes Whittle's likelihood greater in the logarithm, with correlated
    noise on the signals; infinite where these are too short for it."""
    signals = CellSignals.of(problem, depth_m)
    if not signals.stretches:
        return np.inf
    return gained_by_wiring(signals, SpectralBands.of(signals), fault.gain, has_tail=True)


def _of_waves(problem: LineProblem) -> Bool[np.ndarray, " k"]:
    """Which wavenumbers the waves of mains are at: what is sought there goes with them."""
    if problem.nuisance is None:
        return np.zeros(problem.line.k.size, bool)
    waves = np.fft.rfft(np.asarray(problem.nuisance, float))
    power = np.sum(np.abs(waves) ** 2, axis=(0, 1))
    return power > OF_WAVES * np.max(power)


def _faults(names: Sequence[str], power: Float[np.ndarray, " e"]) -> Iterator[ElementWiring]:
    """Each fault with its sentence. All elements turned are none turned; one whose signal's
    `power` (that of noise is 1) is above `DEAD` is not dead, whatever fits."""
    elements = len(names)
    every, plain = tuple(range(elements)), (1.0,) * elements

    def with_sign(e: int, sign: float) -> tuple[float, ...]:
        return tuple(sign if own == e else 1.0 for own in every)

    for e in every:
        if elements > 2 or e > 0:
            yield ElementWiring(
                every,
                with_sign(e, -1.0),
                f"{names[e]} seems to be of the other sign than the others. Change its polarity, "
                "or that of all others, which changes the sign of p and q.",
            )
        if power[e] < DEAD:
            yield ElementWiring(
                every,
                with_sign(e, 0.0),
                f"{names[e]} seems to be dead: it has noise alone. Remove it from "
                "recording.channels and its element from the sensor, or record it again.",
            )
    for a, b in itertools.combinations(every, 2):
        yield ElementWiring(
            tuple({a: b, b: a}.get(own, own) for own in every),
            plain,
            f"{names[a]} and {names[b]} seem to be exchanged. Exchange them in recording.channels.",
        )
    for a, b in itertools.permutations(every, 2):
        yield ElementWiring(
            tuple(b if own == a else own for own in every),
            plain,
            f"{names[a]} and {names[b]} seem to record the same element, that of {names[b]}. "
            "Remove one from recording.channels and an element from the sensor, or repair the "
            "wiring.",
        )


def _priors(
    gain: Gain, white: Complex[np.ndarray, "e k"], kz: Float[np.ndarray, " k"]
) -> Iterator[Float[np.ndarray, "c c k"]]:
    """Spectra of p and q (of p alone where friction is known), by length and friction, at the level
    that makes the data's power."""
    power = np.sum(np.abs(white) ** 2)
    are_apart = gain.shape[1] > 1
    shears = SHEARS if are_apart else SHEARS[:1]
    for depths, (mu, apart) in itertools.product(LENGTHS, shears):
        both = np.array([[1.0, mu], [mu, mu**2 + apart**2]] if are_apart else [[1.0]])
        shape = both[..., None] / (1 + (depths * kz) ** 2)
        unit = np.einsum("eck,cdk,edk->", gain, shape, gain.conj()).real
        yield power / unit * shape


def _log_evidence(
    gain: Gain, white: Complex[np.ndarray, "e k"], priors: Sequence[Float[np.ndarray, "c c k"]]
) -> float:
    """Log probability density of the data, the mean over the priors at all levels."""
    eye = np.eye(len(white))[..., None]
    logs = []
    for prior in priors:
        of_signal = np.einsum("edk,fdk->efk", np.einsum("eck,cdk->edk", gain, prior), gain.conj())
        power = np.einsum("eek->k", of_signal).real
        for level in LEVELS:
            noise = np.maximum(1.0, LEAST_NOISE * level * power)
            logs.append(_log_density(level * of_signal + noise * eye, white))
    return float(scipy.special.logsumexp(logs))


def _log_density(
    covariance: Complex[np.ndarray, "e e k"], white: Complex[np.ndarray, "e k"]
) -> float:
    """That of normal values at every wavenumber, by elimination of one element after the other: a
    hundredth of the time that LAPACK takes for matrices this small."""
    log, left, values = 0.0, covariance, white
    while len(values):
        pivot = left[0, 0].real
        log -= float(np.sum(np.log(pivot) + np.abs(values[0]) ** 2 / pivot))
        factor = left[1:, 0] / pivot
        left = left[1:, 1:] - factor[:, None] * left[0, 1:]
        values = values[1:] - factor * values[0]
    return log
