"""Noise that elements share, as bursts of catch and snap: its cross-spectral matrix in the line's
problem.

All elements respond to the same bursts, so that their noise is correlated across elements: N(k) =
own(k) I + V diag(power(k)) V^T, with the same orthogonal V at every wavenumber. Sums of the
elements' signals along the columns of V have independent noise. The signals of all elements at a
time are rotated, so that this holds on every line, and where all elements miss a sample together.
"""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...known import Numbers, array_module, by_numpy, is_traced
from ...modules import with_fields
from .. import diagnostics

if TYPE_CHECKING:
    from .problem import LineProblem

LEAST_POWER = 1e-10  # of the loudest axis: sums of elements that lack all noise are not exact
COMMON_AXES = 1e-6  # of the matrix that its axes leave aside, at most: beyond, they change with k


class SharedNoise(eqx.Module):
    """Noise with a part that all elements share, or that one element has beside its own.

    - `axes` (e, e): V, orthogonal sums of the elements; `power` (e, k): the shared part's power per
      sample along each; `own` (k,): the power of the rest, independent and alike in all elements.
    """

    axes: Float[Numbers, "e e"]
    power: Float[Numbers, "e k"]
    own: Float[Numbers, " k"]

    @property
    def of_elements(self) -> Float[Any, "e k"]:
        """The whole noise's power in each element."""
        return self.own[None] + self.axes**2 @ self.power

    def to_elements(self, rows: Float[Numbers, "e n"]) -> Float[Any, "e n"]:
        """Signals along the axes as signals of the elements."""
        return self.axes @ rows


def shared_noise(
    cross: Float[Array, "e e k"], own: Float[Array, " k"]
) -> tuple[SharedNoise | None, Sequence[str]]:
    """The noise of a shared part with this cross-spectral matrix beside independent noise, and
    warnings; None where no elements share any, or where its axes change with the wavenumber."""
    axes, power, aside = _along_axes(cross)
    if is_traced(cross):
        return SharedNoise(axes, power, own), ()
    if not np.any(np.asarray(cross)):
        return None, ()
    if float(aside) > COMMON_AXES:
        return None, diagnostics.correlated_elements("its causes correlate elements differently")
    return SharedNoise(axes, power, own), ()


@by_numpy
def _along_axes(cross: Float[Numbers, "e e k"], xp: Any = jnp) -> tuple[Any, Any, Any]:
    """The axes, the powers along them, and the fraction of the matrix between them."""
    size = xp.maximum(xp.max(xp.abs(cross)), np.finfo(np.dtype(cross.dtype)).tiny)
    _, axes = xp.linalg.eigh(xp.mean(cross / size, axis=-1))
    along = xp.einsum("ei,efk,fj->ijk", axes, cross / size, axes)
    power = xp.maximum(xp.einsum("iik->ik", along), 0.0)
    between = xp.max(xp.abs(along - xp.eye(len(cross))[..., None] * along))
    return axes, power * size, between


def usable(
    shared: SharedNoise | None, observed: Any, others: Sequence[Any]
) -> tuple[SharedNoise | None, Sequence[str]]:
    """The shared noise where signals can be rotated, else None with a warning: where elements miss
    other samples than each other, or have further noise of their own (`others`)."""
    if shared is None or len(shared.axes) == 1:
        return shared, ()
    if observed is not None and not np.all(np.asarray(observed) == np.asarray(observed)[:1]):
        return None, diagnostics.correlated_elements("elements miss different samples")
    if any(each is not None for each in others):
        return None, diagnostics.correlated_elements("elements have further noise of their own")
    return shared, ()


def decorrelated(problem: "LineProblem") -> "LineProblem":
    """The same problem of signals along the noise's axes, whose noise is independent."""
    shared = problem.shared_noise
    if shared is None:
        return problem
    if len(shared.axes) == 1:
        return with_fields(problem, shared_noise=None)
    xp = array_module(shared, problem)
    turn = xp.asarray(shared.axes).T
    noise = shared.own[None] + xp.maximum(
        shared.power, LEAST_POWER * xp.max(shared.power, axis=0, keepdims=True)
    )
    is_free = xp.isinf(xp.asarray(problem.noise)[:1, 0])
    first = xp.where(is_free, xp.inf, noise[:, 0])
    changes = problem.rig_changes
    if changes is not None:
        each = changes.transfer.reshape(-1, *problem.forward.transfer.shape)
        each = xp.einsum("ef,jfck->jeck", turn, each).reshape(changes.transfer.shape)
        changes = dataclasses.replace(changes, transfer=jnp.asarray(each))
    forward = dataclasses.replace(
        problem.forward,
        transfer=jnp.asarray(xp.einsum("ef,fck->eck", turn, xp.asarray(problem.forward.transfer))),
    )
    return with_fields(
        problem,
        forward=forward,
        data=jnp.asarray(turn @ xp.asarray(problem.data)),
        mean_signal=jnp.asarray(turn @ xp.asarray(problem.mean_signal)),
        noise=jnp.asarray(xp.concatenate([first[:, None], noise[:, 1:]], axis=1)),
        rig_changes=changes,
        shared_noise=None,
    )
