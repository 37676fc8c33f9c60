"""What changes nothing real changes nothing: mirrors, shifts, orders, copies and signs."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film, Offset, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import _operator
from tests.stability.test_invariance import CELL_M, DEPTH_M, LINES, PRECISIONS, N, truth

ANGLES, OFFSETS = (0.2, np.pi / 2), (0.0, 2e-4)
METHODS = {
    "wiener": lambda: Wiener(Exponential(1e3, 1e-3), Exponential(1e3, 1e-3)),
    "tikhonov": lambda: Tikhonov(1, weight_p=1e-5, weight_q=1e-5),
}
# Round-offs that Fourier transforms, transfers and sums over so few cells add up to, at most.
FORWARD = 64


def operator(kind, order=(0, 1), side=1.0, start_m=-4e-3):
    """The signal of two films, in an order, or seen in a mirror (`side` -1) as it slides there."""
    films = [
        Film(
            DEPTH_M,
            side * ANGLES[i],
            effects=(StripAverage(5e-4), Offset(side * OFFSETS[i])),
        )
        for i in order
    ]
    line = LINES[kind](N, CELL_M, start_m)
    return line, _operator(line, Sensor(films), ConstantSpeed(side * 0.05))


def eps(precision) -> float:
    return float(np.finfo(precision).eps)


def check(ours, wanted, bound, margin):
    ours, wanted = np.asarray(ours, float), np.asarray(wanted, float)
    error = float(np.abs(ours - wanted).max() / np.abs(wanted).max())
    margin(error, bound)
    assert error < bound


def mirrored(r):
    """p is even and q is odd."""
    return np.array([[1.0], [-1.0]]) * r[:, ::-1]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", LINES)
def test_mirrored_signal(kind, precision, margin):
    """The mirrored traction, felt by mirrored films that slide the other way, gives the same signal
    in time: mirrored along the line."""
    with jax.enable_x64(precision == "float64"):
        signal = operator(kind)[1](jnp.asarray(truth()))
        mirrored_signal = operator(kind, side=-1.0)[1](jnp.asarray(mirrored(truth())))
        check(np.asarray(mirrored_signal)[:, ::-1], signal, FORWARD * eps(precision), margin)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("cells", [1, 7, 0.5, 0.3])
def test_shifted_signal(cells, precision, margin):
    """On the periodic line, by whole cells and by parts of one, of band-limited traction."""

    def shift(values):
        spectrum = np.fft.rfft(np.asarray(values, float))
        spectrum[:, -1] = 0.0  # the last wavenumber has no shift by part of a cell
        turn = np.exp(-2j * np.pi * np.arange(N // 2 + 1) * cells / N)
        return np.fft.irfft(spectrum, N), np.fft.irfft(turn * spectrum, N)

    with jax.enable_x64(precision == "float64"):
        _, forward = operator("periodic")
        here, shifted = (forward(jnp.asarray(r)) for r in shift(truth()))
        check(shifted, shift(here)[1], FORWARD * eps(precision), margin)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_shifted_signal_on_the_open_line(precision, margin):
    """By whole cells, of traction that stays within the window; where it lies does not matter."""
    inside = np.where(np.abs(np.arange(N) - N // 2) < 8, truth(), 0.0)
    with jax.enable_x64(precision == "float64"):
        signal = np.asarray(operator("open")[1](jnp.asarray(inside)))
        moved = np.asarray(operator("open", start_m=1.0)[1](jnp.asarray(np.roll(inside, 5, 1))))
        check(moved[:, 5:], signal[:, :-5], FORWARD * eps(precision), margin)


@cache
def data(kind, precision):
    """A noisy signal and its noise's standard deviation, in float32's digits."""
    with jax.enable_x64(True):
        signal = np.asarray(operator(kind)[1](jnp.asarray(truth())))
    sigma = float(np.float32(0.01 * signal.std()))
    noisy = signal + sigma * np.random.default_rng(3).normal(size=signal.shape)
    return noisy.astype("float32").astype(precision), sigma


@cache
def condition(kind, method, sigma) -> float:
    """Of the rows [G/sigma; P^(1/2)] of the dense problem: that by which orthogonalising them wave
    by wave grows rounding. Its square is that of the normal equations."""
    with jax.enable_x64(True):
        _, forward = operator(kind)
        basis = np.eye(2 * N).reshape(2 * N, 2, N)
        model = np.asarray(jax.vmap(forward)(jnp.asarray(basis))).reshape(2 * N, -1).T
    if method == "wiener":
        lag = CELL_M * np.abs((np.arange(N)[:, None] - np.arange(N) + N // 2) % N - N // 2)
        held = np.linalg.inv(1e6 * np.exp(-lag / 1e-3))
    else:
        step = np.roll(np.eye(N), -1, axis=0) - np.eye(N)
        step = step if kind == "periodic" else step[:-1]
        held = 1e-5 * (DEPTH_M / CELL_M) ** 2 * step.T @ step
    precision = model.T @ model / sigma**2 + np.kron(np.eye(2), held)
    values = np.linalg.eigvalsh(precision)
    # The means of a periodic line are not solved for.
    values = values[values > 1e-13 * values.max()]
    return float(np.sqrt(values.max() / values.min()))


def solved(method, kind, y, sigma, order=(0, 1), side=1.0):
    line, forward = operator(kind, order, side)
    noise = np.full(N // 2 + 1, sigma**2)
    return METHODS[method]()(LineProblem(line, forward, y, noise))


CHANGES = {  # (data -> data, order of films, side, noise power's factor, answer -> answer)
    "films reordered": (lambda y: y[::-1], (1, 0), 1.0, 1.0, lambda r: r),
    "films doubled": (lambda y: np.tile(y, (2, 1)), (0, 1, 0, 1), 1.0, 2.0, lambda r: r),
    "mirrored": (lambda y: y[:, ::-1], (0, 1), -1.0, 1.0, mirrored),
    "negated": (lambda y: -y, (0, 1), 1.0, 1.0, lambda r: -r),
    "shifted": (lambda y: np.roll(y, 7, axis=1), (0, 1), 1.0, 1.0, lambda r: np.roll(r, 7, 1)),
}
# Each method on each line, each change with each of both: the other half is for `make claims`.
SOLVED = [
    pytest.param(
        method, kind, change, precision, marks=() if (i + j + k) % 2 == 0 else pytest.mark.claim
    )
    for i, method in enumerate(METHODS)
    for j, kind in enumerate(LINES)
    for k, change in enumerate(CHANGES)
    for precision in PRECISIONS
    # Shifts have an end on the open line, where float32 gives no digit of the normal equations.
    if kind == "periodic" or (change != "shifted" and precision == "float64")
]


@pytest.mark.parametrize(("method", "kind", "change", "precision"), SOLVED)
def test_answer(method, kind, change, precision, margin):
    """The same answer of the same data told otherwise, and the same standard error."""
    of_data, order, side, power, of_answer = CHANGES[change]
    y, sigma = data(kind, precision)
    grown = condition(kind, method, sigma) ** (1 if kind == "periodic" else 2)
    bound = FORWARD * eps(precision) * grown
    assert bound < 0.1
    with jax.enable_x64(precision == "float64"):
        original = solved(method, kind, y, sigma)
        other = solved(method, kind, of_data(y), sigma * power**0.5, order, side)
    check(other.value, of_answer(np.asarray(original.value)), bound, margin)
    # A standard error has no sign.
    check(other.stderr, np.abs(of_answer(np.asarray(original.stderr))), bound, margin)
