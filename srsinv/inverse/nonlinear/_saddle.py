"""Restart of a search that began on a saddle or a maximum and could not leave it."""

import dataclasses

import numpy as np

from ._search import Objective, Search, SearchEnd
from ._summary import rows_of, terms_of
from ._uncertainty import ROUNDING_FACTOR, spread

ESCAPES = 3  # times that a search is begun again
BESIDE = (1.0, 0.1, 0.01)  # standard errors at which a lower cost is tried


def escape_saddle(objective: Objective, ends: SearchEnd, search: Search) -> SearchEnd:
    """Search again from beside a saddle or a maximum where a search began and could not leave: the
    slope is zero there as in a minimum."""
    for _ in range(ESCAPES):
        beside = _lower_beside(objective, ends, search)
        if beside is None:
            break
        starts = np.broadcast_to(beside, search.starts.shape)
        ends = dataclasses.replace(search, starts=starts)(objective)
    return ends


def _lower_beside(objective: Objective, ends: SearchEnd, search: Search) -> np.ndarray | None:
    """A point within a standard error where the cost is lower, None where there is none, or where
    the search has moved and so does not end on a saddle."""
    dtype = np.asarray(ends.z).dtype
    eps, cost = float(np.finfo(dtype).eps), float(np.min(ends.costs))
    moved = cost < float(np.min(ends.start_costs)) * (1 - ROUNDING_FACTOR * eps)
    searched = objective.is_robust or len(objective.layout.linear) < ends.z.size
    if moved or not searched or not 0 < cost < np.inf:
        return None
    rows = rows_of(objective, ends)
    if not np.isfinite(rows).all():
        return None
    steps = np.sqrt(2 * cost / len(rows)) * spread(rows, eps).factor.T
    for fraction in BESIDE:
        for step in (*(fraction * steps), *(-fraction * steps)):
            z = np.clip(np.asarray(ends.z) + step.astype(dtype), search.lower, search.upper)
            there = ends._replace(z=z, white=search.white_at(objective, z))
            terms, _ = terms_of(objective, there)
            if 0.5 * float(terms @ terms) < cost * (1 - ROUNDING_FACTOR * eps):
                return z
    return None
