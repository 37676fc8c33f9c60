"""Measured kernels: their prior, evidence and posterior, and what inversions make of them."""

import dataclasses

import h5py
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from srsinv.errors import BadInput
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.filter import FirstOrder
from srsinv.forward.measured import KernelTable, MeasuredFilm
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.estimate import averages, relative_error
from srsinv.inverse.kernel.evidence import (
    KernelEnvelope,
    KernelPrior,
    Products,
    likeliest,
    posterior,
)
from srsinv.inverse.kernel.lags import Lags
from srsinv.inverse.kernel.measure import Place, choose, known_input, measure_kernel
from srsinv.inverse.kernel.measured import as_netcdf, is_as_written, kernels, load_kernel
from srsinv.inverse.kernel.operator_model import Measured
from srsinv.inverse.kernel.signals import KernelSignals, far_field
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.problem import Problem
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.recording.passes import passes_of
from tests.inverse.cases import signals_along
from tests.tiers import rare

DEPTH_M, MU = 7.5e-4, 0.5
LINE = Periodic(512, 0.03 / 512, -0.015)
SCAN = ConstantSpeed(0.05)
LOAD = np.where(np.arange(512) == 256, 5.0 / float(LINE.cell_m), 0.0)


def films(depth_m=DEPTH_M, tilt_deg=0.0, blur_m=0.0):
    both = [
        Film(depth_m, angle + np.deg2rad(tilt_deg)).with_strip_average()
        for angle in (0.0, np.pi / 2)
    ]
    blurred = [film.with_effect(StripAverage(blur_m)) for film in both]
    return blurred if blur_m else both


STATED, TRUE = Sensor(films()), Sensor(films(9e-4, 4.0, 3e-4))


def passes(
    true=TRUE, level=1e-3, seed=0, directions=2, stated=STATED, line=LINE, load=LOAD, noisier=1.0
):
    """Mean signals over the known load, of a noise level over the signal's rms; `noisier` times
    as much as stated."""
    own, given = (each.in_both_directions() if directions == 2 else each for each in (true, stated))
    clean = np.asarray(own.operator(line, SCAN)(np.stack([load, MU * load])))
    rms = level * np.sqrt(np.mean(clean**2))
    data = clean + noisier * rms * np.random.default_rng(seed).normal(size=clean.shape)
    noise = np.concatenate([[np.inf], np.full(line.k.size - 1, rms**2)])
    return LineProblem.of_sensor(line, given, SCAN, data, noise, known_mean_Pa=(load.mean(), None))


@pytest.fixture(scope="module")
def measured():
    return measure_kernel(passes(), STATED, LOAD, MU)


@pytest.fixture(scope="module")
def fitted():
    return measure_kernel(passes(), STATED, LOAD, MU, None)


def of(sensor, kernel):
    return kernels(sensor, sensor.elements, kernel.lags.x_m)


def slope_error(value, truth):
    """Of the kernel's slope, which a rate shows."""
    return np.linalg.norm(np.diff(value - truth)) / np.linalg.norm(np.diff(truth))


# --- the estimate ------------------------------------------------------------------------------


def test_the_kernel_is_far_nearer_the_true_one_than_theory(measured, fitted):
    truth = of(TRUE, measured)
    assert slope_error(of(STATED, measured), truth) > 0.3
    assert slope_error(measured.value, truth) < 0.005
    assert slope_error(fitted.value, truth) < 0.003


def test_a_blur_that_no_theory_has_is_in_the_errors_of_its_parameters(fitted):
    """It is read as depth: 10 standard errors of the noise alone."""
    for name, truth in {"depth_m": 9e-4, "tilt_deg": 4.0, "gain_1": 1.0, "gain_2": 1.0}.items():
        value, error = fitted.parameters[name]
        assert abs(value - truth) < 3 * error, name


@pytest.fixture(scope="module")
def rough():
    """Measured in ten times the noise."""
    return measure_kernel(passes(level=1e-2), STATED, LOAD, MU)


@pytest.mark.full
def test_less_noise_is_a_better_kernel(measured, rough):
    truth = of(TRUE, measured)
    better = slope_error(measured.value, truth) / slope_error(rough.value, truth)
    assert 0.05 < better < 0.5  # noise falls to a tenth, and more short waves are seen


