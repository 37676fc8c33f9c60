"""A skin that relaxes, sliding steadily, against its limits, energy, and a dense solution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.shape_from_traction.shape import shape_band, shape_under
from srsinv.forward import contact_viscoelastic
from srsinv.forward.contact import press
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Ridge, Rough, SineWave, Tape
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Periodic
from srsinv.inverse.estimate import TractionEstimate
from srsinv.status import Status
from tests.forward.setups import height_of, solve_contact
from tests.refusals import refused

LENGTH, N = 0.02, 256
CELL = LENGTH / N
LINE = Periodic(N, CELL, -LENGTH / 2 + CELL / 2)
X, K = np.asarray(LINE.x), np.asarray(LINE.k)
MODULUS = 7e5 / 0.75
TIME = 1e-3
REST = HalfSpace()
RIDGE, LOAD = Ridge(25e-6, 2e-3, 0.0, 4e-4), 4e3
MODES = 3


def sliding(speed, fractions=(3.0,), times=(TIME,)):
    """Filled up with modes that do nothing, so that one program does for any number."""
    idle = MODES - len(fractions)
    return Viscoelastic(REST, [*fractions] + idle * [0.0], [*times] + idle * [1.0], speed)


def modulus(frequency, fractions, times):
    w = 1j * np.asarray(frequency)
    return 1 + sum(f * w * t / (1 + w * t) for f, t in zip(fractions, times, strict=True))


def compliance(skin):
    """Of cells, at K; the last wavenumber is its own conjugate."""
    k, modes = K[1:], (np.asarray(skin.fractions), np.asarray(skin.times_s))
    late = modulus(k * float(skin.speed_m_per_s), *modes)
    spectrum = 2 / (MODULUS * k * np.sinc(k * CELL / 2 / np.pi) * late)
    spectrum[-1] = spectrum[-1].real
    return np.concatenate([[0.0], spectrum])


def check(contact, skin, height, nominal, size=1e-8):
    """Load, signs, complementarity and the skin's own displacement."""
    p, gap, span = np.asarray(contact.pressure_Pa), np.asarray(contact.gap_m), np.ptp(height)
    assert contact.status == "converged"
    assert float(contact.residual) <= 1e-10
    assert np.mean(p) == pytest.approx(nominal, rel=1e-10)
    assert np.all(p >= 0)
    assert np.min(gap) >= -1e-10 * span
    assert np.max(np.abs(p * gap)) <= 1e-10 * nominal * span * (1 + 1e-6)
    moved = np.fft.irfft(compliance(skin) * np.fft.rfft(p), N)
    left = moved - gap - height
    # The uniform pressure rounds in the transform.
    np.testing.assert_allclose(left, left.mean(), rtol=0, atol=size * span + 1e-20 * nominal)


# --- the modulus -----------------------------------------------------------------------------


def test_the_modulus_is_the_series_at_every_frequency():
    skin = sliding(0.1, (0.5, 0.0, 40.0), (1e-2, 1.0, 1e-5))
    w = np.concatenate([-(10.0 ** np.arange(-8, 12)), [0.0], 10.0 ** np.arange(-8, 12)])
    relative_modulus = np.asarray(skin.relative_modulus(jnp.asarray(w)))
    np.testing.assert_allclose(
        relative_modulus, modulus(w, (0.5, 0.0, 40.0), (1e-2, 1.0, 1e-5)), rtol=1e-13
    )


def test_no_frequency_overflows_in_value_or_slope():
    with jax.enable_x64(False):
        w = jnp.asarray([0.0, 1e-30, 1.0, 1e30], jnp.float32)
        value, slope = jax.jit(
            jax.value_and_grad(
                lambda time, w: jnp.sum(jnp.abs(sliding(1.0, times=[time]).relative_modulus(w)))
            )
        )(1.0, w)
        assert value == pytest.approx(1 + 1 + np.hypot(2.5, 1.5) + 4)
        assert np.isfinite(slope)


