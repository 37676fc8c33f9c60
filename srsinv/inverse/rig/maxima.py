"""The search for the facts of a rig under which signals of an unknown surface are most probable.

The evidence can have several maxima along the depth. It is scanned with spectra that are fitted to
the signals' power at each depth, and climbed from the best places.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...known import Numbers
from .stationary import BEND, DEPTH, LEVEL, StationaryEvidence, gain_of

# Of minus the logarithm of the evidence, by a full step: a hundredth of a standard deviation.
CLOSE, STEPS, MOST_DAMPING = 1e-4, 200, 1e8
LAST, LEVELLED = 10, 0.1  # steps, and their gain of the logarithm, that are next to nothing
SCANNED = np.geomspace(0.35, 2.9, 16)  # depths over the stated one
# Noise over the signal's rms at which searches start and go on, and the steps with each.
LOUD, FIRST_STEPS = (0.3, 0.1, 0.03), 8
# A standard error of the depth with which no other is as probable; else a walk along it, in steps
# of its logarithm, as far as probabilities e^12 times less, and again from a greater maximum.
WELL, STEP, IMPROBABLE, BETTER, WALKS = 0.01, (0.04, 0.15), 12.0, 0.1, 3
HIGHEST = 300.0  # of a spectrum's logarithm, where numbers are still finite


@compiled
def value_of(model: StationaryEvidence, x: Float[Numbers, " m"]) -> Float[Array, ""]:
    return model(x)


@compiled
def slope_of(
    model: StationaryEvidence, x: Float[Numbers, " m"]
) -> tuple[Float[Array, ""], Float[Array, " m"]]:
    return jax.value_and_grad(lambda at: model(at))(x)


@compiled
def information_of(model: StationaryEvidence, x: Float[Numbers, " m"]) -> Float[Array, "m m"]:
    return model.information(x)


def least(
    function: Callable[[np.ndarray], tuple[Any, Any]],
    information: Callable[[np.ndarray], Any],
    start: Float[np.ndarray, " m"],
    bounds: tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]],
    steps: int = STEPS,
) -> tuple[float, Float[np.ndarray, " m"], bool]:
    """The least value of a `function` with its slope, the place, and whether the search converged,
    by Fisher scoring with Levenberg's and Marquardt's damping. It ends where a full step is less
    than a hundredth of a standard deviation, or where several steps together gain next to nothing:
    neither depends on the parameters' scales."""
    x, damping = np.clip(start, *bounds), 1e-2
    value, slope = map(np.asarray, function(x))
    curvature, values = np.asarray(information(x)), [float(value)]
    for _ in range(steps):
        free = (x > bounds[0]) & (x < bounds[1]) | (np.clip(x - slope, *bounds) != x)
        step = np.zeros_like(x)
        own = curvature[np.ix_(free, free)]
        damped = own + damping * np.diag(np.diag(own))
        step[free] = -np.linalg.solve(damped, slope[free])
        is_level = len(values) > LAST and values[-LAST] - values[-1] < LEVELLED
        if is_level or (-slope @ step < CLOSE and damping < 1):
            return float(value), x, True
        at = np.clip(x + step, *bounds)
        other, other_slope = map(np.asarray, function(at))
        if np.isfinite(other) and other < value:
            x, value, slope, damping = at, other, other_slope, max(damping / 10, 1e-6)
            curvature = np.asarray(information(x))
        elif damping > MOST_DAMPING:
            break
        else:
            damping *= 4
        values.append(float(value))
    return float(value), x, False


class Searched(NamedTuple):
    """Minus the logarithm of the greatest evidence, the parameters there, whether the search
    converged, and the standard errors of the unknown facts."""

    value: float
    x: Float[np.ndarray, " m"]
    converged: bool
    stderr: Float[np.ndarray, " u"]


def greatest(model: StationaryEvidence) -> Searched:
    """The greatest evidence.

    Under more noise the evidence is wide and has few maxima, so that the search begins there, and
    follows the best one down to the noise that there is. It then walks along the depth, both ways,
    unless that is well determined.
    """
    data, observed = np.asarray(model.stretches.data), np.asarray(model.stretches.observed)
    rms = float(np.sqrt(np.sum(data**2) / np.sum(observed)))
    loud = [part * rms * np.sqrt(model.block_cells) for part in LOUD]
    at = None
    for size in (each for each in loud if each > 1):
        own = eqx.tree_at(lambda m: m.stretches.scale, model, size * model.stretches.scale)
        at = least(*_functions(own), _start(own) if at is None else at, own.bounds, FIRST_STEPS)[1]
    found = least(*_functions(model), _start(model) if at is None else at, model.bounds)
    best = _with_errors(model, found)
    for _ in range(WALKS):
        if DEPTH not in model.unknown or best.stderr[model.unknown.index(DEPTH)] < WELL:
            break
        better, best = _walked(model, best)
        if better is None:
            break
        best = _with_errors(model, least(*_functions(model), better, model.bounds))
    return best


