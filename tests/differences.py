"""Derivatives by central differences."""

from collections.abc import Callable
from typing import Any

import numpy as np


def differences(of: Callable[[Any], Any], theta: np.ndarray, step: float) -> np.ndarray:
    """The derivatives of numbers by theta (number, parameter); the error in step^2 drops out."""

    def central(step: float) -> np.ndarray:
        each = [
            (np.asarray(of(theta + step * d)) - np.asarray(of(theta - step * d))) / (2 * step)
            for d in np.eye(theta.size)
        ]
        return np.stack(each, axis=1)

    return (4 * central(step) - central(2 * step)) / 3
