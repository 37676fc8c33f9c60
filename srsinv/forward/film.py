"""Piezoelectric film: stress to charge, and the effects of a strip's size and position.

Charge per electrode area D = d1 S11 + d2 Syy + d3 S33 [C/m^2], the paper's (1), S the stress in
film axes. An effect along the line (strip width, offset, averaging of samples) is a module of its
own: it multiplies the transfer, or spreads the exact kernel, and is absent where it is not named.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Shaped

from ..errors import BadInput, number, of_kind, refuse, whole
from ..grid import Scalar, as_real, sinc, spread_over
from ..known import is_traced

Kernel = Callable[[Float[Array, " x"]], Float[Array, "c x"]]
StressAt = Callable[[Float[Array, " x"]], Float[Array, "4 c x"]]

PANEL_DEPTHS = 20  # widest panel of a strip's mean
MOST_PANELS = 350
TRACED_NODES = 128  # of one panel: round-off for widths up to 14 depths
MOST_OFFSET_M = 1e3  # far beyond, positions beside an element have no digits left

ORIENTATIONS_RAD = {"1_to_x_3_to_z": 0.0, "1_to_z_3_to_x": np.pi / 2}


def _constant(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"sensor.piezo_constants_C_per_N.{name}", value, "a number in C/N"))


def _turn(value) -> Float[Array, ""] | None:
    """A turn [rad]; None for none, so that the model of a strip across x has no factor for it."""
    if value is None:
        return None
    turn = number("sensor turn_rad", value, "an angle in radians, from +x toward +y")
    return None if not is_traced(turn) and turn == 0 else as_real(turn)


def _length(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"sensor {name}", value, "a positive length in metres", above=0))


class LineEffect(eqx.Module):
    """Base of effects along a film's line: the same all along x, as a factor over wavenumbers k and
    as a change of the kernel over x.

    `transfer` and `spread` are to be defined. `averages_samples`: whether it is a mean over
    samples, which lie along a line at constant speed. `acts_on_signal`: whether it acts on the
    signal, along the motion, so that it comes after a finite contact zone; else it acts within the
    finger.
    """

    averages_samples: ClassVar[bool] = False
    acts_on_signal: ClassVar[bool] = False

    @abc.abstractmethod
    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, " k"] | Float[Array, " k"]:
        """The factor on the film's transfer."""

    @abc.abstractmethod
    def spread(self, kernel: Kernel) -> Kernel:
        """The film's kernel after the effect."""

    @property
    def farthest_shift_m(self) -> Scalar:
        """How far [m] it shifts a part of a kernel at most, infinite where that is not known."""
        return np.inf

    def scaled(self, factor: Scalar) -> "LineEffect":
        """The effect with every length times `factor`, as over features that cross x obliquely.

        Raises `BadInput` unless a class defines it.
        """
        del factor
        raise BadInput(
            f"{type(self).__name__} does not support oblique_features: leave one of them "
            "out of effects."
        )

    def quadrature(self, nodes: int) -> tuple[Float[Array, " node"], Float[Array, " node"]]:
        """Shifts [m] and weights of the sum over shifted kernels that it is, of so many `nodes`
        where it is an integral.

        Raises `BadInput` unless a class defines it.
        """
        del nodes
        raise BadInput(
            f"{type(self).__name__} cannot be simulated on a circle: leave it out of effects."
        )


