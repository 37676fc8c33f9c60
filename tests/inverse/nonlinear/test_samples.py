"""Posterior samples: closed forms within their Monte Carlo errors, diagnostics, warnings."""

import json
import sys
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import srsinv
from srsinv.inverse.nonlinear._convergence import convergence, ess
from srsinv.report.printed import MOST_LINES
from srsinv.status import Status
from tests.tiers import quick

REFERENCE = Path(__file__).parents[2] / "reference" / "posteriordb.json"
SIGMAS = 4.5  # of Monte Carlo errors: by chance beyond it once in 150,000 numbers
X = np.linspace(-1.0, 1.0, 12)
NOISE = 0.3
RNG = np.random.default_rng(5)
LINE = 1.0 + 2.0 * X + NOISE * RNG.normal(size=X.size)
SETTINGS = {"draws": 1000, "chains": 4, "warmup": 300, "seed": 3}


def line(params):
    return params["level_m"] + params["slope"] * X


@cache
def line_fit(noise=NOISE):
    return srsinv.fit(line, {"level_m": 0.0, "slope": 0.0}, LINE, noise=noise)


@cache
def line_samples(noise=NOISE, seed=3):
    return srsinv.sample(line_fit(noise), **SETTINGS | {"seed": seed})


def check_moments(draws, mean, std, mean_stderr=0.0, std_stderr=0.0):
    """The mean and the standard deviation of draws (chain, draw) within their Monte Carlo errors,
    and those of the reference."""
    own, spread = draws.mean(), draws.std(ddof=1)
    squares = (draws - own) ** 2
    of_mean = spread / np.sqrt(ess(draws))
    of_std = squares.std() / np.sqrt(ess(squares)) / (2 * spread)
    assert abs(own - mean) < SIGMAS * np.hypot(of_mean, mean_stderr)
    assert abs(spread - std) < SIGMAS * np.hypot(of_std, std_stderr)


def test_a_linear_model_with_known_noise_is_normal():
    fit, made = line_fit(), line_samples()
    for i, name in enumerate(made.names):
        check_moments(made.draws[..., i], fit.value[name], fit.stderr[name])
    both = np.corrcoef(made.draws.reshape(-1, 2).T)[0, 1]
    assert abs(both - fit.correlation[0, 1]) < SIGMAS / np.sqrt(min(made.ess_bulk.values()))
    assert made.quality == fit.quality == "good"
    assert made.params["slope"].shape == (4, 1000)
    np.testing.assert_array_equal(made.params["slope"], made.draws[..., 1])


@pytest.mark.full
def test_an_unknown_noise_level_makes_students_distribution():
    """Of n - m degrees of freedom, with the standard error as its scale."""
    fit, made = line_fit(None), line_samples(None)
    freedom = X.size - 2
    for i, name in enumerate(made.names):
        draws = (made.draws[..., i] - fit.value[name]) / fit.stderr[name]
        check_moments(draws, 0.0, np.sqrt(freedom / (freedom - 2)))
        below = draws < scipy.special.stdtrit(freedom, 0.05)
        tail = np.sqrt(0.05 * 0.95 / ess(below.astype(float)))
        assert abs(below.mean() - 0.05) < SIGMAS * tail


@pytest.mark.full
@pytest.mark.parametrize("bounds", [(None, 0.0), (-0.02, 0.05)])
def test_bounds_cut_a_normal(bounds):
    """A mean near a bound: the normal of the likelihood, cut there."""
    data = np.array([0.02, -0.05, 0.01])
    start = 0.01 if bounds[0] == 0.0 else -0.01
    fit = srsinv.fit(lambda p: p["a"] * jnp.ones(3), {"a": start}, data, noise=0.1,
                     bounds={"a": bounds})  # fmt: skip
    made = srsinv.sample(fit, **SETTINGS)
    low, high = (
        np.inf * sign if end is None else end for sign, end in zip((-1, 1), bounds, strict=True)
    )
    centre, scale = data.mean(), 0.1 / np.sqrt(3)
    exact = scipy.stats.truncnorm((low - centre) / scale, (high - centre) / scale, centre, scale)
    check_moments(made.draws[..., 0], exact.mean(), exact.std())
    assert made.draws.min() >= low
    assert made.draws.max() <= high
    assert any("not Gaussian" in each for each in made.warnings)


