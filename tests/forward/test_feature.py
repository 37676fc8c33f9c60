"""Features felt along a motion, against closed forms of an infinitely fine film.

The reference sums the closed-form slope of stress over each strip's width by Gauss's rule, at the
positions x(t); it knows no cells, lines or transfers.
"""

import itertools
from functools import cache

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import (
    GratingFeature,
    HertzFeature,
    LineFeature,
    ScanExtent,
    StepFeature,
    StripFeature,
)
from srsinv.forward.film import Film, Offset, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, as_real
from srsinv.inverse.features import FeatureModel
from tests.features import FEATURES
from tests.forward.setups import fitted_order, largest_error
from tests.reference import closed_forms as cf
from tests.refusals import refused
from tests.tiers import quick

OHM, NU = 2e6, 0.45
D = (23e-12, 3e-12, -33e-12)
# Two elements: (depth, angle, width, offset), active over 8 mm.
ELEMENTS = ((0.75e-3, 0.0, 0.7e-3, 0.0), (0.9e-3, 1.3, 0.5e-3, 3e-4))
SENSOR = Sensor(
    [Film(z, angle, w, effects=(StripAverage(w), Offset(o))) for z, angle, w, o in ELEMENTS],
    HalfSpace(NU),
    CurrentAmplifier(OHM),
)
TIME = np.linspace(0, 0.2, 301)
TURN = 2 * np.pi / 0.2
MOTIONS = {
    "steady": (-5e-3 + 0.05 * TIME, np.full(TIME.size, 0.05)),
    "varying": (
        5e-3 - 0.05 * TIME + 0.02 / TURN * np.sin(TURN * TIME),
        -0.05 * (1 - 0.4 * np.cos(TURN * TIME)),
    ),
    "reversing": (-5e-3 * np.cos(TURN * TIME), 5e-3 * TURN * np.sin(TURN * TIME)),
}
SHAPES = {
    "line": {"position_m": 3.1e-4},
    "strip": {"position_m": 3.1e-4, "width_m": 2.3e-3},
    "hertz": {"position_m": 3.1e-4, "half_width_m": 1.3e-3},
    "step": {"position_m": 3.1e-4},
    "grating": {"pitch_m": 1.9e-3, "duty": 0.37, "phase_rad": 0.7},
}


def strip(x, z, position_m, width_m):
    return cf.cauchy_strip(x - position_m, z, width_m)


def hertz(x, z, position_m, half_width_m):
    return cf.cauchy_hertz(x - position_m, z, half_width_m)


def step(x, z, position_m):
    return cf.cauchy_strip(x - position_m - 500.0, z, 1000.0)


def grating(x, z, pitch_m, duty, phase_rad):
    """Its Fourier series, up to where the film feels nothing."""
    k, total = 2 * np.pi / pitch_m, np.zeros((3, x.size), complex)
    for n in range(1, int(40 / (k * z)) + 2):
        wave = cf.cauchy_cosine(x, z, n * k, -n * phase_rad)
        total += 2 / (np.pi * n) * np.sin(np.pi * n * duty) * np.array(wave)
    return tuple(total)


# Of each signal's peak, at the cells of the fit; of the grating the fade takes most.
BOUND = {"line": 1e-5, "strip": 2e-6, "hertz": 2e-5, "step": 3e-6, "grating": 1.5e-4}
CAUCHY = {
    "line": lambda x, z, position_m: cf.cauchy_line(x - position_m, z),
    "strip": strip,
    "hertz": lambda x, z, position_m, half_width_m: cf.cauchy_hertz(
        x - position_m, z, half_width_m
    ),
    "step": step,
    "grating": grating,
}


def closed_form(name, motion, p, mu):
    """R_f u dQ/dx (element, sample); the shear turns with the motion."""
    x, u = MOTIONS[motion]
    way = np.sign(u)
    way[u == 0] = 1.0  # ahead of the first motion, and at its end, where the signal is zero
    nodes, weights = np.polynomial.legendre.leggauss(24)

    def one(z, angle, width, offset):
        under = x[:, None] + offset + width / 2 * nodes
        slope = cf.stress_slope(CAUCHY[name](under.ravel(), z, **SHAPES[name]), z)
        total_slope = slope[:, 0] + np.repeat(way * mu, nodes.size) * slope[:, 1]
        density = cf.charge_density(total_slope, angle, D, NU).reshape(under.shape)
        return width * 8e-3 * density @ weights / 2

    return OHM * u * p * np.stack([one(*element) for element in ELEMENTS])


