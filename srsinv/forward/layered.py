"""Bonded elastic layers over a half space or a rigid core, in plane strain.

Below, u_x = i s U, w, tau_xz = i s T and sigma_z = S with s = sign(k), so that U, w, T, S are real,
and 1/|k| is the unit of length. C maps the tractions (T, S) of a face to its displacements (U, w):
it is carried from the bottom up, layer by layer, in a form that neither overflows for thick layers
nor cancels for thin ones (docs/physics.md, section 11).
"""

from collections.abc import Sequence
from math import factorial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Complex, Float

from ..errors import number, refuse
from ..grid import as_real
from .antiplane import Antiplane, AntiplaneHalfSpace
from .kernel_table import KAPPA, integral_over_x, kernel
from .skin import HalfSpace, Skin

SHORT = 0.5  # |k| h below which eta cosh(eta) - sinh(eta) is a series
THIN = 0.13  # exp(-|k| h) above which a layer counts as thin
LONGEST = 1e-30  # rad/m, for k = 0

Matrix = tuple[Float[Array, " k"], Float[Array, " k"], Float[Array, " k"], Float[Array, " k"]]

# Stress that is even in x, and has a real transfer; the others are odd, and imaginary.
EVEN = np.array([[True, False], [True, False], [False, True], [True, False]])
ACROSS = np.array([False, True])  # the same of tau_xieta and tau_etaz


class Layer(eqx.Module):
    """One homogeneous elastic layer.

    - `thickness_m`: None for a half space, which only the last layer can be.

    Raises `BadInput` for a thickness or a modulus that is not positive and for a ratio outside
    [0, 1/2].
    """

    thickness_m: Float[Array, ""] | None
    youngs_modulus_Pa: Float[Array, ""]
    poisson_ratio: Float[Array, ""]

    def __init__(self, thickness_m=None, youngs_modulus_Pa=7e5, poisson_ratio=0.5):
        if thickness_m is not None:
            wanted = "a positive thickness in metres, or null for a half space"
            number("skin.layers thickness_m", thickness_m, wanted, above=0)
        wanted = "a positive modulus in Pa"
        number("skin.layers youngs_modulus_Pa", youngs_modulus_Pa, wanted, above=0)
        wanted = "a number between 0 and 0.5"
        number("skin.layers poisson_ratio", poisson_ratio, wanted, least=0, most=0.5)
        self.thickness_m = None if thickness_m is None else as_real(thickness_m)
        self.youngs_modulus_Pa = as_real(youngs_modulus_Pa)
        self.poisson_ratio = as_real(poisson_ratio)


