"""Exact draws of a normal distribution that is truncated to x >= 0: Pakman and Paninski (2014).

A trajectory of Hamilton's equations in the normal's own potential is a sinusoid, whose meeting with
each wall is known in closed form. There the velocity is reflected in the metric of the covariance.
"""

import numpy as np

QUARTER = np.pi / 2  # of a period, after which a trajectory has forgotten where it began


def truncated_draws(
    mean: np.ndarray, covariance: np.ndarray, start: np.ndarray, draws: int = 400, burn: int = 50,
    seed: int = 0,
) -> np.ndarray:  # fmt: skip
    """Draws (draw, n) of the normal with this mean (n,) and covariance (n, n) given x >= 0, from a
    `start` (n,) above zero; the first `burn` trajectories are left out."""
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    x, made = start.copy(), []
    for _ in range(burn + draws):
        x = _moved(x, root @ rng.normal(size=mean.size), mean, covariance)
        made.append(x)
    return np.array(made[burn:])


def _moved(x, velocity, mean, covariance) -> np.ndarray:
    """Where a trajectory is after a quarter of a period."""
    left, last = QUARTER, -1
    while True:
        along = x - mean
        size = np.hypot(velocity, along)
        meets = size > np.abs(mean)
        ratio = np.where(meets, -mean / np.where(meets, size, 1.0), 0.0)
        time = np.mod(np.arctan2(velocity, along) + np.arccos(ratio), 2 * np.pi)
        time = np.where(meets, time, np.inf)
        if last >= 0 and min(time[last], 2 * np.pi - time[last]) < 1e-9:
            time[last] = np.inf  # the wall that it has just left
        wall = int(np.argmin(time))
        step = min(time[wall], left)
        x = mean + along * np.cos(step) + velocity * np.sin(step)
        velocity = velocity * np.cos(step) - along * np.sin(step)
        if time[wall] >= left:
            return np.maximum(x, 0.0)
        left, last = left - step, wall
        x[wall] = 0.0
        velocity = velocity - 2 * velocity[wall] / covariance[wall, wall] * covariance[:, wall]
