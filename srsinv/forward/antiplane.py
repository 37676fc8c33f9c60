"""Antiplane shear: traction along straight features, which displaces the skin along them only.

Rows are always (tau_xieta, tau_etaz): xi across the features, eta along them, z into the finger.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float


class Antiplane(eqx.Module):
    """Stress at `depth_m` in Pa per Pa of shear along the features; x [m] is the film's position
    across them from the middle of the load."""

    @abc.abstractmethod
    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "2 k"]:
        """Stress under unit traction exp(ikx)."""

    @abc.abstractmethod
    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        """Stress under unit uniform traction on |x'| < width_m/2."""

    @abc.abstractmethod
    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        """d/dx of [`strip_response`][], in 1/m."""


class AntiplaneHalfSpace(Antiplane):
    """Antiplane shear of a half space: (tau_xieta, tau_etaz) under shear q along the features.

    tau_xieta + i tau_etaz = -1/(pi (xi - i z)) under a line load, whatever the modulus (from the
    harmonic displacement with tau_etaz = -q on the surface).
    """

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "2 k"]:
        """Stress under unit traction exp(ikx)."""
        decay = jnp.exp(-jnp.abs(k) * depth_m)
        return jnp.stack([1j * jnp.sign(k) * decay, -decay + 0j])

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        """Stress under unit uniform traction on |x'| < width_m/2."""
        t1, t2 = (x + width_m / 2) / depth_m, (x - width_m / 2) / depth_m
        step = width_m / depth_m
        # ln((1 + t1^2)/(1 + t2^2)) with the larger over the smaller one, so that none cancels.
        rise = step * (t1 + t2)
        sign, near = jnp.where(rise >= 0, 1.0, -1.0), jnp.where(rise >= 0, t2, t1)
        log = sign * jnp.log1p(sign * rise / (1 + near**2))
        return -jnp.stack([log / 2, jnp.arctan2(step, 1 + t1 * t2)]) / jnp.pi

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        """d/dx of [`strip_response`][], in 1/m."""
        t1, t2 = (x + width_m / 2) / depth_m, (x - width_m / 2) / depth_m
        r1, r2 = 1 / (1 + t1**2), 1 / (1 + t2**2)
        s1, s2 = t1 * r1, t2 * r2
        # The differences of t/(1+t^2) and 1/(1+t^2), divided by t1 - t2.
        scale = -width_m / (jnp.pi * depth_m**2)
        return scale * jnp.stack([r1 * r2 - s1 * s2, -(s1 * r2 + r1 * s2)])