@cache
def operator_along(motion, cell_m=None):
    return FeatureModel.along(SENSOR, Motion(TIME, *MOTIONS[motion]), cell_m)


def parameters(name, p, mu):
    feature = FEATURES[name]
    return {name: SHAPES[name] | {feature.amplitude: p, feature.shear: mu * p}}


def signal(name, motion, p=2e3, mu=0.6, cell_m=None):
    model = operator_along(motion, cell_m).with_features({name: FEATURES[name]})
    return np.asarray(model(jax.tree.map(as_real, parameters(name, p, mu))))


# What a feature feels like.


@pytest.mark.parametrize("name", quick(FEATURES, "line", "strip"))
@pytest.mark.parametrize(
    ("motion", "p", "mu"), [("steady", 2e3, 0.6), ("varying", -1e3, -0.3), ("reversing", 2e3, -0.6)]
)
def test_signal_is_the_closed_form(name, motion, p, mu):
    """Either friction, either way and both, a step's endless traction beyond the window, and a
    grating's that fades out beyond the scan, for which its bound is wider."""
    error = largest_error(signal(name, motion, p, mu), closed_form(name, motion, p, mu))
    assert error < BOUND[name]


@pytest.mark.parametrize(("name", "least"), [("line", 3.5), ("strip", 3.5), ("hertz", 2.4),
                                             ("step", 3.5)])  # fmt: skip
@pytest.mark.full
def test_order_in_the_cell(name, least):
    cells = np.array([8, 16, 32])
    exact = closed_form(name, "steady", 2e3, 0.6)
    errors = [
        largest_error(signal(name, "steady", cell_m=float(SENSOR.depth_m) / int(n)), exact)
        for n in cells
    ]
    assert fitted_order(1 / cells, errors) > least


def test_a_sum_is_the_sum_and_friction_is_its_own():
    both = {"strip": FEATURES["strip"], "grating": GratingFeature(friction=-0.2)}
    own = parameters("strip", 2e3, 0.6) | {"grating": SHAPES["grating"] | {"pressure_Pa": 900.0}}
    together = operator_along("reversing").with_features(both)(jax.tree.map(as_real, own))
    apart = signal("strip", "reversing") + signal("grating", "reversing", 900.0, -0.2)
    np.testing.assert_allclose(together, apart, atol=1e-12 * np.abs(apart).max(), rtol=0)


@pytest.mark.parametrize("name", quick(FEATURES, "line", "grating"))
def test_gradient_by_finite_differences(name):
    """Where positions and widths put edges inside cells, and on them, all the same."""
    model = operator_along("steady").with_features({name: FEATURES[name]})
    tree = jax.tree.map(as_real, parameters(name, 2e3, 0.6))
    flat, unravel = jax.flatten_util.ravel_pytree(tree)
    size = np.where(np.abs(flat) > 1, np.abs(flat), np.where(np.abs(flat) < 0.1, 0.75e-3, 1.0))

    def scaled(s):
        return model(unravel(flat + size * s))

    origin, h = jnp.zeros(flat.size), 2e-4
    jacobian = np.asarray(jax.jit(jax.jacfwd(scaled))(origin))
    moves = h * jnp.eye(flat.size)
    ends = jax.jit(jax.vmap(scaled))(jnp.concatenate([2 * moves, moves, -moves, -2 * moves]))
    far, near, back, far_back = np.asarray(ends).reshape(4, flat.size, *jacobian.shape[:2])
    difference = (8 * (near - back) - (far - far_back)) / (12 * h)
    error = np.abs(np.moveaxis(jacobian, -1, 0) - difference).max(axis=(1, 2))
    assert np.all(error < 1e-4 * np.abs(difference).max(axis=(1, 2)))


# Profiles on cells.

LINE = Open(40, 1.1e-4, -2e-3)
PROFILES = {
    "strip": (lambda x: abs(x - 3.1e-4) < 1.15e-3, (3.1e-4 - 1.15e-3, 3.1e-4 + 1.15e-3)),
    "hertz": (
        lambda x: np.sqrt(max(0.0, 1 - ((x - 3.1e-4) / 1.3e-3) ** 2)),
        (3.1e-4 - 1.3e-3, 3.1e-4 + 1.3e-3),
    ),
    "step": (lambda x: x > 3.1e-4, (3.1e-4,)),
    "grating": (
        lambda x: (np.cos(2 * np.pi * x / 1.9e-3 - 0.7) > np.cos(np.pi * 0.37)) - 0.37,
        tuple(
            1.9e-3 * (n + (0.7 + side * np.pi * 0.37) / (2 * np.pi))
            for n in range(-3, 4)
            for side in (-1, 1)
        ),
    ),
}


