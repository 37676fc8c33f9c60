"""What the two filters have in common."""

import dataclasses

import numpy as np

from ..filter import Filter
from ..setup import Setup
from ._glance import Glance


def filtered(setup: Setup, by: Filter) -> Setup:
    """The setup with one more filter behind the amplifier."""
    sensor = setup.sensor
    return setup.but(sensor=dataclasses.replace(sensor, filters=(*sensor.filters, by)))


def filtered_share(glance: Glance, by: Filter) -> float:
    """How much of the signal a filter takes or delays."""
    turn = 1j * glance.k * glance.speed_m_per_s * float(by.time_scale_s)
    response = np.prod([-pole / (turn - pole) for pole in by.poles], axis=0)
    return glance.share((response[None] - 1) * glance.signal)