@pytest.mark.full
def test_a_direction_that_only_bounds_limit_is_sampled():
    """a + b alone is determined: along a - b the posterior is flat within the bounds."""
    fit = srsinv.fit(
        lambda p: (p["a"] + p["b"]) * jnp.ones(2), {"a": 0.5, "b": 0.5}, np.ones(2), noise=0.1,
        bounds={"a": (0.0, 1.0), "b": (-2.0, 4.0)},
    )  # fmt: skip
    made = srsinv.sample(fit, **SETTINGS)
    check_moments(made.draws[..., 0], 0.5, np.sqrt(1 / 12))


@pytest.mark.full
def test_priors_of_the_fit_are_those_of_the_samples():
    fit = srsinv.fit(line, {"level_m": 0.0, "slope": 0.0}, LINE, noise=NOISE,
                     priors={"slope": (1.0, 0.05)})  # fmt: skip
    made = srsinv.sample(fit, **SETTINGS)
    check_moments(made.draws[..., 1], fit.value["slope"], fit.stderr["slope"])


def banana(params):
    x, y = params["x"], params["y"]
    return -0.5 * x**2 - 0.5 * ((y - x**2) / 0.5) ** 2


@pytest.mark.full
def test_a_banana_has_a_warning_and_its_own_interval():
    made = srsinv.sample(banana, initial={"x": 0.3, "y": 0.0}, **SETTINGS | {"acceptance": 0.95})
    check_moments(made.params["x"], 0.0, 1.0)
    check_moments(made.params["y"], 1.0, np.sqrt(2 + 0.25))  # x^2 is chi-square
    assert made.quality == "doubtful"
    (said,) = [each for each in made.warnings if "not Gaussian" in each]
    assert "posterior of y is" in said
    assert made.high["y"] > 3 * made.laplace["y"][1]


def test_the_same_seed_gives_the_same_draws():
    fit = line_fit()
    again = srsinv.sample(fit, **SETTINGS)
    assert np.array_equal(again.draws, line_samples().draws)
    assert not np.array_equal(line_samples(seed=4).draws, again.draws)


def autoregressive(correlation, shape, seed=0):
    """Chains whose draws are correlated."""
    chains = np.random.default_rng(seed).normal(size=shape)
    for t in range(1, shape[1]):
        chains[:, t] += correlation * chains[:, t - 1]
    return chains


@pytest.mark.full
@pytest.mark.parametrize("shape", [(4, 1000), (3, 301), (2, 50)])
@pytest.mark.parametrize("correlation", [-0.5, 0.0, 0.5, 0.95])
def test_convergence_is_that_of_arviz(correlation, shape):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        arviz = pytest.importorskip("arviz")
    chains = autoregressive(correlation, shape)
    theirs = arviz.rhat(chains), arviz.ess(chains), arviz.ess(chains, method="tail")
    np.testing.assert_allclose(convergence(chains), theirs, rtol=1e-6)


@pytest.mark.parametrize("correlation", [-0.5, 0.5, 0.9])
def test_the_effective_sample_size_is_that_of_the_process(correlation):
    """(1 - r) / (1 + r) of the draws; its estimate scatters by a few times the root of their
    number, here by less than a tenth."""
    chains = autoregressive(correlation, (8, 20000))
    exact = chains.size * (1 - correlation) / (1 + correlation)
    assert ess(chains) == pytest.approx(exact, rel=0.1)


