"""Fits with standard errors by central differences, for a model whose derivative jumps.

The search goes by the model's own derivative: at its end the cost has no slope by that. Differences
include how the model bends over their steps. They have a slope in the minimum itself, by as
much as the residual bends alike: a little by noise, more where a stated fact is wrong. Such a slope
does not show that the search stopped short. A lower cost along it does.

Where jax traces a fit, `ByDifferences` has the differences for derivatives: the quadratic through
the model's values one step away.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...errors import refuse
from ...numerics import orthonormal_basis
from ...status import Status
from ..diagnostics import slope_by_differences
from ._answer import Fit
from ._parameters import Layout
from ._search import Objective, Search, SearchEnd
from ._summary import Summary, terms_of

# Standard errors: as far from its minimum a search may stop, as the jumps are as large there.
STOPPED_NEAR = 1.0
SHORT = (Status.STALLED, Status.STEP_LIMIT)  # of a minimum
FRACTIONS = (1.0, 0.5, 0.25)  # of the step to the differences' minimum, where the cost is tried


def checked_steps(steps: Mapping[str, float] | None) -> dict[str, float]:
    """Steps by name, refused where one is not above 0."""
    for name, step in (steps or {}).items():
        refuse(not step > 0, f"The step of {name} is {step!r}: give a number above 0.")
    return dict(steps or {})


def with_differences(
    summary: Summary,
    objective: Objective,
    ends: SearchEnd,
    search: Search,
    steps: Mapping[str, float],
) -> Fit:
    """The `Fit` at the end of a search, its errors by differences over `steps` by name.

    Where these alone say that the search stopped short, and the cost does not, it has converged,
    with a note where their slope is more than noise makes. Where the model's own derivative says so
    too, and the minimum is within a standard error, the errors hold how far it is.
    """
    ends = jax.device_get(ends)
    by_steps = jax.device_get(_differenced(objective, ends, search, steps))
    found = summary(objective, by_steps, search)
    if found.status not in SHORT:
        return found
    own, distance = summary(objective, ends, search), "distance_to_minimum"
    falls = partial(_falls, summary, objective, by_steps, search, found)
    if own.status in SHORT or (own.converged and falls(summary.solver.near_enough)):
        is_far = max(own.stats[distance], found.stats[distance]) > STOPPED_NEAR
        return found if is_far or falls(STOPPED_NEAR) else found.stopped_near()
    if not own.converged:
        return found
    chance = max(_distance_by_noise(objective, ends, by_steps), np.finfo(float).tiny)
    notes = (*found.notes, *slope_by_differences(found.stats[distance] / chance))
    stats = found.stats | {distance: own.stats[distance]}
    return dataclasses.replace(found, status=own.status, stats=stats, notes=notes)


def _differenced(
    objective: Objective, ends: SearchEnd, search: Search, steps: Mapping[str, float]
) -> SearchEnd:
    """The search's end with central differences in the Jacobian's columns of these parameters."""
    names, jacobian = objective.layout.free_names, np.array(ends.jacobian)
    for name, step in steps.items():
        if name not in names:
            continue
        at = names.index(name)
        off = np.zeros(ends.z.size)
        off[at] = step
        above, below = (search.white_at(objective, ends.z + sign * off) for sign in (1, -1))
        jacobian[:, at] = (np.asarray(above) - np.asarray(below)) / (2 * step)
    return ends._replace(jacobian=jacobian)


def _falls(
    summary: Summary,
    objective: Objective,
    ends: SearchEnd,
    search: Search,
    found: Fit,
    within: float,
) -> bool:
    """Whether the cost is lower along the step to the differences' minimum, by more than it is from
    so far `within` a minimum: standard errors per root parameter."""
    terms, jacobian = terms_of(objective, ends)
    moving = np.array([name not in found.at_bound for name in found.names])
    columns = np.linalg.norm(jacobian, axis=0)
    columns = np.where(columns > 0, columns, 1.0)
    unit_step = np.linalg.lstsq(np.where(moving, jacobian / columns, 0.0), -terms)[0]
    step, unknowns = unit_step / columns, summary.unknowns

    def cost_at(fraction: float) -> float:
        z = np.clip(ends.z + fraction * step, unknowns.lower, unknowns.upper)
        white = search.white_at(objective, z)
        there = terms_of(objective, ends._replace(z=z, white=white))[0]
        return 0.5 * float(there @ there)

    cost, freedom = 0.5 * float(terms @ terms), found.stats["degrees_of_freedom"]
    variance = max(2 * cost / max(freedom, 1), 1.0 if summary.level_known else 0.0)
    negligible = 0.5 * within**2 * moving.sum() * variance
    return bool(min(map(cost_at, FRACTIONS)) < cost - negligible)


def _distance_by_noise(objective: Objective, ends: SearchEnd, by_steps: SearchEnd) -> float:
    """The rms over noise of the differences' distance to their minimum, in standard errors, where
    the model fits: the search leaves noise across its own derivative's columns alone."""
    own, theirs = (orthonormal_basis(terms_of(objective, each)[1]) for each in (ends, by_steps))
    across = theirs - own @ (own.T @ theirs)
    return float(np.linalg.norm(across)) / np.sqrt(max(theirs.shape[1], 1))


