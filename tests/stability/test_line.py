"""Signals of a sensor on short, long, coarse and fine lines, against plain sums."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film, Offset, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, Periodic, as_real
from tests.reference import exact, lines
from tests.refusals import refused
from tests.stability import matrix
from tests.stability.matrix import PRECISIONS, Group, HardCase
from tests.tiers import rare

CELL_M, SPEED, OHM = 1e-4, 0.05, 1e6
LINES = {"periodic": Periodic, "open": Open}
EPS = np.array([np.finfo(precision).eps for precision in PRECISIONS])
ORDERS = {"rate": 1, "charge": 0}


def round_offs(count):
    """That many round-offs in float64 and in float32."""
    return tuple(float(bound) for bound in count * EPS)


def sensor(v):
    """Strips of one square metre, so that the charge is that per area."""
    films = [
        Film(depth, angle, 1.0, 1.0, effects=(Offset(offset),))
        for depth, angle, offset in zip(v["depth_m"], v["angle_rad"], v["offset_m"], strict=True)
    ]
    return Sensor(films, HalfSpace(v["nu"]))


def sums(kind, n, order):
    """Rate signals or charges of tractions p (load, n), q = mu p; and the transpose of `y`."""

    def model(v):
        line, device = LINES[kind](n, v["cell_m"]), sensor(v)
        r = jnp.stack([v["p"], v["mu"] * v["p"]], axis=1)
        operator = line.operator(device.output(ConstantSpeed(SPEED)) if order else device.charge())
        return jax.vmap(operator)(r), operator.adjoint(v["y"])

    return model


def sums_reference(kind, n, order):
    def reference(v):
        given = zip(v["depth_m"], v["angle_rad"], v["offset_m"], strict=True)
        elements = [(depth, angle, 0.0, offset) for depth, angle, offset in given]
        gain = SPEED * OHM if order else 1.0
        h = lines.kernels(kind == "periodic", n, v["cell_m"], elements, v["nu"], gain, order)
        signals = [lines.signals(h, np.stack([p, v["mu"] * p])) for p in v["p"]]
        return np.stack(signals), lines.transposed(h, v["y"])

    return reference


def loads(n):
    """A pressure without a pattern, a constant one, and nothing."""
    rng = np.random.default_rng(n)
    return np.stack([rng.uniform(-1, 1, n), np.ones(n), np.zeros(n)])


def case(n, name, hard, depth_cells=5.0, mu=0.5, cell_m=CELL_M, nu=0.5, p=None, count=128.0):
    depth_m = np.array([1.0, 1.3]) * depth_cells * cell_m
    numbers = {
        "cell_m": cell_m,
        "depth_m": depth_m,
        "angle_rad": np.array([0.0, np.pi / 2]),
        "offset_m": np.array([0.0, 0.3 * cell_m]),
        "mu": mu,
        "nu": nu,
        "p": loads(n) if p is None else p,
        "y": np.random.default_rng(n + 1).uniform(-1, 1, (2, n)),
    }
    return HardCase(name, hard, numbers, round_offs(count))


def on_a_line(n):
    # The longest wave of a periodic line arrives as exp(-kz), which alone has the condition kz.
    for cells in (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0):
        hard = "the film lies on the surface" if cells < 1 else "cells far finer than the depth"
        count = max(128.0, 4 * 2 * np.pi * 1.3 * cells / n)
        yield case(n, f"depth {cells:g} cells", hard, cells, count=count)
    for mu in (0.0, 1e-6, 1e6, -1e6):
        yield case(n, f"mu {mu:g}", "one component hides the other", mu=mu)
    for cell_m in (1e-9, 1e3):
        yield case(n, f"cell {cell_m:g} m", "lengths of no skin", cell_m=cell_m)
    # A wave's round-off is that of the largest pressure.
    p, nu = loads(n) * np.array([1.0, 1e3, 0.0])[:, None], 0.0
    yield case(n, "1 kPa", "no part of a constant pressure is felt", p=p, nu=nu, count=16e3)


def on(kind, n, order=1):
    name = f"{kind} line of {n}{'' if order else ', charge'}"
    models = sums(kind, n, order), sums_reference(kind, n, order)
    return Group(name, *models, tuple(on_a_line(n)))


PITCH_M, N_PITCH = 0.7e-3, 8


def one_strip(kind, v, width):
    effects = (StripAverage(width), Offset(v["offset_m"]))
    film = Film(v["depth_m"], 0.4, 1.0, 1.0, effects=effects)
    cell_m = v["pitch_m"] / N_PITCH
    operator = LINES[kind](N_PITCH, cell_m).operator(Sensor([film]).output(ConstantSpeed(SPEED)))
    return operator(jnp.stack([v["p"], v["mu"] * v["p"]]))


def blind(v):
    """Signals of a strip beside those of a thin one, and what they change by with the width."""

    def wide(width):
        return one_strip("periodic", v, width)

    value, slope = jax.jvp(wide, (v["width_m"],), (v["width_m"],))
    return jnp.stack([value, wide(0.0 * v["width_m"])]), slope


def blind_reference(v):
    """Of one wave, whose strip is sinc a of a thin one's; and cos a - sinc a, a = kw/2."""
    element = (v["depth_m"], 0.4, 0.0, v["offset_m"])
    cell = v["pitch_m"] / N_PITCH
    h = lines.kernels(True, N_PITCH, cell, [element], 0.5, SPEED * OHM, 1)
    thin = lines.signals(h, np.stack([v["p"], v["mu"] * v["p"]]))
    a = exact.mp.pi * float(v["width_m"]) / float(v["pitch_m"])
    sinc = exact.mp.sin(a) / a
    less, slope = exact.as_float([sinc, exact.mp.cos(a) - sinc])
    return np.stack([less * thin, thin]), slope * thin