def test_chains_of_different_regions_are_no_answer():
    made = line_samples()
    apart = replace(made, draws=made.draws + np.array([0.0, 0.0, 9.0, 9.0])[:, None, None])
    assert apart.quality == "failed"
    assert apart.r_hat["slope"] > 1.5
    assert any("chains differ" in each for each in apart.warnings)


OFF = {"std": (0.0, 0.8), "end": (0.3, 1.0)}  # of the mode and the standard error, in the latter


@pytest.mark.parametrize("off", OFF)
def test_a_standard_error_that_is_off_has_a_warning(off):
    made = line_samples()
    moved, times = OFF[off]
    value, stderr = made.laplace["slope"]
    wrong = made.laplace | {"slope": (value + moved * stderr, times * stderr)}
    (said,) = replace(made, laplace=wrong).warnings
    assert "posterior of slope is not Gaussian" in said
    assert "Quote intervals of the samples" in said


def test_few_draws_and_divergences_have_warnings():
    made = line_samples()
    sampler = made.sampler._replace(is_divergent=np.ones((4, 60), bool))
    few = replace(made, draws=made.draws[:, :60], sampler=sampler)
    assert few.quality != "good"
    assert any("independent ones, fewer than 400" in each for each in few.warnings)
    assert any("240 draws diverged" in each for each in few.warnings)


def test_the_report_has_intervals_and_convergence():
    made = line_samples()
    text = str(made)
    assert len(text.splitlines()) <= MOST_LINES
    (row,) = [each for each in text.splitlines() if each.startswith("slope")]
    said = [float(word) for word in row.split() if word[0].isdigit()]
    expected = [made.mean["slope"], made.std["slope"], made.low["slope"], made.high["slope"],
                made.r_hat["slope"], made.ess_bulk["slope"], made.ess_tail["slope"]]  # fmt: skip
    np.testing.assert_allclose(said, expected, rtol=0.05)  # two digits
    assert " mm" in text  # by the name's unit
    assert made.quality in repr(made)
    assert "<table>" in made._repr_html_()


@pytest.mark.full
def test_arrays_tables_and_figures():
    made = line_samples()
    data = made.to_xarray()
    assert data["posterior_draws"].dims == ("chain", "draw", "reported")
    assert all("units" in each.attrs for each in data.variables.values())
    table = made.to_dataframe().set_index("name")
    assert table.loc["slope", "low"] == made.low["slope"]
    assert len(made.plot().axes) == 2


@pytest.mark.full
def test_inference_data_has_the_three_groups():
    pytest.importorskip("blackjax")
    made = line_samples()
    tree = made.to_inference_data()
    np.testing.assert_array_equal(tree["posterior"]["slope"].values, made.draws[..., 1])
    assert tree["sample_stats"]["diverging"].shape == (4, 1000)
    np.testing.assert_array_equal(tree["observed_data"]["y"].values, LINE)


@pytest.mark.parametrize("package", ["blackjax", "arviz"])
def test_a_package_that_is_missing_is_named(package, monkeypatch):
    made = line_samples()
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(srsinv.BadInput, match=f"needs {package}.*pip install 'srsinv\\[sample\\]'"):
        srsinv.sample(line_fit()) if package == "blackjax" else made.to_inference_data()


def fit_of(model, *params, **options):
    return srsinv.fit(model, dict.fromkeys(params, 1.0), LINE, **options)


REFUSED = {
    "Neither data nor priors limit a, b": lambda: srsinv.sample(
        fit_of(lambda p: (p["a"] + p["b"]) * X, "a", "b", noise=1.0)
    ),
    "so its samples have no start": lambda: srsinv.sample(
        replace(line_fit(), status=Status.STALLED)
    ),
    "give the fit its noise": lambda: srsinv.sample(
        fit_of(lambda p: p["a"] * X, "a", loss="huber")
    ),
    "a function of the parameters with initial": lambda: srsinv.sample(banana),
    "leave out initial": lambda: srsinv.sample(line_fit(), initial={"level_m": 0.0}),
    "start where it is finite": lambda: srsinv.sample(lambda p: jnp.log(-p), initial=1.0),
    "chains is 1: give": lambda: srsinv.sample(line_fit(), chains=1),
    "draws is 10: give": lambda: srsinv.sample(line_fit(), draws=10),
    "acceptance is 1.0: give": lambda: srsinv.sample(line_fit(), acceptance=1.0),
}


