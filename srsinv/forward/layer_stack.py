"""Bonded elastic layers in plane strain and in antiplane shear, wave by wave.

u_x = i s U, w, tau_xz = i s T and sigma_z = S with s = sign(k), so that U, w, T, S are real, and
1/|k| is the unit of length. The compliance K of a face, (U, w) = -K (T, S), goes up through a layer
by K <- (P11 K - P12) A^-1, A = P22 - P21 K, P the layer's transfer matrix. Products of such
matrices cancel in thick layers and in thin ones. Their 2x2 minors do not (Dunkin 1965): det A times
(1, K, det K) of the top is linear in (1, K, det K) of the bottom, with coefficients in closed form
that need no differences (docs/explanation/physics/layers.md).
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

SHORT = 1.0  # |k| h below which sinh(eta) - eta is a series

Matrix = tuple[Float[Array, " k"], Float[Array, " k"], Float[Array, " k"], Float[Array, " k"]]


class LayerStack(eqx.Module):
    """Every layer cut at the film's depth into a part above it and one below, either of which may
    be nothing, so that the film may lie in any layer while it is traced. From the bottom up.

    `layers` have `thickness_m` (None for a half space below), `youngs_modulus_Pa` and
    `poisson_ratio`. `softness` is unit_Pa over the shear modulus. The film lies on top of the one
    part where `at_film` holds.
    """

    poisson_ratio: Float[Array, " n"]
    softness: Float[Array, " n"]
    thickness_m: Float[Array, " n"]
    at_film: Bool[Array, " n"]
    unit_Pa: Float[Array, ""]
    endless: bool = eqx.field(static=True)

    def __init__(self, layers: Sequence, depth_m: Float[Array, ""]):
        self.endless = layers[-1].thickness_m is None
        self.unit_Pa = layers[0].youngs_modulus_Pa
        nothing = jnp.zeros_like(depth_m)
        thick = jnp.stack(
            [nothing if h is None else h for h in (one.thickness_m for one in layers)]
        )
        bottom = jnp.cumsum(thick)
        if not self.endless:
            depth_m = jnp.where(depth_m < bottom[-1], depth_m, bottom[-1])
        # An interface is met but for round-off.
        passed = depth_m > bottom[:-1] * (1 + 8 * jnp.finfo(bottom.dtype).eps)
        over = jnp.concatenate([passed, np.array([False])])
        holds = ~over & jnp.concatenate([np.array([True]), passed])
        top = bottom - thick
        above = jnp.where(over, thick, jnp.where(holds, depth_m - top, 0.0))
        below = jnp.where(over, 0.0, jnp.where(holds, bottom - depth_m, thick))
        if self.endless:
            below = below.at[-1].set(0.0)
        nu = jnp.stack([one.poisson_ratio for one in layers])
        modulus = jnp.stack([one.youngs_modulus_Pa for one in layers])
        self.poisson_ratio = _from_below(nu, nu)
        self.softness = 2 * (1 + self.poisson_ratio) * self.unit_Pa / _from_below(modulus, modulus)
        self.thickness_m = _from_below(above, below)
        self.at_film = _from_below(jnp.zeros_like(holds), holds)

    def film_of(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        """The element of `values` for the film's layer."""
        return jnp.sum(jnp.where(self.at_film, values, 0.0))

    @property
    def passed_on(self) -> Float[Array, ""]:
        """Approximate fraction of a half space's stress that the layers above the film transmit, 1
        in one material: the product of min(1, G below/G above) over their interfaces."""
        ratio = jnp.minimum(1.0, self.softness[1:] / self.softness[:-1])
        above = np.tri(self.at_film.size, k=-1, dtype=bool) & self.at_film[None]
        ratio = jnp.where(jnp.any(above, axis=1)[1:], ratio, 1.0)
        return jax.lax.stop_gradient(jnp.exp(jnp.sum(jnp.log(ratio))))

    def surface(self, wavenumber: Float[Array, " k"]) -> "Compliance":
        """K of the surface, for wavenumbers > 0, in units of 1/(G |k|), G of the first layer."""

        def part(below, one):
            nu, ratio, waves = one
            return _to_top(below.in_units(ratio), nu, waves)[0], None

        base, each = self._base(wavenumber), self._parts(wavenumber)
        return jax.lax.scan(part, base, each)[0]

    def at_the_film(self, wavenumber: Float[Array, " k"]) -> tuple[Matrix, Matrix]:
        """The film's displacements (U, w), in units of traction/(G |k|), G that of its layer, and
        its tractions (T, S), both under (T, S) on the surface, for wavenumbers > 0."""

        def part(carry, one):
            below, moved, down = carry
            each, at_film, film_below = one
            top, across, onto = _through(below, *each)
            moved = _either(film_below, across, _times(moved, onto))
            moved = _either(at_film, top.displacement, moved)
            return (top, moved, _either(at_film, same, _times(down, onto))), None

        zero = jnp.zeros_like(wavenumber)
        same, none = (zero + 1, zero, zero, zero + 1), (zero, zero, zero, zero)
        film_below = jnp.concatenate([np.array([False]), self.at_film[:-1]])
        each = self._parts(wavenumber), self.at_film, film_below
        return jax.lax.scan(part, (self._base(wavenumber), none, same), each)[0][1:]

    def _base(self, wavenumber) -> "Compliance":
        zero = jnp.zeros_like(wavenumber)
        if self.endless:
            return Compliance.of_half_space(self.poisson_ratio[0], zero)
        return Compliance(zero, zero, zero, zero)

    def _parts(self, wavenumber) -> tuple:
        """Per part: Poisson's ratio, softness below over its own, and its waves."""
        before = jnp.concatenate([self.softness[:1], self.softness[:-1]])
        return self.poisson_ratio, before / self.softness, self._waves(wavenumber)

    def antiplane(
        self, wavenumber: Float[Array, " k"]
    ) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
        """v/tau at the film, in units of 1/(unit_Pa |k|), and tau there over that on the surface,
        for wavenumbers > 0. v/tau is never positive, so that nothing cancels."""

        def part(carry, one):
            yields, film, down = carry
            softness, waves, at_film = one
            onto = 1 / (waves.cosh - waves.sinh * yields / softness)
            yields = (waves.cosh * yields - waves.sinh * softness) * onto
            film = jnp.where(at_film, yields, film)
            return (yields, film, jnp.where(at_film, 1.0, down * waves.decay * onto)), None

        zero = jnp.zeros_like(wavenumber)
        base = zero - self.softness[0] if self.endless else zero
        each = self.softness, self._waves(wavenumber), self.at_film
        _, film, down = jax.lax.scan(part, (base, zero, zero + 1), each)[0]
        return film, down

    def _waves(self, wavenumber) -> "_Waves":
        return _waves(self.thickness_m[:, None] * wavenumber[None])


