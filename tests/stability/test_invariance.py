"""The answer transforms as physics says when units change, and when nothing real does.

Units change by powers of two, from about 1e-9 to 1e9: these change no digit of any number, so that
the answer in the old unit is the same to a few round-offs, however ill-conditioned the problem is.
What fails is a square that overflows or underflows, and a threshold that has a unit.
"""

import itertools
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.errors import BadInput
from srsinv.forward.contact import press
from srsinv.forward.film import Film, Offset, Piezo, StripAverage
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import Hertz
from srsinv.grid import Convolution, Open, Periodic, as_real
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import _operator
from tests.tiers import rare

N, CELL_M, DEPTH_M, SPEED_M_PER_S = 32, 2.5e-4, 7.5e-4, 0.05
PRECISIONS = ("float64", "float32")
SMALL, LOW, HIGH, LARGE = 2.0**-30, 2.0**-13, 2.0**13, 2.0**30


class UnitFactors(NamedTuple):
    """What numbers of length, traction and charge are multiplied by."""

    name: str
    length: float = 1.0
    traction: float = 1.0
    charge: float = 1.0

    @property
    def signal(self) -> float:
        """Of the charge on an electrode's area, which a speed of so many lengths reads."""
        return self.charge * self.traction * self.length**2


SAME = UnitFactors("same")
UNITS = (
    *(UnitFactors(f"{what} {f:.0e}", **{what: f})
      for what in UnitFactors._fields[1:] for f in (SMALL, LARGE)),
    UnitFactors("all small", LOW, LOW, LOW),
    UnitFactors("all large", HIGH, HIGH, HIGH),
    UnitFactors("short and stiff", SMALL, LARGE, LARGE),
    UnitFactors("long and soft", LARGE, SMALL, SMALL),
    UnitFactors("weak charge, large load", 1.0, LARGE, SMALL),
)  # fmt: skip
LINES = {"periodic": Periodic, "open": Open}


def sensor(u: UnitFactors) -> Sensor:
    d = [u.charge * each for each in (23e-12, 3e-12, -33e-12)]
    films = [
        Film(
            u.length * DEPTH_M, angle, u.length * 7e-4, u.length * 8e-3, Piezo(*d),
            (StripAverage(u.length * 5e-4), Offset(u.length * offset)),
        )
        for angle, offset in ((0.2, 0.0), (np.pi / 2, 2e-4))
    ]  # fmt: skip
    return Sensor(films)


def operator(kind: str, u: UnitFactors):
    line = LINES[kind](N, u.length * CELL_M, -u.length * 4e-3)
    return line, _operator(line, sensor(u), ConstantSpeed(u.length * SPEED_M_PER_S))


@cache
def truth() -> np.ndarray:
    x = np.linspace(-4, 4, N)
    p = 2e3 * np.exp(-((x / 1.2) ** 2))
    return np.stack([p, 0.3 * p + 5e2 * np.exp(-((x - 1) ** 2))]).astype("float32").astype(float)


@cache
def data(kind: str) -> tuple[np.ndarray, float]:
    """A signal in the unit of `SAME`, and its noise's standard deviation, in float32's digits."""
    signal = np.asarray(operator(kind, SAME)[1](jnp.asarray(truth())))
    sigma = float(np.float32(0.01 * signal.std()))
    noisy = signal + sigma * np.random.default_rng(0).normal(size=signal.shape)
    return noisy.astype("float32").astype(float), sigma


