"""What the forward model refuses, each in one sentence that names the value and what to give."""

import math

import pytest

from srsinv.forward.amplifier import CurrentAmplifier, IntegratedCurrent
from srsinv.forward.film import Film
from srsinv.forward.noise import Johnson, SignalToNoise, Sliding, White
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import FrictionStep, Hertz, PressedStrip, Sinusoid, UniformStrip
from srsinv.grid import Open, Periodic
from tests.refusals import refused

REFUSED = {
    "negative_depth": (lambda: Film(depth_m=-1e-3), "depth_m", "-0.001", "positive"),
    "no_depth": (lambda: Film(depth_m=0), "depth_m", "0", "positive"),
    "depth_nan": (lambda: Film(depth_m=math.nan), "depth_m", "nan", "positive"),
    "zero_width": (lambda: Film(width_m=0.0), "width_m", "0.0", "positive"),
    "endless_length": (lambda: Film(length_m=math.inf), "length_m", "inf", "positive"),
    "no_strips": (lambda: Film(strips=0), "strips", "0", "from 1"),
    "no_elements": (lambda: Sensor([]), "elements", "0", "at least 1"),
    "poisson_high": (lambda: HalfSpace(0.6), "poisson_ratio", "0.6", "0.5"),
    "poisson_low": (lambda: HalfSpace(-0.1), "poisson_ratio", "-0.1", "between 0"),
    "negative_ohm": (lambda: CurrentAmplifier(-1e6), "resistance_ohm", "-1000000.0", "positive"),
    "no_ohm": (lambda: IntegratedCurrent(0), "resistance_ohm", "0", "positive"),
    "speed_nan": (lambda: ConstantSpeed(math.nan), "speed_m_per_s", "nan", "finite"),
    "speed_inf": (lambda: ConstantSpeed(-math.inf), "speed_m_per_s", "-inf", "finite"),
    "two_cells": (lambda: Periodic(2, 1e-4), "2 cells", "at least 3", "samples"),
    "no_cells": (lambda: Open(0, 1e-4), "0 cells", "at least 3", "samples"),
    "negative_cell": (lambda: Open(8, -1e-4), "cell_m", "-0.0001", "positive"),
    "cell_nan": (lambda: Periodic(8, math.nan), "cell_m", "nan", "positive"),
    "rms": (lambda: White(-1.0), "rms", "-1.0", "at least 0"),
    "snr": (lambda: SignalToNoise(math.inf), "snr_dB", "inf", "finite"),
    "johnson_ohm": (lambda: Johnson(-1.0), "resistance_ohm", "-1.0", "at least 0"),
    "johnson_cold": (lambda: Johnson(1e6, -4.0), "temperature_K", "-4.0", "at least 0"),
    "sliding": (lambda: Sliding(-0.1), "fraction", "-0.1", "at least 0"),
    "correlation": (lambda: Sliding(0.1, -1e-4), "correlation_m", "-0.0001", "at least 0"),
    "strip_edge": (lambda: PressedStrip(1e3, 1e-3, 0.0, 0.0), "edge_m", "0.0", "positive"),
    "strip_width": (lambda: PressedStrip(1e3, -1e-3, 0.0, 1e-4), "width_m", "-0.001", "positive"),
    "uniform_width": (lambda: UniformStrip(1e3, 0.0), "width_m", "0.0", "positive"),
    "hertz_width": (lambda: Hertz(1e3, -1e-3), "half_width_m", "-0.001", "positive"),
    "wavelength": (lambda: Sinusoid(1e3, 0), "wavelength_m", "0", "positive"),
    "step_edge": (lambda: FrictionStep(0.1, 0.0, -1e-3), "edge_m", "-0.001", "positive"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])


ALLOWED = {
    "static_touch": lambda: ConstantSpeed(0),
    "whole_numbers": lambda: Film(depth_m=1, strips=2),
    "three_cells": lambda: Open(3, 1e-4),
    "poisson_half": lambda: HalfSpace(0.5),
    "poisson_nothing": lambda: HalfSpace(0),
    "no_noise": lambda: White(0.0),
    "negative_friction_step": lambda: FrictionStep(-0.5, 0.0, 1e-4),
    "suction": lambda: UniformStrip(-1e3, 1e-3),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_the_bounds_themselves_are_allowed(name):
    ALLOWED[name]()