def _from_below(above, below):
    return jnp.stack([above, below], axis=1).ravel()[::-1]


class Compliance(NamedTuple):
    """K = [[uu, uw], [uw, ww]] of a face, (U, w) = -K (T, S), and its determinant, which would
    cancel where a face yields far more to some tractions than to others."""

    uu: Float[Array, " k"]
    uw: Float[Array, " k"]
    ww: Float[Array, " k"]
    det: Float[Array, " k"]

    @classmethod
    def of_half_space(cls, nu, zero: Float[Array, " k"]) -> "Compliance":
        own = zero + (1 - nu)
        return cls(own, zero + (0.5 - nu), own, zero + (0.75 - nu))

    def in_units(self, ratio) -> "Compliance":
        """The compliance in a unit of softness that is smaller by `ratio`."""
        uu, uw, ww, det = self
        return Compliance(ratio * uu, ratio * uw, ratio * ww, ratio * (ratio * det))

    @property
    def displacement(self) -> Matrix:
        """(U, w) under (T, S)."""
        return -self.uu, -self.uw, -self.uw, -self.ww


class _Waves(NamedTuple):
    """Functions of parts of thickness eta/|k|, all times exp(-eta): cosh(eta), sinh(eta), eta,
    cosh(eta) - 1 and sinh(eta) - eta; and exp(-eta)."""

    cosh: Float[Array, "*shape"]
    sinh: Float[Array, "*shape"]
    eta: Float[Array, "*shape"]
    rise: Float[Array, "*shape"]
    excess: Float[Array, "*shape"]
    decay: Float[Array, "*shape"]


def _waves(eta: Float[Array, "n k"]) -> _Waves:
    decay = jnp.exp(-eta)
    sinh = -jnp.expm1(-2 * eta) / 2
    short = jnp.minimum(eta, SHORT)
    square, series = short * short, 1.0
    for n in range(8, 1, -1):
        series = 1 + square * series / (2 * n * (2 * n + 1))
    series = short * square * series / 6 * jnp.exp(-short)
    excess = jnp.where(eta < SHORT, series, sinh - eta * decay)
    return _Waves(1 - sinh, sinh, eta * decay, jnp.expm1(-eta) ** 2 / 2, excess, decay)