def width(pitches, hard):
    numbers = {
        "width_m": pitches * PITCH_M,
        "pitch_m": PITCH_M,
        "depth_m": 0.75e-3,
        "offset_m": 1e-4,
        "mu": 0.5,
        "p": np.cos(2 * np.pi * np.arange(N_PITCH) / N_PITCH),
    }
    return HardCase(f"width {pitches:.9g} pitches", hard, numbers, round_offs(128.0))


def widths():
    """Through the zeros of the strip's sinc, and down to where it is one."""
    for pitches in (0.9, 0.999, 1 - 1e-9, 1.0, 1 + 1e-6, 1.1, 2.0, 3.0):
        yield width(pitches, "a strip as wide as the pitch is blind to it")
    for pitches in (1e-9, 1e-6, 1e-4, 1e-2):
        yield width(pitches, "the sinc is one but for round-off, and its slope next to nothing")


# Values here, derivatives in test_more_derivatives.py.
CHARGE = on("open", 7, 0)
GROUPS = (
    on("periodic", 4),
    on("open", 31),
    Group("strip", blind, blind_reference, tuple(widths())),
)
# Their values alone; the longer ones cost most and are like the shorter.
SHORT = [on(kind, n, order) for kind in LINES for n, order in ((3, 1), (4, 0), (5, 1))]
LONG = [on("periodic", 61), on("open", 31, 0)]
LONGER = [on("periodic", 7), on("open", 7), on("periodic", 31), on("open", 61)]
OTHERS = [pytest.param(group, id=group.name) for group in [*SHORT, CHARGE]]
OTHERS += [pytest.param(group, id=group.name, marks=pytest.mark.full) for group in LONG]
OTHERS += [pytest.param(group, id=group.name, marks=pytest.mark.claim) for group in LONGER]
# A program for each: single precision repeats what double precision shows.
EITHER = ["float64", pytest.param("float32", marks=pytest.mark.full)]


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("group", OTHERS)
def test_other_lines(group, precision, margin):
    """The values of lines of other lengths, even and odd, short and long."""
    margin(*matrix.within_bounds(group, precision))


@eqx.filter_jit
def both_ways(line, device, r, y):
    operator = device.operator(line, ConstantSpeed(SPEED))
    return operator(r), operator.adjoint(y)


