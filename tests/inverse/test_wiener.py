"""Wiener's filter: its predicted error against draws, dense conditioning, the paper's form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.noise import Sliding, White, total_spectrum
from srsinv.forward.scan import ConstantSpeed
from srsinv.grid import half_spectrum_weights
from srsinv.inverse.line import direct, spectral
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.solve import PATHS
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Flat, Normalised, SpectralPrior, Wiener
from tests.inverse.cases import (
    DEPTH_M,
    LENGTH_M,
    RATE,
    SLOW,
    N,
    bumps,
    condition,
    deviation,
    from_reference,
    gaps,
    make_case,
    make_line,
    make_operator,
    relative,
    stderr_of,
)
from tests.refusals import refused
from tests.tiers import hardest, quick

P, Q = Exponential(1500.0, 0.8e-3), Exponential(500.0, 1.5e-3)
NOISES = {
    "quiet": (White(2e-8),),
    "white": (White(2e-6),),
    "sliding": (White(1e-6), Sliding(1.0, 0.5e-3)),
}


@eqx.filter_jit
def solve_all(path, problem, prior, data):
    """Values of many data sets (draw, e, n), by the bare path."""

    def one(data):
        each = eqx.tree_at(lambda problem: problem.data, problem, data)
        if path == "spectral":
            return spectral.solve(each, prior).value
        return direct.solve(each, prior, direct.whiten(each)).value

    return jax.vmap(one)(data)


def draws(rng, count, spectra, n):
    """Periodic Gaussian draws (count, row, n) of the given half spectra."""
    white = rng.normal(size=(count, len(spectra), n))
    return np.fft.irfft(np.sqrt(spectra) * np.fft.rfft(white), n)


def draw_problem(count, kind, n, films="pair", amplifier=RATE, noise="white",
                 spectra=(P, Q), **known):  # fmt: skip
    """A problem, the prior powers, and many draws of its traction and its data."""
    line = make_line(kind, n)
    operator = make_operator(line, films, amplifier)
    rms = jnp.asarray(2e-6)
    spectrum = np.asarray(total_spectrum(NOISES[noise], line, ConstantSpeed(0.05), rms))
    blank = np.zeros((operator.transfer.shape[0], n))
    problem = LineProblem(line, operator, blank, spectrum, **known)
    power = np.stack([s.power(problem) for s in spectra[: problem.unknowns]])
    rng = np.random.default_rng(5)
    traction = draws(rng, count, power, n)
    signals = jax.vmap(problem.forward)(jnp.asarray(traction))
    data = signals + draws(rng, count, np.stack([spectrum] * len(blank)), n)
    return problem, power, traction, data


FLOORS = {
    "white": {},
    "sliding": {"noise": "sliding"},
    "mean_in_the_signal": {"amplifier": SLOW, "films": "turned"},
    "friction": {"films": "one", "friction": -0.4},
}


@pytest.mark.parametrize("name", quick(FLOORS, "white", "friction"))
def test_error_is_the_predicted_floor(name):
    problem, power, traction, data = draw_problem(400, "periodic", 256, **FLOORS[name])
    n, unknowns = problem.line.n, problem.unknowns
    values = solve_all("spectral", problem, SpectralPrior(jnp.asarray(power)), data)
    one = eqx.tree_at(lambda problem: problem.data, problem, data[0])
    estimate = Wiener(P, Q)(one)
    assert relative(values[0], estimate.value[:unknowns]) < 1e-10
    error = np.asarray(values) - deviation(problem, traction)
    for c in range(unknowns):
        stderr = np.asarray(estimate.stderr[c])
        floor = half_spectrum_weights(n) @ np.real(estimate.covariance[c, c])
        np.testing.assert_allclose(floor, np.mean(stderr**2), rtol=1e-12)
        assert abs(np.mean(error[:, c] ** 2) / floor - 1) < 0.03
        assert 0.86 < np.mean(np.abs(error[:, c]) < 1.645 * stderr) < 0.94
    # A filter that knew nothing would pass these bounds too: the signal must have told much.
    assert np.mean(error**2) < 0.5 * np.mean(deviation(problem, traction) ** 2)


@pytest.mark.full
@pytest.mark.parametrize("noise", ["white", "sliding"])
def test_error_is_the_predicted_floor_with_gaps(noise):
    """The open line and missing samples, each cell with its own standard error."""
    known = {"noise": noise, "observed": gaps()}
    problem, power, traction, data = draw_problem(200, "open", N, **known)
    values = solve_all("direct", problem, SpectralPrior(jnp.asarray(power)), data)
    estimate = Wiener(P, Q)(eqx.tree_at(lambda problem: problem.data, problem, data[0]))
    assert estimate.stats["path"] == "direct"
    assert relative(values[0], estimate.value) < 1e-10
    to = from_reference(problem)
    error = ((np.asarray(values) - traction).reshape(-1, 2 * N) @ to.T).reshape(-1, 2, N)
    covariance = to @ np.asarray(estimate.covariance) @ to.T
    for c in range(2):
        own = covariance[c * N : (c + 1) * N, c * N : (c + 1) * N]
        # The squared error is a sum of chi squares: variance 2 tr C^2 a draw.
        spread = np.sqrt(2 * np.sum(own**2) / len(error))
        assert abs(np.mean(np.sum(error[:, c] ** 2, axis=-1)) - np.trace(own)) < 3.5 * spread
        covered = np.abs(error[:, c]) < 1.645 * np.asarray(estimate.stderr[c])
        assert 0.86 < covered.mean() < 0.94


CONDITIONED = {
    "whole": {},
    "odd": {"n": 47},
    "coloured": {"colour": True},
    "coloured_apart": {"colour": "apart"},
    "from_the_signal": {"amplifier": SLOW, "films": "turned"},
    "friction": {"films": "one", "friction": 0.3},
    "identical": {"films": "same"},
    "open": {"kind": "open"},
    "gaps": {"kind": "open", "colour": True, "observed": gaps()},
}


@pytest.mark.full
@pytest.mark.parametrize("name", quick(CONDITIONED, "friction", "gaps"))
def test_posterior_is_dense_conditioning(name):
    problem = make_case(**CONDITIONED[name]).problem
    n, unknowns = problem.line.n, problem.unknowns
    power = np.stack([s.power(problem) for s in (P, Q)[:unknowns]])
    mean, covariance = condition(problem, power)
    for path in ("spectral", "direct") if name == "whole" else ("auto",):
        estimate = Wiener(P, Q, path=path)(problem)
        assert estimate.status == "converged"
        ours = estimate.covariance
        if estimate.stats["path"] == "spectral":
            full = np.fft.irfft(np.asarray(ours), n)  # (c, c, lag)
            lag = (np.arange(n)[:, None] - np.arange(n)) % n
            ours = np.block([[full[i, j][lag] for j in range(unknowns)] for i in range(unknowns)])
        assert relative(estimate.value[:unknowns], mean) < 1e-7
        assert relative(ours, covariance) < 1e-7
        assert relative(estimate.stderr[:unknowns], stderr_of(problem, covariance)) < 1e-7


def test_normalised_form_is_the_papers():
    """G* / (|G|^2 + N) in units of the largest gain, G written out from the line load."""
    mu, ratio = 0.4, 3e-3
    line = make_line()
    k = np.asarray(line.k)
    kappa = k * DEPTH_M
    decay = np.exp(-kappa)
    sigma_x = -(1 - kappa) * decay + mu * 1j * (2 - kappa) * decay
    sigma_z = -(1 + kappa) * decay + mu * 1j * kappa * decay
    charge = 0.7e-3 * 8e-3 * (24.5e-12 * sigma_x - 31.5e-12 * sigma_z)
    gain = 1e6 * 0.05 * 1j * k * charge / np.sinc(k * LENGTH_M / N / 2 / np.pi)
    gain[-1] = gain[-1].real
    g = gain / np.abs(gain).max()
    data = np.random.default_rng(2).normal(size=(1, N))
    expected = np.fft.irfft(g.conj() / (np.abs(g) ** 2 + ratio) * np.fft.rfft(data[0]), N)
    expected /= np.abs(gain).max()
    for level in (1.0, 1e-12):  # the filter knows the noise by its ratio to the signal alone
        problem = LineProblem(
            line, make_operator(line, "one"), data, np.full(N // 2 + 1, level), friction=mu
        )
        estimate = Wiener(Normalised(ratio))(problem)
        assert relative(estimate.value[0], expected) < 1e-12
        assert relative(estimate.value[1], mu * expected) < 1e-12


def test_stated_rms_is_the_priors():
    """Both spectra have the rms that they were given."""
    estimate = Wiener(P, Flat(70.0))(make_case().problem)
    assert estimate.stats["rms_p_Pa"] == pytest.approx(1500.0, rel=1e-6)
    assert estimate.stats["rms_q_Pa"] == pytest.approx(70.0, rel=1e-6)


@pytest.mark.parametrize("wrong", [1e-2, 1e2])
def test_evidence_finds_the_priors_level(wrong):
    """Spectra a hundred times too weak or too strong come back to those of the draw."""
    problem, *_, data = draw_problem(1, "periodic", 256, noise="quiet")
    problem = eqx.tree_at(lambda problem: problem.data, problem, data[0])
    off = (Exponential(wrong * 1500.0, 0.8e-3), Exponential(wrong * 500.0, 1.5e-3))
    estimate = Wiener(*off, scale="evidence")(problem)
    assert estimate.stats["scale_rule"] == "converged"
    right = Wiener(P, Q)(problem)
    for c in "pq":
        assert estimate.stats[f"rms_{c}_Pa"] == pytest.approx(right.stats[f"rms_{c}_Pa"], rel=0.2)
    assert relative(estimate.value, right.value) < 0.1


@pytest.mark.parametrize(("length", "wrong"), [(1.0, 0.2), (0.1, 20.0)])
def test_evidence_finds_the_priors_correlation_length(length, wrong):
    """Lengths that are stated too short or too long come back to those of the draws. Too long ones
    have a warning, unlike the right ones."""

    def spectra(factor):
        return Exponential(1500.0, factor * 0.8e-3), Exponential(500.0, factor * 1.5e-3)

    def warns(method):
        return any("correlation length" in each for each in method(problem).warnings)

    right, stated = spectra(length), spectra(wrong * length)
    problem, *_, data = draw_problem(9, "periodic", 256, noise="quiet", spectra=right)
    factors = []
    for each in data:
        problem = eqx.tree_at(lambda problem: problem.data, problem, each)
        found = Wiener(*stated, scale="evidence", correlation="evidence")(problem)
        factors.append(found.stats["correlation_factor"])
        assert found.stats["scale_rule"] == "converged"
        assert not warns(Wiener(*right, scale="evidence"))
        assert warns(Wiener(*stated, scale="evidence")) == (wrong > 1)
    assert np.median(factors) == pytest.approx(1 / wrong, rel=0.3)


@pytest.mark.parametrize("kind", hardest(["whole", "with gaps"], [], ["whole"]))
def test_a_correlation_length_is_the_same_on_all_paths(kind):
    problem, *_, data = draw_problem(1, "periodic", 256)
    observed = None if kind == "whole" else gaps(256)
    problem = LineProblem(problem.line, problem.forward, data[0], problem.noise, observed=observed)
    paths = ("direct", "iterative") if observed is not None else PATHS[1:]
    methods = [Wiener(P, Q, "evidence", path, correlation="evidence") for path in paths]
    factors = [method(problem).stats["correlation_factor"] for method in methods]
    # The iterative path ends on a grid where samples are missing.
    np.testing.assert_allclose(factors, factors[0], rtol=1e-6 if observed is None else 0.15)


def test_a_correlation_length_that_is_not_there_is_refused():
    refused(lambda: Wiener(scale="given", correlation="evidence"), "scale=evidence")
    method = Wiener(P, Flat(70.0), scale="evidence", correlation="evidence")
    refused(lambda: method(make_case().problem), "Flat", "correlation=given")


def test_averaging_is_the_estimates_response_to_one_cell():
    """On every path: the estimate from the noise-free signal of unit traction in the middle."""
    gappy = make_case("open", observed=gaps()).problem
    paths = {"spectral": make_case().problem, "direct": gappy, "iterative": gappy}
    for path, problem in paths.items():
        method = Tikhonov(1, 2e-5, 8e-5, path=path)
        averaging = method(problem).averaging
        for d in range(2):
            impulse = jnp.zeros((2, N)).at[d, N // 2].set(1.0)
            answer = eqx.tree_at(lambda p: p.data, problem, problem.forward(impulse))
            assert relative(averaging[:, d], method(answer).value) < 1e-6


def test_estimate_improves_on_nothing_at_all():
    """The bumps come back: the filter's use, in one number."""
    problem, truth, _ = make_case(noise_fraction=1e-3)
    estimate = Wiener(P, Q)(problem)
    error = np.asarray(estimate.value) - deviation(problem, bumps(problem.line))
    assert np.linalg.norm(error) < 0.15 * np.linalg.norm(deviation(problem, truth))
