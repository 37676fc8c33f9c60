"""Hard cases as data, and what each of them measures in both precisions.

A group holds cases that differ in numbers alone: one compiled program gives the value and the
derivatives of them all, side by side. Its reference is another derivation, in more digits than the
case needs, and does not import srsinv.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

PRECISIONS = ("float64", "float32")
# Largest difference between a derivative forward and in reverse, over the size of its terms.
AGREEMENT = {"float64": 1e-9, "float32": 1e-2}


class Case(NamedTuple):
    """One hard case.

    - `hard`: what is hard about it; `numbers`: what the group's model and reference take.
    - `bounds`: the largest error over the reference's largest value, in float64 and in float32;
      None where the precision cannot hold the numbers.
    """

    name: str
    hard: str
    numbers: Mapping[str, Any]
    bounds: tuple[float | None, float | None]


def over_largest(ours: np.ndarray, wanted: np.ndarray, _) -> float:
    """The largest error over the reference's largest value."""
    size = max(np.max(np.abs(wanted), initial=0.0), np.finfo(ours.dtype).tiny)
    return float(np.max(np.abs(ours - wanted), initial=0.0) / size)


@dataclass(frozen=True, eq=False)
class Group:
    """Cases of one model.

    - `model(numbers)`: an array, by differentiable jax operations; every number is a traced array.
    - `reference(numbers)`: the same array, independently; the numbers are as the precision worked
      in rounds them, in numpy's float64.
    - `fixed`: numbers that are not differentiated, where a derivative means nothing.
    - `side_by_side`: whether the cases may be mapped by vmap; one after the other where LAPACK is
      used (jaxlib's batched one can wait for itself on a CPU).
    - `error(ours, wanted, numbers)`: how far they are apart, where not over the largest value.
    """

    name: str
    model: Callable[[Mapping[str, Any]], Any]
    reference: Callable[[Mapping[str, Any]], Any]
    cases: tuple[Case, ...]
    fixed: frozenset[str] = frozenset()
    side_by_side: bool = True
    error: Callable[[np.ndarray, np.ndarray, Mapping[str, Any]], float] = over_largest


class Hard(NamedTuple):
    """What a case gave in one precision.

    - `error`: largest, over the reference's largest value; `bound`: what it may be.
    - `disagreement`: between w.(J v) forward and (w J).v in reverse, over the size of their terms.
    """

    finite: bool
    slopes_finite: bool
    disagreement: float
    most_disagreement: float
    error: float
    bound: float


def rows(groups: tuple[Group, ...]) -> dict[str, tuple[Group, int, str]]:
    """Every case of the groups in both precisions, by its name."""
    return {
        f"{group.name}-{case.name}-{precision}": (group, i, precision)
        for group in groups
        for precision in PRECISIONS
        for i, case in enumerate(group.cases)
        if case.bounds[PRECISIONS.index(precision)] is not None
    }


def measured(group: Group, i: int, precision: str) -> Hard:
    """What the case number `i` gives."""
    case, found = group.cases[i], _solved(group, precision)
    value, pushed, pulled = ({k: v[i] for k, v in part.items()} for part in found)
    given = _rounded(case.numbers, precision)
    wanted = np.asarray(group.reference(given))
    ours, tiny = value["value"], np.finfo(precision).tiny
    forward, backward = float(pushed["along"]), float(sum(np.sum(v) for v in pulled.values()))
    terms = float(pushed["size"]) + sum(float(np.sum(np.abs(v))) for v in pulled.values())
    slopes = [pushed["slope"], *pulled.values()]
    return Hard(
        finite=bool(np.all(np.isfinite(ours))),
        slopes_finite=all(bool(np.all(np.isfinite(v))) for v in slopes),
        disagreement=abs(forward - backward) / max(terms, float(tiny)),
        most_disagreement=AGREEMENT[precision],
        error=group.error(ours, wanted, given),
        bound=case.bounds[PRECISIONS.index(precision)],
    )


def _rounded(numbers: Mapping[str, Any], precision: str) -> dict[str, np.ndarray]:
    with np.errstate(over="ignore"):  # a number that the precision cannot hold is not asked for
        return {name: np.asarray(v, precision).astype(float) for name, v in numbers.items()}


@cache
def _solved(group: Group, precision: str):
    """Values, derivatives forward and in reverse of all cases."""
    given = [_rounded(case.numbers, precision) for case in group.cases]
    with jax.enable_x64(precision == "float64"):
        stacked = {
            name: jnp.asarray(np.stack([one[name] for one in given]), precision)
            for name in given[0]
        }
        one = _derived(group)
        over = jax.vmap(one) if group.side_by_side else lambda each: jax.lax.map(one, each)
        return jax.device_get(jax.jit(over)(stacked))


def _derived(group: Group):
    def one(numbers):
        free = {name: v for name, v in numbers.items() if name not in group.fixed}

        def model(free):
            return group.model({**numbers, **free})

        # Every number changes by about its own size, or by about one where it is zero, and the
        # values are weighed by numbers about one over the largest of them: both without a pattern.
        keys = jax.random.split(jax.random.key(7), len(free) + 1)
        turns = {
            name: jnp.where(v == 0, 1, v) * jax.random.uniform(key, v.shape, v.dtype, 0.5, 1.5)
            for key, (name, v) in zip(keys, free.items(), strict=False)
        }
        value, slope = jax.jvp(model, (free,), (turns,))
        _, pull = jax.vjp(model, free)
        largest = jnp.max(jnp.abs(value))
        weights = jax.random.uniform(keys[-1], value.shape, value.dtype, -1.0, 1.0)
        weights = weights / jnp.where(largest > 0, largest, 1.0)
        (pulled,) = pull(weights)
        back = {name: pulled[name] * turns[name] for name in free}
        forward = {
            "slope": slope,
            "along": jnp.sum(weights * slope),
            "size": jnp.sum(jnp.abs(weights * slope)),
        }
        return {"value": value}, forward, back

    return one
