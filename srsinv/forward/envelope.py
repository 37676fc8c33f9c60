"""Envelopes: how hard each part of the finger presses on the surface, relative to its middle.

The infinite model lets the finger touch the whole surface. A finger at X that touches over a finite
zone presses the traction r(x), which is fixed to the surface, through an envelope w that travels
with it, w(0) = 1: the film's charge is the integral of K(X - x) w(x - X) r(x) dx
(docs/explanation/physics/patch.md). So an envelope multiplies the kernel. What acts in the finger's
frame (a strip's width, an element's offset) is in K, and comes before; what acts along the motion
comes after. Envelopes multiply each other.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..errors import all_of_kind, number, refuse
from ..grid import Scalar, as_real, spread_over
from ..known import is_traced
from .window_transform import PLAIN, SQUARE_ROOT, transform, weighted_nodes

Kernel = Callable[[Float[Array, " x"]], Float[Array, "*rows x"]]
Transfer = Callable[[Float[Array, " k"]], Complex[Array, "*rows k"]]
Response = Callable[[Float[Array, " x"], Any], Float[Array, "*rows x"]]

TRACED_TERMS = 1024  # of a zone whose length is not known: round-off up to 25 depths
CELL_NODES = 48  # of the integral over a cell: round-off for cells up to 5 depths
# Depths of a strip that stands for a line load, with two and three such strips: their mean, less
# the terms of second and fourth order in the width, is off by 1e-11.
NARROW = 0.02
EXTRAPOLATION = ((1, 1.5), (2, -0.6), (3, 0.1))


class Envelope(eqx.Module):
    """Base of envelopes w(xi), xi [m] from the finger's middle towards +x.

    `__call__`, `transfer` and `scaled` are to be defined.
    """

    @abc.abstractmethod
    def __call__(self, xi_m: Float[Array, " x"]) -> Float[Array, " x"]:
        """w, 1 in the middle of the contact zone."""

    @abc.abstractmethod
    def transfer(self, transfer: Transfer, kernel: Kernel) -> Transfer:
        """The Fourier transfer of the kernel times the envelope, from that of the kernel and from
        the kernel of a line load, which is x [m] before the film."""

    @abc.abstractmethod
    def scaled(self, factor: Scalar) -> "Envelope":
        """The envelope with every length times `factor`, as over features that cross x."""

    def kernel(self, kernel: Kernel) -> Kernel:
        """The kernel times the envelope."""
        return lambda x: times(self(-x), kernel(x))

    def at_depth(self, depth_m: Any) -> "Envelope":
        """The envelope with nodes enough for a film at this depth [m]."""
        del depth_m
        return self


def _half_width(value: Any) -> Float[Array, ""]:
    wanted = "a positive length in metres"
    return as_real(number("contact zone half_width_m", value, wanted, above=0))


class ContactPatch(Envelope):
    """Base of contact zones |xi| < `half_width_m` [m], outside of which nothing touches.

    `terms`: of the expansion of the kernel within; None: as many as rounding asks for at the
    sensor's depth. Raises `BadInput` for a half-width that is not positive.
    """

    half_width_m: Float[Array, ""] = eqx.field(converter=_half_width)
    terms: int | None = eqx.field(static=True, default=None)

    @abc.abstractmethod
    def _of_square(self, square: Float[Any, " x"]) -> Float[Any, " x"]:
        """w from 1 - s^2, s = xi/a, where that is positive."""

    @property
    @abc.abstractmethod
    def _power(self) -> float:
        """The weight of the expansion: `SQUARE_ROOT` or `PLAIN`."""

    def __call__(self, xi_m: Float[Array, " x"]) -> Float[Array, " x"]:
        square = 1 - (xi_m / self.half_width_m) ** 2
        inside = square > 0
        return jnp.where(inside, self._of_square(jnp.where(inside, square, 1.0)), 0.0)

    def at_depth(self, depth_m: Any) -> "ContactPatch":
        """The zone with as many terms, 32, 64, ..., as rounding asks for: the kernel is analytic
        within a depth of the real axis, so that its expansion converges as exp(-n arcsinh(z/a)).
        Where jax traces a length: as it is, or with `TRACED_TERMS`."""
        if is_traced(self.half_width_m, depth_m):
            return self if self.terms else dataclasses.replace(self, terms=TRACED_TERMS)
        digits = np.log(1 / np.finfo(float).eps) + 4
        least = digits / np.arcsinh(float(depth_m) / float(self.half_width_m)) + 8
        return dataclasses.replace(self, terms=int(2 ** np.ceil(np.log2(max(least, 32)))))

    def transfer(self, transfer: Transfer, kernel: Kernel) -> Transfer:
        del transfer
        terms, power, half = self.terms or TRACED_TERMS, self._power, self.half_width_m
        nodes, weights = weighted_nodes(power, terms)
        # The weight is in the rule: what is left of the envelope is smooth.
        rest = self._of_square(1 - nodes**2) if power == PLAIN else np.ones_like(nodes)
        values = times(half * as_real(weights * rest), kernel(half * as_real(nodes)))
        return lambda k: transform(power, nodes, values, k * half, terms)

    def scaled(self, factor: Scalar) -> "ContactPatch":
        return eqx.tree_at(lambda s: s.half_width_m, self, factor * self.half_width_m)


class HertzPatch(ContactPatch):
    """The contact zone of a solid finger: w = sqrt(1 - (xi/a)^2), as Hertz's pressure."""

    @classmethod
    def under_load(cls, radius_m: Any, load_N_per_m: Any, contact_modulus_Pa: Any) -> "HertzPatch":
        """The zone of a solid cylinder on a plate, a = sqrt(4 P R/(pi E*)) (Johnson 1985, 4.43).

        `radius_m` [m]: R; `load_N_per_m` [N/m]: P; `contact_modulus_Pa` [Pa]: E* = E/(1 - nu^2).
        """
        radius, load = _positive("radius_m", radius_m), _positive("load_N_per_m", load_N_per_m)
        modulus = _positive("contact_modulus_Pa", contact_modulus_Pa)
        return cls(np.sqrt(4 * load * radius / (np.pi * modulus)))

    def _of_square(self, square: Float[Any, " x"]) -> Float[Any, " x"]:
        return square**0.5

    @property
    def _power(self) -> float:
        return SQUARE_ROOT


