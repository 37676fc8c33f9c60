"""Points that a fit's searches start from."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import refuse
from ...known import array_module, is_traced
from ._parameters import Parameters, flat_mapping, on_host, real, with_numbers


def starting_points(given: Any, unknowns: Parameters) -> Float[Any, "s m"]:
    """The points to start from, the first value among them.

    A number: that many points spread evenly over the bounds (a Sobol sequence); a mapping by name:
    values along a leading axis, the other parameters as in the first; None: the first value alone.
    """
    layout = unknowns.layout
    first = unknowns.first[np.asarray(layout.free)]
    if given is None:
        return on_host(first[None])
    if isinstance(given, Mapping):
        rows = first[None], _listed(given, unknowns)
        return on_host(array_module(rows).concatenate(rows))
    refuse(
        isinstance(given, bool) or not isinstance(given, int) or given < 1,
        f"starts is {given!r}: give a whole number from 1, or a mapping of names to values.",
    )
    bounded = np.isfinite(unknowns.lower) & np.isfinite(unknowns.upper)
    searched = [j for j, i in enumerate(layout.free) if i not in layout.linear]
    open_ended = [layout.names[layout.free[j]] for j in searched if not bounded[j]]
    refuse(
        bool(open_ended),
        f"starts={given} spreads over the bounds, but {', '.join(open_ended)} has "
        "none: give bounds, or a mapping of starts.",
    )
    from scipy.stats import qmc

    points = array_module(first).tile(first, (given, 1))
    if searched:
        power = int(np.ceil(np.log2(given)))
        unit = qmc.Sobol(len(searched), scramble=True, rng=0).random_base2(power)[:given]
        low, high = unknowns.lower[searched], unknowns.upper[searched]
        points = with_numbers(points, searched, low + unit * (high - low))
    return on_host(array_module(first).concatenate([first[None], points]))


def starting_rows(
    given: Mapping[str, Any] | None, unknowns: Parameters, count: int
) -> Float[Any, "b m"] | None:
    """The points to start each of `count` data from; None where all start from the first value."""
    if given is None:
        return None
    rows = _listed(given, unknowns)
    refuse(
        len(rows) != count,
        f"each gives {len(rows)} values to start from for {count} data: give one for each of them.",
    )
    return rows


def _listed(given: Mapping, unknowns: Parameters) -> Any:
    layout, rows = unknowns.layout, None
    for name, values in flat_mapping(given).items():
        where = layout.indices(name, "starts")
        listed = real(values, f"The starts of {name} are {values!r}: give rows of numbers.")
        count = len(rows) if rows is not None else (listed.shape or (1,))[0]
        refuse(
            not count or listed.shape[:1] != (count,) or listed.size != count * len(where),
            f"The starts of {name} have shape {listed.shape}: give as many as for the others, at "
            f"least one, each of {len(where)} numbers.",
        )
        is_known = not is_traced(listed)
        refuse(
            is_known and not np.isfinite(listed).all(),
            f"A start of {name} is not finite: give numbers.",
        )
        if rows is None:
            rows = array_module(unknowns.first).tile(unknowns.first, (count, 1))
        rows = with_numbers(rows, where, listed.reshape(count, -1))
    refuse(rows is None, "starts names no parameter: give values for at least one.")
    rows = array_module(rows).asarray(rows)[:, np.asarray(layout.free)]
    if is_traced(rows):
        return jnp.clip(rows, unknowns.lower, unknowns.upper)
    inside = (rows >= unknowns.lower) & (rows <= unknowns.upper)
    worst = int(np.argmin(inside.all(axis=0)))
    refuse(
        not inside.all(),
        f"A start of {layout.free_names[worst]} lies outside its bounds "
        f"[{unknowns.lower[worst]:g}, {unknowns.upper[worst]:g}]: start inside them.",
    )
    return rows
