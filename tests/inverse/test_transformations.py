"""Inversions under jit, vmap, grad and jvp: the same numbers as outside, and their derivatives."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.forward.film import Film
from srsinv.inverse.line import rule as rules
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.differences import differences
from tests.inverse.cases import DEPTH_M, N, gaps, make_case, make_operator
from tests.refusals import refused
from tests.tiers import hardest, quick

PARAMETERS = ("depth", "angle", "data", "noise", "prior", "length")
OF_WEIGHTS = "weight_", "rms_p_P", "correla"
NOMINAL = np.ones(len(PARAMETERS))
TURNS = np.random.default_rng(9).normal(size=(2, 2, N))
ALONG = np.random.default_rng(1).normal(size=(2, N))


def method_of(name: str, factor: dict, path: str):
    """A method whose parameters are multiplied by these factors."""
    spectra = Exponential(1.5e3 * factor["prior"], 1e-3 * factor["length"]), Exponential(5e2, 2e-3)
    length_m = 1e-3 * factor["length"]
    how = {"path": path, "tolerance": 1e-12}
    if name in ("given", "evidence"):
        return Wiener(*spectra, scale=name, **how)
    if name == "correlation":
        return Wiener(*spectra, scale="evidence", correlation="evidence", **how)
    if name == "weights":
        return Tikhonov(1, 2e-5 * factor["prior"], 8e-5, length_m=length_m, **how)
    return Tikhonov(length_m=length_m, rule=getattr(rules, name)(), **how)


def problem_of(case, factor: dict) -> LineProblem:
    """The problem of a case with these factors on its physics, its data and its noise."""
    line, given = case.problem.line, case.problem
    films = (
        Film(DEPTH_M * factor["depth"], 0.2 * factor["angle"]),
        Film(DEPTH_M * factor["depth"], 1.6 * factor["angle"]),
    )
    moved = case.sigma * (factor["data"] - 1) * ALONG * given.is_observed
    data, noise = given.data + moved, given.noise * factor["noise"] ** 2
    known = {"observed": given.observed, "nuisance": given.nuisance}
    return LineProblem(line, make_operator(line, films), data, noise, **known)


def roughened(case):
    """The case over a fine texture, whose correlation length is within what its line can show."""
    power = np.asarray(Exponential(30.0, 3e-4).power(case.problem))
    white = np.random.default_rng(4).normal(size=(2, N))
    texture = np.fft.irfft(np.sqrt(power) * np.fft.rfft(white), N)
    data = case.problem.data + case.problem.forward(jnp.asarray(texture))
    return case._replace(problem=eqx.tree_at(lambda p: p.data, case.problem, data))


def numbers(case, method: str, path: str, theta):
    """Numbers of value, bands, chosen weights and chi-square; theta: factors on the parameters."""
    factor = dict(zip(PARAMETERS, theta, strict=True))
    made = srsinv.invert(problem_of(case, factor), method_of(method, factor, path))
    weights = [
        made.stats[name] for name in made.stats if name[:7] in ("weight_", "rms_p_P", "correla")
    ]
    of_value, of_stderr = jnp.sum(made.value * TURNS[0]), jnp.sum(made.stderr * TURNS[1])
    logs = [jnp.log10(jnp.asarray(each)) for each in weights]
    return jnp.stack([of_value / 1e4, of_stderr / 1e3, *logs, made.stats["chi2_per_freedom"]])


CASES = {
    "spectral": {},
    "direct": {"kind": "open", "observed": gaps(), "colour": True},
    "iterative": {"kind": "open", "observed": gaps(), "colour": True},
}
RULES = ("Evidence", "GeneralisedCrossValidation", "UnbiasedPredictiveRisk", "LCurve",
         "CorrectedAkaikeCriterion", "DiscrepancyPrinciple", "NormalisedCumulativePeriodogram",
         "QuasiOptimality")  # fmt: skip
ON_DIRECT = "given", "weights", "evidence", "GeneralisedCrossValidation", "LCurve"
GRADIENTS = [
    *(("spectral", method) for method in ("given", "weights", "evidence", "correlation", *RULES)),
    *(("direct", method) for method in ON_DIRECT),
    ("direct", "correlation"), ("iterative", "given"), ("iterative", "weights"),
]  # fmt: skip
# Rules that differ in the terms of a score that they take: the others are differentiated alike.
RARE = [
    ("spectral", "Evidence"), ("spectral", "NormalisedCumulativePeriodogram"),
    ("direct", "weights"), ("iterative", "weights"),
    *(("spectral", rule) for rule in (*RULES[2:6], RULES[7])),
    *(("direct", method) for method in ("GeneralisedCrossValidation", "LCurve", "correlation")),
]  # fmt: skip
GRADUALLY = [case for case in GRADIENTS if case not in RARE]


@pytest.mark.parametrize(
    ("path", "method"), hardest(GRADIENTS, [("spectral", "evidence")], GRADUALLY)
)
def test_derivatives_are_the_differences(path, method):
    """By the sensor, data, noise and prior, forward and reverse, of value, bands and weights. The
    bands of the iterative path are approximations without derivatives, and say so."""
    case = make_case(**CASES[path])
    case = roughened(case) if method == "correlation" else case

    @jax.jit
    def of(theta):
        return numbers(case, method, path, theta)

    forward, reverse = (np.asarray(jax.jit(each(of))(NOMINAL)) for each in (jax.jacfwd, jax.jacrev))
    expected = differences(of, NOMINAL, 1e-3 if path == "iterative" else 1e-4)
    some = [0, *range(2, len(expected) - 1)] if path == "iterative" else slice(None)
    assert np.isnan(forward[1]).any() == (path == "iterative")
    size = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1e-9)
    assert np.max(np.abs(forward - expected)[some] / size[some]) < 1e-6
    assert np.max(np.abs(forward - reverse)[some] / size[some]) < 1e-6


@pytest.mark.full
def test_a_length_at_the_end_of_its_range_has_derivatives():
    """Over smooth bumps it is the longest of the line, whatever the stated one."""
    case = make_case()

    @jax.jit
    def of(length):
        return numbers(case, "correlation", "spectral", [1.0] * 5 + [length[0]])

    slope = np.asarray(jax.jacfwd(of)(np.ones(1)))
    expected = differences(of, np.ones(1), 1e-4)
    assert np.max(np.abs(slope - expected)) < 1e-6 * np.max(np.abs(expected))


@pytest.mark.parametrize("path", quick(CASES, "spectral", "direct"))
def test_traced_numbers_are_those_of_known_ones(path):
    case = make_case(**CASES[path])
    for method in ("given", "Evidence") if path != "iterative" else ("given",):
        known = np.asarray(numbers(case, method, path, NOMINAL))
        traced = np.asarray(jax.jit(lambda t, m=method: numbers(case, m, path, t))(NOMINAL))
        np.testing.assert_allclose(traced, known, rtol=1e-8)


@pytest.mark.parametrize("path", quick(CASES, "spectral", "direct"))
def test_nuisance_and_rig_are_the_same_when_traced(path):
    """Fitted signal, residual and degrees of freedom, beside columns on the signals and under a rig
    whose gains are uncertain."""
    columns = np.cos(np.linspace(0, 9, N) + np.arange(2)[:, None, None]) * 1e-6
    beside = {} if path == "spectral" else {"nuisance": columns}
    operator = make_case(**CASES[path]).problem.forward
    gains = 0.1 * np.eye(2)[..., None, None] * np.asarray(operator.transfer)  # of each element
    changes = dataclasses.replace(operator, transfer=jnp.asarray(gains.reshape(4, 2, -1)))
    rig = {"rig_changes": changes, "rig_sources": ("gain_1", "gain_2")}
    case = make_case(**CASES[path], **beside, **rig)
    method = Tikhonov(weight_p=2e-5, weight_q=8e-5, path=path, tolerance=1e-12)
    exact = srsinv.invert(make_case(**CASES[path], **beside).problem, method)
    assert np.all(np.asarray(srsinv.invert(case.problem, method).stderr) >= exact.stderr)
    known = srsinv.invert(case.problem, method)
    traced = eqx.filter_jit(srsinv.invert)(case.problem, method)
    for name in ("value", "stderr", "fitted", "whitened"):
        size = np.nanmax(np.abs(getattr(known, name)))
        mine, theirs = np.asarray(getattr(traced, name)), np.asarray(getattr(known, name))
        np.testing.assert_allclose(mine, theirs, atol=1e-8 * size)
    for name in ("chi2_per_freedom", "degrees_of_freedom", "resolved_dof_p"):
        assert float(traced.stats[name]) == pytest.approx(known.stats[name], rel=1e-8)


@pytest.mark.parametrize("scale", quick(("given", "evidence"), "given"))
def test_many_problems_at_once_are_those_one_by_one(scale):
    """And each estimate under vmap says that it was not checked."""
    case = make_case()
    rng = np.random.default_rng(2)
    data = np.asarray(case.problem.data) + case.sigma * rng.normal(size=(5, 2, N))

    def estimate(y):
        problem = eqx.tree_at(lambda p: p.data, case.problem, y)
        return srsinv.invert(problem, Wiener(scale=scale))

    together = jax.vmap(estimate)(jnp.asarray(data))
    for i, y in enumerate(data):
        alone = estimate(jnp.asarray(y))
        np.testing.assert_allclose(together.value[i], alone.value, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(together.stderr[i], alone.stderr, rtol=1e-8)
        chi2 = float(together.stats["chi2_per_freedom"][i])
        assert chi2 == pytest.approx(alone.stats["chi2_per_freedom"], rel=1e-8)
    assert any("JAX traced" in each for each in together.warnings)
    assert not any("JAX traced" in each for each in alone.warnings)


@pytest.mark.parametrize("path", CASES)
def test_an_estimate_has_arrays_of_jax_on_all_paths(path):
    made = srsinv.invert(make_case(**CASES[path]).problem, Wiener(path=path))
    for name in ("value", "stderr", "fitted", "whitened", "covariance", "averaging"):
        assert isinstance(getattr(made, name), jax.Array), name


def test_what_the_direct_path_cannot_solve_is_nan_when_traced():
    """Known numbers raise the weights, or say that there is no answer."""
    case = make_case("open", films="same")
    tiny = Tikhonov(weight_p=1e-25, weight_q=1e-25, path="direct")
    assert srsinv.invert(case.problem, tiny).quality == "failed"
    assert np.isnan(np.asarray(eqx.filter_jit(srsinv.invert)(case.problem, tiny).value)).all()


def test_a_rule_that_cannot_be_traced_says_so():
    case = make_case("open", observed=gaps())
    refused(
        lambda: eqx.filter_jit(srsinv.invert)(case.problem, Tikhonov(path="iterative")),
        "path=direct",
    )


SCENES = {
    "periodic": lambda: srsinv.Periodic(N, 2.5e-4),
    "open": lambda: srsinv.Open(N, 2.5e-4),
}


@pytest.mark.parametrize("line", quick(SCENES, "periodic"))
def test_the_error_of_a_task_has_a_slope_by_the_sensor(line):
    """From depth, width and speed through the simulated signal and its noise to the error of the
    inversion, the mean over a strip's width with them."""
    cells = SCENES[line]()

    def error(theta):
        film = Film(DEPTH_M * theta[0], 0.0, width_m=0.7e-3 * theta[1]).with_strip_average()
        films = [film, dataclasses.replace(film, angle_rad=jnp.asarray(np.pi / 2))]
        strip = srsinv.UniformStrip(2e3, 1e-3, 6e-3)
        scenario = srsinv.Scenario(
            srsinv.TractionScene(500.0, 0.3, pressures=[strip]),
            srsinv.Sensor(films),
            srsinv.ConstantSpeed(0.05 * theta[2]),
            noises=[srsinv.SignalToNoise(40.0)],
        )
        made = srsinv.simulate(scenario, cells)
        estimate = srsinv.invert(made.problem, Wiener(scale="evidence"))
        return jnp.sum((estimate.value - made.traction) ** 2)[None] / 1e6

    theta = np.ones(3)
    slopes = np.asarray(jax.jit(jax.jacrev(error))(theta))
    expected = differences(jax.jit(error), theta, 1e-4)
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