@pytest.mark.parametrize("sentence", quick(REFUSED, *list(REFUSED)[3:]))
def test_refused(sentence):
    with pytest.raises(srsinv.BadInput, match=sentence):
        REFUSED[sentence]()


def eight_schools(data, p):
    y, sigma = np.array(data["y"], float), np.array(data["sigma"], float)
    theta = p["trans"] * p["tau"] + p["mu"]
    rest = -0.5 * jnp.sum(p["trans"] ** 2) - 0.5 * (p["mu"] / 5) ** 2
    return rest - 0.5 * jnp.sum(((y - theta) / sigma) ** 2) - jnp.log1p((p["tau"] / 5) ** 2)


def autoregression(data, p):
    y, order = np.array(data["y"]), data["K"]
    past = np.stack([y[order - k : len(y) - k] for k in range(1, order + 1)])
    residual = (y[order:] - p["alpha"] - p["beta"] @ past) / p["sigma"]
    prior = -0.5 * (jnp.sum(p["beta"] ** 2) + p["alpha"] ** 2) / 100
    prior = prior - jnp.log1p((p["sigma"] / 2.5) ** 2)
    return prior - 0.5 * residual @ residual - (len(y) - order) * jnp.log(p["sigma"])


def gaussian_process(data, p):
    x, y = np.array(data["x"], float), np.array(data["y"])
    kernel = p["alpha"] ** 2 * jnp.exp(-0.5 * ((x[:, None] - x[None]) / p["rho"]) ** 2)
    factor = jnp.linalg.cholesky(kernel + p["sigma"] * jnp.eye(len(x)))
    white = jax.scipy.linalg.solve_triangular(factor, y, lower=True)
    prior = 24 * jnp.log(p["rho"]) - 4 * p["rho"] - (p["alpha"] / 2) ** 2 / 2 - p["sigma"] ** 2 / 2
    return prior - 0.5 * white @ white - jnp.sum(jnp.log(jnp.diag(factor)))


POSITIVE = (0.0, None)
POSTERIORS = {  # of posteriordb: the density, where to start, and bounds
    "eight_schools-eight_schools_noncentered": (
        eight_schools, {"trans": np.zeros(8), "mu": 0.0, "tau": 1.0}, {"tau": POSITIVE},
    ),
    "arK-arK": (
        autoregression, {"alpha": 0.0, "beta": np.zeros(5), "sigma": 1.0}, {"sigma": POSITIVE},
    ),
    "gp_pois_regr-gp_regr": (
        gaussian_process, {"rho": 6.0, "alpha": 1.0, "sigma": 1.0},
        {"rho": POSITIVE, "alpha": POSITIVE, "sigma": POSITIVE},
    ),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("name", POSTERIORS)
def test_reference_draws_of_posteriordb(name):
    """Means and standard deviations within the Monte Carlo errors of both."""
    kept = json.loads(REFERENCE.read_text())["posteriors"][name]
    density, initial, bounds = POSTERIORS[name]
    made = srsinv.sample(
        lambda p: density(kept["data"], p), initial=initial, bounds=bounds,
        draws=2000, acceptance=0.95,
    )  # fmt: skip
    assert made.status == "converged"
    params = dict(made.params)
    if "trans" in params:
        params["theta"] = params["trans"] * params["tau"][..., None] + params["mu"][..., None]
    for key, own in kept["reference"].items():
        leaf, _, at = key.partition("[")
        draws = params[leaf][..., int(at[:-1]) - 1] if at else params[leaf]
        check_moments(draws, own["mean"], own["sd"], own["mean_stderr"], own["sd_stderr"])