class Layered(Skin):
    """Layers from the surface down, each bonded to the next one.

    The last is a half space where it has no thickness; else it is bonded to a rigid core. A film
    that lies on an interface belongs to the layer above. Differentiable in the depth and in every
    number of the layers; a traced depth below the core's face counts as at that face.

    Raises `BadInput` when there is no layer, and for a layer without thickness above another one.
    """

    layers: tuple[Layer, ...]

    def __init__(self, layers: Sequence[Layer]):
        refuse(not layers, "The skin has 0 layers: give at least 1 in skin.layers.")
        for at, layer in enumerate(layers[:-1], 1):
            refuse(
                layer.thickness_m is None,
                f"Layer {at} of {len(layers)} in skin.layers has no thickness_m: give one in "
                "metres, as only the last layer can be a half space.",
            )
        self.layers = tuple(layers)

    @property
    def words(self) -> str:
        def one(layer: Layer) -> str:
            thick = layer.thickness_m
            kind = "a half space" if thick is None else f"{float(thick) * 1e3:.4g} mm"
            return (
                f"{kind} of {float(layer.youngs_modulus_Pa):.4g} Pa "
                f"(Poisson's ratio {float(layer.poisson_ratio):.4g})"
            )

        base = [] if self._endless else ["a rigid core"]
        return " on ".join([one(layer) for layer in self.layers] + base)

    def check_depth(self, depth_m) -> None:
        """Raise `BadInput` for a film inside the rigid core, unless values are traced."""
        thickness = [layer.thickness_m for layer in self.layers]
        if self._endless or any(isinstance(value, Tracer) for value in [depth_m, *thickness]):
            return
        total, depth = float(np.sum([np.asarray(h) for h in thickness])), float(depth_m)
        refuse(
            depth > total * (1 + 1e-6),
            f"The film's depth_m is {depth:.6g} and the rigid core begins at {total:.6g} m: give "
            "a smaller depth, or thicker skin.layers.",
        )

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        """Stress [Pa/Pa] at `depth_m` per unit traction exp(ikx).

        At k = 0 the limit, with nothing where the transfer is odd: sigma_x from q on a half space
        jumps there.
        """
        self.check_depth(depth_m)
        return self._transfer(k, as_real(depth_m))

    def surface_displacement(self, k: Float[Array, " k"]) -> Complex[Array, "2 2 k"]:
        """Displacement of the surface (u along x, w into the finger) per unit traction exp(ikx)
        [m/Pa], for k of either sign but not 0."""
        return self._displacement(k)

    def compliance(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        return self._displacement(k)[1, 0].real

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """Stress [Pa/Pa] at (x, depth_m) under unit uniform traction on |x'| < width_m/2: that of
        a half space in closed form, and what the layers add to it."""
        self.check_depth(depth_m)
        return self._strip(x, as_real(depth_m), as_real(width_m))

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        self.check_depth(depth_m)
        return self._slope(x, as_real(depth_m), as_real(width_m))

    @property
    def _endless(self) -> bool:
        return self.layers[-1].thickness_m is None

    @eqx.filter_jit
    def _transfer(self, k, depth_m) -> Array:
        parts = _Parts(self.layers, depth_m)
        _, moved, down = parts.up(_never_zero(k))
        nu, softness = parts.film_of(parts.poisson_ratio), parts.film_of(parts.softness)
        shear_t, shear_s, normal_t, normal_s = down
        stretch_t, stretch_s, _, _ = moved

        def rows(stretch, shear, normal):
            along = (nu * normal - 2 * stretch / softness) / (1 - nu)
            return jnp.stack([along, normal, shear, nu * (along + normal)])

        # (T, S) is (0, -1) for p = 1 and (i s, 0) for q = 1, and tau_xz is i s T.
        from_p = -rows(stretch_s, shear_s, normal_s)
        from_q = rows(stretch_t, -shear_t, normal_t)
        real = jnp.stack([from_p, from_q], axis=1)
        return jnp.where(EVEN[..., None], real + 0j, 1j * jnp.sign(k)[None, None] * real)

    @eqx.filter_jit
    def _displacement(self, k) -> Array:
        wavenumber, parts = _never_zero(k), _Parts(self.layers, as_real(0.0))
        surface, _, _ = parts.up(wavenumber)
        u_t, u_s, w_t, w_s = _scaled(1 / (parts.unit_Pa * wavenumber), surface)
        odd = 1j * jnp.sign(k)
        return jnp.stack([jnp.stack([-odd * u_s, -u_t + 0j]), jnp.stack([-w_s + 0j, odd * w_t])])

    @property
    def antiplane(self) -> "AntiplaneLayers":
        return AntiplaneLayers(self.layers)

    @eqx.filter_jit
    def _strip(self, x, depth_m, width_m) -> Array:
        half, transfer = self._added(depth_m)
        step = ends(integral_over_x(transfer, EVEN), x, depth_m, width_m)
        return half.strip_response(x, depth_m, width_m) + step

    @eqx.filter_jit
    def _slope(self, x, depth_m, width_m) -> Array:
        half, transfer = self._added(depth_m)
        step = ends(kernel(transfer, EVEN), x, depth_m, width_m)
        return half.strip_slope(x, depth_m, width_m) + step / depth_m

    def _added(self, depth_m):
        """A half space of the material around the film, and what the layers add to its transfer at
        |k| depth = `KAPPA`."""
        parts = _Parts(self.layers, depth_m)
        nu: Any = parts.film_of(parts.poisson_ratio)
        half = HalfSpace(nu)
        k = as_real(KAPPA) / depth_m
        return half, self._transfer(k, depth_m) - half.transfer(k, depth_m)


class AntiplaneLayers(Antiplane):
    """Shear along features on the same layers: tau = G dv/dz with v'' = k^2 v in each.

    D = v/tau, in the unit of C, is carried from the bottom up as C is; it is never positive, so
    that nothing cancels.
    """

    layers: tuple[Layer, ...]

    @eqx.filter_jit
    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "2 k"]:
        parts = _Parts(self.layers, depth_m)
        film, down = parts.up_across(_never_zero(k))
        along = film * down / parts.film_of(parts.softness)
        return jnp.stack([-1j * jnp.sign(k) * along, -down + 0j])

    @eqx.filter_jit
    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        step = ends(integral_over_x(self._added(depth_m), ACROSS), x, depth_m, width_m)
        return AntiplaneHalfSpace().strip_response(x, depth_m, width_m) + step

    @eqx.filter_jit
    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        step = ends(kernel(self._added(depth_m), ACROSS), x, depth_m, width_m)
        return AntiplaneHalfSpace().strip_slope(x, depth_m, width_m) + step / depth_m

    def _added(self, depth_m):
        k = as_real(KAPPA) / depth_m
        return self.transfer(k, depth_m) - AntiplaneHalfSpace().transfer(k, depth_m)


