"""Conformal bands: the order statistic, what is widened with it, and a rig that is stated wrong."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import srsinv
from srsinv.errors import BadInput
from srsinv.inverse.conformal import widened
from srsinv.inverse.wiener import Exponential
from srsinv.numerics import BAND_90
from tests.refusals import refused

LINE, SCAN = srsinv.Periodic(96, 3e-4), srsinv.ConstantSpeed(0.05)
SPECTRUM = Exponential(1500.0, 2e-3)
METHOD = srsinv.Wiener(SPECTRUM, SPECTRUM)
EVERY = np.ones(LINE.n, bool)


@cache
def operators():
    """Of the stated sensor, and of the true one, which is 15 % deeper."""
    stated = srsinv.Sensor()
    true = stated.with_films(lambda film: dataclasses.replace(film, depth_m=1.15 * film.depth_m))
    return tuple(np.asarray(each.operator(LINE, SCAN).transfer) for each in (stated, true))


def passes(seed: int, count: int, friction=None):
    """Passes of the deeper sensor over random traction, as problems of the stated one."""
    rng = np.random.default_rng(seed)
    spread = np.asarray(METHOD.spectra(_problem(np.zeros((2, LINE.n)), 1.0, friction)))[:1]
    own = []
    for _ in range(count):
        r = np.fft.rfft(rng.standard_normal((2, LINE.n))) * np.sqrt(spread)
        r = np.concatenate([r[:1], friction * r[:1]]) if friction else r
        r[:, 0] = 0.0
        clean = np.fft.irfft(np.einsum("eck,ck->ek", operators()[1], r), LINE.n)
        noise = 0.01 * np.sqrt(np.mean(clean**2))
        data = clean + noise * rng.standard_normal(clean.shape)
        own.append((_problem(data, noise**2, friction), np.fft.irfft(r, LINE.n)))
    return own


def _problem(data, power, friction=None):
    noise = np.full(LINE.n // 2 + 1, power)
    known = {"known_mean_Pa": (0.0, None), "friction": friction}
    return srsinv.LineProblem.of_sensor(LINE, srsinv.Sensor(), SCAN, data, noise, **known)


def test_the_factor_is_the_order_statistic_of_the_passes():
    """Twenty passes, nine in ten: the 19th least of the multiples that hold a share of cells."""
    own = passes(0, 20)
    made = srsinv.Conformal.of_passes(METHOD, own, confidence=0.9, share=0.8)
    scores = []
    for problem, truth in own:
        estimate = METHOD(problem)
        z = np.abs(np.asarray(estimate.value) - truth) / np.asarray(estimate.stderr)
        scores.append(np.sort(z, axis=1)[:, int(np.ceil(0.8 * (LINE.n - 1)))])
    p, q = np.sort(scores, axis=0)[18] / BAND_90
    np.testing.assert_allclose([made.factor_p, made.factor_q], [p, q], rtol=1e-6)


def test_a_wrong_depth_is_held_by_conformal_bands_and_not_by_the_models():
    """The model holds nine tenths of the cells in few scans, conformal bands in nine of ten."""
    factors = [
        (float(made.factor_p), float(made.factor_q))
        for made in (srsinv.Conformal.of_passes(METHOD, passes(i, 19)) for i in range(1, 5))
    ]
    held = {"model": [], "conformal": []}
    for problem, truth in passes(9, 40):
        estimate = METHOD(problem)
        held["model"].append(estimate.coverage(truth, EVERY) >= 0.9)
        held["conformal"] += [
            widened(estimate, each).coverage(truth, EVERY) >= 0.9 for each in factors
        ]
    assert np.mean(held["model"]) < 0.4
    # Of 40 scans, whose share scatters by 5 %, and over calibrations by as much again.
    assert 0.75 < np.mean(held["conformal"]) <= 1.0


@pytest.mark.parametrize("friction", [None, 0.4])
def test_all_errors_of_an_estimate_grow_by_the_factors(friction):
    """Also those on another line, which follow from the covariance."""
    ((problem, _),) = passes(3, 1, friction)
    estimate, made = METHOD(problem), srsinv.Conformal(METHOD, 2.0, 2.0 if friction else 3.0)
    wide, wider = made(problem), srsinv.Periodic(LINE.n // 4, 1.2e-3, 4.5e-4)
    for own, other in ((estimate, wide), (estimate.on(wider), wide.on(wider))):
        ratio = np.asarray(other.stderr) / np.asarray(own.stderr)
        np.testing.assert_allclose(ratio, [[2.0], [2.0 if friction else 3.0]] * np.ones(own.line.n))
        np.testing.assert_array_equal(other.value, own.value)
    assert wide.stats["conformal_factor_p"] == 2.0


def test_bad_input():
    own = passes(0, 9)
    of = srsinv.Conformal.of_passes
    refused(lambda: of(METHOD, own[:8]), "8 passes", "9")
    refused(lambda: of(METHOD, own, confidence=0.95), "9 passes", "19")
    refused(lambda: of(METHOD, own, share=1.2), "share", "1.2")
    short = [(problem, truth[:, :-1]) for problem, truth in own]
    refused(lambda: of(METHOD, short), "(2, 95)", "(2, 96)")
    refused(lambda: srsinv.Conformal(METHOD, -1.0, 1.0), "factor_p", "-1.0")
    refused(lambda: srsinv.Conformal("wiener", 1.0, 1.0), "method")
    edges = srsinv.Conformal(srsinv.Wiener(constraint=srsinv.Admissible()), 1.0, 1.0)
    with pytest.raises(BadInput):
        edges(own[0][0])
