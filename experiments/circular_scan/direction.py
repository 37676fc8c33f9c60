"""The Cramer-Rao bound of a ridge's direction on a circle."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from srsinv.compiled import compiled
from srsinv.forward.planar import ObliqueRidge, PathScan, RidgeLoad


@compiled
def angle_bounds_deg(
    circling: PathScan, ridge: ObliqueRidge, angles_rad: Float[Array, " angle"], snr_dB: float
) -> Float[Array, " angle"]:
    """The Cramer-Rao bound [deg] on the standard error of a ridge's angle, at each of
    `angles_rad`: all five parameters unknown, white noise `snr_dB` below the rms signal."""
    others = (ridge.load_N_per_m, ridge.friction * ridge.load_N_per_m, ridge.width_m)

    def signal(values):
        load, shear, width, distance, angle = values
        by_load, by_shear = circling.unit(angle, RidgeLoad(distance, width))
        return jnp.ravel(load * by_load + shear * by_shear)

    def bound(angle):
        truth = jnp.stack([*others, ridge.distance_m, angle])
        slopes = jax.jacfwd(signal)(truth)
        # Scaled: loads are in N/m, widths in metres.
        size = jnp.linalg.norm(slopes, axis=0)
        triangle = jnp.linalg.qr(slopes / size, mode="r")
        rms = jnp.sqrt(jnp.mean(signal(truth) ** 2)) * 10 ** (-snr_dB / 20)
        return jnp.rad2deg(rms / (jnp.abs(triangle[-1, -1]) * size[-1]))

    return jax.lax.map(bound, jnp.asarray(angles_rad))