class FoundationPatch(ContactPatch):
    """The contact zone of a finger of soft foam below a thin skin: w = 1 - (xi/a)^2, as on an
    elastic foundation."""

    @classmethod
    def under_load(
        cls, radius_m: Any, load_N_per_m: Any, foundation_Pa_per_m: Any
    ) -> "FoundationPatch":
        """The zone of a cylinder whose surface yields by the pressure over K, as springs side by
        side do, a = (3 P R/(2 K))^(1/3) (Johnson 1985, 4.59).

        `radius_m` [m]: R; `load_N_per_m` [N/m]: P; `foundation_Pa_per_m` [Pa/m]: K, the foam's
        modulus over its thickness.
        """
        radius, load = _positive("radius_m", radius_m), _positive("load_N_per_m", load_N_per_m)
        foundation = _positive("foundation_Pa_per_m", foundation_Pa_per_m)
        return cls(np.cbrt(3 * load * radius / (2 * foundation)))

    def _of_square(self, square: Float[Any, " x"]) -> Float[Any, " x"]:
        return square

    @property
    def _power(self) -> float:
        return PLAIN


def _positive(name: str, value: Any) -> float:
    return float(number(f"contact zone {name}", value, "a positive number in SI units", above=0))


class FingerprintRidges(Envelope):
    """Parallel ridges on the finger's skin, which press harder than the grooves between them:
    w = 1 + m cos(2 pi xi/pitch + phase) (the idea of Scheibert et al. 2009).

    - `modulation`: m, from 0 to 1; `pitch_m` [m]; `phase_rad` [rad]: 0 for a ridge in the middle.

    Raises `BadInput` for a modulation outside 0 to 1, and a pitch that is not positive.
    """

    modulation: Float[Array, ""]
    pitch_m: Float[Array, ""]
    phase_rad: Float[Array, ""]

    def __init__(self, modulation: Any, pitch_m: Any, phase_rad: Any = 0.0):
        name, wanted = "fingerprint modulation", "a number from 0 to 1"
        self.modulation = as_real(number(name, modulation, wanted, least=0, most=1))
        wanted = "a positive length in metres"
        self.pitch_m = as_real(number("fingerprint pitch_m", pitch_m, wanted, above=0))
        wanted = "an angle in radians"
        self.phase_rad = as_real(number("fingerprint phase_rad", phase_rad, wanted))

    def __call__(self, xi_m: Float[Array, " x"]) -> Float[Array, " x"]:
        turn = 2 * jnp.pi * xi_m / self.pitch_m + self.phase_rad
        return 1 + self.modulation * jnp.cos(turn)

    def transfer(self, transfer: Transfer, kernel: Kernel) -> Transfer:
        del kernel
        turn, k0 = jnp.exp(1j * self.phase_rad), 2 * jnp.pi / self.pitch_m

        def shifted(k):
            # At once, as the transfer of a zone takes longer to compile than to run.
            every = transfer(jnp.concatenate([k, k + k0, k - k0]))
            own, above, below = jnp.split(every, 3, axis=-1)
            return own + self.modulation / 2 * (turn * above + turn.conj() * below)

        return shifted

    def scaled(self, factor: Scalar) -> "FingerprintRidges":
        return eqx.tree_at(lambda s: s.pitch_m, self, factor * self.pitch_m)