@pytest.mark.full
def test_parameters_are_those_of_the_true_sensor_where_nothing_else_is_wrong():
    true = Sensor(films(9e-4, 4.0))
    found = measure_kernel(passes(true), STATED, LOAD, MU, None).parameters
    want = {"depth_m": 9e-4, "tilt_deg": 4.0, "gain_1": 1.0, "gain_2": 1.0}
    for name, truth in want.items():
        value, error = found[name]
        assert abs(value - truth) < 4 * error + 1e-3 * abs(truth), name
    assert found["depth_m"][1] < 1e-5


@pytest.mark.full
def test_one_way_measures_one_combination(measured):
    """K_p + mu K_q at the passes' mu, and warns that neither is known alone."""
    kernel = measure_kernel(passes(directions=1), STATED, LOAD, MU)
    (warning,) = kernel.warnings
    assert "one direction" in warning
    assert not kernel.has_both_ways
    truth = of(TRUE, kernel)
    both = kernel.value[:, 0] + MU * kernel.value[:, 1]
    assert slope_error(both, truth[:, 0] + MU * truth[:, 1]) < 0.01
    assert slope_error(kernel.value, truth) > 0.05
    assert np.max(kernel.stderr) > 20 * np.max(measured.stderr)


@pytest.mark.full
def test_known_filters_are_beside_the_kernel_and_unknown_ones_in_it():
    """A lag in time is one of the other sign on the way back: no kernel has it for both ways."""
    lag = (FirstOrder(4e-3),)
    slow, known = (dataclasses.replace(each, filters=lag) for each in (TRUE, STATED))
    traction = np.stack([np.exp(-((np.asarray(LINE.x) / 2e-3) ** 2))] * 2) * 1e4
    traction[1] *= MU
    want = np.asarray(slow.operator(LINE, SCAN)(traction))
    without = np.asarray(TRUE.operator(LINE, SCAN)(traction))
    size = np.linalg.norm(want)
    both = measure_kernel(passes(slow, stated=known), known, LOAD, MU).sensor(known)
    one = measure_kernel(passes(slow, directions=1), STATED, LOAD, MU).sensor(STATED)
    for sensor in (both, one):
        got = np.asarray(sensor.operator(LINE, SCAN)(traction))
        assert np.linalg.norm(got - want) < 0.005 * size < 0.1 * np.linalg.norm(without - want)


@pytest.mark.full
def test_layers_are_fitted():
    from srsinv.forward.layered import Layered

    def skin(thickness_m, modulus_Pa):
        return Layered([
            {"thickness_m": thickness_m, "youngs_modulus_Pa": 7e5, "poisson_ratio": 0.5},
            {"thickness_m": 4e-3, "youngs_modulus_Pa": modulus_Pa, "poisson_ratio": 0.3},
        ])  # fmt: skip

    stated, true = Sensor(films(), skin(1.5e-3, 5e4)), Sensor(films(), skin(1.8e-3, 7e4))
    names = ("layer_1_thickness_m", "layer_2_modulus")
    kernel = measure_kernel(passes(true, stated=stated), stated, LOAD, MU, names)
    assert abs(kernel.parameters["layer_1_thickness_m"][0] - 1.8e-3) < 2e-5
    assert abs(kernel.parameters["layer_2_modulus"][0] - 1.4) < 0.03


# --- inversions --------------------------------------------------------------------------------

SCENE = np.stack([np.exp(-((np.asarray(LINE.x) / 1e-3) ** 2)), np.zeros(512)]) * 5e3


def inverted(sensor, rig=None, level=1e-2):
    clean = np.asarray(TRUE.operator(LINE, SCAN)(SCENE))
    rms = level * np.sqrt(np.mean(clean**2))
    data = clean + rms * np.random.default_rng(9).normal(size=clean.shape)
    noise = np.concatenate([[np.inf], np.full(LINE.k.size - 1, rms**2)])
    problem = LineProblem.of_sensor(
        LINE, sensor, SCAN, data, noise, known_mean_Pa=(SCENE[0].mean(), None), rig=rig
    )
    return Wiener(Exponential(1000.0, 2e-3), Exponential(1000.0, 2e-3))(problem)