def problem(kind: str, u: UnitFactors, gaps: bool = False) -> LineProblem:
    signal, sigma = data(kind)
    line, forward = operator(kind, u)
    observed = np.ones(signal.shape, bool)
    observed[0, 20:23] = not gaps
    y = np.where(observed, signal, 0.0) * u.signal
    noise = np.full(N // 2 + 1, (sigma * u.signal) ** 2)
    return LineProblem(line, forward, y, noise, observed=observed)


def wiener(u: UnitFactors, path: str) -> Wiener:
    spectrum = Exponential(u.traction * 1e3, u.length * 1e-3)
    return Wiener(spectrum, spectrum, path=path)


RULES = {
    "gcv": GeneralisedCrossValidation,
    "evidence": Evidence,
}
METHODS = {
    "wiener spectral": ("periodic", lambda u: wiener(u, "spectral")),
    "wiener direct": ("open", lambda u: wiener(u, "direct")),
    "wiener iterative": ("open", lambda u: wiener(u, "iterative")),
    "wiener likely": (
        "periodic",
        lambda u: Wiener(wiener(u, "auto").p, wiener(u, "auto").q, scale="evidence"),
    ),
} | {
    f"tikhonov {order} {name}": (
        "periodic",
        lambda u, order=order, rule=rule: Tikhonov(
            order, rule=rule(), length_m=u.length * DEPTH_M
        ),
    )
    for order in (0, 1, 2)
    for name, rule in RULES.items()
}  # fmt: skip
# Each order and each rule is in `make test-all`, but not each with each.
REPEATED = {"tikhonov 0 evidence", "tikhonov 1 gcv", "tikhonov 2 evidence"}
SOME = rare(METHODS, *REPEATED)


def answer(method: str, precision: str, u: UnitFactors):
    kind, make = METHODS[method]
    data(kind)
    with jax.enable_x64(precision == "float64"):
        estimate = make(u)(problem(kind, u))
        parts = {
            "value": np.asarray(estimate.value, float) / u.traction,
            "stderr": np.asarray(estimate.stderr, float) / u.traction,
            "fitted": np.asarray(estimate.fitted, float) / u.signal,
            "whitened": np.asarray(estimate.whitened, float),
        }
    return estimate.status, parts


# Of 64 round-offs: the longest chain here, log10 weights of up to 40 that a rule chose, takes as
# many round-offs as their size times ln 10.
ROUNDINGS = 128


def close(ours, wanted, size, precision: str, margin, roundings: float = ROUNDINGS) -> None:
    """Within so many round-offs of `size`."""
    error = float(np.max(np.abs(np.asarray(ours, float) - np.asarray(wanted, float))) / size)
    bound = roundings * float(np.finfo(precision).eps)
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", SOME)
def test_answer_in_other_units(method, precision, margin):
    """Traction and its error, the signal explained and the whitened residual; refused where the
    precision does not hold the noise's power."""
    result, wanted = answer(method, precision, SAME)
    y, sigma = data(METHODS[method][0])
    sizes = {name: np.abs(part).max() for name, part in wanted.items()}
    sizes["whitened"] = np.abs(y).max() / sigma
    for units in UNITS:
        if (sigma * units.signal) ** 2 < np.finfo(precision).tiny:
            with pytest.raises(BadInput, match="noise is zero"):
                answer(method, precision, units)
            continue
        rescaled = answer(method, precision, units)
        assert rescaled[0] == result, units
        for name, part in rescaled[1].items():
            close(part, wanted[name], sizes[name], precision, margin)


# --- the forward model -----------------------------------------------------------------------


def layered(u: UnitFactors):
    modulus = u.traction
    layers = [
        Layer(u.length * 1.5e-3, modulus * 7e5, 0.5),
        Layer(u.length * 5e-3, modulus * 5e4, 0.3),
    ]
    return Layered(layers)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    ("skin", "kind"),
    rare(
        itertools.product(("half space", "layered"), LINES),
        ("half space", "periodic"),
        ("layered", "open"),
    ),
)
def test_signal_in_other_units(kind, skin, precision, margin):
    """The signal of a given traction, and its adjoint."""

    def both(u: UnitFactors):
        made = sensor(u)
        if skin == "layered":
            made = Sensor(made.elements, layered(u))
        line = LINES[kind](N, u.length * CELL_M, -u.length * 4e-3)
        forward = _operator(line, made, ConstantSpeed(u.length * SPEED_M_PER_S))
        signal = forward(jnp.asarray(u.traction * truth()))
        back = forward.adjoint(jnp.asarray(signal / u.signal))  # signals of about 1e-5
        gain = u.signal / u.traction
        return np.asarray(signal, float) / u.signal, np.asarray(back, float) / gain

    with jax.enable_x64(precision == "float64"):
        wanted = both(SAME)
        for units in UNITS:
            for ours, part in zip(both(units), wanted, strict=True):
                close(ours, part, np.abs(part).max(), precision, margin)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_contact_in_other_units(precision, margin):
    """Pressure, gap, the way to them, and how the pressure moves with the height."""
    x = np.linspace(-1, 1, N, endpoint=False)
    height = (4e-5 * (1 - x**2) + 3e-6 * np.cos(9 * np.pi * x)).astype("float32").astype(float)
    weights = jnp.asarray(np.random.default_rng(1).uniform(0.5, 1.0, N).astype("float32"))

    def contact_in(u: UnitFactors):
        line = Periodic(N, u.length * CELL_M)
        skin = HalfSpace(0.5, u.traction * 7e5)
        contact, slope = _solve_contact(
            line, skin, jnp.asarray(u.length * height), as_real(u.traction * 2e3), weights
        )
        assert bool(contact.converged)
        assert 0 < int(contact.touching.sum()) < N
        return (
            np.asarray(contact.pressure_Pa, float) / u.traction,
            np.asarray(contact.gap_m, float) / u.length,
            np.asarray(contact.iterations, float),
            np.asarray(slope, float) * (u.length / u.traction),
        )

    with jax.enable_x64(precision == "float64"):
        wanted = contact_in(SAME)
        for units in UNITS:
            for ours, part in zip(contact_in(units), wanted, strict=True):
                close(ours, part, np.abs(part).max(), precision, margin)


