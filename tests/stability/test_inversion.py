"""Inversions whose data hardly tell what is asked, against posteriors in many digits."""

from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Convolution, Periodic
from srsinv.inverse.line import direct, iterative, spectral
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.tikhonov import DerivativePenalty
from srsinv.inverse.wiener import Exponential, SpectralPrior
from tests.reference import exact, posterior
from tests.stability.matrix import PRECISIONS, Group, HardCase, within_bounds

WINDOW_M, WIDTH_M, STRIP_M = 4e-3, 0.7e-3, 8e-3
SPEED_M_PER_S, RESISTANCE_OHM = 0.05, 1e6
LENGTH_M = 0.75e-3  # of the derivative penalty


def forward_of(v, n):
    """The rate signal's operator on n cells; all films side by side, which is quick to compile."""
    line = Periodic(n, v["cell_m"])

    def one(angle, width):
        film = Film(v["depth_m"], angle, width, STRIP_M, effects=(StripAverage(width),))
        sensor = Sensor([film], amplifier=CurrentAmplifier(RESISTANCE_OHM))
        return sensor.operator(line, ConstantSpeed(SPEED_M_PER_S)).transfer[0]

    return line, Convolution(
        jax.vmap(one)(v["angles_rad"], v["widths_m"]), line.cell_m, n, n, False
    )


def problem_of(v, n, observed=None):
    line, forward = forward_of(v, n)
    noise = jnp.full(line.k.shape, v["noise_V"] ** 2)
    friction = v.get("friction")
    return LineProblem(line, forward, v["data_V"], noise, observed=observed, friction=friction)


def prior_of(problem, v, order):
    """Wiener's for `order` None, else a penalty on the derivative of this order."""
    if order is not None:
        return DerivativePenalty(v["weights_per_Pa2"], jnp.asarray(LENGTH_M), order)
    spectra = [Exponential(rms, 1e-3) for rms in v["rms_Pa"]]
    return SpectralPrior(jnp.stack([one.power(problem) for one in spectra]))


def estimated(v, n, order, path, observed=None):
    """Value and standard error (2, c, n) [Pa]."""
    problem = problem_of(v, n, observed)
    prior = prior_of(problem, v, order)
    if path == "spectral":
        estimate = spectral.solve(problem, prior)
    elif path == "direct":
        estimate = direct.solve(problem, prior, direct.whiten(problem))
    else:
        estimate = iterative.solve(problem, prior, 1e-12).solution
    return jnp.stack([estimate.value, estimate.stderr])