def test_inversions_by_it_are_as_good_as_by_the_true_kernel(measured):
    error = {
        name: relative_error(np.asarray(inverted(sensor).value), SCENE)[0]
        for name, sensor in {
            "stated": STATED, "true": TRUE, "measured": measured.sensor(STATED)
        }.items()
    }  # fmt: skip
    assert error["measured"] < 1.02 * error["true"] < 0.8 * error["stated"]


@pytest.mark.full
def test_its_uncertainty_widens_the_bands():
    rough = measure_kernel(passes(level=0.1), STATED, LOAD, MU)
    sensor = rough.sensor(STATED)
    exact, wide = inverted(sensor), inverted(sensor, rough.error)
    np.testing.assert_allclose(exact.value, wide.value)
    ratio = np.asarray(wide.stderr)[0] / np.asarray(exact.stderr)[0]
    assert np.all(ratio > 1.05)


def test_error_directions_are_signals_of_the_moved_kernel(measured):
    sensor = measured.sensor(STATED)
    at = int(np.argmax(np.linalg.norm(measured.factors.reshape(len(measured.factors), -1), axis=1)))
    factor, far = measured.factors[at], measured.far_factors[at]
    one = dataclasses.replace(measured, factors=factor[None], far_factors=far[None])
    moved = dataclasses.replace(measured, value=measured.value + factor, far=measured.far + far)

    def signal(each):
        return each.operator(LINE, SCAN)(SCENE)

    want = np.asarray(signal(moved.sensor(STATED)) - signal(sensor))
    signals = np.asarray(signal(sensor))
    (column,) = one.error.columns(sensor, signals, lambda setup: signal(setup.sensor))
    np.testing.assert_allclose(column, want, atol=1e-6 * np.abs(want).max())


# --- its parts, against dense algebra ----------------------------------------------------------


def toy(seed=0):
    rng = np.random.default_rng(seed)
    k = np.array([0.0, 1.0, 1.0, 2.0, 2.0])
    a, j, y = rng.normal(size=(10, 30)), rng.normal(size=(2, 30)), rng.normal(size=30)
    products = Products(a @ a.T, a @ y, a @ j.T, j @ j.T, j @ y, float(y @ y))
    return k, a, j, y, products


def test_evidence_and_posterior_are_those_of_dense_algebra():
    k, a, j, y, products = toy()
    t0 = np.array([0.3, -0.2])
    logs, wanted = [], []
    for scale, length in ((0.7, 0.3), (2.0, 1.0)):
        prior = KernelPrior(np.array([[scale, 1.5 * scale]]), length, KernelEnvelope(1.0, 1.0))
        r = prior.deviations(0, k)
        found = posterior([products], prior, k, t0)
        covariance = np.eye(30) + a.T @ np.diag(r**2) @ a + j.T @ j
        # t is normal about -t0: what is fitted is y, whose mean is -J t0.
        logs.append(found.log_evidence)
        wanted.append(stats.multivariate_normal(-t0 @ j, covariance).logpdf(y))
        left = y + t0 @ j
        want_t = -t0 + j @ np.linalg.solve(covariance, left)
        np.testing.assert_allclose(found.t, want_t, atol=1e-9)
        np.testing.assert_allclose(
            found.elements[0].coefficients(found.t), r**2 * (a @ np.linalg.solve(covariance, left)),
            atol=1e-9,
        )  # fmt: skip
        np.testing.assert_allclose(
            found.covariance, np.eye(2) - j @ np.linalg.solve(covariance, j.T), atol=1e-9
        )
    assert abs((logs[1] - logs[0]) - (wanted[1] - wanted[0])) < 1e-8


