"""Whether the elements' signals fit another wiring better than the one stated.

Each fault of the wiring is a model of its own: an element turned in sign, without signal, exchanged
with another, or giving another's signal. Under a Gaussian prior of p and q (a grid of levels,
lengths and frictions, all as probable) the data have an evidence Z under each. A fault is reported
where Z_fault / Z_stated exceeds 1/a: under the wiring as stated that happens with a probability of
at most a (Markov's inequality, as the ratio's mean is one). A gain, an angle, an offset or a
saturation can look like such a fault: where one of these explains the signals better it is reported
instead.
"""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.special import logsumexp

from ... import false_alarm
from ..line.problem import LineProblem
from ..noise.causes import causes_of_wiring, in_words
from ..noise.nuisance import WithoutNuisance

LEVELS = 10.0 ** np.arange(-2.0, 2.1, 0.5)  # of p, in units of that which makes the data's power
LENGTHS = (1.0, 4.0)  # depths, over which p is correlated
# mu, and the part of q that is not mu p: apart, and hardly apart from friction.
SHEARS = ((0.0, 1.0), (0.0, 0.1), (0.25, 0.1), (-0.25, 0.1), (0.6, 0.1), (-0.6, 0.1))
DEEP = 12.0  # k z beyond which the skin transmits nothing
# Of a signal's power, at least: less noise is a float64's rounding, which would make the signals'
# covariance singular, and the evidence that of rounding.
LEAST_NOISE = 1e-12
DEAD = 4.0  # of the noise's power: twice its level, as that may be stated too low
MOST_DIGITS = 12  # of a ratio of probabilities that is said
OF_WAVES = 0.01  # of the largest power of mains' waves: wavenumbers with more are left out
Gain = Complex[np.ndarray, "e c k"]


def element_findings(problem: LineProblem, names: Sequence[str], depth_m: float) -> tuple[str, ...]:
    """The most probable fault of the wiring, as a sentence, or none; `names` of the elements."""
    if len(names) < 2:
        return ()
    k = np.asarray(problem.line.k)[1:]
    used = np.flatnonzero((k * depth_m < DEEP) & ~_of_waves(problem)[1:]) + 1
    given, problem = problem, WithoutNuisance.of(problem).problem
    together = problem.is_observed.all(axis=0)
    data = np.fft.rfft(np.where(together, np.asarray(problem.data), 0.0)) / np.sqrt(problem.line.n)
    white = data[:, used] / np.sqrt(np.asarray(problem.noise, float)[:, used])
    gain = np.asarray(problem.forward.circulant().transfer * problem.whitener[:, None])[..., used]
    gain = gain.astype(complex)
    priors = list(_priors(gain, white, k[used - 1] * depth_m))
    stated = _log_evidence(gain, white, priors)
    power = np.mean(np.abs(white) ** 2, axis=1)
    faults = list(_faults(gain, names, power))
    ratios = [_log_evidence(each, white, priors) - stated for each, _ in faults]
    best = int(np.argmax(ratios))
    if not ratios[best] > np.log(len(faults) / false_alarm.WIRING):
        return ()

    def fault(gain: Gain) -> Gain:
        return list(_faults(gain, names, power))[best][0]

    instead = causes_of_wiring(given, depth_m, fault)
    if instead:
        return (f"The signals fit another rig than the one stated: {in_words(instead)}.",)
    tens = ratios[best] / np.log(10)
    times = f"more than 10^{MOST_DIGITS}" if tens > MOST_DIGITS else f"10^{tens:.0f}"
    return (
        f"{faults[best][1]} The signals are {times} times as probable "
        "with that as with the elements as stated; if the wiring is right, then a gain, an angle "
        "or a depth is not, or hum is on the signals.",
    )


def _of_waves(problem: LineProblem) -> Bool[np.ndarray, " k"]:
    """Which wavenumbers the waves of mains are at: what is sought there goes with them."""
    if problem.nuisance is None:
        return np.zeros(problem.line.k.size, bool)
    waves = np.fft.rfft(np.asarray(problem.nuisance, float))
    power = np.sum(np.abs(waves) ** 2, axis=(0, 1))
    return power > OF_WAVES * np.max(power)


def _faults(
    gain: Gain, names: Sequence[str], power: Float[np.ndarray, " e"]
) -> Iterator[tuple[Gain, str]]:
    """The model of each fault, and what is said of it. All elements turned are none turned; one
    whose signal's `power` (that of noise is 1) is above `DEAD` is not dead, whatever fits."""
    turned, elements = -gain, len(names)
    for e in range(elements):
        at = np.arange(elements)[:, None, None] == e
        if elements > 2 or e > 0:
            yield (
                np.where(at, turned, gain),
                f"{names[e]} seems to be of the other sign beside the others: turn its polarity, "
                "or theirs.",
            )
        if power[e] < DEAD:
            yield (
                np.where(at, 0.0, gain),
                f"{names[e]} seems to be dead, with noise alone: leave it out of "
                "recording.channels, and its element out of the sensor, or record it again.",
            )
    for a, b in itertools.combinations(range(elements), 2):
        order = np.arange(elements)
        order[[a, b]] = b, a
        yield (
            gain[order],
            f"{names[a]} and {names[b]} seem to be exchanged: exchange them in recording.channels.",
        )
    for a, b in itertools.permutations(range(elements), 2):
        order = np.arange(elements)
        order[a] = b
        yield (
            gain[order],
            f"{names[a]} and {names[b]} seem to have the signal of {names[b]}'s element alone: "
            "leave one out of recording.channels, and an element out of the sensor, or mend the "
            "wiring.",
        )


def _priors(
    gain: Gain, white: Complex[np.ndarray, "e k"], kz: Float[np.ndarray, " k"]
) -> Iterator[Float[np.ndarray, "c c k"]]:
    """Spectra of p and q (of p alone where friction is known), by level, length and friction."""
    power = np.sum(np.abs(white) ** 2)
    are_apart = gain.shape[1] > 1
    shears = SHEARS if are_apart else SHEARS[:1]
    for depths, (mu, apart) in itertools.product(LENGTHS, shears):
        both = np.array([[1.0, mu], [mu, mu**2 + apart**2]] if are_apart else [[1.0]])
        shape = both[..., None] / (1 + (depths * kz) ** 2)
        unit = np.einsum("eck,cdk,edk->", gain, shape, gain.conj()).real
        for level in LEVELS:
            yield level * power / unit * shape


def _log_evidence(
    gain: Gain, white: Complex[np.ndarray, "e k"], priors: Sequence[Float[np.ndarray, "c c k"]]
) -> float:
    """Log probability density of the data, the mean over the priors."""
    eye = np.eye(len(white))
    logs = []
    for prior in priors:
        covariance = np.einsum("eck,cdk,fdk->kef", gain, prior, gain.conj())
        power = np.einsum("kee->k", covariance).real
        covariance = covariance + np.maximum(1.0, LEAST_NOISE * power)[:, None, None] * eye
        solved = np.linalg.solve(covariance, white.T[..., None])[..., 0]
        squares = np.sum(white.T.conj() * solved).real
        logs.append(-squares - np.sum(np.linalg.slogdet(covariance)[1]))
    return float(logsumexp(logs))
