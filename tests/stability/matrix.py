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


class HardCase(NamedTuple):
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
    """The largest error over the reference's largest value; what is less than the smallest normal
    number may count as nothing."""
    tiny = float(np.finfo(ours.dtype).tiny)
    size = np.max(np.abs(wanted), initial=tiny)
    return float(np.max(np.abs(ours - wanted) - tiny, initial=0.0) / size)


@dataclass(frozen=True, eq=False)
class Group:
    """Cases of one model.

    - `model(numbers)`: an array, by differentiable jax operations; every number is a traced array.
      Or a tuple of arrays, each of which is measured against its own largest value.
    - `reference(numbers)`: the same, independently; the numbers are as the precision worked in
      rounds them, in numpy's float64.
    - `fixed`: numbers that are not differentiated, where a derivative means nothing.
    - `side_by_side`: whether the cases may be mapped by vmap; one after the other where LAPACK is
      used (jaxlib's batched one can wait for itself on a CPU).
    - `error(ours, wanted, numbers)`: how far they are apart, where not over the largest value.
    """

    name: str
    model: Callable[[Mapping[str, Any]], Any]
    reference: Callable[[Mapping[str, Any]], Any]
    cases: tuple[HardCase, ...]
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
    case, outputs = group.cases[i], _solved(group, precision)
    pushed, pulled = ({k: v[i] for k, v in part.items()} for part in outputs[1:])
    given = _rounded(case.numbers, precision)
    wanted = [np.asarray(part) for part in _parts(group.reference(given))]
    ours, tiny = [part[i] for part in outputs[0]], np.finfo(precision).tiny
    forward, backward = float(pushed["along"]), float(sum(np.sum(v) for v in pulled.values()))
    terms = float(pushed["size"]) + sum(float(np.sum(np.abs(v))) for v in pulled.values())
    slopes = [pushed["slope"], *pulled.values()]
    return Hard(
        finite=all(bool(np.all(np.isfinite(part))) for part in ours),
        slopes_finite=all(bool(np.all(np.isfinite(v))) for v in slopes),
        disagreement=abs(forward - backward) / max(terms, float(tiny)),
        most_disagreement=AGREEMENT[precision],
        error=max(group.error(*each, given) for each in zip(ours, wanted, strict=True)),
        bound=case.bounds[PRECISIONS.index(precision)],
    )


def within_bounds(group: Group, precision: str) -> tuple[float, float]:
    """The error and the bound of the case that comes nearest to its own, of all cases from one
    program that derives nothing; every one has to hold."""
    bounds = [case.bounds[PRECISIONS.index(precision)] for case in group.cases]
    pairs = list(zip(errors(group, precision), bounds, strict=True))
    assert all(error < bound for error, bound in pairs), pairs
    return max(pairs, key=lambda each: each[0] / each[1])


def errors(group: Group, precision: str) -> list[float]:
    """The error of every case, from one program that derives nothing."""
    with jax.enable_x64(precision == "float64"):
        outputs = jax.device_get(jax.jit(_over(group, group.model))(_stacked(group, precision)))
    given = [_rounded(case.numbers, precision) for case in group.cases]
    return [
        max(
            group.error(part[i], np.asarray(wanted), numbers)
            for part, wanted in zip(_parts(outputs), _parts(group.reference(numbers)), strict=True)
        )
        for i, numbers in enumerate(given)
    ]


def _parts(value) -> tuple:
    return value if isinstance(value, tuple) else (value,)


def _rounded(numbers: Mapping[str, Any], precision: str) -> dict[str, np.ndarray]:
    with np.errstate(over="ignore"):  # a number that the precision cannot hold is not asked for
        return {name: np.asarray(v, precision).astype(float) for name, v in numbers.items()}


@cache
def _solved(group: Group, precision: str):
    """Values, derivatives forward and in reverse of all cases."""
    with jax.enable_x64(precision == "float64"):
        one = _over(group, _derived(group))
        return jax.device_get(jax.jit(one)(_stacked(group, precision)))


def _over(group: Group, one):
    return jax.vmap(one) if group.side_by_side else lambda each: jax.lax.map(one, each)


def _stacked(group: Group, precision: str):
    given = [_rounded(case.numbers, precision) for case in group.cases]
    return {
        name: jnp.asarray(np.stack([one[name] for one in given]), precision) for name in given[0]
    }


def _derived(group: Group):
    def one(numbers):
        free = {name: v for name, v in numbers.items() if name not in group.fixed}

        def model(free):
            return _parts(group.model({**numbers, **free}))

        # Every number changes by about its own size, or by about one where it is zero, and the
        # values are weighed by numbers about one over the largest of them: both without a pattern.
        keys = jax.random.split(jax.random.key(7), len(free) + 1)
        turns = {
            name: jnp.where(v == 0, 1, v) * jax.random.uniform(key, v.shape, v.dtype, 0.5, 1.5)
            for key, (name, v) in zip(keys, free.items(), strict=False)
        }
        # Traced once for the value and both ways: half of a test's time is compiling.
        value, push = jax.linearize(model, free)
        slope, pull = push(turns), jax.linear_transpose(push, free)
        weights = tuple(
            _weights(jax.random.fold_in(keys[-1], at), part) for at, part in enumerate(value)
        )
        (pulled,) = pull(weights)
        back = {name: pulled[name] * turns[name] for name in free}
        weighed = jnp.concatenate(
            [(w * part).ravel() for w, part in zip(weights, slope, strict=True)]
        )
        return (
            value,
            {"slope": weighed, "along": weighed.sum(), "size": jnp.abs(weighed).sum()},
            back,
        )

    return one


def _weights(key, value):
    largest = jnp.max(jnp.abs(value))
    weights = jax.random.uniform(key, value.shape, value.dtype, -1.0, 1.0)
    return weights / jnp.where(largest > jnp.finfo(value.dtype).tiny, largest, 1.0)
