"""Traction on the skin: pressure profiles with exact cell averages, and local friction."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import number
from ..grid import Line, Scalar, as_real


def _positive(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"scene {name}", value, "a positive number, in SI units", above=0))


def _real(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"scene {name}", value, "a number, in SI units"))


class Pressure(eqx.Module):
    """Base of load profiles: a pressure p(x) [Pa], known by its antiderivative `primitive`."""

    @abc.abstractmethod
    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """integral of p from anywhere to x [N/m]."""

    def cell_average(self, line: Line) -> Float[Array, " n"]:
        """Mean of p over each cell of the line [Pa], exact."""
        half = line.cell_m / 2
        return (self.primitive(line.x + half) - self.primitive(line.x - half)) / line.cell_m

    def cell_values(self, line: Line) -> Float[Array, " n"]:
        """Values of the cells [Pa] whose signal is that of p, to higher order than its averages.

        A cell's signal is spread twice, by the averaging and by the cell: by a variance of
        cell^2/6, which half the second difference takes out again.
        """
        return _deconvolve(self.cell_average(line), 1 / 6)


def _deconvolve(values: Float[Array, " n"], variance: float) -> Float[Array, " n"]:
    """`values` less the spread of this variance, in cells^2."""
    padded = jnp.pad(values, 1, mode="edge")
    return values - variance / 2 * (padded[2:] - 2 * values + padded[:-2])


class Discontinuous(Pressure):
    """A profile of jumps, which would leave kinks in the signal as they cross from cell to cell.

    It is distributed over cells by the quadratic B-spline: the signal has a continuous derivative
    in every position and width, and the spline's variance, cell^2/4, is the same wherever a jump
    lies.
    """

    @abc.abstractmethod
    def bspline_average(
        self, x: Float[Array, " n"], cell_m: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """Mean of p about x with the quadratic B-spline of cells `cell_m` as the weight."""

    def cell_values(self, line: Line) -> Float[Array, " n"]:
        return _deconvolve(self.bspline_average(line.x, line.cell_m), 1 / 4 + 1 / 12)


def _bell(t: Float[Array, "..."]) -> Float[Array, "..."]:
    """The quadratic B-spline: twice differentiable pieces on |t| < 3/2, of area one."""
    size = jnp.abs(t)
    outer = jnp.maximum(1.5 - size, 0.0) ** 2 / 2
    return jnp.where(size < 0.5, 0.75 - size**2, outer)


def _rise(t: Float[Array, "..."]) -> Float[Array, "..."]:
    """Integral of `_bell` from -infinity: from 0 to 1."""
    size = jnp.minimum(jnp.abs(t), 1.5)
    half = jnp.where(size < 0.5, 0.75 * size - size**3 / 3, 0.5 - (1.5 - size) ** 3 / 6)
    return 0.5 + jnp.sign(t) * half


class PressedStrip(Pressure):
    """A strip pressed into the skin, its edges smoothed as tanh(x/edge_m).

    p = P/2 [tanh((x-x0+W/2)/e) - tanh((x-x0-W/2)/e)].
    """

    pressure_Pa: Float[Array, ""]
    width_m: Float[Array, ""]
    position_m: Float[Array, ""]
    edge_m: Float[Array, ""]

    def __init__(self, pressure_Pa, width_m, position_m, edge_m):
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.position_m = _real("position_m", position_m)
        self.width_m, self.edge_m = _positive("width_m", width_m), _positive("edge_m", edge_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        # log cosh a = logaddexp(a, -a) - log 2 does not overflow; the constant drops out.
        def log_cosh(a):
            return jnp.logaddexp(a, -a)

        rise = (x - self.position_m + self.width_m / 2) / self.edge_m
        fall = (x - self.position_m - self.width_m / 2) / self.edge_m
        return self.pressure_Pa * self.edge_m / 2 * (log_cosh(rise) - log_cosh(fall))


class UniformStrip(Discontinuous):
    """Uniform pressure on a strip, |x - `position_m`| < `width_m`/2.

    - `pressure_Pa` [Pa]; `width_m` [m], positive; `position_m` [m]: of the strip's middle.

    Raises `BadInput` for a width that is not positive.
    """

    pressure_Pa: Float[Array, ""]
    width_m: Float[Array, ""]
    position_m: Float[Array, ""]

    def __init__(self, pressure_Pa, width_m, position_m: Scalar = 0.0):
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.position_m = _real("position_m", position_m)
        self.width_m = _positive("width_m", width_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        half = self.width_m / 2
        return self.pressure_Pa * jnp.clip(x - self.position_m, -half, half)

    def bspline_average(
        self, x: Float[Array, " n"], cell_m: Float[Array, ""]
    ) -> Float[Array, " n"]:
        t, half = (x - self.position_m) / cell_m, self.width_m / 2 / cell_m
        return self.pressure_Pa * (_rise(t + half) - _rise(t - half))


class Hertz(Pressure):
    """A cylinder's contact: p = P sqrt(1 - (x-x0)^2/a^2) on |x - x0| < a."""

    pressure_Pa: Float[Array, ""]
    half_width_m: Float[Array, ""]
    position_m: Float[Array, ""]

    def __init__(self, pressure_Pa, half_width_m, position_m: Scalar = 0.0):
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.position_m = _real("position_m", position_m)
        self.half_width_m = _positive("half_width_m", half_width_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        s = (x - self.position_m) / self.half_width_m
        inside = jnp.abs(s) < 1
        s_in = jnp.where(inside, s, 0.0)  # keeps the square root's gradient finite outside
        area = (s_in * jnp.sqrt(1 - s_in**2) + jnp.arcsin(s_in)) / 2
        area = jnp.where(inside, area, jnp.sign(s) * jnp.pi / 4)
        return self.pressure_Pa * self.half_width_m * area


class Sinusoid(Pressure):
    """p = P cos(2 pi (x - x0)/L)."""

    pressure_Pa: Float[Array, ""]
    wavelength_m: Float[Array, ""]
    position_m: Float[Array, ""]

    def __init__(self, pressure_Pa, wavelength_m, position_m=0.0):
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.position_m = _real("position_m", position_m)
        self.wavelength_m = _positive("wavelength_m", wavelength_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        k = 2 * jnp.pi / self.wavelength_m
        return self.pressure_Pa / k * jnp.sin(k * (x - self.position_m))


class LineLoad(Discontinuous):
    """A load [N/m] on one line: p = F delta(x - x0)."""

    load_N_per_m: Float[Array, ""]
    position_m: Float[Array, ""]

    def __init__(self, load_N_per_m: Scalar, position_m: Scalar = 0.0):
        self.load_N_per_m = _real("load_N_per_m", load_N_per_m)
        self.position_m = _real("position_m", position_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.load_N_per_m * jnp.heaviside(x - self.position_m, 0.5)

    def bspline_average(
        self, x: Float[Array, " n"], cell_m: Float[Array, ""]
    ) -> Float[Array, " n"]:
        return self.load_N_per_m / cell_m * _bell((x - self.position_m) / cell_m)


class Step(Discontinuous):
    """More pressure from x0 on: p = P for x > x0."""

    pressure_Pa: Float[Array, ""]
    position_m: Float[Array, ""]

    def __init__(self, pressure_Pa: Scalar, position_m: Scalar = 0.0):
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.position_m = _real("position_m", position_m)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.pressure_Pa * jnp.maximum(x - self.position_m, 0.0)

    def bspline_average(
        self, x: Float[Array, " n"], cell_m: Float[Array, ""]
    ) -> Float[Array, " n"]:
        return self.pressure_Pa * _rise((x - self.position_m) / cell_m)


class Bars(Discontinuous):
    """A grating: bars of pressure P over the fraction `duty` of each pitch, less their mean.

    `phase_rad` is that of the first harmonic at x = 0: a bar is centred where 2 pi x/pitch equals
    it. The mean is left out, as a rate signal does not show it.
    """

    pressure_Pa: Float[Array, ""]
    pitch_m: Float[Array, ""]
    duty: Float[Array, ""]
    phase_rad: Float[Array, ""]

    def __init__(self, pressure_Pa, pitch_m, duty: Scalar = 0.5, phase_rad: Scalar = 0.0):
        wanted = "a number between 0 and 1, the bars' part of the pitch"
        self.duty = as_real(number("scene duty", duty, wanted, above=0, below=1))
        self.pressure_Pa = _real("pressure_Pa", pressure_Pa)
        self.pitch_m = _positive("pitch_m", pitch_m)
        self.phase_rad = _real("phase_rad", phase_rad)

    def primitive(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        turns = x / self.pitch_m - self.phase_rad / (2 * jnp.pi) + self.duty / 2
        within = turns - jnp.floor(turns)
        deviation = jnp.minimum(within, self.duty) - self.duty * within
        return self.pressure_Pa * self.pitch_m * deviation

    def bspline_average(
        self, x: Float[Array, " n"], cell_m: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """Mean for bars and gaps wider than three cells."""
        turns = x / self.pitch_m - self.phase_rad / (2 * jnp.pi)
        away = jnp.abs(turns - jnp.round(turns))  # from the nearest bar's middle, in pitches
        inside = (self.duty / 2 - away) * self.pitch_m / cell_m
        return self.pressure_Pa * (_rise(inside) - self.duty)


class FrictionStep(eqx.Module):
    """A step of friction along x: change/2 (1 + tanh((x - position_m)/edge_m)).

    - `change`: of mu; `position_m` [m]: of the step; `edge_m` [m]: over which it rises, positive.
    """

    change: Float[Array, ""]
    position_m: Float[Array, ""]
    edge_m: Float[Array, ""]

    def __init__(self, change, position_m, edge_m):
        self.change, self.position_m = _real("change", change), _real("position_m", position_m)
        self.edge_m = _positive("edge_m", edge_m)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        return self.change / 2 * (1 + jnp.tanh((x - self.position_m) / self.edge_m))