def ends(primitive, x, depth_m, width_m):
    """What `primitive` rises by from one end of a strip to the other."""
    return primitive((x + width_m / 2) / depth_m) - primitive((x - width_m / 2) / depth_m)


class _Parts(eqx.Module):
    """Every layer cut at the film's depth into a part above it and one below, either of which may
    be nothing, so that the film may lie in any layer while it is traced. From the bottom up.

    Displacements are in units of traction/(unit_Pa |k|); `softness` is unit_Pa over the shear
    modulus. The film lies on top of the one part where `at_film` holds.
    """

    poisson_ratio: Float[Array, " n"]
    softness: Float[Array, " n"]
    thickness_m: Float[Array, " n"]
    at_film: Bool[Array, " n"]
    unit_Pa: Float[Array, ""]
    endless: bool = eqx.field(static=True)

    def __init__(self, layers: Sequence[Layer], depth_m: Float[Array, ""]):
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
        """What the film's layer has of `values`."""
        return jnp.sum(jnp.where(self.at_film, values, 0.0))

    def up(self, wavenumber: Float[Array, " k"]) -> tuple[Matrix, Matrix, Matrix]:
        """C at the surface, and the film's displacements (U, w) and tractions (T, S) under those on
        the surface, for wavenumbers > 0."""

        def part(carry, one):
            compliance, moved, down = carry
            nu, softness, waves, at_film, film_below = one
            compliance, across, onto = _through(compliance, nu, softness, waves)
            moved = _either(film_below, across, _times(moved, onto))
            moved = _either(at_film, compliance, moved)
            return (compliance, moved, _either(at_film, same, _times(down, onto))), None

        zero = jnp.zeros_like(wavenumber)
        same = zero + 1, zero, zero, zero + 1
        rigid = zero, zero, zero, zero
        nu, softness = self.poisson_ratio, self.softness
        base = _endless(nu[0], softness[0], zero) if self.endless else rigid
        # Outside the loop, which is then quick to compile.
        waves = _waves(self.thickness_m[:, None] * wavenumber[None])
        film_below = jnp.concatenate([np.array([False]), self.at_film[:-1]])
        each = nu, softness, waves, self.at_film, film_below
        return jax.lax.scan(part, (base, rigid, same), each)[0]

    def up_across(
        self, wavenumber: Float[Array, " k"]
    ) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
        """D at the film, and tau there over that on the surface, for wavenumbers > 0."""

        def part(carry, one):
            yields, film, down = carry
            softness, waves, at_film = one
            onto = 1 / (waves.cosh - waves.sinh * yields / softness)
            yields = (waves.cosh * yields - waves.sinh * softness) * onto
            film = jnp.where(at_film, yields, film)
            return (yields, film, jnp.where(at_film, 1.0, down * waves.decay * onto)), None

        zero = jnp.zeros_like(wavenumber)
        base = zero - self.softness[0] if self.endless else zero
        waves = _waves(self.thickness_m[:, None] * wavenumber[None])
        each = self.softness, waves, self.at_film
        _, film, down = jax.lax.scan(part, (base, zero, zero + 1), each)[0]
        return film, down


def _from_below(above, below):
    return jnp.stack([above, below], axis=1).ravel()[::-1]


class _Waves(NamedTuple):
    """Of parts of thickness eta/|k|, all times exp(-eta): cosh(eta), sinh(eta), eta sinh(eta) and
    eta cosh(eta) - sinh(eta); exp(-eta), and whether what lies below shows less than round-off, at
    any ratio of moduli."""

    cosh: Float[Array, "*shape"]
    sinh: Float[Array, "*shape"]
    slope: Float[Array, "*shape"]
    excess: Float[Array, "*shape"]
    decay: Float[Array, "*shape"]
    hides: Bool[Array, "*shape"]


