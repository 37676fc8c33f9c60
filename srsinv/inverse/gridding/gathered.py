"""A problem with the samples of neighbouring cells gathered into wider ones."""

import numpy as np
from jaxtyping import Float

from ...errors import refuse, whole
from ...forward.film import SampleAverage
from ...grid import as_real
from ..line.problem import LineProblem


def gathered(problem: LineProblem, count: int) -> LineProblem:
    """The same problem on cells `count` times wider, each with the mean of its samples.

    A cell with a missing sample is missing. The film's charge is averaged as the samples are, and
    the noise has the spectrum of the means. Raises `BadInput` for a problem without a sensor, and
    where `count` does not divide the number of cells.
    """
    line = problem.line
    count = whole("count", count, "a whole number from 1", least=1)
    refuse(
        line.n % count > 0,
        f"{line.n} cells cannot be gathered by {count}: give a divisor of their number.",
    )
    if count == 1:
        return problem
    sensor, scan = problem.sensor, problem.scan
    refuse(sensor is None, "The problem has an operator and no sensor, and cannot be gathered.")
    assert sensor is not None
    assert scan is not None
    cell = float(line.cell_m)
    average = SampleAverage(count, cell)
    start = float(line.start_m) + (count - 1) / 2 * cell
    wider = type(line)(line.n // count, as_real(count * cell), as_real(start))
    observed = _gather(problem.is_observed, count).all(axis=-1)
    whole_signal = np.asarray(problem.data + problem.mean_signal)
    data = np.where(observed, _gather(whole_signal, count).mean(axis=-1), 0.0)
    noise_scale = nuisance = None
    if problem.noise_scale is not None:  # the noise of a mean has the rms of its samples' factors
        squares = np.asarray(problem.noise_scale) ** 2
        noise_scale = np.sqrt(np.mean(_gather(squares, count), axis=-1))
    if problem.nuisance is not None:
        columns = [np.asarray(each) for each in problem.nuisance]
        nuisance = np.stack([_gather(each, count).mean(axis=-1) for each in columns])
    return LineProblem.of_sensor(
        wider,
        sensor.with_films(lambda film: film.with_effect(average)),
        scan,
        data,
        noise_of_means(np.asarray(problem.noise), line.n, count),
        observed=observed,
        noise_scale=noise_scale,
        nuisance=nuisance,
        known_mean_Pa=problem.known_mean_Pa,
        background_Pa=problem.background_Pa,
        friction=problem.friction,
        rig=problem.rig,
        warnings=problem.warnings,
    )


def _gather(samples: np.ndarray, count: int) -> np.ndarray:
    return samples.reshape(len(samples), -1, count)


def noise_of_means(
    power: Float[np.ndarray, "*e k"], n: int, count: int
) -> Float[np.ndarray, "*e wide"]:
    """Power of means of `count` successive samples out of n, from their `power` per sample.

    The mean's response is that of a comb of `count`, and the waves that the wider cells cannot tell
    apart add up. An infinite power at k = 0, of an offset, stays.
    """
    has_offset = not np.isfinite(power[..., 0]).all()
    finite = np.where(np.isfinite(power), power, 0.0)
    mirrored = finite[..., 1 : n - power.shape[-1] + 1][..., ::-1]
    both = np.concatenate([finite, mirrored], axis=-1)
    comb = np.abs(np.fft.fft(np.ones(count) / count, n)) ** 2
    folded = (comb * both).reshape(*power.shape[:-1], count, -1).sum(axis=-2) / count
    wide = folded[..., : n // count // 2 + 1]
    wide[..., 0] = np.inf if has_offset else wide[..., 0]
    return wide