@pytest.mark.parametrize("precision", EITHER)
@pytest.mark.parametrize("depths", [1e-3, 10.0, 100.0, 1000.0])
def test_strip_of_many_depths_on_the_open_line(depths, precision, margin):
    """Its mean is a sum over as many nodes as the depth asks for."""
    n, depth_m = 5, 0.5e-3
    element, cell_m = (depth_m, 0.4, depths * depth_m, 0.0), max(depths, 1.0) * depth_m
    with jax.enable_x64(precision == "float64"):
        strip = StripAverage.at_depth(element[2], depth_m)
        device = Sensor([Film(depth_m, 0.4, 1.0, 1.0, effects=(strip,))])
        r, y = np.stack([loads(n)[0], 0.5 * loads(n)[0]]), np.ones((1, n))
        ours = both_ways(Open(n, cell_m), device, as_real(r), as_real(y))
    given = np.asarray(element, precision).astype(float), np.asarray(cell_m, precision)
    h = lines.kernels(False, n, given[1], [given[0]], 0.5, SPEED * OHM, 1)
    wanted = lines.signals(h, r), lines.transposed(h, y)
    error = max(
        np.abs(np.asarray(one) - other).max() / np.abs(other).max()
        for one, other in zip(ours, wanted, strict=True)
    )
    # Every node rounds the sum once, and there are about 9 for each depth.
    bound = round_offs(128 + 9 * depths)[PRECISIONS.index(precision)]
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("precision", EITHER)
@pytest.mark.parametrize("kind", rare(LINES, "periodic"))
def test_twenty_elements(kind, precision, margin):
    """At twenty depths and angles; no traction gives nothing at all."""
    n, elements = 7, 20
    element = np.stack(
        [
            np.geomspace(1e-5, 5e-3, elements),
            np.linspace(-np.pi, np.pi, elements),
            np.zeros(elements),
            np.linspace(-1e-3, 1e-3, elements),
        ],
        axis=1,
    )
    rng = np.random.default_rng(1)
    r, y = rng.uniform(-1, 1, (2, n)), rng.uniform(-1, 1, (elements, n))
    with jax.enable_x64(precision == "float64"):
        device = Sensor([Film(z, a, 1.0, 1.0, effects=(Offset(o),)) for z, a, _, o in element])
        line = LINES[kind](n, CELL_M)
        ours = both_ways(line, device, as_real(r), as_real(y))
        nothing = both_ways(line, device, as_real(0 * r), as_real(0 * y))
    assert not any(np.any(part) for part in nothing)
    rounded = np.asarray(element, precision).astype(float)
    cell_m = np.asarray(CELL_M, precision)
    h = lines.kernels(kind == "periodic", n, cell_m, rounded, 0.5, SPEED * OHM, 1)
    wanted = lines.signals(h, r), lines.transposed(h, y)
    errors = np.abs(np.asarray(ours[0]) - wanted[0]).max(1) / np.abs(wanted[0]).max(1)
    # Alone, each wave exp(-kz) has the condition kz.
    kz = 2 * np.pi * rounded[:, 0] / (n * CELL_M) if kind == "periodic" else np.zeros(elements)
    bounds = round_offs(1.0)[PRECISIONS.index(precision)] * np.maximum(128.0, 8 * kz)
    error = np.abs(np.asarray(ours[1]) - wanted[1]).max() / np.abs(wanted[1]).max()
    margin(error, bounds[0])
    assert (errors < bounds).all()
    assert error < bounds[0]


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("kind", LINES)
def test_one_and_two_samples_are_refused(kind, n):
    refused(lambda: LINES[kind](n, CELL_M), f"{n} cells", "at least 3")


def test_a_strip_too_wide_for_the_open_line_is_refused():
    device = Sensor([Film(1e-9, effects=(StripAverage.at_depth(1e-3, 1e-9),))])
    r, y = jnp.ones((2, 3)), jnp.ones((1, 3))
    refused(lambda: both_ways(Open(3, CELL_M), device, r, y), "depths", "grid.line=periodic")
    assert np.isfinite(both_ways(Periodic(3, CELL_M), device, r, y)[0]).all()