def profile(name):
    return FEATURES[name].profile({part: as_real(v) for part, v in SHAPES[name].items()})


@pytest.mark.parametrize("name", PROFILES)
def test_cell_averages_by_quadrature(name):
    p, edges = PROFILES[name]
    averages = np.asarray(eqx.filter_jit(lambda f: f.cell_average(LINE))(profile(name)))
    for x, average in zip(np.asarray(LINE.x), averages, strict=True):
        ends = [x - 0.55e-4, *sorted(e for e in edges if abs(e - x) < 0.55e-4), x + 0.55e-4]
        total = sum(
            quad(p, a, b, epsabs=1e-15, epsrel=1e-11)[0] for a, b in itertools.pairwise(ends)
        )
        assert average == pytest.approx(total / 1.1e-4, abs=1e-9)


@pytest.mark.parametrize("name", ["line", "strip", "hertz"])
def test_shares_keep_load_and_place(name):
    """Sharpened or blurred, the cells hold the load and its first moment."""
    averages, cell_values = (
        np.asarray(eqx.filter_jit(of)(profile(name)))
        for of in (lambda f: f.cell_average(LINE), lambda f: f.cell_values(LINE))
    )
    assert cell_values.sum() == pytest.approx(averages.sum(), rel=1e-12)
    place = LINE.x @ cell_values / cell_values.sum()
    assert place == pytest.approx(3.1e-4, abs=1e-9)


# What is looked for, and what is refused.

STRETCH = ScanExtent(-5e-3, 5e-3, 0.75e-3)


@pytest.mark.parametrize("name", FEATURES)
def test_starts_are_dense_and_inside(name):
    feature = FEATURES[name]
    starts, ranges = feature.starts(STRETCH), feature.ranges(STRETCH)
    assert set(starts) == set(ranges) == set(feature.axes)
    for part, values in starts.items():
        low, high = ranges[part]
        assert np.all((values >= low * (1 - 1e-12) - 1e-12) & (values <= high * (1 + 1e-12)))
    if "position_m" in starts:
        assert np.diff(np.unique(starts["position_m"])).max() <= 0.75e-3 / 2 * 1.1


def test_a_range_is_where_it_is_looked_for():
    feature = StripFeature(position_range_m=[1e-3, 2e-3], width_range_m=None)
    assert feature.ranges(STRETCH)["position_m"] == (1e-3, 2e-3)
    assert feature.ranges(STRETCH)["width_m"] == pytest.approx((0.75e-4, 1e-2))


def test_the_usual_way_to_write_a_grating():
    own = {"pitch_m": 2e-3, "duty": 0.3, "phase_rad": 0.5, "pressure_Pa": -800.0}
    canonical = FEATURES["grating"].canonical(own)
    expected = {"pitch_m": 2e-3, "duty": 0.7, "phase_rad": 0.5 - np.pi, "pressure_Pa": 800.0}
    assert canonical == pytest.approx(expected)
    model = operator_along("steady").with_features({"grating": GratingFeature(friction=0.3)})
    same = [np.asarray(model({"grating": jax.tree.map(as_real, way)})) for way in (own, canonical)]
    np.testing.assert_allclose(*same, atol=1e-9 * np.abs(same[0]).max(), rtol=0)


REFUSED = {
    "unknown": (
        lambda: LineFeature(width_range_m=[1e-3, 2e-3]),
        "width_range_m",
        "position_range",
    ),
    "backwards": (
        lambda: StripFeature(width_range_m=[2e-3, 1e-3]),
        "width_range_m",
        "greatest",
    ),
    "no_width": (
        lambda: StripFeature(width_range_m=[0.0, 1e-3]),
        "width_range_m",
        "above 0",
    ),
    "half": (lambda: HertzFeature(half_width_range_m=[-1e-3, 1e-3]), "half_width_range_m"),
    "one": (
        lambda: StepFeature(position_range_m=[1e-3]),
        "position_range_m",
        "[least, greatest]",
    ),
    "nan": (
        lambda: StepFeature(position_range_m=[0.0, np.nan]),
        "position_range_m",
        "SI units",
    ),
    "duty": (lambda: GratingFeature(duty_range=[0.5, 1.0]), "duty_range", "below 1"),
    "words": (lambda: GratingFeature(pitch_range_m="all"), "pitch_range_m", "null"),
    "friction": (lambda: LineFeature(friction="high"), "friction", "null"),
    "friction_inf": (lambda: LineFeature(friction=np.inf), "friction", "number"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])
