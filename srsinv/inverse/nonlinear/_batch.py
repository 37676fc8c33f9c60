"""Levenberg and Marquardt's method for many data under one model at the same time.

The compiled program is the linearised model alone, for `width` of the data at once. Normal
equations, damping and convergence are in numpy, for all data that have not ended yet: none waits
for the slowest. The equations have columns of length one; as few as a model has parameters they are
solved as they are, and their rounding only slows the last steps.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...compiled import compiled
from ...grid import as_real
from ._levenberg_marquardt import ACCEPTED, FIRST_DAMPING, MOST_DAMPING
from ._search import Objective

LEAST_DAMPING = 1e-14  # of columns of length one: the equations stay solvable
MOST_ROUNDS = 20  # of linearisations: a search that needs more is left to that of a single fit
ROUNDS_ALONE = 300  # the same of one of the data, as that search takes ten seconds to compile
ROUNDING_FACTOR = 16  # roundings of the data within which a step is none
LOOSEST = 1e-4  # a step, in units of the noise: a tenth of how far a converged search may be off


class Rows(NamedTuple):
    """The problems of some data linearised: the whitened residual and its derivatives, `white` (j,
    1 + m, n), and the `residual` (j, ...) like the data."""

    white: Float[np.ndarray, "j rows n"]
    residual: Float[np.ndarray, "j ..."]


@dataclass(frozen=True)
class LinearisedBatch:
    """Problems at one point each: all `products` (j, 1 + m, 1 + m) of the whitened residual and its
    derivatives, and these themselves, as the program left them for `width` of the data at once."""

    products: Float[np.ndarray, "j rows rows"]
    parts: Sequence[tuple[Any, Any, Any]]
    width: int

    def write(self, which: Int[np.ndarray, " i"], onto: Rows, at: Int[np.ndarray, " i"]) -> None:
        """Copy the rows of some of them into others."""
        for one, place in zip(which, at, strict=True):
            _, white, residual = self.parts[one // self.width]
            onto.white[place] = np.asarray(white)[one % self.width]
            onto.residual[place] = np.asarray(residual)[one % self.width]


@dataclass
class Ends:
    """Where searches ended: of each the index of its data, the point, half the sum of squares there
    and where it began, the iterations, whether it is a minimum, and the linearised problem."""

    which: Int[np.ndarray, " j"]
    z: Float[np.ndarray, "j m"]
    cost: Float[np.ndarray, " j"]
    begun: Float[np.ndarray, " j"]
    iterations: Int[np.ndarray, " j"]
    done: Bool[np.ndarray, " j"]
    rows: Rows


@dataclass(frozen=True)
class Batch:
    """Data (b, ...) of an objective, searched within a box (m,), by a solver's relative `tolerance`
    and most steps."""

    objective: Objective
    ys: Float[np.ndarray, "b ..."]
    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]
    tolerance: float
    max_steps: int
    width: int

    def linearised(
        self, which: Int[np.ndarray, " j"], z: Float[np.ndarray, "j m"]
    ) -> "LinearisedBatch":
        """The problem of each of these data at its own point."""
        parts = []
        for first in range(0, len(which), self.width):
            # Filled up: an incomplete round would be compiled a second time.
            at = np.minimum(np.arange(first, first + self.width), len(which) - 1)
            parts.append(_linearised(*self._program, self.ys[which[at]], z[at]))
        products = np.concatenate([np.asarray(each[0]) for each in parts])[: len(which)]
        return LinearisedBatch(self._with_priors(products, z), parts, self.width)

    def search(self, which: Int[np.ndarray, " j"], starts: Float[np.ndarray, "j m"]) -> Ends:
        """The minimum reached from each start."""
        ends = self.unsearched(which, np.clip(starts, self.lower, self.upper))
        damping, growth = np.full(len(which), FIRST_DAMPING), np.full(len(which), 2.0)
        trial, active = ends.z.copy(), np.arange(len(which))
        normal = np.zeros((len(which), trial.shape[1] + 1, trial.shape[1] + 1))
        predicted, eps = np.zeros(len(which)), np.finfo(ends.rows.white.dtype).eps
        most = min(self.max_steps, MOST_ROUNDS if len(self.ys) > 1 else ROUNDS_ALONE)
        for count in range(1, most + 1):
            at = self.linearised(which[active], trial[active])
            made = at.products
            with np.errstate(all="ignore"):
                gain = ends.cost[active] - made[:, 0, 0] / 2
                ratio = gain / np.where(predicted[active] > 0, predicted[active], 1.0)
                equal = np.abs(gain) <= ROUNDING_FACTOR * eps * ends.cost[active]
            better = (count == 1) | equal | (gain > ACCEPTED * predicted[active])
            taken = active[better]
            ends.z[taken], normal[taken] = trial[taken], made[better]
            ends.cost[taken], ends.iterations[active] = made[better, 0, 0] / 2, count
            if count == 1:
                ends.begun[:] = ends.cost
            else:
                ease = np.clip(1 - (2 * ratio - 1) ** 3, 1 / 3, 2.0)
                damping[active] *= np.where(better, ease, growth[active])
                growth[active] = np.where(better, 2.0, 2 * growth[active])
            np.clip(damping, LEAST_DAMPING, None, out=damping)
            step, fall, size = self._step(ends.z[active], normal[active], damping[active])
            ended = better & (size <= self._negligible(which[active], ends.cost[active]))
            at.write(np.flatnonzero(ended), ends.rows, active[ended])
            ends.done[active[ended]] = True
            trial[active], predicted[active] = ends.z[active] + step, fall
            failed = ~np.isfinite(ends.cost[active]) | (damping[active] > MOST_DAMPING)
            active = active[~ended & ~failed]
            if not active.size:
                break
        return ends

    def rows(self, which: Int[np.ndarray, " j"], z: Float[np.ndarray, "j m"]) -> Rows:
        """The linearised problems themselves."""
        ends = self.unsearched(which, z)
        everything = np.arange(len(which))
        self.linearised(which, z).write(everything, ends.rows, everything)
        return ends.rows

    def unsearched(self, which, z) -> Ends:
        """Ends that nothing is known of."""
        (count, m), dtype = z.shape, np.asarray(self.objective.y).dtype
        none = np.full(count, np.inf)
        rows = Rows(
            np.empty((count, 1 + m, self.data.shape[1]), dtype),
            np.empty((count, *self.ys.shape[1:]), dtype),
        )
        return Ends(which, z, none, none.copy(), np.zeros(count, int), np.zeros(count, bool), rows)

    def _with_priors(self, products, z) -> Float[np.ndarray, "j rows rows"]:
        """All products of the terms and their derivatives."""
        weight, mean = self.objective.prior_weight, self.objective.prior_mean
        if weight is None or mean is None:
            return products
        products = products.copy()
        weight, places = np.asarray(weight), np.arange(z.shape[1]) + 1
        off = weight * (z - np.asarray(mean))
        products[:, 0, 0] += np.sum(off**2, axis=1)
        products[:, 0, 1:] += weight * off
        products[:, 1:, 0] += weight * off
        products[:, places, places] += weight**2
        return products

    def _step(self, z, normal, damping):
        """The damped step within the box, the fall of the cost that it predicts, and the change of
        the terms by the step without damping."""
        gradient, hessian = normal[:, 0, 1:], normal[:, 1:, 1:]
        held = ((z <= self.lower) & (gradient >= 0)) | ((z >= self.upper) & (gradient <= 0))
        length = np.sqrt(np.einsum("jmm->jm", hessian))
        length = np.where((length > 0) & np.isfinite(length), length, 1.0)
        moving = ~held
        both = moving[:, :, None] & moving[:, None, :]
        scaled = np.where(both, hessian / length[:, :, None] / length[:, None], 0.0)
        scaled = np.where(np.isfinite(scaled), scaled, 0.0)
        right = np.where(moving & np.isfinite(gradient), gradient, 0.0) / length
        eye = np.eye(z.shape[1])
        undamped, damped = (
            -np.linalg.solve(scaled + (each[:, None, None]) * eye, right[..., None])[..., 0]
            for each in (np.full(len(z), LEAST_DAMPING), damping)
        )
        size = np.sqrt(np.maximum(-np.sum(right * undamped, axis=1), 0.0))
        step = np.clip(z + damped / length, self.lower, self.upper) - z
        bent = np.einsum("jm,jmk,jk->j", step, hessian, step)
        fall = -np.sum(gradient * step, axis=1) - bent / 2
        return step, fall, size

    def _negligible(self, which, cost) -> Float[np.ndarray, " j"]:
        """The largest change of the terms that is negligible: a part of their rms, or rounding."""
        size = self.data.shape[1]
        eps = np.finfo(np.asarray(self.objective.y).dtype).eps
        relative = max(min(self.tolerance**0.75, LOOSEST), ROUNDING_FACTOR * eps)
        return relative * np.sqrt(2 * cost / size) + ROUNDING_FACTOR * eps * self._lengths[which]

    @cached_property
    def _program(self) -> tuple[Any, Any]:
        """What the objective's program is compiled for, and its arrays: flattened once, as a call
        is shorter than an `eqx.filter_jit` takes to begin."""
        leaves, structure = jax.tree.flatten(self.objective)
        is_array = [eqx.is_array(leaf) for leaf in leaves]
        others = tuple(None if a else leaf for a, leaf in zip(is_array, leaves, strict=True))
        arrays = [leaf if a else None for a, leaf in zip(is_array, leaves, strict=True)]
        return (structure, others), arrays

    @cached_property
    def data(self) -> Float[np.ndarray, "b n"]:
        """The data in units of the noise."""
        return np.asarray(_whitened(self.objective, as_real(self.ys)), float)

    @cached_property
    def _lengths(self) -> Float[np.ndarray, " b"]:
        return np.linalg.norm(self.data, axis=1)


@partial(jax.jit, static_argnums=0)
def _linearised(static, arrays, ys, z):
    structure, others = static
    leaves = [o if a is None else a for a, o in zip(arrays, others, strict=True)]
    objective: Objective = jax.tree.unflatten(structure, leaves)

    def one(y, z):
        of = dataclasses.replace(objective, y=y).white
        white, push, residual = jax.linearize(of, z, has_aux=True)
        slopes = jax.vmap(push)(jnp.eye(z.size, dtype=z.dtype))
        rows = jnp.concatenate([white[None], slopes])
        return rows @ rows.T, rows, residual

    return jax.vmap(one)(ys, z)


@compiled
def _whitened(objective: Objective, ys):
    """The data in units of the noise (b, n)."""
    return jax.vmap(objective.whiten)(ys) / objective.scale
