"""What the two filters have in common."""

import dataclasses

import jax
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
    by = jax.tree.map(float, by)
    return by.response(glance.k * glance.speed_m_per_s, np)[None] * np.ones_like(glance.passed)
