"""Where the searches for many data begin, and which of their ends are minima of another basin.

From one start some of the data are led into false minima. What explains one of the data is a
candidate for the others: the points reached so far are a bank of filters, each with the linear
parameters that are best for the data at hand, so that the cost of every candidate for all data is a
product of matrices. The first few data are searched from the given starts, ever more others from
the candidate that explains them best, and those whose end another candidate explains better, or
whose misfit is beyond the noise's, once more.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ._batch import Batch, Ends, Rows
from ._search import Objective, SearchEnd
from ._solvers import Solver, relative
from ._uncertainty import ROUNDING_FACTOR

WAVE = 3  # times as many data are searched after each wave, from what it has reached
MOST_CANDIDATES = 32  # of the ends reached: a bank of more costs as much as a step
BETTER = 1e-6  # of a cost, by which that of another candidate is lower beyond rounding
AGAIN = 2  # candidates from which a doubtful end is searched again
ROUNDS = 8  # of these searches at most, while any of them improves an end

IsNoise = Callable[[Float[np.ndarray, " b"]], Bool[np.ndarray, " b"]]


@dataclass(frozen=True)
class Candidates:
    """Points to begin at (s, m), the signals there without the linear parameters `fixed` (s, n), an
    orthonormal basis of theirs (s, n + a, a) with its triangular factor, and the priors' terms."""

    z: Float[np.ndarray, "s m"]
    linear: Int[np.ndarray, " a"]
    fixed: Float[np.ndarray, "s n"]
    basis: Float[np.ndarray, "s rows a"]
    factor: Float[np.ndarray, "s a a"]
    pulled: Float[np.ndarray, " a"]
    constant: Float[np.ndarray, " s"]

    @classmethod
    def at(
        cls, batch: Batch, which: Int[np.ndarray, " s"], z: Float[np.ndarray, "s m"], rows: Rows
    ) -> "Candidates":
        """Those at points where the problem of some data is linearised."""
        layout, objective = batch.objective.layout, batch.objective
        is_linear = np.isin(layout.free, layout.linear)
        linear = np.flatnonzero(is_linear)
        mean, weight = objective.prior_mean, objective.prior_weight
        mean = np.zeros(z.shape[1]) if mean is None else np.asarray(mean)
        weight = np.zeros(z.shape[1]) if weight is None else np.asarray(weight)
        # In double precision, as costs are differences of large squares.
        white = rows.white.astype(float)
        slopes = -white[:, 1 + linear]
        fixed = batch.data[which] - white[:, 0] - np.einsum("san,sa->sn", slopes, z[:, linear])
        diagonal = np.broadcast_to(np.diag(weight[linear]), (len(z), len(linear), len(linear)))
        basis, factor = np.linalg.qr(np.concatenate([slopes, diagonal], axis=2).swapaxes(1, 2))
        own = np.sum((weight * (z - mean))[:, ~is_linear] ** 2, axis=1)
        pulled = (weight * mean)[linear]
        return cls(z, linear, fixed, basis, factor, pulled, own + np.sum(pulled**2))

    def joined(self, other: "Candidates") -> "Candidates":
        """Both sets."""
        both = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("z", "fixed", "basis", "factor", "constant")
        }
        return dataclasses.replace(self, **both)

    def costs(self, data: Float[np.ndarray, "b n"]) -> tuple[np.ndarray, np.ndarray]:
        """Half the sum of squares (b, s) of each of the data at every candidate, and the linear
        parameters (b, s, a) that are best there."""
        n, (s, a) = data.shape[1], self.factor.shape[:2]
        top = self.basis[:, :n].swapaxes(1, 2)
        own = self.basis[:, n:].swapaxes(1, 2) @ self.pulled - np.einsum(
            "san,sn->sa", top, self.fixed
        )
        across = data @ np.concatenate([top.reshape(s * a, n), self.fixed]).T
        parts = across[:, : s * a].reshape(len(data), s, a) + own
        squares = np.sum(data**2, axis=1)[:, None] - 2 * across[:, s * a :]
        squares = squares + np.sum(self.fixed**2, axis=1) + self.constant
        with np.errstate(all="ignore"):
            costs = (squares - np.sum(parts**2, axis=2)) / 2
            best = _solved(self.factor, parts)
        return np.where(np.isfinite(costs), costs, np.inf), best

    def points(self, chosen: Int[np.ndarray, " j"], linear) -> Float[np.ndarray, "j m"]:
        """The chosen candidates, with these linear parameters (j, a)."""
        z = self.z[chosen].copy()
        z[:, self.linear] = linear
        return z


def _solved(factor: Float[np.ndarray, "s a a"], parts: Float[np.ndarray, "b s a"]) -> np.ndarray:
    """The linear parameters (b, s, a) whose terms along the basis these are; zero for those that
    change nothing."""
    if not factor.shape[1]:
        return parts
    size = np.abs(np.einsum("saa->sa", factor))
    # Beside the columns' lengths, whatever their units.
    length = np.linalg.norm(factor, axis=1)
    dead = size <= ROUNDING_FACTOR * np.finfo(factor.dtype).eps * length
    safe = factor + np.einsum("sa,ab->sab", np.where(dead, 1.0, 0.0), np.eye(factor.shape[1]))
    values = np.linalg.solve(safe, np.where(dead, 0.0, parts).transpose(1, 2, 0))
    return values.transpose(2, 0, 1)


