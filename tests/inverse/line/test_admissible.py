"""Tractions that are admissible or have edges: projections and minima against independent solvers,
draws against closed forms, and the estimates."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.stats

from srsinv import BadInput
from srsinv.grid import Periodic
from srsinv.inverse.constrained_estimate import ConstrainedEstimate
from srsinv.inverse.line import constrained as constrained_module
from srsinv.inverse.line.constrained import centred_posterior, penalties
from srsinv.inverse.line.constraint import Admissible, Edges, Gaussian, onto_cone
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.splitting import Penalised, PerWave, minimise
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, SpectralPrior, Wiener
from tests.inverse.cases import make_line, make_operator
from tests.tiers import quick

RNG = np.random.default_rng(7)
N = 48
POWERS = (4e3, 2e3)  # of p and q, rms [Pa]


def problem_of(kind="periodic", missing=False, known=True, background_Pa=0.0, seed=1):
    """Two elements over two bumps of pressure between which nothing touches, and their truth."""
    line = make_line(kind, N)
    x = np.asarray(line.x)
    p = 8e3 * np.maximum(1 - ((np.abs(x) - 3e-3) / 1.2e-3) ** 2, 0) + background_Pa
    truth = np.stack([p, 0.4 * p])
    operator = make_operator(line)
    signal = np.asarray(operator(jnp.asarray(truth)))
    sigma = 0.03 * signal.std()
    data = signal + sigma * np.random.default_rng(seed).normal(size=signal.shape)
    observed = np.ones(data.shape, bool)
    if missing:
        observed[0, 10:14] = observed[1, 30:36] = False
    data = np.where(observed, data, 0.0)
    mean = float(p.mean()) if known else None
    noise = np.full((1, N // 2 + 1), sigma**2)
    return LineProblem(
        line, operator, data, noise, observed=observed, known_mean_Pa=(mean, None)
    ), truth


def prior_of(problem):
    powers = [Exponential(rms, 2e-3).power(problem) for rms in POWERS]
    return SpectralPrior(np.stack([np.asarray(each) for each in powers]))


def dense(problem, prior, share=1.0):
    """The precision and the mean of the Gaussian posterior, from columns of the operator, and a
    basis (m, free) of tractions whose fixed means are zero."""
    size = 2 * N
    columns = [np.asarray(problem.forward(jnp.asarray(e.reshape(2, N)))) for e in np.eye(size)]
    rows = problem.is_observed.ravel()
    model = np.stack(columns, axis=-1).reshape(-1, size)[rows] / problem.noise_rms
    data = np.asarray(problem.data).ravel()[rows] / problem.noise_rms
    weighed = [np.asarray(prior.apply(problem.line, e.reshape(2, N))).ravel() for e in np.eye(size)]
    precision = model.T @ model + share * np.stack(weighed, axis=-1)
    fixed = np.kron(np.diag(np.asarray(problem.zero_mean, float)), np.ones((1, N)))
    basis = scipy.linalg.null_space(fixed) if fixed.any() else np.eye(size)
    reduced = basis.T @ precision @ basis
    return reduced, np.linalg.solve(reduced, basis.T @ model.T @ data), basis


def least_distance(precision, mean, rows, least):
    """The minimum of (y - mean)^T precision (y - mean) with rows y >= least, by active sets: Lawson
    and Hanson's least distance programming."""
    root = np.linalg.cholesky(precision)
    inward = np.linalg.solve(root, rows.T).T
    matrix = np.vstack([inward.T, (least - rows @ mean)[None]])
    target = np.eye(len(matrix))[-1]
    multipliers, _ = scipy.optimize.nnls(matrix, target, maxiter=100 * len(rows))
    left = matrix @ multipliers - target
    return mean + np.linalg.solve(root.T, -left[:-1] / left[-1])


