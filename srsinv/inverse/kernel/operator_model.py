"""What takes traction to the signals of a recording's sensor: the theory of its films, or a kernel
that was measured."""

import abc
from typing import Any

import equinox as eqx

from ...forward.sensor import Sensor
from ..rig.error import SensorError
from .measured import MeasuredKernel, load_kernel

SAME_FRICTION = 0.02  # by which mu may differ where a kernel is of one combination of p and q


class OperatorModel(eqx.Module):
    """Base of operator models: the sensor that a recording is inverted by, in place of the one that
    is stated, and the uncertainty of it.

    `sensor` is to be defined.
    """

    @abc.abstractmethod
    def sensor(self, stated: Sensor) -> Sensor:
        """The sensor that inversions and fits go by."""

    @property
    def error(self) -> SensorError | None:
        """What is uncertain of it, beside or in place of a calibration's; None: nothing."""
        return None

    def warnings(self, friction: float | None) -> tuple[str, ...]:
        """What speaks against it for a scan of this mu, as sentences; None: p and q apart."""
        del friction
        return ()


class Theory(OperatorModel):
    """The closed forms of the films as they are stated."""

    def sensor(self, stated: Sensor) -> Sensor:
        return stated


class Measured(OperatorModel):
    """A kernel that was measured over a known input, with its uncertainty.

    `path`: of the file `kernel.nc` that experiment=measure_kernel or fig10_11 wrote. Raises
    `BadInput` for any other file.
    """

    kernel: MeasuredKernel = eqx.field(static=True)

    def __init__(self, path: Any):
        self.kernel = load_kernel(path)

    def sensor(self, stated: Sensor) -> Sensor:
        return self.kernel.sensor(stated)

    @property
    def error(self) -> SensorError | None:
        return self.kernel.error

    def warnings(self, friction: float | None) -> tuple[str, ...]:
        mu = self.kernel.friction
        is_same = friction is not None and abs(friction - mu) <= SAME_FRICTION
        residual = self.kernel.of_residual()
        if self.kernel.has_both_ways or is_same:
            return residual
        return (
            *residual,
            f"The kernel was measured in one direction, as K_p + {mu:.3g} K_q, but the inversion "
            "has another friction. Its bands therefore depend on the prior. Measure the kernel in "
            f"both directions, or give friction={mu:.3g}.",
        )
