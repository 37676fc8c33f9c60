"""Profile likelihood: against closed forms, and refits by scipy."""

from functools import cache, partial

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import srsinv
from srsinv.numerics import BAND_90
from tests.tiers import quick

X = np.linspace(0.0, 1.0, 30)
START = {"a": 1.0, "k": 2.2, "c": 0.0}
NAMES = ("a", "c", "k")  # as a fit has them
NOISE = 0.1
COLUMNS = np.stack([np.ones(30), X, X**2], axis=1)
CLOSE = 2e-3  # standard errors: twice what the search for an end leaves


def decay(params):
    return params["a"] * jnp.exp(-params["k"] * X) + params["c"]


def data(noise=NOISE):
    rng = np.random.default_rng(0)
    return 3.0 * np.exp(-2.0 * X) + 1.0 + noise * rng.normal(size=X.size)


@cache
def decay_fit(**options):
    options = dict(options)
    if "priors" in options:
        options["priors"] = dict(options["priors"])
    if "bounds" in options:
        options["bounds"] = dict(options["bounds"])
    return srsinv.fit(decay, START, data(), linear=("a", "c"), **options)


@pytest.mark.parametrize("noise", quick([0.02, None], 0.02))
def test_a_linear_model_has_its_standard_errors(noise):
    y = COLUMNS @ np.array([1.0, -2.0, 3.0]) + 0.02 * np.random.default_rng(1).normal(size=30)
    fit = srsinv.fit(lambda b: COLUMNS @ b, np.zeros(3), y, noise=noise)
    half = BAND_90 * fit.stderr
    ends = np.array(list(fit.profile().values()))
    np.testing.assert_allclose(ends, fit.value[:, None] + half[:, None] * [-1, 1], rtol=1e-9)
    assert fit.asymmetric() == {}


def refitted_cost(y, scale, more, i, value):
    """Half the squares with one parameter at a value, the others fitted by scipy."""

    def terms(others):
        a, c, k = np.insert(others, i, value)
        left = (y - a * np.exp(-k * X) - c) / scale
        return np.concatenate([left, more(a, c, k)])

    begun = np.delete([3.0, 1.0, 2.0], i)
    return scipy.optimize.least_squares(terms, begun, xtol=1e-14, ftol=1e-14, gtol=1e-14).cost


PRIOR = (1.3, 0.1)
CASES = {
    "known noise": ({"noise": NOISE}, lambda a, c, k: []),
    "unknown noise": ({}, lambda a, c, k: []),
    "prior": (
        {"noise": NOISE, "priors": (("c", PRIOR),)}, lambda a, c, k: [(c - PRIOR[0]) / PRIOR[1]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", quick(CASES, "unknown noise"))
def test_an_exponential_decay_has_the_ends_of_independent_refits(case):
    options, more = CASES[case]
    fit, y = decay_fit(**options), data()
    cost = fit.stats["cost"]
    scale, rise = NOISE, BAND_90**2 / 2
    if fit.noise_rms is not None:
        scale, cost, rise = 1.0, cost, rise * fit.noise_rms**2
    found = fit.profile()
    for i, name in enumerate(NAMES):
        of, stderr = partial(refitted_cost, y, scale, more, i), fit.stderr[name]
        for end, sign in zip(found[name], (-1, 1), strict=True):
            reach = fit.value[name] + sign * np.array([0.5, 5.0]) * stderr
            exact = scipy.optimize.brentq(lambda v, of=of: of(v) - cost - rise, *reach)
            assert abs(end - exact) < CLOSE * stderr


def test_a_report_has_the_asymmetric_intervals_alone():
    """Of the decay at this noise, c alone: its lower end is 1.14 times as far as the standard error
    has it, by scipy's refits, and no other end is off by a tenth."""
    fit = decay_fit(noise=NOISE)
    assert set(fit.asymmetric()) == {"c"}
    text = str(fit)
    (row,) = [each for each in text.splitlines() if each.startswith("c ")]
    assert row.endswith("asymmetric")
    low, high = fit.profile("c")["c"]
    assert f"{low:.2f} to {high:.2f}" in row
    table = fit.to_dataframe().set_index("name")
    np.testing.assert_allclose(
        table.loc["c", ["low", "high"]].astype(float), [low, high], rtol=1e-3
    )
    value, stderr = fit.value["a"], fit.stderr["a"]
    np.testing.assert_allclose(table.loc["a", "low"], value - BAND_90 * stderr)


def test_a_bound_ends_an_interval():
    fit = decay_fit(noise=NOISE, bounds=(("k", (2.0, 2.4)),))
    assert fit.profile("k")["k"] == (2.0, 2.4)
    assert fit.profile("a")["a"][1] < decay_fit(noise=NOISE).profile("a")["a"][1]


@pytest.mark.full
def test_an_interval_without_an_end_is_infinite():
    """The rate of a decay that noise nearly hides at the second sample: any larger fits as well.
    Without the decay chi-square is larger by (exp(-40/29) / 0.3)^2 = 0.7."""
    fit = srsinv.fit(lambda p: jnp.exp(-p["k"] * X), {"k": 30.0}, np.exp(-40.0 * X), noise=0.3)
    low, high = fit.profile()["k"]
    assert high == np.inf
    assert low > 0


def test_errors_beside_the_noise_add_in_squares():
    fit = decay_fit(noise=NOISE)
    wider = fit.with_error(np.diag([0.0, 0.3, 0.0]))
    (low, high), own = wider.profile("c")["c"], fit.profile("c")["c"]
    value = fit.value["c"]
    expected = np.hypot(np.array(own) - value, BAND_90 * 0.3)
    np.testing.assert_allclose([value - low, high - value], expected)


REFUSED = {
    "names names 'b'": lambda: decay_fit(noise=NOISE).profile("b"),
    "profile a fit of squares": lambda: decay_fit(noise=NOISE, loss="huber").profile(),
}


@pytest.mark.parametrize("sentence", quick(REFUSED, "names names 'b'"))
def test_refused(sentence):
    with pytest.raises(srsinv.BadInput, match=sentence):
        REFUSED[sentence]()