class ByDifferences(eqx.Module):
    """A function of parameters as the quadratic in some of them, `places` in the row of their
    numbers, through its values at `steps` (s,) around `centre` (s,).

    Its derivatives in the centre, first and second, are central differences by these parameters,
    and the function's own by all else.
    """

    function: Callable[[Any], Array]
    places: tuple[int, ...] = eqx.field(static=True)
    steps: tuple[float, ...] = eqx.field(static=True)
    centre: Float[Array, " s"]

    @classmethod
    def around(
        cls,
        function: Callable[[Any], Any],
        layout: Layout,
        z: Float[Array, " m"],
        steps: tuple[tuple[str, float], ...],
    ) -> Callable[[Any], Any]:
        """That of a function around the free parameters z; the function itself where none of them
        has a step."""
        own = {name: step for name, step in steps if name in layout.free_names}
        if not own:
            return function
        at = np.array([layout.free_names.index(name) for name in own])
        places = tuple(layout.free[i] for i in at)
        return cls(function, places, tuple(own.values()), jax.lax.stop_gradient(z[at]))

    def __call__(self, params: Any) -> Array:
        leaves, structure = jax.tree.flatten(params)
        ends = np.cumsum([leaf.size for leaf in leaves])
        owners = [int(np.searchsorted(ends, place, "right")) for place in self.places]
        inside = [p - int(ends[o]) for p, o in zip(self.places, owners, strict=True)]
        pairs = list(zip(owners, inside, strict=True))
        here = jnp.stack([leaves[owner].ravel()[place] for owner, place in pairs])
        away = (here - self.centre) / np.array(self.steps)

        def at(shift: Float[Array, " s"]) -> Array:
            moved = list(leaves)
            for (owner, place), value in zip(pairs, self.centre + shift, strict=True):
                leaf = moved[owner]
                moved[owner] = leaf.ravel().at[place].set(value).reshape(leaf.shape)
            return self.function(jax.tree.unflatten(structure, moved))

        points, weights = _quadratic(away)
        # A loop over them could not be differentiated backwards through a contact again.
        values = jax.vmap(at)(jnp.asarray(points * np.array(self.steps)))
        return jnp.tensordot(weights, values, 1)


def _quadratic(t: Float[Array, " s"]) -> tuple[np.ndarray, Float[Array, " point"]]:
    """Points (point, s) with numbers -1, 0, 1, and the weights at t of the values there in the
    quadratic through them."""
    unit = np.eye(t.size)
    points, weights = [np.zeros(t.size)], [1 - jnp.sum(t**2)]
    for i, sign in itertools.product(range(t.size), (1, -1)):
        points.append(sign * unit[i])
        weights.append((t[i] ** 2 + sign * t[i]) / 2)
    for i, j in itertools.combinations(range(t.size), 2):
        for one, other in itertools.product((1, -1), repeat=2):
            points.append(one * unit[i] + other * unit[j])
            weights.append(one * other * t[i] * t[j] / 4)
    return np.stack(points), jnp.stack(weights)