def _waves(eta: Float[Array, "n k"]) -> _Waves:
    precision = jnp.finfo(eta.dtype)
    # Beyond, nothing passes: only the powers of eta have to stay finite.
    within = jnp.minimum(eta, -jnp.log(precision.tiny))
    sinh = -jnp.expm1(-2 * within) / 2
    cosh = 1 - sinh
    short = jnp.minimum(within, SHORT)
    series = sum(short ** (2 * n + 1) * (2 * n / factorial(2 * n + 1)) for n in range(1, 9))
    excess = jnp.where(within < SHORT, series * jnp.exp(-short), within * cosh - sinh)
    # A reflection is at most of the order of eta^2 exp(-2 eta).
    hides = eta > -0.75 * jnp.log(precision.eps)
    return _Waves(cosh, sinh, within * sinh, excess, jnp.exp(-eta), hides)


def _through(compliance: Matrix, nu, softness, waves: _Waves) -> tuple[Matrix, Matrix, Matrix]:
    """C on top of a part from that at its bottom; (U, w) and (T, S) at its bottom under (T, S) on
    its top.

    From exp(-M eta), which solves d(U, w, T, S)/d eta = M (U, w, T, S), as (M^2 - 1)^2 = 0.
    """
    a = 1 / (2 * (1 - nu))
    cosh, sinh, e, f = waves.cosh, waves.sinh, a * waves.slope / 2, a * waves.excess / 2
    uu = cosh + 2 * e, sinh + 2 * f, (1 - 2 * a) * sinh - 2 * f, cosh - 2 * e
    ut = _scaled(softness, (-sinh - f, -e, e, (nu - 0.5) / (1 - nu) * sinh + f))
    tu = _scaled(4 / softness, (-a * sinh - f, -e, e, f))
    tt = cosh + 2 * e, (2 * a - 1) * sinh + 2 * f, -sinh - 2 * f, cosh - 2 * e
    # (T, S) at the top from that at the bottom. Where what lies below is softer than a thin part,
    # the large terms of its determinant cancel: there it is det(C) times that of tu + tt K, K the
    # inverse of C.
    to_top = _plus(_times(tu, compliance), tt)
    soft = abs(to_top[0] - tt[0]) + abs(to_top[3] - tt[3]) > tt[0] + tt[3]
    soft = soft & (waves.decay > THIN)
    one, zero = jnp.ones_like(cosh), jnp.zeros_like(cosh)
    given = _either(soft, compliance, (one, zero, zero, one))
    stiffness = _inverse(given)
    loaded = _either(soft, _plus(tu, _times(tt, stiffness)), to_top)
    moved = _either(soft, _plus(uu, _times(ut, stiffness)), _plus(_times(uu, compliance), ut))
    inverse = _inverse(loaded)
    on_top = _either(waves.hides, _endless(nu, softness, cosh), _times(moved, inverse))
    onto = _scaled(1 / (_determinant(loaded) * _determinant(given)), _adjugate(to_top))
    across = _either(soft, inverse, _times(compliance, onto))
    return on_top, _scaled(waves.decay, across), _scaled(waves.decay, onto)


def _endless(nu, softness, like: Float[Array, " k"]) -> Matrix:
    """C of a half space."""
    own = jnp.broadcast_to((nu - 1) * softness, like.shape)
    other = jnp.broadcast_to((nu - 0.5) * softness, like.shape)
    return own, other, other, own


# 2x2 matrices by rows, as four arrays over the wavenumbers.
def _times(a: Matrix, b: Matrix) -> Matrix:
    (a11, a12, a21, a22), (b11, b12, b21, b22) = a, b
    return (
        a11 * b11 + a12 * b21,
        a11 * b12 + a12 * b22,
        a21 * b11 + a22 * b21,
        a21 * b12 + a22 * b22,
    )


def _plus(a: Matrix, b: Matrix) -> Matrix:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


def _scaled(factor, a: Matrix) -> Matrix:
    return factor * a[0], factor * a[1], factor * a[2], factor * a[3]


def _either(first, a: Matrix, b: Matrix) -> Matrix:
    """a where `first` holds, else b."""
    return jax.tree.map(lambda one, other: jnp.where(first, one, other), a, b)


def _inverse(a: Matrix) -> Matrix:
    return _scaled(1 / _determinant(a), _adjugate(a))


def _determinant(a: Matrix):
    return a[0] * a[3] - a[1] * a[2]


def _adjugate(a: Matrix) -> Matrix:
    return a[3], -a[1], -a[2], a[0]


def _never_zero(k):
    """|k|, and at k = 0 so little that every transfer has its limit there."""
    zero = k == 0
    return jnp.where(zero, LONGEST, jnp.abs(jnp.where(zero, 1.0, k)))
