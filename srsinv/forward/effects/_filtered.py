"""What the two filters have in common."""

import dataclasses

import numpy as np
from jaxtyping import Complex

from ..filter import Filter
from ..setup import Setup
from ._glance import Glance


def filtered(setup: Setup, by: Filter) -> Setup:
    """The setup with one more filter behind the amplifier."""
    sensor = setup.sensor
    return setup.but(sensor=dataclasses.replace(sensor, filters=(*sensor.filters, by)))


def filter_factor(glance: Glance, by: Filter) -> Complex[np.ndarray, "e k"]:
    """What a filter multiplies the signal's spectrum by."""
    turn = 1j * glance.k * glance.speed_m_per_s * float(by.time_scale_s)
    response = np.prod([-pole / (turn - pole) for pole in by.poles], axis=0)
    return response[None] * np.ones_like(glance.passed)