@dataclass
class Best:
    """The best end for each of the data, in rows of `ends`, and the costs of all."""

    ends: Ends
    costs: list[list[float]]

    @classmethod
    def of_nothing(cls, batch: Batch) -> "Best":
        """Before any search."""
        count, m = len(batch.ys), batch.lower.size
        ends = batch.unsearched(np.arange(count), np.zeros((count, m)))
        return cls(ends, [[] for _ in range(count)])

    def take(self, new: Ends) -> None:
        """Keep each end that is the best so far."""
        for j, i in enumerate(new.which):
            self.costs[i].append(float(new.cost[j]))
            mine = self.ends
            if (not new.done[j], new.cost[j]) < (not mine.done[i], mine.cost[i]):
                for name in ("z", "cost", "begun", "iterations", "done"):
                    getattr(mine, name)[i] = getattr(new, name)[j]
                for full, some in zip(mine.rows, new.rows, strict=True):
                    full[i] = some[j]

    def candidates(self, batch: Batch, of: Int[np.ndarray, " b"]) -> Candidates | None:
        """The ends of some of the data, evenly chosen where these are too many."""
        done = of[self.ends.done[of]]
        if not done.size:
            return None
        done = done[np.unique(np.linspace(0, done.size - 1, MOST_CANDIDATES).astype(int))]
        rows = Rows(*(each[done] for each in self.ends.rows))
        return Candidates.at(batch, done, self.ends.z[done], rows)


def search_many(
    batch: Batch,
    starts: Float[np.ndarray, "s m"],
    own: Float[np.ndarray, "b m"] | None,
    most: int,
    is_noise: IsNoise,
) -> tuple[Best, Float[np.ndarray, "b s"]]:
    """The best ends of searches from its `own` start for each of the data or, where there is none,
    from the `most` best of the starts, and the starts' costs. `is_noise(cost)`: whether noise alone
    makes so large a misfit."""
    best, everything = Best.of_nothing(batch), np.arange(len(batch.ys))
    first = np.zeros(len(starts), int)
    given = Candidates.at(batch, first, starts, batch.rows(first, starts))
    start_costs, most = given.costs(batch.data)[0], min(most, len(starts))
    if own is not None:
        ends = batch.search(everything, own)
        best.take(ends)
        start_costs[:, 0] = ends.begun
    known, first, last = given, 0, batch.width
    while own is None and first < len(everything):
        best.take(_searched(batch, known, everything[first:last], most))
        others = best.candidates(batch, everything[:last])
        known = given if others is None else given.joined(others)
        first, last = last, WAVE * last
    for _ in range(ROUNDS):
        if not _searched_again(batch, best, is_noise):
            break
    return best, start_costs


def _searched_again(batch: Batch, best: Best, is_noise: IsNoise) -> bool:
    """Search again where an end is doubtful, from candidates of other data; whether any end became
    better."""
    others = best.candidates(batch, np.arange(len(batch.ys)))
    if others is None:
        return False
    costs, linear = others.costs(batch.data)
    own = best.ends.cost
    beaten = costs.min(axis=1) < own * (1 - BETTER)
    doubtful = np.flatnonzero(beaten | ~is_noise(own) | ~best.ends.done)
    # Not from its own end again, nor from one in the same basin.
    same = np.abs(costs - own[:, None]) <= BETTER * own[:, None]
    chosen = np.argsort(np.where(same, np.inf, costs)[doubtful], axis=1)[:, :AGAIN]
    row = np.repeat(doubtful, chosen.shape[1])
    before = own.copy()
    if row.size:
        points = others.points(chosen.ravel(), linear[row, chosen.ravel()])
        best.take(batch.search(row, points))
    return bool(np.any(best.ends.cost < before * (1 - BETTER)))


def _searched(
    batch: Batch, candidates: Candidates, which: Int[np.ndarray, " b"], most: int
) -> Ends:
    """The ends of searches for some of the data from the `most` candidates that are best for
    each."""
    costs, linear = candidates.costs(batch.data[which])
    chosen = np.argsort(costs, axis=1, kind="stable")[:, :most]
    row = np.repeat(np.arange(len(which)), chosen.shape[1])
    points = candidates.points(chosen.ravel(), linear[row, chosen.ravel()])
    return batch.search(which[row], points)


def _end_of(best: Best, i: int, start_costs: Float[np.ndarray, " s"]) -> SearchEnd:
    """The best end for one of the data, as the search of a single fit has it."""
    ends = best.ends
    return SearchEnd(
        z=ends.z[i],
        white=ends.rows.white[i, 0],
        jacobian=ends.rows.white[i, 1:].T,
        residual=ends.rows.residual[i],
        costs=np.array(best.costs[i]),
        start_costs=start_costs,
        iterations=ends.iterations[i],
        done=ends.done[i],
    )  # pyright: ignore[reportArgumentType]


def ends_of_many(
    objective: Objective,
    ys: Float[np.ndarray, "b ..."],
    box: tuple[np.ndarray, np.ndarray],
    starts: Float[np.ndarray, "s m"],
    own: Float[np.ndarray, "b m"] | None,
    solver: Solver,
    most: int,
    at_once: int,
    is_noise: IsNoise,
) -> list[SearchEnd | None]:
    """The end of the search for each of the data, None where it has to be searched alone."""
    if not solver.has_batch:
        return [None] * len(ys)
    tolerance = float(relative(solver.tolerance, objective.y.dtype))
    width = min(at_once, len(ys))
    batch = Batch(objective, ys, *box, tolerance, solver.max_steps, width)
    best, start_costs = search_many(batch, starts, own, most, is_noise)
    return [_end_of(best, i, start_costs[i]) if best.ends.done[i] else None for i in range(len(ys))]
