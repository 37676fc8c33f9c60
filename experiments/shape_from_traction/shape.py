"""Surface profile from the pressure: the inverse of the contact problem.

Where the skin touches, its displacement is the surface's height up to a constant, and at nu = 1/2
pressure alone displaces it, w(k) = compliance(k) p(k) (docs/explanation/physics/contact.md).
Between, w is the skin over the gap. The compliance falls as 1/|k|: errors of long waves grow most.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from srsinv.compiled import compiled
from srsinv.errors import BadInput
from srsinv.forward.contact import cell_compliance
from srsinv.forward.skin import Skin
from srsinv.grid import Line, Periodic
from srsinv.inverse.estimate import Estimate
from srsinv.inverse.solved_contact import SolvedContact, smoothed_truth


@compiled
def shape_under(
    line: Line, skin: Skin, pressure_Pa: Float[Array, "*rows n"]
) -> Float[Array, "*rows n"]:
    """The skin's displacement [m] at the cell centres, its mean zero, under cell averages of p.

    The inverse of [`press`][srsinv.forward.contact.press]: everything repeats with the window.
    """
    spectrum = cell_compliance(line, skin) * jnp.fft.rfft(pressure_Pa)
    return jnp.fft.irfft(spectrum, line.n)


def shape_band(
    line: Line, skin: Skin, estimate: Estimate, touching: Bool[Array | np.ndarray, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """The displacement [m] under the estimate's p, less its mean over the cells in contact, and its
    standard error.

    p enters linearly, so that the error is the estimate's own covariance carried through, exactly.
    Raises `BadInput` for an estimate without one.
    """
    if estimate.covariance is None:
        raise BadInput(
            "The estimate has no covariance, which the profile's error needs: give a "
            "method that has one, such as method=[wiener] or method=[tikhonov]."
        )
    w, stderr = _band(line, skin, estimate.value[0], estimate.covariance, jnp.asarray(touching))
    rig_errors = getattr(estimate, "rig_errors", None)
    if rig_errors is None:
        return w, stderr
    moved = np.asarray(shape_under(line, skin, jnp.asarray(rig_errors[:, 0])))
    moved = moved - moved[:, np.asarray(touching)].mean(axis=-1, keepdims=True)
    return w, jnp.sqrt(stderr**2 + jnp.sum(jnp.asarray(moved) ** 2, axis=0))


@compiled
def _band(line: Line, skin: Skin, pressure, covariance, touching):
    weights = touching / jnp.maximum(jnp.sum(touching), 1)
    w = shape_under(line, skin, pressure)
    if covariance.ndim == 3:
        own, shared = _stationary(line, skin, covariance[0, 0].real, weights)
    else:
        own, shared = _whole(line, skin, covariance[: line.n, : line.n], weights)
    # Variance of w less its mean: var w - 2 cov(w, mean) + var mean.
    variance = own - 2 * shared + weights @ shared
    return w - weights @ w, jnp.sqrt(jnp.maximum(variance, 0.0))


def _stationary(line: Line, skin: Skin, power: Float[Array, " k"], weights):
    """Variance of w and its covariance with the mean, p's errors having the spectrum `power`."""
    compliance = cell_compliance(line, skin)
    spectrum = (compliance * compliance.conj()).real * power
    own = jnp.fft.irfft(spectrum, line.n)[0]
    return jnp.full(line.n, own), jnp.fft.irfft(spectrum * jnp.fft.rfft(weights), line.n)


def _whole(line: Line, skin: Skin, covariance: Float[Array, "n n"], weights):
    """As `_stationary`, from the covariance between all cells."""
    carried = shape_under(line, skin, shape_under(line, skin, covariance).T)
    return jnp.diagonal(carried), carried @ weights


class RecoveredShape(NamedTuple):
    """The profile recovered in a solved contact, and what it is compared with.

    - `shape`, `shape_stderr` [m]: the skin's displacement under the estimate's p, and its standard
      error.
    - `shape_resolved`, `shape_exact_pressure` [m]: the displacement under `pressure_resolved`, and
      under the true `pressure`.
    - `height`, `skin` [m]: of the surface, and of the skin on it. All heights are less the mean of
      the surface or of their own over the cells in contact, `touching`.
    - `pressure`, `pressure_resolved` [Pa]: the truth, and what the averaging kernels of the
      estimate show of it without any noise.
    """

    shape: Float[np.ndarray, " n"]
    shape_stderr: Float[np.ndarray, " n"]
    shape_resolved: Float[np.ndarray, " n"]
    shape_exact_pressure: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    skin: Float[np.ndarray, " n"]
    pressure: Float[np.ndarray, " n"]
    pressure_resolved: Float[np.ndarray, " n"]
    touching: Bool[np.ndarray, " n"]

    @classmethod
    def under(cls, solved: SolvedContact, estimate: Estimate) -> "RecoveredShape":
        """From an estimate on the line of the simulation. Raises `BadInput` for one without a
        covariance."""
        sim, skin = solved.sim, solved.scene.skin
        touching = solved.contact.touching[:: sim.refinement]
        shape, stderr = shape_band(sim.line, skin, estimate, touching)
        p = solved.traction()
        resolved = smoothed_truth(p, estimate, isinstance(sim.line, Periodic))[0]
        height = solved.surface.height(sim.line)
        on_surface = (solved.surface.height(sim.fine) + solved.contact.gap_m)[:: sim.refinement]
        w = shape_under(sim.line, skin, jnp.stack([resolved, p[0]]))
        w = w - jnp.mean(w, axis=-1, keepdims=True, where=touching)
        level = jnp.mean(height, where=touching)
        heights = shape, stderr, *w, height - level, on_surface - level
        return cls(*(np.asarray(each) for each in (*heights, p[0], resolved, touching)))
