"""How well film elements separate the stresses at their depth, and p from q on the skin."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..forward.sensor import Sensor


def stress_gains(sensor: Sensor, poisson_ratio: float) -> Float[np.ndarray, "2"]:
    """Charge per area and stress [C/N] of the combinations of sigma_x and sigma_z that the elements
    measure best and least, in plane strain with sigma_y = nu (sigma_x + sigma_z)."""
    films = sensor.elements
    area = films[0].width_m * films[0].length_m
    per_stress = np.stack([film.charge_per_stress() for film in films]) / float(area)
    in_plane = per_stress[:, :2] + poisson_ratio * per_stress[:, 3:]
    return np.linalg.svd(in_plane, compute_uv=False)


def condition(sensor: Sensor, k: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Condition number of the elements' charge per p and q at wavenumbers above 0 [rad/m]. What all
    entries have in common, as the decay over the depth, is not in it."""
    pair = np.moveaxis(np.asarray(sensor.charge().transfer(jnp.asarray(k))), -1, 0)
    return np.linalg.cond(pair)