@pytest.mark.full
def test_the_stress_inside_is_the_wrapped_skin_s():
    skin, x = sliding(0.1), jnp.linspace(-1e-3, 1e-3, 5)
    depth, width = jnp.asarray(1e-3), jnp.asarray(2e-4)

    @jax.jit
    def inside(x, depth, width):
        return [
            (
                each.transfer(x * 1e6, depth),
                each.strip_response(x, depth, width),
                each.strip_slope(x, depth, width),
            )
            for each in (skin, REST)
        ]

    for ours, theirs in zip(*inside(x, depth, width), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert "half space" in skin.words
    assert "4 times stiffer" in skin.words


def test_refusals():
    refused(lambda: Viscoelastic(REST, [1.0, 2.0], [1e-3]), "fractions has 2", "times_s has 1")
    refused(lambda: Viscoelastic(REST, [], []), "times_s has 0")
    for fraction in (-0.1, np.nan, "a"):
        refused(lambda f=fraction: sliding(0.1, (1.0, f), (1e-3, 1e-2)), "skin.fractions[1]")
    for time in (0.0, -1e-3, np.inf):
        refused(lambda t=time: sliding(0.1, (1.0,), (t,)), "skin.times_s[0]", "positive")
    refused(lambda: sliding(np.nan), "skin.speed_m_per_s")


# --- contact ---------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize(("speed", "stiffer"), [(1e-11, 1), (-1e-11, 1), (1e9, 4), (-1e9, 4)])
def test_very_slow_and_very_fast_it_is_elastic(speed, stiffer):
    height = height_of(RIDGE, LINE)
    pressure_Pa = solve_contact(LINE, sliding(speed), height, LOAD).pressure_Pa
    elastic = solve_contact(LINE, HalfSpace(0.5, stiffer * 7e5), height, LOAD)
    assert 0.05 < np.mean(elastic.touching) < 0.95
    np.testing.assert_allclose(pressure_Pa, elastic.pressure_Pa, rtol=1e-6, atol=1e-6 * LOAD)


def test_the_edge_met_first_carries_more():
    """A finger that moves to +x meets a ridge at its -x side, where the skin is bent fast."""
    height = height_of(RIDGE, LINE)
    ahead, back = (
        solve_contact(LINE, sliding(u), height, LOAD / 8).pressure_Pa for u in (0.3, -0.3)
    )
    np.testing.assert_allclose(back, ahead[::-1], rtol=0, atol=1e-6)
    p = np.asarray(ahead)
    assert np.sum(p * X) / np.sum(p) < -2 * CELL
    assert p[X < 0].max() > 1.05 * p[X > 0].max()


def test_sliding_is_resisted_by_what_the_skin_loses():
    """Power into the skin is u times the integral of p dh/dx, as its surface moves at u dh/dx; by
    wavenumber u k Re(i C) |p|^2 = u k |Im C| |p|^2, which is never negative, and nothing where the
    skin is elastic."""
    height = height_of(RIDGE, LINE)
    slope = np.gradient(np.asarray(height), CELL)

    def resistance(speed):
        p = np.asarray(solve_contact(LINE, sliding(speed), height, LOAD).pressure_Pa)
        loss = -2 * K * np.imag(compliance(sliding(speed))) * np.abs(np.fft.rfft(p)) ** 2
        return np.sum(p * slope) * CELL, np.sum(loss) * CELL / N

    most, dissipated = resistance(0.3)
    assert dissipated > 0
    assert most == pytest.approx(dissipated, rel=0.02)
    assert resistance(-0.3)[0] == pytest.approx(-most, rel=1e-6)
    for speed in (1e-7, 1e6):
        assert 0 < resistance(speed)[0] < 1e-4 * most


def test_full_contact_is_the_wave_stiffer_and_ahead():
    """p = nominal + E* k D/2 |m| cos(k x + arg m): its crest comes before the surface's."""
    depth, k, speed = 1e-5, 2 * np.pi / LENGTH, 2.0
    skin = sliding(speed, (0.7, 2.0), (1e-3, 2e-4))
    late = modulus(k * speed, (0.7, 2.0), (1e-3, 2e-4))
    assert np.angle(late) > 0.2
    full = MODULUS * k * depth / 2 * np.sinc(k * CELL / 2 / np.pi)
    contact = solve_contact(LINE, skin, height_of(SineWave(depth, LENGTH, 0.0), LINE), 6e3)
    wave = full * np.abs(late) * np.cos(k * X + np.angle(late))
    np.testing.assert_allclose(contact.pressure_Pa, 6e3 + wave, rtol=1e-11)
    assert float(contact.iterations) == 0


def circulant(spectrum):
    """The matrix of the convolution, its kernel summed wave by wave."""
    waves = np.exp(1j * K[None] * (X[:, None] - X[0]))
    weight = np.where((K == 0) | (K[-1] == K), 1.0, 2.0)
    kernel = (waves * (spectrum * weight)[None]).real.sum(1) / N
    return kernel[(np.arange(N)[:, None] - np.arange(N)[None]) % N]


def on_simplex(values, mean):
    """The nearest point with no negative entry and this mean."""
    down = np.sort(values)[::-1]
    above = (np.cumsum(down) - mean * values.size) / np.arange(1, values.size + 1)
    return np.maximum(values - above[np.nonzero(down > above)[0][-1]], 0.0)


def by_extragradient(matrix, height, nominal):
    """The variational inequality by Korpelevich's method (1976), which needs no symmetry."""
    step = 0.9 / np.linalg.norm(matrix, 2)
    p = np.full(height.size, nominal)
    for _ in range(30_000):
        tried = on_simplex(p - step * (matrix @ p - height), nominal)
        new = on_simplex(p - step * (matrix @ tried - height), nominal)
        if np.max(np.abs(new - p)) < 1e-13 * np.max(p):
            return new
        p = new
    raise AssertionError("the reference has not converged")


ROUGH = pytest.param(Rough(5e-6, 3e-3, 2e-4, 0.8, 1), id="rough", marks=pytest.mark.claim)


@pytest.mark.full
@pytest.mark.parametrize("shape", [pytest.param(RIDGE, id="ridge"), ROUGH])
def test_a_dense_solution_by_another_method(shape):
    skin = sliding(-0.2, (2.0, 2.0), (2e-3, 2e-4))
    height = height_of(shape, LINE)
    matrix = circulant(compliance(skin))
    assert np.linalg.norm(matrix - matrix.T) > 0.1 * np.linalg.norm(matrix)
    reference = by_extragradient(matrix, height, LOAD)
    contact = solve_contact(LINE, skin, jnp.asarray(height), LOAD)
    assert 0.05 < np.mean(contact.touching) < 0.95
    np.testing.assert_allclose(contact.pressure_Pa, reference, rtol=0, atol=1e-6 * reference.max())


HARD = {
    "ridge": (RIDGE, 3e3),
    "tape": (Tape(50e-6, 0.012), 2e4),
    "groove": (Ridge(-25e-6, 0.9e-3), 3e4),
    "vertical": (Ridge(25e-6, 0.9e-3, 0.0, 0.0), 3e4),
    "light": (RIDGE, 1e-6),
    "heavy": (RIDGE, 1e12),
    "tall": (Ridge(1e-3, 0.9e-3), 3e4),
    "picometre": (Ridge(1e-12, 0.9e-3), 3e4),
    "rough": (Rough(5e-6, 3e-3, 2e-4, 0.3, 7), 2e3),
    "rough, lightly": (Rough(20e-6, 3e-3, 2e-4, 0.3, 7), 50.0),
    "wave": (SineWave(1e-5, LENGTH, 0.0), 70.0),
}
# Fractions, times and speed: from elastic to a loss of five times the storage, of both signs.
LAGS = {
    "creeping": ((1.0,), (TIME,), 1e-6),
    "one": ((1.0,), (TIME,), 0.5),
    "ten": ((10.0,), (TIME,), -0.5),
    "a hundred": ((100.0,), (TIME,), 0.1),
    "a hundred, slowly": ((100.0,), (TIME,), 0.01),
    "broad": ((20.0,) * 3, (1e-2, 1e-3, 1e-4), 0.1),
    "rushing": ((100.0,), (TIME,), 1e4),
    "a thousand": ((1000.0,), (TIME,), 0.03),
    "still": ((100.0,), (TIME,), 0.0),
}


@pytest.mark.full
@pytest.mark.parametrize("lag", LAGS.values(), ids=LAGS)
@pytest.mark.parametrize(("shape", "nominal"), HARD.values(), ids=HARD)
def test_hard_profiles_and_lags(shape, nominal, lag):
    fractions, times, speed = lag
    skin = sliding(speed, fractions, times)
    height = height_of(shape, LINE)
    check(solve_contact(LINE, skin, jnp.asarray(height), nominal), skin, height, nominal)


def test_a_flat_surface_is_pressed_evenly():
    contact = solve_contact(LINE, sliding(0.1), jnp.zeros(N), 1e4)
    np.testing.assert_array_equal(contact.pressure_Pa, 1e4)
    np.testing.assert_array_equal(contact.gap_m, 0.0)


def test_the_pressure_gives_the_profile_back():
    height = height_of(RIDGE, LINE)
    contact = solve_contact(LINE, sliding(0.3), height, LOAD)
    left = np.asarray(shape_under(LINE, sliding(0.3), contact.pressure_Pa) - height)
    touching = np.asarray(contact.touching)
    assert 5 < touching.sum() < 250
    assert np.ptp(left[touching]) < 1e-9 * 25e-6


@pytest.mark.full
def test_the_profile_s_band_from_the_pressure_s():
    """Its standard error by the matrix of the displacement, for errors that are the same anywhere
    and for the same errors between all cells."""
    skin, power = sliding(0.3), 1 / (1 + (K / 3e3) ** 2)
    matrix, errors = circulant(compliance(skin)), circulant(power + 0j)
    touching = np.abs(X) < 1e-3
    projection = np.eye(N) - touching[None] / touching.sum()
    expected = np.sqrt(np.diag(projection @ matrix @ errors @ matrix.T @ projection.T))
    for covariance in (jnp.asarray(power)[None, None] + 0j, jnp.asarray(errors)):
        none = jnp.zeros((1, N))
        estimate = TractionEstimate(
            line=LINE,
            value=jnp.zeros((2, N)),
            stderr=jnp.zeros((2, N)),
            fitted=none,
            whitened=none,
            covariance=covariance,
            mean_weights=None,
            averaging=none[None],
            friction=None,
            status=Status.CONVERGED,
            warnings=(),
            stats={},
        )
        with jax.numpy_rank_promotion("allow"):  # it is the inverse's
            _, stderr = shape_band(LINE, skin, estimate, jnp.asarray(touching))
        np.testing.assert_allclose(stderr, expected, rtol=1e-9)


@pytest.mark.full
def test_odd_lengths_and_single_precision():
    line = Periodic(255, LENGTH / 255, -LENGTH / 2)
    height = height_of(RIDGE, line)
    double = solve_contact(line, sliding(0.3), height, LOAD)
    assert double.status == "converged"
    with jax.enable_x64(False):
        small = jax.tree.map(
            lambda v: jnp.asarray(v, jnp.float32), (line, sliding(0.3), height, LOAD)
        )
        single = solve_contact(*small)
        assert single.pressure_Pa.dtype == jnp.float32
        assert single.status == "converged"
    error = np.asarray(single.pressure_Pa) - np.asarray(double.pressure_Pa)
    assert np.linalg.norm(error) < 2e-3 * np.linalg.norm(double.pressure_Pa)


def test_an_elastic_skin_is_solved_without_a_trace_of_this(monkeypatch):
    def untouched(*_):
        raise AssertionError("traced")

    monkeypatch.setattr(contact_viscoelastic, "pressure_deviation", untouched)
    line = Periodic(17, 1e-3)  # of a length that nothing else has compiled
    trace = jax.make_jaxpr(lambda skin, height: press(line, skin, height, 1e3).pressure_Pa)
    trace(REST, jnp.zeros(17))
    with pytest.raises(AssertionError, match="traced"):
        trace(sliding(0.1), jnp.zeros(17))


# --- derivatives -----------------------------------------------------------------------------

UNITS = {
    "height_m": 25e-6,
    "width_m": 2e-3,
    "nominal_pressure_Pa": LOAD,
    "modulus_Pa": 7e5,
    "fraction": 3.0,
    "time_s": TIME,
    "speed_m_per_s": 0.3,
}


def pressure(relative):
    """p over its mean, of a ridge whose parameters are so many times those above."""
    height, width, nominal, stiffness, fraction, time, speed = (
        r * unit for r, unit in zip(relative, UNITS.values(), strict=True)
    )
    shape = Ridge(height, width, 0.3e-3, 4e-4)
    skin = Viscoelastic(HalfSpace(0.5, stiffness), [fraction], [time], speed)
    return press(LINE, skin, shape.height(LINE), nominal).pressure_Pa / LOAD


STEP, WEIGHT = 1e-5, np.sin(3e3 * X)


@pytest.fixture(scope="module")
def derived():
    """Pressures, Jacobians forward and gradients in reverse of WEIGHT times the pressure, by one
    program: at three sizes of all parameters, and a step above and below in each."""

    def all_of(relative):
        value, push = jax.linearize(pressure, relative)
        pull = jax.linear_transpose(push, relative)
        return value, jax.vmap(push)(jnp.eye(len(UNITS))).T, pull(jnp.asarray(WEIGHT))[0]

    steps = STEP * np.eye(len(UNITS))
    points = np.concatenate([np.outer([1.0, 0.7, 1.4], np.ones(len(UNITS))), 1 + steps, 1 - steps])
    return jax.device_get(jax.jit(jax.vmap(all_of))(points))


@pytest.mark.full
@pytest.mark.parametrize("name", UNITS)
def test_derivatives_are_the_differences_where_the_contact_stays(name, derived):
    at, (values, forward, _) = list(UNITS).index(name), derived
    above, below = values[3 + at], values[3 + len(UNITS) + at]
    np.testing.assert_array_equal(above > 0, below > 0)
    differences = (above - below) / (2 * STEP)
    error = np.linalg.norm(forward[0][:, at] - differences)
    assert error <= 1e-4 * np.linalg.norm(differences)


@pytest.mark.full
def test_reverse_is_the_transpose_of_forward_under_vmap(derived):
    _, forward, reverse = derived
    for jacobian, gradient in zip(forward[:3], reverse[:3], strict=True):
        slopes = WEIGHT @ jacobian
        np.testing.assert_allclose(gradient, slopes, rtol=0, atol=1e-9 * np.abs(slopes).max())


total = jax.jit(
    jax.grad(
        lambda height, nominal, skin: jnp.sum(
            jnp.sin(500 * LINE.x) * press(LINE, skin, height, nominal).pressure_Pa
        ),
        argnums=(0, 1, 2),
    )
)


@pytest.mark.full
@pytest.mark.parametrize("lag", ["creeping", "a hundred", "still"])
@pytest.mark.parametrize(("shape", "nominal"), HARD.values(), ids=HARD)
def test_derivatives_are_finite(shape, nominal, lag):
    fractions, times, speed = LAGS[lag]
    for leaf in jax.tree.leaves(
        total(height_of(shape, LINE), jnp.asarray(nominal), sliding(speed, fractions, times))
    ):
        assert np.all(np.isfinite(leaf))


@pytest.mark.full
def test_without_pressure_everything_is_nan():
    height, nothing = height_of(RIDGE, LINE), jnp.asarray(0.0)
    assert np.all(np.isnan(solve_contact(LINE, sliding(0.1), height, nothing).pressure_Pa))
    _, slope, _ = total(height, nothing, sliding(0.1))
    assert np.isnan(slope)