def test_slopes_and_curvature_of_the_evidence_are_those_of_dense_algebra():
    """Fisher's information of normal data, tr(C^-1 dC C^-1 dC)/2, where nothing else is fitted."""
    k, a, _, _, products = toy()
    none = products._replace(
        both=np.zeros((10, 0)), physics=np.zeros((0, 0)), physics_data=np.zeros(0)
    )
    prior, t0 = KernelPrior(np.array([[0.7, 1.1]]), 0.3, KernelEnvelope(1.0, 1.0)), np.zeros(0)

    def evidence(logs, own, t0):
        scale, length = prior.scale * np.exp(logs[:2]), prior.length_m * np.exp(logs[2])
        return posterior([own], KernelPrior(scale, length, prior.envelope), k, t0).log_evidence

    r = prior.deviations(0, k)
    by_logs = np.zeros((10, 3))
    by_logs[:5, 0] = by_logs[5:, 1] = 1.0
    by_logs[:, 2] = np.tile(prior.length_slope(k), 2)
    inverse = np.linalg.inv(np.eye(30) + a.T @ np.diag(r**2) @ a)
    moves = [inverse @ a.T @ np.diag(2 * r**2 * column) @ a for column in by_logs.T]
    for own, start in ((none, t0), (products, np.array([0.3, -0.2]))):
        slope, curvature = posterior([own], prior, k, start).slopes(0)
        steps = [1e-5 * row for row in np.eye(3)]
        want = [(evidence(s, own, start) - evidence(-s, own, start)) / 2e-5 for s in steps]
        np.testing.assert_allclose(slope @ by_logs, want, rtol=1e-7, atol=1e-7)
        if own is none:
            fisher = [[np.trace(one @ other) / 2 for other in moves] for one in moves]
            np.testing.assert_allclose(by_logs.T @ curvature @ by_logs, fisher, rtol=1e-9)


def test_no_prior_near_the_likeliest_is_likelier():
    k, _, _, _, products = toy()
    first, t0 = KernelPrior(np.array([[0.7, 1.1]]), 0.3, KernelEnvelope(1.0, 1.0)), np.zeros(2)
    found, evidence = likeliest([products], first, k, t0, shared=False)
    assert evidence > posterior([products], first, k, t0).log_evidence
    for step in (0.9, 1.1):
        for scale in (np.array([step, 1.0]), np.array([1.0, step])):
            near = found._replace(scale=found.scale * scale)
            assert posterior([products], near, k, t0).log_evidence < evidence + 0.02
        near = found._replace(length_m=found.length_m * step)
        assert posterior([products], near, k, t0).log_evidence < evidence + 0.02


@pytest.mark.parametrize("directions", [1, 2])
def test_products_are_those_of_the_signals_of_the_waves(directions):
    problem = passes(directions=directions)
    signals = KernelSignals(
        known_input(problem, STATED, LOAD, MU), STATED, Lags(DEPTH_M, 12 * DEPTH_M)
    )
    envelope, mean, known = KernelEnvelope(2 * DEPTH_M, 0.1), far_field(signals), signals.known
    basis = signals.basis(envelope)
    for e, about in enumerate(signals.less_mean(mean)):
        rows = known.rows_of(e)
        shown = [
            np.concatenate([
                known.signals(signals.lags, basis[0], row),
                known.shear(row) * known.signals(signals.lags, basis[1], row),
            ])
            for row in rows
        ]  # fmt: skip
        weight = float(problem.whitener[0, -1]) ** 2  # white, of unknown mean
        rest = (signals.data - mean.signal)[rows]
        rest = weight * (rest - rest.mean(axis=-1, keepdims=True))
        heavy = [weight * (each - each.mean(axis=-1, keepdims=True)) for each in shown]
        found = about.under(envelope)
        want = sum(s @ w.T for s, w in zip(shown, heavy, strict=True))
        np.testing.assert_allclose(found.waves, want, atol=1e-9 * np.abs(want).max())
        data = sum(s @ y for s, y in zip(shown, rest, strict=True))
        np.testing.assert_allclose(found.data, data, atol=1e-9 * np.abs(data).max())


def test_no_place_beside_the_chosen_one_is_likelier():
    signals = KernelSignals(
        known_input(passes(), STATED, LOAD, MU), STATED, Lags(DEPTH_M, 12 * DEPTH_M)
    )
    about, none = signals.less_mean(far_field(signals))[:1], np.zeros(4)
    first = KernelPrior(np.array([[1e-13, 1e-13]]), DEPTH_M, Place().envelope(DEPTH_M))
    best = choose(about, first, Place(4.0, 1.0, 1.0), none, shared=False)
    assert best.place != Place(4.0, 1.0, 1.0)
    for place in best.place.neighbours:
        other = choose(about, best.prior, place, none, shared=False, is_free=False)
        assert other.place == place
        assert other.evidence < best.evidence + 0.05


LINES = {"periodic": LINE, "open": Open(512, 0.03 / 512, -0.015)}