def exactly(v, n, order, observed=None):
    """The same in many digits."""
    gain = gains_of(v, n)
    precision = [precisions(v, order, j, n) for j in range(n // 2 + 1)]
    noise = mp.mpf(float(v["noise_V"])) ** 2
    if observed is None:
        return np.stack(posterior.spectral(gain, noise, precision, v["data_V"]))
    power = [[1 / p if p else mp.mpf(0) for p in row] for row in precision]
    return np.stack(posterior.conditioned(gain, noise, power, v["data_V"], observed))


def gains_of(v, n):
    """G[k][e][c] in many digits."""
    elements = len(v["angles_rad"])
    gain = posterior.gains(
        n, v["cell_m"], v["depth_m"], v["angles_rad"], v["widths_m"], [STRIP_M] * elements,
        SPEED_M_PER_S, RESISTANCE_OHM,
    )  # fmt: skip
    if "friction" not in v:
        return gain
    mu = mp.mpf(float(v["friction"]))
    return [[[p + mu * q] for p, q in rows] for rows in gain]


def precisions(v, order, j, n):
    """P of each component at the wavenumber number j."""
    cell = mp.mpf(float(v["cell_m"]))
    half = mp.pi * j / n
    if order is not None:
        slope = (2 * mp.mpf(LENGTH_M) / cell * mp.sin(half)) ** (2 * order)
        return [mp.mpf(float(w)) * slope for w in v["weights_per_Pa2"]]
    a = mp.exp(-cell / mp.mpf("1e-3"))
    shape = (1 - 2 * a * mp.cos(2 * half) + a**2) / (1 - a**2)
    return [shape / mp.mpf(float(rms)) ** 2 for rms in v["rms_Pa"]]


def apart(ours, wanted, v):
    """The largest error, in units of what a change of data and model by one part in one makes.

    Data that change by a share of their size move the value by at most that share of |data|/noise
    standard errors. A model that does moves the standard error by that share of the condition, the
    largest gain times the standard error over the noise, and the value by as much again times the
    residual.
    """
    (value, stderr), (exact_value, exact_stderr) = ours, wanted
    band, n = exact_stderr.max(-1), np.shape(v["data_V"])[-1]
    gain = exact.as_float(gains_of(v, n))
    condition = 1 + np.abs(gain).max() * band / v["noise_V"]
    fitted = np.fft.irfft(np.einsum("kec,ck->ek", gain, np.fft.rfft(exact_value)), n)
    data, residual = (np.linalg.norm(s) / v["noise_V"] for s in (v["data_V"], v["data_V"] - fitted))
    moved = (
        np.abs(exact_value).max(-1) + band * (data + condition * residual) + np.finfo(float).tiny
    )
    of_value = np.abs(value - exact_value).max(-1) / moved
    of_band = np.abs(stderr / exact_stderr - 1).max(-1) / condition
    return float(np.max([of_value, of_band]))


NOISE_V = 2e-7  # a hundredth of the bump's signal at the usual depth


def squared(ours, wanted, v):
    """As `apart`, where normal equations square the condition: a change of them by one part in one
    moves value and standard error by its square."""
    gain = np.abs(exact.as_float(gains_of(v, np.shape(v["data_V"])[-1]))).max()
    largest = wanted[1].max() / v["noise_V"] * gain
    return apart(ours, wanted, v) / (1 + largest)


def value_alone(ours, wanted, v):
    """As `squared`, without the standard error, which is that of another problem on the iterative
    path: the nearest periodic one with every sample there."""
    return squared(np.stack([ours[0], wanted[1]]), wanted, v)


def numbers(n=16, angles=(0.2, 1.5), depth_m=0.75e-3, noise_V=NOISE_V, seed=0, **changes):
    """A bump of p and one of q felt by elements at these angles, with white noise."""
    cell = WINDOW_M / n
    x = (np.arange(n) - n / 2) * cell
    p = 2e3 * np.exp(-((x / 6e-4) ** 2))
    q = 5e2 * np.exp(-(((x - 5e-4) / 6e-4) ** 2)) + 0.3 * p
    widths = np.full(len(angles), changes.pop("width_m", WIDTH_M))
    v = {"cell_m": cell, "depth_m": depth_m, "angles_rad": np.array(angles), "widths_m": widths}
    gain = exact.as_float(gains_of(v, n))
    signal = np.fft.irfft(np.einsum("kec,ck->ek", gain, np.fft.rfft([p, q])), n)
    data = signal + noise_V * np.random.default_rng(seed).normal(size=signal.shape)
    return v | {"noise_V": noise_V, "data_V": data, "rms_Pa": np.array([1e3, 5e2])} | changes


EPS = np.array([np.finfo(float).eps, np.finfo(np.float32).eps])
# Round-offs, in the units of `apart`: what a short chain of backward stable steps may lose.
ROUNDOFFS = 64


def case(name, hard, *, single=True, **changes):
    """`single`: whether float32 holds the numbers."""
    double, narrow = ROUNDOFFS * EPS
    return HardCase(name, hard, numbers(**changes), (double, narrow if single else None))


def turned(angle_rad, **changes):
    hard = "half of what is asked is not in the data, or barely"
    name = f"elements {angle_rad:g} rad apart"
    return case(name, hard, angles=(0.4, 0.4 + angle_rad), **changes)


def weights(p, q, **changes):
    hard = "the penalty is nothing, or all, beside the data"
    both = np.array([p, q])
    return case(f"weights {p:g} and {q:g}", hard, weights_per_Pa2=both, **changes)


def rubbing(mu):
    hard = "the signal of q = mu p vanishes, or dwarfs that of p"
    return case(f"mu {mu:g}", hard, angles=(0.3,), friction=mu, rms_Pa=np.array([1e3]))


TWO = (
    *(turned(angle) for angle in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12, 0.0)),
    case("noise 80 dB above", "the answer is the prior", noise_V=1e6 * NOISE_V),
    case("noise 140 dB below", "nothing holds the answer but data", noise_V=1e-5 * NOISE_V),
    turned(1e-3, noise_V=1e-5 * NOISE_V)._replace(name="noise 140 dB below, nearly equal"),
    case("zero signal", "the answer is nothing, with a band", data_V=np.zeros((2, 16))),
    case("film at a hundredth of a cell", "q is hardly felt", depth_m=2.5e-6),
    case("film at a hundred cells", "the signal underflows", depth_m=2.5e-2),
    case("film at a thousand cells", "every wave underflows", depth_m=2.5e-1),
    case("prior of 1e12 Pa", "the prior is nothing", rms_Pa=np.array([1e12, 1e12])),
    case("prior of 1e-12 Pa", "the prior is all", rms_Pa=np.array([1e-12, 1e-12])),
    case("priors 1e24 apart", "one component is free, one held", rms_Pa=np.array([1e12, 1e-12])),
    case("prior of 1e100 Pa", "nearly overflows", rms_Pa=np.full(2, 1e100), single=False),
    case("strip's zero in the band", "a wave that no element feels", width_m=1e-3),
    case(
        "strip's zero in the band, prior of 1e12 Pa", "a wave that nothing holds",
        width_m=1e-3, rms_Pa=np.full(2, 1e12),
    ),
)  # fmt: skip
SLOPES = (
    *(weights(w, w) for w in (1e-30, 1e-12, 1.0, 1e12, 1e30)),
    *(weights(w, w, single=False) for w in (1e-300, 1e300)),
    weights(1e-12, 1e12),
    weights(1e-30, 1e-30, depth_m=2.5e-3)._replace(name="weights 1e-30, film at ten cells"),
)
TWENTY = {"angles": tuple(np.linspace(0, 3, 20)), "n": 8}
SAME = {"angles": (0.4,) * 20, "n": 8}
FEW = (
    ("plain", "few cells", {}),
    ("identical elements", "few cells, half of them told", {"angles": (0.4, 0.4)}),
)
OBSERVED = np.ones((2, 12), bool)
OBSERVED[:, 3:6] = False
OBSERVED[1, 9] = False
MISSING = (
    case("plain", "samples are missing", n=12),
    turned(1e-3, n=12),
    turned(1e-9, n=12),
    turned(0.0, n=12),
    case("noise 80 dB above", "the answer is the prior", n=12, noise_V=1e6 * NOISE_V),
    case("noise 40 dB lower", "normal equations near their end", n=12, noise_V=1e-2 * NOISE_V),
    case("zero signal", "nothing, with a band", n=12, data_V=np.zeros((2, 12))),
    case("prior of 1e-12 Pa", "the prior is all", n=12, rms_Pa=np.full(2, 1e-12)),
    case("film at a hundred cells", "the signal underflows", n=12, depth_m=2.5e-2),
)


def group(
    name, cases, n=16, order=None, path="spectral", observed=None, error=apart, side_by_side=True
):
    return Group(
        name,
        partial(estimated, n=n, order=order, path=path, observed=observed),
        partial(exactly, n=n, order=order, observed=observed),
        cases,
        side_by_side=side_by_side,
        error=error,
    )


GROUPS = (
    group("Wiener", TWO),
    group("slope penalty", SLOPES, order=1),
    group("direct", MISSING, 12, None, "direct", OBSERVED, squared, side_by_side=False),
)


# Values here, derivatives in test_more_derivatives.py.
CURVATURE = group("curvature penalty", SLOPES[:5], order=2)
ONE = group(
    "one element",
    tuple(rubbing(mu) for mu in (0.0, 1e-6, -1e-6, 1.0, -1.0, 1e3, -1e3, 1e6, -1e6)),
)
MANY = group(
    "twenty elements",
    (
        case("all ways", "many rows", **TWENTY),
        case("identical", "twenty rows, one of them told", **SAME),
    ),
    n=8,
)
VALUES = (
    CURVATURE,
    ONE,
    MANY,
    *(
        group(f"{n} cells", tuple(case(name, hard, n=n, **c) for name, hard, c in FEW), n)
        for n in (3, 13)
    ),
)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("of", VALUES, ids=lambda of: of.name)
def test_value(of, precision, margin):
    """Of groups whose derivatives are not asked for here."""
    margin(*within_bounds(of, precision))


@pytest.mark.parametrize("each", MISSING, ids=lambda each: each.name)
def test_value_of_the_iterative_path(each):
    """It is not compiled, and has no derivatives."""
    v = {name: np.asarray(number, float) for name, number in each.numbers.items()}
    ours = np.asarray(estimated(v, 12, None, "iterative", OBSERVED))
    wanted = exactly(v, 12, None, OBSERVED)
    # Conjugate gradients stop at 1e-12.
    assert value_alone(ours, wanted, v) < 1e-8


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
