"""What an inversion refuses, each in one sentence that names the value and what to give."""

import math

import numpy as np
import pytest

from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Flat, Normalised, Wiener
from tests.inverse.cases import N, gaps, make_case, make_line, make_operator
from tests.refusals import refused

LINE = make_line()
PAIR, ONE = make_operator(LINE), make_operator(LINE, "one")
DATA, LEVEL = np.zeros((2, N)), np.ones(N // 2 + 1)
TWO_LEFT = np.zeros((2, N), bool)
TWO_LEFT[:, :2] = True


def problem(forward=PAIR, data=DATA, noise: object = LEVEL, **known):
    return LineProblem(LINE, forward, data, noise, **known)


def one_zero(at, value=0.0):
    return np.where(np.arange(len(LEVEL)) == at, value, 1.0)


REFUSED = {
    "one_element": (lambda: problem(ONE, DATA[:1]), "One element", "friction", "second"),
    "data_shape": (lambda: problem(data=DATA[:, :-1]), "(2, 47)", "(2, 48)"),
    "data_element": (lambda: problem(data=DATA[:1]), "(1, 48)", "(2, 48)"),
    "data_flat": (lambda: problem(data=DATA[0]), "(48,)", "(2, 48)"),
    "data_nan": (lambda: problem(data=DATA + math.nan), "data", "nan"),
    "no_noise": (lambda: problem(noise=0 * LEVEL), "noise", "zero", "above 0"),
    "no_noise_somewhere": (lambda: problem(noise=one_zero(7)), "noise", "zero", "above 0"),
    "negative_noise": (lambda: problem(noise=one_zero(3, -1.0)), "noise", "above 0"),
    "noise_nan": (lambda: problem(noise=one_zero(3, math.nan)), "noise", "nan"),
    "noise_endless": (lambda: problem(noise=one_zero(3, math.inf)), "noise", "inf"),
    "noise_number": (lambda: problem(noise=1e-6), "noise", "25"),
    "noise_shape": (lambda: problem(noise=np.ones(N)), "noise", "48", "25"),
    "two_samples": (lambda: problem(observed=TWO_LEFT), "2 samples", "at least 3"),
    "no_samples": (lambda: problem(observed=gaps() & False), "0 samples", "at least 3"),
    "gaps_shape": (lambda: problem(observed=gaps()[0]), "observed", "(48,)", "(2, 48)"),
    "friction_nan": (lambda: problem(friction=math.nan), "friction", "nan"),
    "known_mean_nan": (lambda: problem(known_mean_Pa=(math.nan, None)), "mean", "nan"),
    "path": (lambda: Wiener(path="spectre")(problem()), "'spectre'", "spectral", "direct"),
    "spectral_gaps": (
        lambda: Wiener(path="spectral")(problem(observed=gaps())),
        "path=spectral",
        "periodic",
        "auto",
    ),
    "spectral_open": (
        lambda: Tikhonov(path="spectral")(make_case("open").problem),
        "path=spectral",
        "periodic",
        "auto",
    ),
    "direct_size": (
        lambda: Wiener(path="direct")(make_case(n=2050).problem),
        "path=direct",
        "4100",
        "4096",
        "iterative",
    ),
    "order_3": (lambda: Tikhonov(3), "order", "3", "0, 1 or 2"),
    "order_minus": (lambda: Tikhonov(-1), "order", "-1", "0, 1 or 2"),
    "weight_minus": (lambda: Tikhonov(weight_p=-1.0), "weight_p", "-1.0", "positive"),
    "weight_zero": (lambda: Tikhonov(weight_q=0), "weight_q", "0", "positive"),
    "weight_nan": (lambda: Tikhonov(weight_q=math.nan), "weight_q", "nan", "positive"),
    "length_zero": (lambda: Tikhonov(length_m=0.0), "length_m", "0.0", "positive"),
    "length_minus": (lambda: Tikhonov(length_m=-1e-3), "length_m", "-0.001", "positive"),
    "tolerance_zero": (lambda: Tikhonov(tolerance=0.0), "tolerance", "0.0", "positive"),
    "tolerance_minus": (lambda: Wiener(tolerance=-1.0), "tolerance", "-1.0", "positive"),
    "scale": (lambda: Wiener(scale="likely"), "scale", "'likely'", "evidence"),
    "rms_zero": (lambda: Exponential(0.0), "rms_Pa", "0.0", "positive"),
    "rms_nan": (lambda: Flat(math.nan), "rms_Pa", "nan", "positive"),
    "correlation": (lambda: Exponential(1.0, -1e-3), "correlation_m", "-0.001", "positive"),
    "normalised": (lambda: Normalised(0), "noise_to_signal", "0", "positive"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])


def test_what_is_right_is_taken():
    """The table's neighbours that are good input."""
    problem(noise=one_zero(0, math.inf))  # an unknown offset
    problem(friction=0.0)
    problem(data=np.where(gaps(), DATA, math.nan), observed=gaps())
    Tikhonov(weight_p=1e-30, rule=GeneralisedCrossValidation())