@pytest.mark.full
@pytest.mark.parametrize("line", LINES.values(), ids=list(LINES))
def test_signals_of_kernels_are_those_of_films_that_have_them(line):
    known = known_input(passes(directions=1, line=line), STATED, LOAD, MU)
    lags = Lags(DEPTH_M, 12 * DEPTH_M)
    at = lags.x_m / DEPTH_M
    values = np.stack([np.exp(-(at**2) / 2), 0.7 * at * np.exp(-((at - 0.3) ** 2) / 2)])
    film = MeasuredFilm.of(films()[0], np.zeros(2), KernelTable.of(lags.x_m, values))
    want = np.asarray(Sensor([film]).operator(line, SCAN)(np.stack([LOAD, MU * LOAD])))[0]
    p, q = known.signals(lags, values, 0)
    np.testing.assert_allclose(p + known.shear(0) * q, want, atol=1e-6 * np.abs(want).max())


def test_the_prior_has_its_standard_deviation_at_no_lag():
    lags = Lags(DEPTH_M, 20 * DEPTH_M)
    k = lags.wavenumbers(np.inf)
    envelope = KernelEnvelope(2 * DEPTH_M, 0.1)
    r = KernelPrior(np.array([[3.0, 5.0]]), DEPTH_M, envelope).deviations(0, k)
    basis = lags.envelope(*envelope)[:, None] * lags.waves(k)
    middle = lags.x_m.size // 2
    near = basis[:, :, middle - 3 : middle + 4]
    deviation = np.sqrt(np.einsum("cb,cbm->cm", r.reshape(2, -1) ** 2, near**2))
    np.testing.assert_allclose(deviation[:, 3], [3.0, 5.0], rtol=0.02)


def test_spectra_of_kernels_on_the_lags():
    lags = Lags(DEPTH_M, 20 * DEPTH_M)
    k = np.array([0.0, 300.0, 2000.0])
    got = lags.spectrum(np.exp(-((lags.x_m / DEPTH_M) ** 2)), k)
    want = np.sqrt(np.pi) * DEPTH_M * np.exp(-((k * DEPTH_M) ** 2) / 4)
    np.testing.assert_allclose(got, want, atol=1e-12 * want[0])


# --- gains that vary from pass to pass ---------------------------------------------------------

WIDE_DEPTH_M, PER_PASS, ON_LINE = 1.4e-3, 800, Open(1000, 3e-5, -0.015)
RIDGE = np.where(np.abs(np.asarray(ON_LINE.x)) < 4e-4, 1e4, 0.0)


