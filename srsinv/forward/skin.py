"""Subsurface stress of a skin in plane strain under traction on its surface.

Frame and signs as in docs/explanation/physics/signs.md: x along the sliding direction, z into the
finger, tension positive, p > 0 pushes into the finger, q > 0 acts along +x on the finger. Rows are
always (sigma_x, sigma_z, tau_xz, sigma_y), columns the traction components (p, q).
"""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact

from ..compiled import compiled
from ..errors import number
from ..grid import Scalar, as_real
from ..quantities import quantity
from .antiplane import Antiplane, AntiplaneHalfSpace

STRESSES = ("sigma_x", "sigma_z", "tau_xz", "sigma_y")


class Skin(eqx.Module):
    """Base of skins: subsurface stress at the film, and compliance of the surface.

    Stress is that at `depth_m` in Pa per Pa of traction (p, q); x [m] is the film's position from
    the middle of the load.
    """

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """Description of the skin, for the page."""

    @property
    def half_space(self) -> "HalfSpace | None":
        """The one elastic half space that it is, in place of which effects may put another skin;
        None for any other skin."""
        return None

    @property
    def relaxes(self) -> bool:
        """Whether its modulus depends on the sliding speed."""
        return False

    @property
    def surface_modulus_Pa(self) -> float | None:
        """Young's modulus [Pa] at the surface, the largest that it has; None where it has none."""
        return None

    def sliding_at(self, speed_m_per_s: Scalar) -> "Skin":
        """The skin as the finger slides at this speed."""
        del speed_m_per_s
        return self

    def transfer_once(self, k: np.ndarray, depth_m: float) -> Complex[np.ndarray, "4 2 k"]:
        """[`transfer`][] for use outside a compiled program."""
        return np.asarray(_transfer(self, as_real(k), as_real(depth_m)))

    def compliance_once(self, k: np.ndarray) -> Inexact[np.ndarray, " k"]:
        """[`compliance`][] for use outside a compiled program."""
        return np.asarray(self.compliance(as_real(k)))

    @abc.abstractmethod
    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        """Stress under unit traction exp(ikx), k [rad/m] of either sign or 0."""

    @abc.abstractmethod
    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """Stress under unit uniform traction on |x'| < width_m/2."""

    @abc.abstractmethod
    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """d/dx of [`strip_response`][], in 1/m."""

    def series_radius_m(self, depth_m: Float[Array, ""], width_m: Float[Array, ""]) -> Scalar:
        """Distance |x| [m] beyond which [`strip_response`][] is a power series in 1/x, infinite
        where none is known."""
        del depth_m, width_m
        return np.inf

    @abc.abstractmethod
    def compliance(self, k: Float[Array, " k"]) -> Inexact[Array, " k"]:
        """The surface's displacement into the finger per unit pressure exp(ikx) [m/Pa], k > 0.

        Complex where the displacement lags behind a moving load.
        """

    @property
    @abc.abstractmethod
    def antiplane(self) -> Antiplane:
        """The stress under shear along features that cross the sliding direction."""


