"""Missing samples: nothing comes from them, and they never make an estimate surer."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse.gridding.cells import Cells, line_over
from srsinv.inverse.line.gaps import Gaps
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import SLOW, N, gaps, make_case, relative

WIENER = Wiener(Exponential(1.5e3, 0.8e-3), Exponential(5e2, 1.5e-3), path="direct")
METHODS = {
    "wiener": WIENER,
    "tikhonov": Tikhonov(1, 2e-5, 8e-5, path="direct"),
    "iterative": Tikhonov(1, 2e-5, 8e-5, path="iterative"),
}


def again(problem: LineProblem, **change) -> LineProblem:
    """The same problem, built anew with other data or other samples."""
    given = {"data": problem.data, "noise": problem.noise, "observed": problem.observed} | change
    return LineProblem(problem.line, problem.forward, **given)


@pytest.mark.full
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("filling", [0.0, 1e30, np.nan, np.inf])
def test_what_stands_in_a_gap_does_not_matter(name, filling):
    problem = make_case("open", observed=gaps()).problem
    filled = again(problem, data=np.where(gaps(), problem.data, filling))
    one, other = METHODS[name](problem), METHODS[name](filled)
    np.testing.assert_array_equal(one.value, other.value)
    np.testing.assert_array_equal(one.stderr, other.stderr)
    np.testing.assert_array_equal(np.isnan(other.whitened), ~gaps())
    assert np.all(np.isfinite(other.fitted))


@pytest.mark.parametrize("name", ["wiener", "tikhonov"])
def test_fewer_samples_never_shrink_the_standard_error(name):
    rng = np.random.default_rng(6)
    observed = np.ones((2, N), bool)
    before = np.zeros((2, N))
    for _ in range(5):
        observed = observed & (rng.random((2, N)) > 0.3)
        stderr = np.asarray(METHODS[name](make_case(observed=observed).problem).stderr)
        assert np.all(stderr > before * (1 - 1e-9))
        before = stderr
    assert observed.sum() < N


def test_a_gap_is_where_the_estimate_is_unsure():
    observed = np.ones((2, N), bool)
    observed[:, 20:32] = False
    stderr = np.asarray(METHODS["wiener"](make_case("open", observed=observed).problem).stderr)
    assert np.all(stderr[:, 24:28] > 1.3 * stderr[:, 8:12])


@pytest.mark.parametrize("amplifier", ["rate", "slow"])
def test_every_sample_there_is_the_whole_problem(amplifier):
    """Also by the path for gaps, with one sample gone that the noise makes worthless."""
    settings = {"slow": {"amplifier": SLOW, "films": "turned"}}.get(amplifier, {})
    whole = make_case(**settings).problem
    marked = make_case(observed=np.ones((2, N), bool), **settings).problem
    spectral, direct = (Tikhonov(1, 2e-5, 8e-5, path=path) for path in ("auto", "direct"))
    assert spectral(marked).stats["path"] == "spectral"
    assert relative(spectral(marked).value, spectral(whole).value) == 0
    assert relative(direct(marked).value, spectral(whole).value) < 1e-9


@pytest.mark.full
def test_an_element_missing_altogether():
    """With friction known, two elements of which one never spoke are the other one."""
    observed = np.ones((2, N), bool)
    observed[1] = False
    pair = make_case(friction=0.3, observed=observed).problem
    one = eqx.tree_at(lambda p: p.data, make_case(films="one", friction=0.3).problem, pair.data[:1])
    one = eqx.tree_at(lambda p: p.noise, one, pair.noise)
    ours, reference = METHODS["wiener"](pair), METHODS["wiener"](one)
    assert relative(ours.value, reference.value) < 1e-9
    assert relative(ours.stderr, reference.stderr) < 1e-9
    assert np.all(np.isnan(ours.whitened[1]))


def test_an_element_missing_altogether_leaves_p_and_q_apart_unsure():
    observed = np.ones((2, N), bool)
    observed[1] = False
    half = METHODS["wiener"](make_case(observed=observed).problem)
    full = METHODS["wiener"](make_case().problem)
    assert half.status == "converged"
    assert np.all(np.asarray(half.stderr) >= np.asarray(full.stderr) * (1 - 1e-9))
    assert np.any(np.asarray(half.stderr) > 1.5 * np.asarray(full.stderr))


def test_one_sample_with_an_unknown_offset_is_as_good_as_none():
    observed = np.ones((2, 2, N), bool)
    observed[:, 1] = False
    observed[0, 1, N // 2] = True
    settings = {"amplifier": SLOW, "films": "turned", "free_offset": True}
    one, none = (
        METHODS["tikhonov"](make_case("open", observed=each, **settings).problem)
        for each in observed
    )
    assert relative(one.value, none.value) < 1e-9
    assert relative(one.stderr, none.stderr) < 1e-9


@pytest.mark.full
@pytest.mark.parametrize("path", ["direct", "iterative"])
def test_an_unknown_offset_leaves_no_trace(path):
    """Whatever is added to every sample of one element, with gaps, nothing but the data moves."""
    settings = {"amplifier": SLOW, "films": "turned", "free_offset": True, "observed": gaps()}
    problem, _, sigma = make_case("open", **settings)
    method = Tikhonov(2, 2e-5, 8e-5, path=path)
    moved = again(problem, data=problem.data + sigma * jnp.array([[1e3], [-4e2]]))
    one, other = method(problem), method(moved)
    assert relative(other.value, one.value) < 1e-6
    assert relative(other.stderr, one.stderr) < 1e-9
    assert np.nanmax(np.abs(np.asarray(other.whitened) - np.asarray(one.whitened))) < 1e-3


def test_a_long_line_ends_close_to_its_margin():
    """Samples missing in one long run take a dense matrix, or hundreds of steps."""
    count, cell, depth = 1_111_111, 45e-6, 0.75e-3
    ones = np.ones((2, count))
    cells = Cells(cell * np.arange(count), ones, 1.0, ones, ones)
    line, gridded = line_over(cells, None, depth)
    shortest = line_over(cells._replace(x_m=cells.x_m[:500], signal=ones[:, :500]), None, depth)
    margins = shortest[0].n - 500
    missing = np.isnan(gridded.signal[0])
    assert 0 < margins <= missing.sum() <= margins + 256
    factors, rest = [], line.n
    for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31):
        while rest % prime == 0:
            rest //= prime
            factors.append(prime)
    assert rest == 1, factors


def test_neighbouring_runs_of_missing_samples_are_solved_together():
    clusters, run, apart = 8, 20, 400  # three runs in each, two samples between
    is_observed = np.ones((2, clusters * apart), bool)
    for cluster in range(clusters):
        for first in cluster * apart + np.array([100, 122, 144]):
            is_observed[:, first : first + run] = False
    each = 3 * 2 * run
    sizes = [block.stop - block.start for block in Gaps.of(is_observed).blocks]
    assert sum(sizes) == clusters * each
    assert all(size % each == 0 for size in sizes)


def test_blocks_of_a_long_run_are_bounded():
    is_observed = np.ones((2, 3000), bool)
    is_observed[:, 500:2500] = False
    blocks = Gaps.of(is_observed).blocks
    assert [block.start for block in blocks[1:]] == [block.stop for block in blocks[:-1]]
    assert blocks[0].start == 0
    assert blocks[-1].stop == 4000
    assert max(block.stop - block.start for block in blocks) <= 1024