@pytest.fixture(scope="module")
def repeated():
    """A sensor of one film, four passes each way over a load, and their signals without noise."""
    sensor = Sensor([Film(WIDE_DEPTH_M).with_strip_average()])
    at = np.arange(8 * PER_PASS)
    speed = np.where((at // PER_PASS) % 2 == 0, 0.05, -0.05)
    motion = Motion.from_speed(at / 2000, speed, -1e-2)
    both = np.stack([np.stack([RIDGE, sign * MU * RIDGE]) for sign in (1, -1)])
    return sensor, motion, signals_along(sensor, ON_LINE, motion, both)


def at_gains(repeated, gains, seed=0, level=0.05):
    """The problem of a recording whose passes have these gains."""
    sensor, motion, clean = repeated
    signal = clean.copy()
    for each, gain in zip(passes_of(np.asarray(motion.position_m)), gains, strict=True):
        signal[:, each.samples] *= gain
    rms = level * np.abs(clean).max()
    signal += rms * np.random.default_rng(seed).normal(size=clean.shape)
    return Problem(sensor, motion, signal, rms, cell_m=2e-4).to_grid()


def gain_errors(sensor, on):
    """How far the measured kernels of p and of q are off along the true ones, in standard
    errors, and these, relative."""
    pressure = np.asarray(averages(jnp.asarray(RIDGE)[None], ON_LINE, on.line))[0]
    kernel = measure_kernel(on, sensor, pressure, MU)
    truth = of(sensor, kernel)[0]
    along = truth / np.sum(truth**2, axis=-1, keepdims=True)
    stderr = np.sqrt(np.sum(np.einsum("jcm,cm->jc", kernel.factors[:, 0], along) ** 2, axis=0))
    return np.sum((kernel.value[0] - truth) * along, axis=-1) / stderr, stderr


def test_bands_hold_gains_that_vary_from_pass_to_pass(repeated):
    on = at_gains(repeated, (1.2, 1.1, 1.05, 0.95, 1.1, 1.05, 0.95, 1.2))
    found = on.passes.gains
    assert found.is_found
    assert found.spread == pytest.approx([0.098], rel=0.1)
    assert "9.8 %" in found.note
    assert on.passes.warnings
    assert not on.passes.warnings_beside_gains
    off, stderr = gain_errors(repeated[0], on)
    assert np.all(np.abs(off) < 2.5)  # each direction's mean is 7.5 % off
    # As large beside a gain of 1.075 in the mean; over eight passes, of six degrees of freedom.
    assert stderr[0] == pytest.approx(1.075 * 0.098 / np.sqrt(8) * 1.18, rel=0.1)


def test_gains_that_do_not_vary_change_no_band(repeated):
    on = at_gains(repeated, np.ones(8), seed=1)
    found = on.passes.gains
    assert not found.is_found
    assert "the same in all passes" in found.note
    assert found.spread[0] < 0.01
    assert gain_errors(repeated[0], on)[1][0] < 0.01


def test_gains_of_single_passes_are_not_known(repeated):
    sensor, motion, clean = repeated
    first = slice(0, 2 * PER_PASS)
    columns = motion.time_s, motion.position_m, motion.speed_m_per_s
    cut = Motion(*(np.asarray(each)[first] for each in columns))
    rms = 0.05 * np.abs(clean).max()
    noisy = clean[:, first] + rms * np.random.default_rng(0).normal(size=(1, 2 * PER_PASS))
    found = Problem(sensor, cut, noisy, rms, cell_m=2e-4).to_grid().passes.gains
    assert np.isnan(found.spread).all()
    assert "not known" in found.note
    assert not found.of_means.any()


@pytest.mark.claim
@pytest.mark.parametrize("spread", [0.0, 0.03, 0.1])
def test_bands_cover_the_gain_over_draws(repeated, spread):
    """90 % bands of the gain of the kernel of p, of 20 draws of noise and gains: of a binomial
    distribution all but 1 in 100 lies at 15 and above."""
    off = []
    for seed in range(20):
        gains = 1 + spread * np.random.default_rng([seed, 1]).normal(size=8)
        on = at_gains(repeated, gains, seed)
        off.append(gain_errors(repeated[0], on)[0][0])
    assert np.sum(np.abs(off) < 1.645) >= 15
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.4


# --- recordings and files ----------------------------------------------------------------------


def recording(sensor, seed=0, level=1e-3):
    """Two passes over a load at 0, there and back, as a motion in time."""
    time_s = np.arange(1200) / 2000
    speed = 0.05 * np.where(time_s < 0.3, 1.0, -1.0)
    motion = Motion.from_speed(time_s, speed, -7.5e-3)
    line = Open(800, 2.5e-5, -0.01)
    load = np.where(np.abs(np.asarray(line.x)) < 2e-4, 1e4, 0.0)
    both = np.stack([np.stack([load, sign * MU * load]) for sign in (1, -1)])
    clean = signals_along(sensor, line, motion, both)
    rms = level * np.sqrt(np.mean(clean**2))
    noisy = clean + rms * np.random.default_rng(seed).normal(size=clean.shape)
    return Problem(STATED, motion, noisy, rms), line, load


@pytest.mark.full
def test_passes_of_a_recording_that_turns():
    problem, line, load = recording(TRUE)
    on = problem.to_grid().line
    pressure = np.asarray(averages(jnp.asarray(load)[None], line, on))[0]
    kernel = measure_kernel(problem, STATED, pressure, MU)
    assert kernel.has_both_ways
    near = np.abs(kernel.lags.x_m) < 6 * DEPTH_M
    assert slope_error(kernel.value[..., near], of(TRUE, kernel)[..., near]) < 0.03


@pytest.mark.full
def test_it_says_so_where_it_leaves_more_than_noise(rough, tmp_path):
    assert rough.warnings == ()
    assert abs(rough.chi2_per_freedom - 1) < 0.2
    kernel = measure_kernel(passes(level=3e-3, noisier=3.0), STATED, LOAD, MU)
    assert 6 < kernel.chi2_per_freedom < 12
    (tmp_path / "kernel.nc").write_bytes(as_netcdf(kernel))
    for warnings in (kernel.warnings, Measured(tmp_path / "kernel.nc").warnings(None)):
        assert "times the noise" in warnings[0]


@pytest.mark.full
@pytest.mark.parametrize(("level", "names"), [(1e-6, ()), (1e-12, None)])
def test_signals_with_hardly_any_noise_are_no_error(level, names):
    """What rounding and the far field's model leave is then far above it: the kernel says so."""
    kernel = measure_kernel(passes(level=level), STATED, LOAD, MU, names)
    assert slope_error(kernel.value, of(TRUE, kernel)) < 0.005
    assert "times the noise" in kernel.warnings[0]


def test_a_file_holds_all_of_it(measured, tmp_path):
    path = tmp_path / "kernel.nc"
    path.write_bytes(as_netcdf(measured))
    again = load_kernel(path)
    for name in ("value", "stderr", "factors", "far", "far_factors"):
        np.testing.assert_array_equal(getattr(again, name), getattr(measured, name))
    model = Measured(path)
    here, there = (each.sensor(STATED).operator(LINE, SCAN)(SCENE) for each in (model, measured))
    np.testing.assert_array_equal(here, there)
    assert model.warnings(None) == ()
    assert is_as_written(path)
    for at in range(3):
        path.write_bytes(as_netcdf(measured))
        with h5py.File(path, "a") as file:
            if at == 0:
                file.attrs["note"] = "mine"
            elif at == 1:
                file["table"] = np.ones(3)
            else:
                file["friction"][0] += 1e-9
        assert not is_as_written(path)


DAMAGED = ("kernel_C_m_per_N", "far_field", "depth_m", "lag_m")
TOO_MANY = (("depth_m", 1e-12), ("depth_m", 1e-300), ("lag_m", 1e9), ("lag_m", 1e300))


@pytest.mark.full
@pytest.mark.parametrize("name", rare(DAMAGED, "far_field", "lag_m"))
def test_a_damaged_file_is_refused(measured, tmp_path, name):
    import io

    import xarray

    whole = xarray.load_dataset(io.BytesIO(as_netcdf(measured)), engine="h5netcdf")
    path = tmp_path / "kernel.nc"
    cut = whole[name][:-1] if whole[name].size > 1 else -whole[name]
    path.write_bytes(
        bytes(whole.drop_vars(name).assign({name: cut.rename({cut.dims[0]: "other"})})
              .to_netcdf(engine="h5netcdf"))
    )  # fmt: skip
    with pytest.raises(BadInput, match=r"kernel\.nc: .* give operator\.path"):
        load_kernel(path)
    path.write_bytes(bytes(whole.drop_vars(name).to_netcdf(engine="h5netcdf")))
    with pytest.raises(BadInput, match=f"no column {name}"):
        load_kernel(path)


@pytest.mark.full
@pytest.mark.parametrize(("name", "factor"), rare(TOO_MANY, ("depth_m", 1e-300), ("lag_m", 1e9)))
def test_a_file_of_more_lags_than_it_holds_makes_none(measured, tmp_path, name, factor):
    """How many there would be is in no array's size before it is checked."""
    import io

    import xarray

    whole = xarray.load_dataset(io.BytesIO(as_netcdf(measured)), engine="h5netcdf")
    path = tmp_path / "kernel.nc"
    path.write_bytes(bytes(whole.assign({name: whole[name] * factor}).to_netcdf(engine="h5netcdf")))
    with pytest.raises(BadInput, match=r"kernel\.nc: .* give operator\.path"):
        load_kernel(path)


def test_refusals(measured):
    problem = passes()
    with pytest.raises(BadInput, match="512"):
        measure_kernel(problem, STATED, LOAD[:-1], MU)
    with pytest.raises(BadInput, match="pressure_Pa is uniform"):
        measure_kernel(problem, STATED, np.ones(512), MU)
    with pytest.raises(BadInput, match="choose from gain_1"):
        measure_kernel(problem, STATED, LOAD, MU, ["stiffness"])
    with pytest.raises(BadInput, match="has 2 elements"):
        measured.sensor(Sensor(films()[:1]))
    short = Periodic(64, float(LINE.cell_m), 0.0)
    with pytest.raises(BadInput, match="scan further"):
        measure_kernel(passes(line=short, load=LOAD[224:288]), STATED, LOAD[224:288], MU)