@compiled
def _transfer(skin: Skin, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Array:
    return skin.transfer(k, depth_m)


class HalfSpace(Skin):
    """A homogeneous elastic half space, in plane strain (Johnson 1985, 2.5).

    - `poisson_ratio`: nu in sigma_y = nu (sigma_x + sigma_z); Howe 1993, (4), has nu = 1/2.
    - `youngs_modulus_Pa` [Pa]: sets the surface's compliance in contact. The stress under a given
      traction does not depend on it.

    Raises `BadInput` for a ratio outside [0, 1/2] and a modulus that is not positive.
    """

    poisson_ratio: Float[Array, ""]
    youngs_modulus_Pa: Float[Array, ""]

    def __init__(self, poisson_ratio=0.5, youngs_modulus_Pa=7e5):
        wanted = "a number between 0 and 0.5"
        self.poisson_ratio = as_real(
            number("skin.poisson_ratio", poisson_ratio, wanted, least=0, most=0.5)
        )
        wanted = "a positive modulus in Pa"
        self.youngs_modulus_Pa = as_real(
            number("skin.youngs_modulus_Pa", youngs_modulus_Pa, wanted, above=0)
        )

    @property
    def words(self) -> str:
        modulus, nu = float(self.youngs_modulus_Pa), float(self.poisson_ratio)
        return f"half space of {quantity(modulus, 'Pa')}, Poisson's ratio {nu:.4g}"

    @property
    def half_space(self) -> "HalfSpace | None":
        return self

    @property
    def surface_modulus_Pa(self) -> float | None:
        return float(self.youngs_modulus_Pa)

    # In numpy: what runs once takes longer to compile. A skin derived from this one may have a
    # response of its own.

    def transfer_once(self, k: np.ndarray, depth_m: float) -> Complex[np.ndarray, "4 2 k"]:
        if type(self).transfer is not HalfSpace.transfer:
            return super().transfer_once(k, depth_m)
        return half_space_stress(np, k, depth_m, np.asarray(self.poisson_ratio))

    def compliance_once(self, k: np.ndarray) -> Inexact[np.ndarray, " k"]:
        if type(self).compliance is not HalfSpace.compliance:
            return super().compliance_once(k)
        return 2 / (float(self.youngs_modulus_Pa) / (1 - float(self.poisson_ratio) ** 2) * k)

    @property
    def antiplane(self) -> AntiplaneHalfSpace:
        return AntiplaneHalfSpace()

    @property
    def contact_modulus_Pa(self) -> Scalar:
        """E* = E/(1 - nu^2)."""
        return self.youngs_modulus_Pa / (1 - self.poisson_ratio**2)

    def compliance(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        """The surface's displacement into the finger per unit pressure exp(ikx), 2/(E* |k|) [m/Pa],
        for k > 0 (docs/explanation/physics/contact.md)."""
        # One by one: the square of a stiff E* k, in the derivative, is beyond single precision.
        return 2 / self.contact_modulus_Pa / jnp.abs(k)

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        """Stress [Pa/Pa] at `depth_m` per unit traction exp(ikx)
        (docs/explanation/physics/stress.md)."""
        return half_space_stress(jnp, k, depth_m, self.poisson_ratio)

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """Stress [Pa/Pa] at (x, depth_m) under unit uniform traction on |x'| < width_m/2.

        The differences of the antiderivatives of c t^m are written so that the result is exact to
        round-off relative to its largest value (Johnson 1985, section 2.5).
        """
        t1, t2 = (x + width_m / 2) / depth_m, (x - width_m / 2) / depth_m
        step = width_m / depth_m
        r1, r2 = 1 / (1 + t1**2), 1 / (1 + t2**2)
        s1, s2 = t1 * r1, t2 * r2
        # Differences between t1 and t2 of arctan t, t/(1+t^2), 1/(1+t^2) and ln(1+t^2).
        arctan = jnp.arctan2(step, 1 + t1 * t2)
        fraction = step * (r1 * r2 - s1 * s2)
        reciprocal = -step * (s1 * r2 + r1 * s2)
        # The ratio 1 + t1^2 : 1 + t2^2 as the larger over the smaller one.
        rise = step * (t1 + t2)
        right = rise >= 0
        log = jnp.where(
            right,
            jnp.log1p(jnp.where(right, rise * r2, 0.0)),
            -jnp.log1p(jnp.where(right, 0.0, -rise * r1)),
        )
        return self._rows(
            -(arctan + fraction) / jnp.pi,
            reciprocal / jnp.pi,
            -(arctan - fraction) / jnp.pi,
            -(log + reciprocal) / jnp.pi,
        )

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """d/dx of [`strip_response`][], in 1/m: line loads at the strip's two ends."""
        t1, t2 = (x + width_m / 2) / depth_m, (x - width_m / 2) / depth_m
        r1, r2 = 1 / (1 + t1**2), 1 / (1 + t2**2)
        s1, s2 = t1 * r1, t2 * r2
        a1, a2 = t1 * s1, t2 * s2  # t^2/(1+t^2), bounded
        # (difference of t^m/(1+t^2)^2) / (t1 - t2), as polynomials of bounded terms.
        d0 = -(s1 * r2 + r1 * s2) * (r1 + r2)
        d1 = (r1 * r2) ** 2 - 2 * s1 * s2 * r1 * r2 - s1 * s2 * (a1 * r2 + s1 * s2 + r1 * a2)
        d2 = (s1 * r2 + r1 * s2) * (r1 * r2 - a1 * a2)
        d3 = r1 * r2 * (a1 * r2 + s1 * s2 + r1 * a2) + 2 * (s1 * s2) ** 2 - s1 * s2 * a1 * a2
        scale = -2 * width_m / (jnp.pi * depth_m**2)
        return scale * self._rows(d0, d1, d2, d3)

    def series_radius_m(self, depth_m: Float[Array, ""], width_m: Float[Array, ""]) -> Scalar:
        own = HalfSpace.strip_response, HalfSpace.strip_slope
        is_own = (type(self).strip_response, type(self).strip_slope) == own
        return depth_m + width_m / 2 if is_own else np.inf

    def _rows(self, b0, b1, b2, b3) -> Array:
        return _stress_rows(jnp, self.poisson_ratio, b0, b1, b2, b3)


def half_space_stress(xp, k, depth_m, poisson_ratio):
    """Stress (4, 2, k) under unit traction exp(ikx), by `xp`: jax.numpy, or numpy where a program
    would take longer to compile than to run."""
    kappa = xp.abs(k) * depth_m
    decay = xp.exp(-kappa)
    odd = 1j * xp.sign(k) * decay
    return _stress_rows(
        xp,
        poisson_ratio,
        -(1 + kappa) * decay + 0j,
        odd * kappa,
        -(1 - kappa) * decay + 0j,
        odd * (2 - kappa),
    )


def _stress_rows(xp, poisson_ratio, b0, b1, b2, b3):
    """The stress matrix (4, 2, ...) from the four functions c t^m of a line load.

    sigma_x = c (t^2, t^3), sigma_z = c (1, t), tau_xz = c (t, t^2), with t = x/z, and in plane
    strain sigma_y = nu (sigma_x + sigma_z); the paper's (4) for nu = 1/2.
    """
    across = poisson_ratio * xp.stack([b2 + b0, b3 + b1])
    in_plane = xp.stack([xp.stack([b2, b3]), xp.stack([b0, b1]), xp.stack([b1, b2])])
    return xp.concatenate([in_plane, across[None]])