def _through(below: Compliance, nu, ratio, waves: _Waves) -> tuple[Compliance, Matrix, Matrix]:
    """K on top of a part from that of what lies below; (U, w) and (T, S) at its bottom under (T, S)
    on its top."""
    below = below.in_units(ratio)
    top, inverse = _to_top(below, nu, waves)
    across, onto = _to_bottom(below, nu, waves)
    return top, _scaled(-inverse, across), _scaled(inverse, onto)


def _constants(nu):
    """a, b = 1 - a and b - a without cancellation as nu comes to 1/2 and to 0."""
    twice = 2 * (1 - nu)
    return 1 / twice, (1 - 2 * nu) / twice, -2 * nu / twice


def _to_top(below: Compliance, nu, waves: _Waves) -> tuple[Compliance, Float[Array, " k"]]:
    """K on top of a part, and exp(2 eta)/det A."""
    (a, b, rest), (uu, uw, ww, det) = _constants(nu), below
    cosh, sinh, eta, rise, excess, decay = waves
    # From here all times exp(-2 eta): one is 1, h is eta, and what cancels has names of its own.
    one, h, hh = decay * decay, eta * decay, eta * eta
    cc, ss, cs = cosh * cosh, sinh * sinh, cosh * sinh
    cs_less_h, ss_less_hh = excess * cosh + eta * rise, excess * (sinh + eta)
    b_less, b_more = b * cs_less_h + rest * h, b * cs + a * h  # b cs -+ a h
    d_less, d_more = (1 + b) * cs_less_h + 2 * b * h, (1 + b) * cs + a * h  # (1 + b) cs -+ a h
    mixed, turned = b * ss + a * hh, (1 + b) * b * ss - a * a * hh
    det_moved = one + a * (1 + b) * ss + a * a * hh
    det_rigid = ((1 + b) ** 2 * ss_less_hh + 4 * b * hh) / 4
    onto_itself = one + 2 * (b * b * ss - a * a * hh)
    det_a = det_moved + 4 * a * a * ss_less_hh * det
    det_a = det_a + 2 * a * ((cs + h) * uu + cs_less_h * ww + 2 * mixed * uw)
    inverse = 1 / det_a
    top = Compliance(
        2 * a * cs_less_h * det + d_more / 2 + cc * uu + ss * ww + 2 * b_more * uw,
        2 * a * mixed * det + turned / 2 + b_less * uu + b_more * ww + onto_itself * uw,
        2 * a * (cs + h) * det + d_less / 2 + ss * uu + cc * ww + 2 * b_less * uw,
        det_moved * det + det_rigid + (d_less * uu + d_more * ww) / 2 + turned * uw,
    )
    return Compliance(*(inverse * one for one in top)), inverse


def _to_bottom(below: Compliance, nu, waves: _Waves) -> tuple[Matrix, Matrix]:
    """K adj(A) and adj(A), times exp(-2 eta)."""
    (a, b, rest), (uu, uw, ww, det) = _constants(nu), below
    cosh, sinh, eta, rise, excess, decay = waves
    c, s, hs, hc = cosh * decay, sinh * decay, eta * sinh, eta * cosh
    hc_less_s = eta * rise - excess * decay
    ahead, back = b * s + a * hc, rest * hc - b * hc_less_s  # b s +- a hc
    onto = (
        c - a * hs - 2 * a * (hs * uw + hc_less_s * ww),
        back - 2 * a * ((s + hc) * uw + hs * ww),
        ahead + 2 * a * (hs * uu + hc_less_s * uw),
        c + a * hs + 2 * a * ((s + hc) * uu + hs * uw),
    )
    across = (
        (c - a * hs) * uu + ahead * uw - 2 * a * hc_less_s * det,
        back * uu + (c + a * hs) * uw - 2 * a * hs * det,
        (c - a * hs) * uw + ahead * ww + 2 * a * hs * det,
        back * uw + (c + a * hs) * ww + 2 * a * (s + hc) * det,
    )
    return across, onto


# 2x2 matrices by rows, as four arrays over the wavenumbers.
def _times(a: Matrix, b: Matrix) -> Matrix:
    (a11, a12, a21, a22), (b11, b12, b21, b22) = a, b
    return (
        a11 * b11 + a12 * b21,
        a11 * b12 + a12 * b22,
        a21 * b11 + a22 * b21,
        a21 * b12 + a22 * b22,
    )


def _scaled(factor, a: Matrix) -> Matrix:
    return factor * a[0], factor * a[1], factor * a[2], factor * a[3]


def _either(first, a: Matrix, b: Matrix) -> Matrix:
    """a where `first` holds, else b."""
    return jax.tree.map(lambda one, other: jnp.where(first, one, other), a, b)