def _with_errors(
    model: StationaryEvidence, found: tuple[float, Float[np.ndarray, " m"], bool]
) -> Searched:
    """A maximum with the errors of the unknown facts, by Fisher's information."""
    covariance = np.linalg.inv(np.asarray(information_of(model, found[1])))
    return Searched(*found, np.sqrt(np.diag(covariance)[: len(model.unknown)]))


def _functions(model: StationaryEvidence) -> tuple[Callable[..., Any], Callable[..., Any]]:
    return partial(slope_of, model), partial(information_of, model)


def _walked(
    model: StationaryEvidence, best: Searched
) -> tuple[Float[np.ndarray, " m"] | None, Searched]:
    """Parameters of a greater evidence than that of a maximum, None where there are none along the
    depth; and the maximum with the errors that other depths leave the facts: the rms distance from
    it of depths in even steps, each as probable as the evidence is with all else at its best."""
    where, size = model.unknown.index(DEPTH), len(model.unknown)
    low, high = model.bounds
    step = float(np.clip(2 * best.stderr[where], *STEP))
    squares, weights = np.zeros(size), 1.0
    for sign in (1, -1):
        x = best.x
        while abs(x[where] + sign * step) < high[where]:
            held = x[where] + sign * step
            lower, upper, x = low.copy(), high.copy(), x.copy()
            lower[where] = upper[where] = x[where] = held
            value, x, _ = least(*_functions(model), x, (lower, upper), FIRST_STEPS)
            if value < best.value - BETTER:
                return x, best
            weights += np.exp(best.value - value)
            squares += np.exp(best.value - value) * (x - best.x)[:size] ** 2
            if value > best.value + IMPROBABLE:
                break
    return None, best._replace(stderr=np.maximum(best.stderr, np.sqrt(squares / weights)))


def _start(model: StationaryEvidence) -> Float[np.ndarray, " m"]:
    """Where a search starts: the best of several depths, with all else as stated."""
    if DEPTH not in model.unknown:
        return with_fitted_spectra(model, model.start())
    each = []
    for depth in np.log(SCANNED):
        x = model.start()
        x[model.unknown.index(DEPTH)] = depth
        each.append(with_fitted_spectra(model, x))
    return min(each, key=lambda x: float(value_of(model, x)))


def with_fitted_spectra(
    model: StationaryEvidence, x: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """The parameters with the spectra, the same for p and q, that explain the signals' power: the
    sum over elements at each wavenumber is taken for exponential about the model's."""
    of, stretches = model.parted(x), model.stretches
    gain = np.asarray(gain_of(model, x))
    data = np.asarray(stretches.data)
    m = data.shape[-1]
    taper = np.hanning(m + 2)[1:-1] * np.asarray(stretches.observed).min(axis=1)[:, None]
    spectrum = np.fft.rfft(data * taper)
    observed = np.sum(np.abs(spectrum) ** 2, axis=(0, 1)) / np.sum(taper**2)
    # A stretch has half as many wavenumbers as the circle of lags.
    own = slice(2, m, 2)
    own_gain = gain[..., own]
    unit = np.asarray(model.unit)[:, None] / (float(model.step_m) * model.stride)
    power = np.sum(np.abs(own_gain) ** 2 * unit, axis=(0, 1))
    basis = np.asarray(model.basis)[own]
    noise = len(gain) / model.block_cells * float(np.mean(np.asarray(stretches.scale) ** 2))
    observed = observed[1 : 1 + len(basis)]
    bends = np.diff(np.eye(basis.shape[1]), 2, axis=0) / BEND

    def function(c: np.ndarray) -> tuple[float, np.ndarray]:
        signal = power * np.exp(np.minimum(basis @ c, HIGHEST))
        mean = signal + noise
        value = np.sum(np.log(mean) + observed / mean) + np.sum((bends @ c) ** 2) / 2
        slope = basis.T @ (signal / mean * (1 - observed / mean)) + bends.T @ (bends @ c)
        return float(value + np.sum(c**2) / (2 * LEVEL**2)), slope + c / LEVEL**2

    def information(c: np.ndarray) -> np.ndarray:
        signal = power * np.exp(np.minimum(basis @ c, HIGHEST))
        rows = basis * (signal / (signal + noise))[:, None]
        return rows.T @ rows + bends.T @ bends + np.eye(c.size) / LEVEL**2

    wide = np.full(basis.shape[1], np.inf)
    fitted = least(function, information, np.zeros(basis.shape[1]), (-wide, wide))[1]
    spectra = np.tile(fitted - np.asarray(model.tilt(of))[0], model.unit.size)
    return np.concatenate(of._replace(spectra=spectra))