@eqx.filter_jit
def _solve_contact(line, skin, height, nominal, weights):
    def weighted_pressure(height):
        contact = press(line, skin, height, nominal)
        return jnp.sum(weights * contact.pressure_Pa), contact

    slope, contact = jax.grad(weighted_pressure, has_aux=True)(height)
    return contact, slope


class HertzSignal(eqx.Module):
    """The signal of a Hertz pressure with friction."""

    line: Periodic
    forward: Convolution

    def __call__(self, params):
        hertz = Hertz(params["pressure_Pa"], params["half_width_m"], params["position_m"])
        p = hertz.cell_average(self.line)
        return self.forward(jnp.stack([p, params["friction"] * p]))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_fit_in_other_units(precision, margin):
    """Parameters and standard errors of a feature, by numbers from 1e-13 to 1e12."""
    start = {"pressure_Pa": 2e3, "half_width_m": 1e-3, "position_m": 1e-4, "friction": 0.2}
    true = {"pressure_Pa": 3e3, "half_width_m": 1.3e-3, "position_m": 3e-4, "friction": 0.4}

    def in_units(u: UnitFactors, params):
        scale = {"Pa": u.traction, "m": u.length}
        return {name: v * scale.get(name.split("_")[-1], 1.0) for name, v in params.items()}

    def model(u: UnitFactors):
        return HertzSignal(*operator("periodic", u))

    signal = np.asarray(model(SAME)(jax.tree.map(jnp.asarray, true)))
    sigma = float(np.float32(0.05 * signal.std()))
    y = signal + sigma * np.random.default_rng(2).normal(size=signal.shape)
    y = y.astype("float32").astype(float)

    def fitted(u: UnitFactors):
        bounds = in_units(u, {"half_width_m": 1e-4}), in_units(u, {"half_width_m": 4e-3})
        fit = srsinv.fit(
            model(u), in_units(u, start), y * u.signal, noise=sigma * u.signal,
            bounds={name: (bounds[0][name], bounds[1][name]) for name in bounds[0]},
        )  # fmt: skip
        assert fit.converged, (u, fit.status)
        one = in_units(u, dict.fromkeys(start, 1.0))
        return {n: (fit.value[n] / one[n], fit.stderr[n] / one[n]) for n in start}

    with jax.enable_x64(precision == "float64"):
        wanted = fitted(SAME)
        # A search stops where it is near enough, by a threshold on numbers about one; on the way
        # there it takes the same steps.
        for units in UNITS:
            rescaled = fitted(units)
            for name, (value, stderr) in wanted.items():
                close(rescaled[name][0], value, abs(value), precision, margin)
                close(rescaled[name][1], stderr, stderr, precision, margin)