@pytest.mark.parametrize("friction_max", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("weights", [(1.0, 1.0), (0.3, 5.0)])
def test_projection_on_the_cone_is_the_nearest_point(friction_max, weights):
    points = RNG.normal(size=(2, 200))
    found = np.asarray(onto_cone(jnp.asarray(points), friction_max, jnp.asarray(weights)))
    # Every point of the cone is a sum of its two sides with positive weights.
    sides = np.array([[1.0, 1.0], [friction_max, -friction_max]])
    root = np.sqrt(np.array(weights))
    nearest = [scipy.optimize.nnls(root[:, None] * sides, root * each)[0] for each in points.T]
    np.testing.assert_allclose(found, sides @ np.array(nearest).T, atol=1e-12)


CASES = [
    ("periodic", False, None),
    ("periodic", False, 1.0),
    ("open", False, None),
    ("open", False, 1.0),
    ("periodic", True, 1.0),
]


@pytest.mark.parametrize(("kind", "missing", "friction_max"), quick(CASES, CASES[1], CASES[4]))
def test_minimum_is_that_of_active_sets(kind, missing, friction_max):
    problem, _ = problem_of(kind, missing)
    prior, constraint = prior_of(problem), Admissible(friction_max)
    with jax.enable_x64(True):
        of = centred_posterior(problem, prior, constraint)
        penalised = penalties(problem, prior, constraint, of)
        found = minimise(of.posterior, jnp.asarray(of.mean)[None], constraint, penalised, 1e-5, 1e5)
    assert found.distance[0] <= 1e-5

    precision, mean, basis = dense(problem, prior)
    level = float(np.asarray(of.level)[0, 0])
    unit = np.eye(N)
    rows = np.hstack([unit, 0 * unit])
    if friction_max is not None:
        rows = np.block([[friction_max * unit, -unit], [friction_max * unit, unit]])
    if friction_max is not None and problem.zero_mean[1]:
        # The level of q is one more unknown, normal with the greatest mean shear.
        basis = np.column_stack([basis, np.repeat([0.0, 1.0], N)])
        precision = scipy.linalg.block_diag(precision, (friction_max * level) ** -2)
        mean = np.append(mean, 0.0)
    least = -level * rows[:, :N].sum(axis=1)
    wanted = basis @ least_distance(precision, mean, rows @ basis, least)
    off = np.asarray(found.value[0]).ravel() - wanted
    stderr = np.sqrt(np.diag(basis @ np.linalg.inv(np.asarray(precision)) @ basis.T))
    assert np.any(rows @ wanted - least < 1e-6 * level)  # something is at its bound
    assert np.max(np.abs(off) / stderr) < 2e-5  # within the tolerance, and rounding of the other
    assert np.max(np.abs(off)) < 1e-6 * np.max(np.abs(wanted))


@pytest.mark.parametrize("order", quick((1, 2), 1))
def test_edges_are_those_of_bounded_least_squares(order):
    problem, _ = problem_of()
    prior, constraint, share = prior_of(problem), Edges(order), 1e-2
    with jax.enable_x64(True):
        of = centred_posterior(problem, prior, constraint, share)
        penalised = penalties(problem, prior, constraint, of)
        found = minimise(of.posterior, jnp.asarray(of.mean)[None], constraint, penalised, 1e-4, 1e5)
    precision, mean, basis = dense(problem, prior, share)
    step = np.linalg.matrix_power(np.roll(np.eye(N), 1, axis=1) - np.eye(N), order)
    rows = np.kron(np.eye(2), step) @ basis
    for c, found_weight in enumerate(np.asarray(penalised.edges)):
        unit = np.eye(2)[c][:, None, None] * np.eye(N)
        own = [np.asarray(prior.apply(problem.line, unit[:, i]))[c] for i in range(N)]
        variance = step[0] @ np.linalg.inv(np.array(own)) @ step[0]
        # Laplace's distribution of this variance has the density exp(-w |d|) w / 2.
        np.testing.assert_allclose(found_weight, np.sqrt(2 / variance), rtol=1e-9)
    root = np.linalg.cholesky(precision)
    # The dual: absolute values are multipliers between their weights.
    weights = np.repeat(np.asarray(penalised.edges), N)
    matrix = np.linalg.solve(root, rows.T)
    dual = scipy.optimize.lsq_linear(matrix, root.T @ mean, (-weights, weights), tol=1e-14)
    wanted = basis @ (mean - np.linalg.solve(root.T, matrix @ dual.x))
    stderr = np.sqrt(np.diag(basis @ np.linalg.inv(precision) @ basis.T))
    assert np.max(np.abs(np.asarray(found.value[0]).ravel() - wanted) / stderr) < 1e-3


def white(covariance, n):
    """A posterior whose cells are independent, each of this covariance (c, c)."""
    line = Periodic(n, 1e-4)
    blocks = jnp.asarray(covariance, complex)[..., None] * jnp.ones(n // 2 + 1)
    inverse = jnp.asarray(np.linalg.inv(covariance), complex)[..., None] * jnp.ones(n // 2 + 1)
    return PerWave(
        line=line, precision=inverse, covariance=blocks, is_solved=jnp.ones(blocks.shape[1:], bool)
    )


def projected(posterior, mean, constraint, draws=400):
    """Projected draws (draw, c, n) about a mean (c,)."""
    c = len(mean)
    centre = posterior.draw(jax.random.key(3), draws) + jnp.asarray(mean)[:, None]
    split = np.ones(c)
    numbers = np.zeros((c, 1)), np.zeros(c, bool), np.zeros(c), split, np.zeros(c)
    return np.asarray(
        minimise(posterior, centre, constraint, Penalised(*map(jnp.asarray, numbers)), 1e-4, 1e5)
        .value
    )  # fmt: skip


@pytest.mark.parametrize("mean", quick([-1.0, 0.0, 0.7], -1.0))
def test_draws_of_one_pressure_are_rectified(mean):
    """max(g, 0) of a normal g: its atom at zero, mean and mean square in closed form."""
    values = projected(white([[1.0]], 64), [mean], Admissible()).ravel()
    density, above = scipy.stats.norm.pdf(mean), scipy.stats.norm.cdf(mean)
    expected = mean * above + density, (mean**2 + 1) * above + mean * density
    for power, wanted in zip((1, 2), expected, strict=True):
        error = np.std(values**power) / np.sqrt(values.size)
        assert abs(np.mean(values**power) - wanted) < 4 * error
    atom = np.mean(values < 1e-6)
    assert abs(atom - (1 - above)) < 4 * np.sqrt(above * (1 - above) / values.size)


def test_draws_about_the_apex_fill_angles():
    """About no traction, the draws that become none and those that stay are angles over 2 pi of
    the cone and its polar, in the units of a correlated posterior."""
    covariance, friction_max = np.array([[1.0, 0.5], [0.5, 2.0]]), 0.8
    values = projected(white(covariance, 64), [0.0, 0.0], Admissible(friction_max))
    p, q = values[:, 0].ravel(), values[:, 1].ravel()
    sides = np.linalg.solve(np.linalg.cholesky(covariance), [[1, 1], [0.8, -0.8]])
    cosine = sides[:, 0] @ sides[:, 1] / np.prod(np.linalg.norm(sides, axis=0))
    angle = np.arccos(cosine)
    is_none = (np.abs(p) < 1e-4) & (np.abs(q) < 1e-4)
    is_inside = np.abs(q) < friction_max * p - 1e-4
    for found, wanted in ((is_none, np.pi - angle), (is_inside, angle)):
        chance = wanted / (2 * np.pi)
        # Draws within the solver's tolerance of a face are of one in ten thousand.
        assert abs(np.mean(found) - chance) < 4 * np.sqrt(chance / p.size) + 1e-3


@pytest.mark.parametrize("tolerance", [1.0, 0.1, 1e-2])
def test_distance_bounds_the_error(tolerance):
    problem, _ = problem_of()
    prior, constraint = prior_of(problem), Admissible(1.0)
    with jax.enable_x64(True):
        of = centred_posterior(problem, prior, constraint)
        penalised = penalties(problem, prior, constraint, of)
        about = of.posterior, jnp.asarray(of.mean)[None], constraint, penalised
        rough, exact = minimise(*about, tolerance, 1e5), minimise(*about, 1e-5, 1e5)
        off = rough.value - exact.value
        distance = float(jnp.sqrt(jnp.sum(off * of.posterior.weigh(off))))
    assert distance <= float(rough.distance[0]) + 1e-5
    assert float(rough.distance[0]) <= tolerance


@pytest.mark.parametrize("kind", quick(["periodic", "open"], "periodic"))
def test_under_full_contact_it_is_the_gaussian_estimate(kind):
    problem, _ = problem_of(kind, background_Pa=6e4)
    spectra = [Exponential(rms, 2e-3) for rms in POWERS]
    gaussian = Wiener(*spectra)(problem)
    found = Wiener(*spectra, constraint=Admissible())(problem)
    size = np.max(np.abs(gaussian.value))
    np.testing.assert_allclose(found.value, gaussian.value, rtol=0, atol=1e-9 * size)
    # 199 draws have a standard error of a twentieth of their standard deviation.
    ratio = np.asarray(found.stderr) / np.asarray(gaussian.stderr)
    assert np.all(np.abs(ratio - 1) < 5 / np.sqrt(2 * 199))


@pytest.mark.parametrize("kind", quick(["periodic", "open"], "periodic"))
def test_partial_contact_does_not_pull_and_is_nearer(kind):
    problem, truth = problem_of(kind)
    cells = np.ones(N, bool)
    gaussian = Wiener(scale="evidence")(problem)
    found = Wiener(scale="evidence", constraint=Admissible(1.0))(problem)
    assert isinstance(found, ConstrainedEstimate)
    p, q = np.asarray(found.value)
    assert p.min() > -1e-9 * p.max()
    assert np.all(np.abs(q) <= p + 1e-6 * p.max())
    draws = np.asarray(found.draws)
    assert draws[:, 0].min() > -1e-9 * p.max()
    assert np.all(np.abs(draws[:, 1]) <= draws[:, 0] + 1e-6 * p.max())
    low, high = found.band
    assert np.all(low <= high)
    assert np.mean(low[0] <= 1e-6 * p.max()) > 0.3  # where nothing touches

    def error(estimate):
        return np.linalg.norm(estimate.deviation(cells)[0] - truth + truth.mean(-1)[:, None])

    assert error(found) < error(gaussian)
    assert found.coverage(truth, cells).min() > 0.8
    assert not found.against(truth, cells).warnings


def test_draws_follow_to_other_cells():
    problem, _ = problem_of()
    found = Wiener(scale="evidence", constraint=Admissible())(problem)
    assert isinstance(found, ConstrainedEstimate)
    cell, start = float(problem.line.cell_m), float(problem.line.start_m)
    wide = found.on(Periodic(N // 2, 2 * cell, start + cell / 2))
    pairs = np.asarray(found.draws).reshape(-1, 2, N // 2, 2).mean(axis=-1)
    np.testing.assert_allclose(wide.draws, pairs, atol=1e-9 * np.abs(pairs).max())
    np.testing.assert_allclose(wide.stderr, pairs.std(axis=0), atol=1e-9 * np.abs(pairs).max())


def test_total_variation_recovers_a_plateau():
    line = make_line("periodic", N)
    p = 1e4 + 5e3 * (np.abs(np.asarray(line.x)) < 2e-3)
    truth = np.stack([p, 0.4 * p])
    operator = make_operator(line)
    signal = np.asarray(operator(jnp.asarray(truth)))
    sigma = 0.02 * signal.std()
    data = signal + sigma * RNG.normal(size=signal.shape)
    noise = np.full((1, N // 2 + 1), sigma**2)
    problem = LineProblem(line, operator, data, noise, known_mean_Pa=(p.mean(), None))
    off = [
        np.asarray(Tikhonov(constraint=each)(problem).value)[0] - p for each in (None, Edges(1, 19))
    ]
    assert np.linalg.norm(off[1]) < 0.5 * np.linalg.norm(off[0])


def test_without_a_level_it_is_the_gaussian_estimate_with_a_warning():
    problem, _ = problem_of(known=False)
    gaussian = Wiener()(problem)
    found = Wiener(constraint=Admissible())(problem)
    assert np.array_equal(found.value, gaussian.value)
    assert any("mean pressure is not known" in each for each in found.warnings)


def test_without_a_constraint_nothing_changes():
    problem, _ = problem_of()
    plain, same = Wiener()(problem), Wiener(constraint=Gaussian())(problem)
    assert eqx.tree_equal(plain.value, same.value)
    assert plain.warnings == same.warnings


def test_what_cannot_be_is_refused(monkeypatch):
    for wrong in (-1.0, 0.0, np.nan, "much"):
        with pytest.raises(BadInput, match="friction_max"):
            Admissible(wrong)
    with pytest.raises(BadInput, match="draws"):
        Admissible(draws=3)
    with pytest.raises(BadInput, match="order"):
        Edges(3)
    with pytest.raises(BadInput, match="constraint"):
        Wiener(constraint="admissible")
    problem, _ = problem_of("open")
    monkeypatch.setattr(constrained_module, "DIRECT_LIMIT", N)
    with pytest.raises(BadInput, match="unknowns"):
        Wiener(constraint=Admissible())(problem)
    known = LineProblem(
        problem.line, make_operator(problem.line), problem.data, problem.noise, friction=1.5,
        known_mean_Pa=(1e3, None),
    )  # fmt: skip
    with pytest.raises(BadInput, match="larger friction_max"):
        Wiener(constraint=Admissible(1.0))(known)
