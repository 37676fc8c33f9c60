"""Least-squares problems of More, Garbow and Hillstrom, ACM TOMS 7 (1981) 17-41, by their numbers.

Each is a residual f(x) of a vector x (n,), a standard start, and the sums of squares |f|^2 at the
minima that the paper lists: local ones, and those that lie at infinity, among them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

FACTORS = (1.0, 10.0, 100.0)  # of the standard start, after the paper
SIX_DIGITS = 1e-5  # to which the paper gives its sums of squares
ZERO = 1e-10  # sum of squares up to which a residual that can vanish has vanished


class LeastSquaresProblem(NamedTuple):
    """A residual function x (n,) -> f (m,), its standard start and the minima of |f|^2."""

    number: int
    residual: Callable
    start: tuple[float, ...]
    minima: tuple[float, ...]

    @property
    def name(self) -> str:
        """The residual function's name."""
        return self.residual.__name__

    def start_at(self, factor: float) -> np.ndarray:
        """The standard start times a factor; a start of zeros becomes the factor itself."""
        start = np.array(self.start)
        return factor * start if start.any() or factor == 1 else np.full(len(start), factor)

    def minimum_at(self, sum_of_squares: float) -> float | None:
        """The listed minimum that a sum of squares reaches, None where it reaches none."""
        for value in self.minima:
            if abs(sum_of_squares - value) <= SIX_DIGITS * value + ZERO * (value == 0):
                return value
        return None


def _index(count: int) -> np.ndarray:
    return np.arange(1.0, count + 1)


def rosenbrock(x):
    return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def freudenstein_roth(x):
    return jnp.stack([
        -13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1],
        -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1],
    ])  # fmt: skip


def powell_badly_scaled(x):
    return jnp.stack([1e4 * x[0] * x[1] - 1, jnp.exp(-x[0]) + jnp.exp(-x[1]) - 1.0001])


def brown_badly_scaled(x):
    return jnp.stack([x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2])


def beale(x):
    return np.array([1.5, 2.25, 2.625]) - x[0] * (1 - x[1] ** _index(3))


def jennrich_sampson(x):
    i = _index(10)
    return 2 + 2 * i - (jnp.exp(i * x[0]) + jnp.exp(i * x[1]))


def helical_valley(x):
    turns = jnp.arctan(x[1] / x[0]) / (2 * np.pi) + jnp.where(x[0] < 0, 0.5, 0.0)
    return jnp.stack([10 * (x[2] - 10 * turns), 10 * (jnp.hypot(x[0], x[1]) - 1), x[2]])


BARD = np.array([
    0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39,
])  # fmt: skip


def bard(x):
    u = _index(15)
    v = 16 - u
    return BARD - (x[0] + u / (v * x[1] + np.minimum(u, v) * x[2]))


HALF_BELL = np.array([0.0009, 0.0044, 0.0175, 0.0540, 0.1295, 0.2420, 0.3521])
BELL = np.concatenate([HALF_BELL, [0.3989], HALF_BELL[::-1]])


def gaussian(x):
    t = (8 - _index(15)) / 2
    return x[0] * jnp.exp(-x[1] * (t - x[2]) ** 2 / 2) - BELL


MEYER = np.array([
    34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744,
    8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872,
])  # fmt: skip


def meyer(x):
    return x[0] * jnp.exp(x[1] / (45 + 5 * _index(16) + x[2])) - MEYER


def gulf(x):
    t = _index(99) / 100
    y = 25 + (-50 * np.log(t)) ** (2 / 3)
    return jnp.exp(-(jnp.abs(y - x[1]) ** x[2]) / x[0]) - t


def box(x):
    t = 0.1 * _index(10)
    return jnp.exp(-t * x[0]) - jnp.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10 * t))


def powell_singular(x):
    return jnp.stack([
        x[0] + 10 * x[1], 5**0.5 * (x[2] - x[3]), (x[1] - 2 * x[2]) ** 2,
        10**0.5 * (x[0] - x[3]) ** 2,
    ])  # fmt: skip


def wood(x):
    return jnp.stack([
        10 * (x[1] - x[0] ** 2), 1 - x[0], 90**0.5 * (x[3] - x[2] ** 2), 1 - x[2],
        10**0.5 * (x[1] + x[3] - 2), 10**-0.5 * (x[1] - x[3]),
    ])  # fmt: skip