def envelopes_of(given: Any, depth_m: Any) -> tuple[Envelope, ...]:
    """Envelopes of a film at `depth_m`, that of the contact zone first. Raises `BadInput` for
    another kind, and for two zones."""
    listed = all_of_kind("envelopes", given, Envelope, "envelopes, as [HertzPatch(5e-3)]")
    patches = [each for each in listed if isinstance(each, ContactPatch)]
    refuse(
        len(patches) > 1,
        f"The sensor has {len(patches)} contact zones: give one, the narrowest, in envelopes.",
    )
    # The expansion of a zone is that of the smooth kernel, which no ridges modulate yet.
    others = [each for each in listed if not isinstance(each, ContactPatch)]
    return tuple(each.at_depth(depth_m) for each in (*patches, *others))


def windowed(
    envelopes: Sequence[Envelope], transfer: Transfer, kernel: Kernel
) -> tuple[Transfer, Kernel]:
    """The Fourier transfer and the kernel, times every envelope."""
    for each in envelopes:
        transfer, kernel = each.transfer(transfer, kernel), each.kernel(kernel)
    return transfer, kernel


def line_load(response: Response, depth_m: Float[Array, ""]) -> Kernel:
    """The kernel of a line load at x, from the `response` (x, width) to a strip of unit traction;
    `depth_m` [m]: of the film."""

    def kernel(x):
        total = jnp.zeros(())
        for times, weight in EXTRAPOLATION:
            width = NARROW * times * depth_m
            total = total + weight / width * response(x, width)
        return total

    return kernel


def times(factor: Float[Array, " x"], rows: Float[Array, "*rows x"]) -> Float[Array, "*rows x"]:
    """Every row times the factor."""
    return jnp.broadcast_to(factor, rows.shape) * rows


def over_cell(envelopes: Sequence[Envelope], kernel: Kernel, cell_m: Float[Array, ""]) -> Kernel:
    """x -> the integral over a cell about 0 of the windowed `kernel` of what lies x away."""
    nodes, weights = np.polynomial.legendre.leggauss(CELL_NODES)
    patches = [each for each in envelopes if isinstance(each, ContactPatch)]
    if not patches:
        return spread_over(kernel, cell_m / 2 * as_real(nodes), cell_m / 2 * as_real(weights))
    half = patches[0].half_width_m

    def integral(x):
        # With y = a sin(angle) the square root at the zone's edge is smooth.
        first, last = (_angle((x + end * cell_m / 2) / half) for end in (-1, 1))
        middle, reach = (first + last) / 2, (last - first) / 2

        def add(total, node):
            at, weight = node
            angle = middle + at * reach
            each = kernel(half * jnp.sin(angle))
            return total + times(weight * half * reach * jnp.cos(angle), each), None

        start = jnp.zeros_like(kernel(x))
        return jax.lax.scan(add, start, (as_real(nodes), as_real(weights)))[0]

    return integral


def _angle(s: Float[Array, " x"]) -> Float[Array, " x"]:
    """arcsin, +-pi/2 beyond +-1."""
    inside = jnp.abs(s) < 1
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, s, 0.0)), jnp.sign(s) * jnp.pi / 2)