class StripAverage(LineEffect):
    """The strip's charge is the mean over its width: sin(kw/2)/(kw/2), zero at k = 2 pi n / w.

    On the open line by Gauss's rule of `nodes` nodes on each of `panels` equal panels; there it
    raises `BadInput` for a strip wider than about 7000 depths.
    """

    width_m: Float[Array, ""]
    nodes: int = eqx.field(static=True)
    panels: int = eqx.field(static=True)

    def __init__(self, width_m, nodes: int = 64, panels: int = 1):
        self.width_m, self.nodes, self.panels = as_real(width_m), nodes, panels

    @classmethod
    def at_depth(cls, width_m: Any, depth_m: Any) -> "StripAverage":
        """The average with nodes enough for round-off at this depth: 8, 16, ... 256, so that a
        change of the numbers seldom needs another program. Where jax traces one of them there are
        `TRACED_NODES`."""
        if is_traced(width_m, depth_m):
            return cls(width_m, TRACED_NODES)
        width_m, depth_m = float(width_m), float(depth_m)
        # The kernel is analytic within a depth of the real axis, so that Gauss's rule converges as
        # r^(-2 nodes), r the sum of the half axes of the ellipse up to there.
        panels = max(1, int(np.ceil(width_m / (PANEL_DEPTHS * depth_m))))
        ratio = 2 * depth_m / (width_m / panels)
        nodes = np.log(1 / np.finfo(float).eps) / (2 * np.arcsinh(ratio))
        # One panel has 8, 16, ... nodes, at most 256 as it is PANEL_DEPTHS long.
        return cls(width_m, int(2 ** np.ceil(np.log2(max(nodes + 2, 8)))), panels)

    def transfer(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        return sinc(k * self.width_m / 2)

    def spread(self, kernel: Kernel) -> Kernel:
        refuse(
            self.panels > MOST_PANELS,
            f"A strip or a cell is wider than {(self.panels - 1) * PANEL_DEPTHS:g} film "
            f"depths, where an open line takes {MOST_PANELS * PANEL_DEPTHS}: give a "
            "smaller width, a deeper film or grid.line=periodic.",
        )
        # 64 nodes are enough for a width of up to ten depths.
        nodes, weights = np.polynomial.legendre.leggauss(self.nodes)
        middle = 2 * np.arange(self.panels)[:, None] + 1 - self.panels
        places = ((middle + nodes) / self.panels).ravel()
        weights = np.tile(weights, self.panels) / (2 * self.panels)
        return spread_over(kernel, self.width_m / 2 * places, weights)

    @property
    def farthest_shift_m(self) -> Scalar:
        return self.width_m / 2

    def scaled(self, factor: Scalar) -> "StripAverage":
        return dataclasses.replace(self, width_m=factor * self.width_m)

    def quadrature(self, nodes: int) -> tuple[Float[Array, " node"], Float[Array, " node"]]:
        at, weights = np.polynomial.legendre.leggauss(nodes)
        return self.width_m / 2 * as_real(at), as_real(weights / 2)


class CellAverage(StripAverage):
    """The mean over the cell of a line that samples are recorded in."""

    acts_on_signal = True


class Offset(LineEffect):
    """The element sits at x(t) + offset_m."""

    offset_m: Float[Array, ""]

    def __init__(self, offset_m):
        self.offset_m = as_real(offset_m)

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, " k"]:
        return jnp.exp(1j * k * self.offset_m)

    def spread(self, kernel: Kernel) -> Kernel:
        return lambda x: kernel(x + self.offset_m)

    @property
    def farthest_shift_m(self) -> Scalar:
        return jnp.abs(self.offset_m)

    def scaled(self, factor: Scalar) -> "Offset":
        return Offset(factor * self.offset_m)

    def quadrature(self, nodes: int) -> tuple[Float[Array, " node"], Float[Array, " node"]]:
        del nodes
        return self.offset_m[None], jnp.ones(1)