KOWALIK_U = np.array([4, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
KOWALIK_Y = np.array([
    0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246,
])  # fmt: skip


def kowalik_osborne(x):
    u = KOWALIK_U
    return KOWALIK_Y - x[0] * (u**2 + u * x[1]) / (u**2 + u * x[2] + x[3])


def brown_dennis(x):
    t = _index(20) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


OSBORNE_1 = np.array([
    844, 908, 932, 936, 925, 908, 881, 850, 818, 784, 751, 718, 685, 658, 628, 603, 580,
    558, 538, 522, 506, 490, 478, 467, 457, 448, 438, 431, 424, 420, 414, 411, 406,
]) / 1e3  # fmt: skip


def osborne_1(x):
    t = 10 * (_index(33) - 1)
    return OSBORNE_1 - (x[0] + x[1] * jnp.exp(-t * x[3]) + x[2] * jnp.exp(-t * x[4]))


def biggs(x):
    t = 0.1 * _index(13)
    y = np.exp(-t) - 5 * np.exp(-10 * t) + 3 * np.exp(-4 * t)
    return x[2] * jnp.exp(-t * x[0]) - x[3] * jnp.exp(-t * x[1]) + x[5] * jnp.exp(-t * x[4]) - y


OSBORNE_2 = np.array([
    1366, 1191, 1112, 1013, 991, 885, 831, 847, 786, 725, 746, 679, 608, 655, 616, 606, 602,
    626, 651, 724, 649, 649, 694, 644, 624, 661, 612, 558, 533, 495, 500, 423, 395, 375, 372,
    391, 396, 405, 428, 429, 523, 562, 607, 653, 672, 708, 633, 668, 645, 632, 591, 559, 597,
    625, 739, 710, 729, 720, 636, 581, 428, 292, 162, 98, 54,
]) / 1e3  # fmt: skip


def osborne_2(x):
    t = (_index(65) - 1) / 10
    bells = [x[i] * jnp.exp(-((t - x[i + 7]) ** 2) * x[i + 4]) for i in (1, 2, 3)]
    return OSBORNE_2 - (x[0] * jnp.exp(-t * x[4]) + sum(bells))


def watson(x):
    t = _index(29)[:, None] / 29
    j = np.arange(len(x))
    rows = (t ** np.maximum(j - 1, 0) * j) @ x - (t**j @ x) ** 2 - 1
    return jnp.concatenate([rows, jnp.stack([x[0], x[1] - x[0] ** 2 - 1])])


def penalty_1(x):
    return jnp.append(1e-5**0.5 * (x - 1), jnp.sum(x**2) - 0.25)


def variably_dimensioned(x):
    linear = _index(len(x)) @ (x - 1)
    return jnp.concatenate([x - 1, jnp.stack([linear, linear**2])])


def trigonometric(x):
    n = len(x)
    return n - jnp.sum(jnp.cos(x)) + _index(n) * (1 - jnp.cos(x)) - jnp.sin(x)


def brown_almost_linear(x):
    n = len(x)
    return jnp.append(x[:-1] + jnp.sum(x) - (n + 1), jnp.prod(x) - 1)


def chebyquad(x):
    n = len(x)
    u = 2 * x - 1
    low, high = jnp.ones_like(u), u
    rows = []
    for i in range(1, n + 1):
        integral = -1 / (i**2 - 1) if i % 2 == 0 else 0.0
        rows.append(jnp.mean(high) - integral)
        low, high = high, 2 * u * high - low
    return jnp.stack(rows)


PROBLEMS = (
    LeastSquaresProblem(1, rosenbrock, (-1.2, 1.0), (0.0,)),
    LeastSquaresProblem(2, freudenstein_roth, (0.5, -2.0), (0.0, 48.9842)),
    LeastSquaresProblem(3, powell_badly_scaled, (0.0, 1.0), (0.0,)),
    LeastSquaresProblem(4, brown_badly_scaled, (1.0, 1.0), (0.0,)),
    LeastSquaresProblem(5, beale, (1.0, 1.0), (0.0,)),
    LeastSquaresProblem(6, jennrich_sampson, (0.3, 0.4), (124.362,)),
    LeastSquaresProblem(7, helical_valley, (-1.0, 0.0, 0.0), (0.0,)),
    LeastSquaresProblem(8, bard, (1.0, 1.0, 1.0), (8.21487e-3, 17.4286)),
    LeastSquaresProblem(9, gaussian, (0.4, 1.0, 0.0), (1.12793e-8,)),
    LeastSquaresProblem(10, meyer, (0.02, 4000.0, 250.0), (87.9458,)),
    LeastSquaresProblem(11, gulf, (5.0, 2.5, 0.15), (0.0,)),
    LeastSquaresProblem(12, box, (0.0, 10.0, 20.0), (0.0,)),
    LeastSquaresProblem(13, powell_singular, (3.0, -1.0, 0.0, 1.0), (0.0,)),
    LeastSquaresProblem(14, wood, (-3.0, -1.0, -3.0, -1.0), (0.0,)),
    LeastSquaresProblem(15, kowalik_osborne, (0.25, 0.39, 0.415, 0.39), (3.07505e-4, 1.02734e-3)),
    LeastSquaresProblem(16, brown_dennis, (25.0, 5.0, -5.0, -1.0), (85822.2,)),
    LeastSquaresProblem(17, osborne_1, (0.5, 1.5, -1.0, 0.01, 0.02), (5.46489e-5,)),
    LeastSquaresProblem(18, biggs, (1.0, 2.0, 1.0, 1.0, 1.0, 1.0), (0.0, 5.65565e-3)),
    LeastSquaresProblem(
        19, osborne_2, (1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5), (4.01377e-2,)
    ),
    LeastSquaresProblem(20, watson, (0.0,) * 6, (2.28767e-3,)),
    LeastSquaresProblem(23, penalty_1, (1.0, 2.0, 3.0, 4.0), (2.24997e-5,)),
    LeastSquaresProblem(25, variably_dimensioned, tuple(1 - _index(6) / 6), (0.0,)),
    LeastSquaresProblem(26, trigonometric, (0.2,) * 5, (0.0,)),
    LeastSquaresProblem(27, brown_almost_linear, (0.5,) * 5, (0.0, 1.0)),
    LeastSquaresProblem(35, chebyquad, tuple(_index(8) / 9), (3.51687e-3,)),
)