class SampleAverage(LineEffect):
    """Each sample is the mean of `count` neighbours `spacing_m` apart, about their middle."""

    averages_samples = True
    acts_on_signal = True
    spacing_m: Float[Array, ""]
    count: int = eqx.field(static=True)

    def __init__(self, count: int, spacing_m):
        self.count, self.spacing_m = count, as_real(spacing_m)

    @property
    def _shifts(self) -> Float[Array, " count"]:
        return self.spacing_m * (np.arange(self.count) - (self.count - 1) / 2)

    def transfer(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        return jnp.mean(jnp.cos(k[:, None] * self._shifts[None]), axis=-1)

    def spread(self, kernel: Kernel) -> Kernel:
        return spread_over(kernel, self._shifts, np.full(self.count, 1 / self.count))

    @property
    def farthest_shift_m(self) -> Scalar:
        return self.spacing_m * (self.count - 1) / 2

    def scaled(self, factor: Scalar) -> "SampleAverage":
        return SampleAverage(self.count, factor * self.spacing_m)


class Piezo(eqx.Module):
    """Piezoelectric constants [C/N]: axis 1 drawn, 2 across, 3 through the thickness.

    The defaults are uniaxial PVDF (manufacturer's values). Raises `BadInput` for values that are
    not numbers.
    """

    d1: Float[Array, ""]
    d2: Float[Array, ""]
    d3: Float[Array, ""]

    def __init__(self, d1=23e-12, d2=3e-12, d3=-33e-12):
        self.d1, self.d2, self.d3 = _constant("d1", d1), _constant("d2", d2), _constant("d3", d3)


class Film(eqx.Module):
    """One element of piezoelectric film.

    - `depth_m` [m]: below the skin's surface; `angle_rad` [rad]: axis 1 turned from +x toward +z.
    - `width_m` [m] times `length_m` [m]: electrode area of one strip; `strips`: how many are
      laminated (their charges add).
    - `offset_m` [m]: of the element from the sensor's origin along x; its signal at the time t is
      that of the place x(t) + offset_m. `offset_y_m` [m]: along y, which matters for features that
      cross x obliquely.
    - `turn_rad` [rad]: turn of the strip about z, from +x toward +y. At 0, which is kept as None,
      its width is along x and its length along y.
    - `piezo`: piezoelectric constants, those of PVDF by default.
    - `effects`: effects along the line; empty for an ideal thin strip, whose width is a part of the
      area alone. [`with_strip_average`][] adds the mean over the width.
    - `is_at_origin`: whether the model leaves `offset_m` out.
    - `is_backward`: whether it stands for the element as it slides towards -x, where friction, and
      with it q, is turned.

    Raises `BadInput` for a depth, width, length or number of strips that is not positive, or an
    offset of kilometres.
    """

    depth_m: Float[Array, ""]
    angle_rad: Float[Array, ""]
    width_m: Float[Array, ""]
    length_m: Float[Array, ""]
    piezo: Piezo
    effects: tuple[LineEffect, ...]
    strips: int = eqx.field(static=True)
    offset_m: Float[Array, ""]
    is_backward: bool = eqx.field(static=True)
    is_at_origin: bool = eqx.field(static=True)
    turn_rad: Float[Array, ""] | None
    offset_y_m: Float[Array, ""]

    def __init__(
        self,
        depth_m=0.75e-3,
        angle_rad=0.0,
        width_m=0.7e-3,
        length_m=8e-3,
        piezo: Piezo | None = None,
        effects: Sequence[LineEffect] = (),
        strips: Any = 1,
        offset_m=0.0,
        is_backward: bool = False,
        is_at_origin: bool = False,
        turn_rad=0.0,
        offset_y_m=0.0,
    ):
        self.depth_m = _length("depth_m", depth_m)
        self.width_m = _length("strip_width_m", width_m)
        self.length_m = _length("active_length_m", length_m)
        self.angle_rad = as_real(number("sensor angle_rad", angle_rad, "an angle in radians"))
        wanted = f"a length in metres, from {-MOST_OFFSET_M:g} to {MOST_OFFSET_M:g}"
        within = {"least": -MOST_OFFSET_M, "most": MOST_OFFSET_M}
        self.offset_m = as_real(number("sensor offset_m", offset_m, wanted, **within))
        self.offset_y_m = as_real(number("sensor offset_y_m", offset_y_m, wanted, **within))
        self.turn_rad = _turn(turn_rad)
        wanted = "a whole number from 1"
        self.strips = whole("sensor strips", strips, wanted, least=1)
        self.piezo = Piezo() if piezo is None else piezo
        self.effects, self.is_backward = tuple(effects), is_backward
        self.is_at_origin = is_at_origin

    def with_effect(self, effect: LineEffect) -> "Film":
        """The same film with one more effect along the line."""
        of_kind("effect", effect, LineEffect, "an effect along the line, as StripAverage(1e-3)")
        return dataclasses.replace(self, effects=(*self.effects, effect))

    def in_place(self) -> "Film":
        """The same film with its offset in the model."""
        return dataclasses.replace(self, is_at_origin=False)

    def at_origin(self) -> "Film":
        """The same film without its offset in the model."""
        return dataclasses.replace(self, is_at_origin=True)

    @property
    def signal_effects(self) -> tuple[LineEffect, ...]:
        """Its effects that act on the signal, along the motion."""
        return tuple(each for each in self.effects if each.acts_on_signal)

    def in_finger(self) -> "Film":
        """The same film without the effects that act on the signal."""
        within = tuple(each for each in self.effects if not each.acts_on_signal)
        return dataclasses.replace(self, effects=within)

    def with_strip_average(self) -> "Film":
        """The same film, whose charge is the mean over its width."""
        return self.with_effect(StripAverage.at_depth(self.width_m, self.depth_m))

    def backward(self) -> "Film":
        """The same film as it slides towards -x."""
        return dataclasses.replace(self, is_backward=True)

    def turned(self, response: Shaped[Array, "c x"]) -> Shaped[Array, "c x"]:
        """The responses (c, x) to p and q as they act while the film slides towards +x: of a
        backward film, the response to q with its sign changed."""
        return response * jnp.array([[1.0], [-1.0]]) if self.is_backward else response

    def charge_per_stress(self, xp: Any = jnp) -> Shaped[Any, "4"]:
        """Charge [C] per unit (sigma_x, sigma_z, tau_xz, sigma_y) [Pa], by `xp`: jax.numpy, or
        numpy.

        The film's axes turned by theta: S11 = sx c^2 + sz s^2 + 2 t s c, S33 with s and c
        exchanged and the shear's sign turned.
        """
        c, s = xp.cos(self.angle_rad), xp.sin(self.angle_rad)
        d1, d2, d3 = self.piezo.d1, self.piezo.d2, self.piezo.d3
        area = self.strips * self.width_m * self.length_m
        return area * xp.stack(
            [d1 * c**2 + d3 * s**2, d1 * s**2 + d3 * c**2, 2 * s * c * (d1 - d3), d2]
        )

    def charge_transfer(
        self, stress: Complex[Array, "4 c k"], k: Float[Array, " k"]
    ) -> Complex[Array, "c k"]:
        """Charge [C] per unit traction exp(ikx), from the `stress` of that traction at the film's
        depth."""
        charge = jnp.tensordot(self.charge_per_stress(), stress, 1)
        return self.turned(self.along_line(charge, k))

    def charge_response(
        self, stress: StressAt, x: Float[Array, " x"], width_m: Float[Array, ""], order: int
    ) -> Float[Array, "c x"]:
        """Charge [C] at x under a strip of unit traction, `width_m` wide; where `order` is 1 its
        slope [C/m].

        `stress`: the stress of that strip at the film's depth, or its slope.
        """
        del width_m, order  # which the stress is of
        weights = self.charge_per_stress()
        kernel = self.along_kernel(lambda x: jnp.tensordot(weights, stress(x), 1))
        return self.turned(kernel(x))

    def series_radius_m(self, of_stress_m: Scalar) -> Scalar:
        """Distance [m] from the load beyond which the charge is a power series in 1/x; infinite
        where it is not known.

        `of_stress_m` [m]: the same distance of the stress.
        """
        shifts = (effect.farthest_shift_m for effect in self.all_effects)
        is_own = type(self).charge_response is Film.charge_response
        return sum(shifts, start=of_stress_m) if is_own else np.inf

    @property
    def place(self) -> tuple[LineEffect, ...]:
        """The effect of its offset; none where the model leaves the offset out."""
        return () if self.is_at_origin else (Offset(self.offset_m),)

    @property
    def all_effects(self) -> tuple[LineEffect, ...]:
        """Its effects along the line, and that of its offset."""
        return (*self.effects, *self.place)

    def along_line(self, transfer: Complex[Array, "c k"], k) -> Complex[Array, "c k"]:
        """The transfer with every effect's factor."""
        for effect in self.all_effects:
            transfer = transfer * effect.transfer(k)[None]
        return transfer

    def along_kernel(self, kernel: Kernel) -> Kernel:
        """The kernel, spread by every effect."""
        for effect in self.all_effects:
            kernel = effect.spread(kernel)
        return kernel
