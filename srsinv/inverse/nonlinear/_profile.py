"""Profile likelihood: intervals of a fit's parameters that need not be symmetric.

The end of an interval is where the cost, with all other parameters fitted again, has risen by as
much as that of a linear model does at the same number of standard errors. The refits are
Gauss-Newton steps whose Jacobian starts as the fit's own and follows the residual by Broyden's
updates (1965): each costs one call of the model, by the program that the search has compiled.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...errors import BadInput, check_name, refuse
from ...numerics import BAND_90

if TYPE_CHECKING:
    from ._answer import Fit

ASYMMETRIC = 0.1  # of its half-width, by which an end is reported apart from the standard error's
CLOSE = 1e-3  # standard errors: how closely an end, or the cost of a refit, is found
MOST_STEPS = 12  # of the search for an end
MOST_REFITS = 12  # steps of one refit
FARTHEST = 30.0  # standard errors up to which an end is searched
LOWER = 1e-2  # of the rise, by which a lower cost shows that a fit is not at its minimum


class NotAMinimum(Exception):
    """A lower cost was found beside a fit, at a value of the profiled parameter."""

    def __init__(self, value: float):
        super().__init__()
        self.value = value


class NotFound(Exception):
    """The refits of a profile do not converge."""


@dataclass
class ProfileSearch:
    """The profile of each parameter of a fit, by calls of its model.

    `terms`, `rows`: the terms of the sum of squares and their derivative, in units of the noise;
    `calls`: number of calls of the model so far.
    """

    fit: "Fit"
    terms: Float[np.ndarray, " t"] = field(init=False)
    rows: Float[np.ndarray, "t m"] = field(init=False)
    calls: int = 0

    def __post_init__(self):
        fit, search = self.fit, self.fit._search
        self._lower, self._upper = (np.asarray(b, float) for b in (search.lower, search.upper))
        self._level = fit.noise_unit
        self.terms = self._terms_at(fit._z)
        rows = fit.whitened_rows()
        self.rows = rows if len(self.terms) == len(rows) else rows[: len(self.terms)]

    def _terms_at(self, z: Float[np.ndarray, " m"]) -> Float[np.ndarray, " t"]:
        """The terms of the sum of squares, in units of the noise's level."""
        objective = self.fit._objective
        self.calls += 1
        white = np.asarray(self.fit._search.white_at(objective, z), float) / self._level
        mean, weight = objective.prior_mean, objective.prior_weight
        if mean is None or weight is None:
            return white
        return np.concatenate([white, (z - np.asarray(mean)) * np.asarray(weight)])

    def interval(self, i: int, stderr: float, like: float = CLOSE) -> tuple[float, float]:
        """Both ends of the 90 % interval of parameter `i`: its bounds, or infinite, where the cost
        stays too low. Ends off the standard error's by less than `like` of it are these."""
        low, high = (self._end(i, sign, stderr, like) for sign in (-1, 1))
        return low, high

    def _end(self, i: int, sign: int, stderr: float, like: float) -> float:
        """One end, by the secant method on the root of the rise, which is linear for a linear
        model."""
        z, bound = self.fit._z, (self._lower if sign < 0 else self._upper)[i]
        refit = _Refit(self, i)
        last, past, step = 0.0, 0.0, BAND_90  # standard errors from the fit, and their root there
        for close in (like, *[CLOSE] * MOST_STEPS):
            value = z[i] + sign * step * stderr
            is_bound = not sign * value < sign * bound
            value = bound if is_bound else value
            step = abs(value - z[i]) / stderr
            root = refit.root_at(value)
            if abs(root - BAND_90) <= close or (is_bound and root < BAND_90):
                return float(value)
            slope = (root - past) / (step - last) if step != last else 0.0
            last, past = step, root
            ahead = step + (BAND_90 - root) / slope if slope > 0 else np.inf
            step = float(np.clip(ahead, step / 3, 2 * step))
            if step > FARTHEST:
                return float(bound)
        raise NotFound


class _Refit:
    """Refits of all parameters but one, `i`, along its profile."""

    def __init__(self, of: ProfileSearch, i: int):
        self._of, self._i = of, i
        self._others = np.delete(np.arange(of.fit._z.size), i)
        self._z, self._terms, self._rows = of.fit._z.copy(), of.terms, of.rows.copy()
        self._cost = float(of.terms @ of.terms)

    def root_at(self, value: float) -> float:
        """The root of the rise of the sum of squares where the parameter has this value."""
        change = np.zeros_like(self._z)
        change[self._i] = value - self._z[self._i]
        # Along the valley of the linearised problem first, so that a linear model needs one call.
        change[self._others] = self._best(self._terms + self._rows[:, self._i] * change[self._i])
        self._move(change)
        before = float(self._terms @ self._terms)
        for _ in range(MOST_REFITS):
            change = np.zeros_like(self._z)
            change[self._others] = self._best(self._terms)
            predicted = self._terms + self._rows @ change
            if before - float(predicted @ predicted) <= CLOSE:
                rise = before - self._cost
                if rise < -LOWER * BAND_90**2:
                    raise NotAMinimum(value)
                return float(np.sqrt(max(rise, 0.0)))
            self._move(change)
            before = float(self._terms @ self._terms)
        raise NotFound

    def _best(self, terms: np.ndarray) -> np.ndarray:
        """The move of the other parameters that is best for the linearised problem within the
        bounds."""
        others, of = self._others, self._of
        rows = self._rows[:, others]
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        unit = rows / scale
        step = np.linalg.lstsq(unit, -terms, rcond=None)[0] / scale
        low, high = (b[others] - self._z[others] for b in (of._lower, of._upper))
        if (step < low).any() or (step > high).any():
            from scipy.optimize import lsq_linear

            # A parameter on its bound has no room on that side.
            box = np.minimum(low, 0.0) * scale, np.maximum(high, 0.0) * scale
            box = box[0] - 1e-12, box[1] + 1e-12
            step = np.clip(lsq_linear(unit, -terms, box).x / scale, low, high)
        return step

    def _move(self, change: np.ndarray) -> None:
        """To another point, with Broyden's update of the derivative."""
        self._z = np.clip(self._z + change, self._of._lower, self._of._upper)
        new = self._of._terms_at(self._z)
        if not np.isfinite(new).all():
            raise NotFound
        scaled = change * np.linalg.norm(self._rows, axis=0) ** 2
        if (size := float(scaled @ change)) > 0:
            miss = new - self._terms - self._rows @ change
            self._rows = self._rows + np.outer(miss, scaled) / size
        self._terms = new


def profiles(fit: "Fit", names: Iterable[str] | None) -> dict[str, tuple[float, float]]:
    """Ends of the 90 % intervals by the names of free parameters; None: of all."""
    names = fit.names if names is None else (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        check_name("names", name, fit.names)
    refuse(not fit.converged, f"The fit is {fit.status}: fit again until it converges.")
    refuse(fit._objective.is_robust, "A robust loss has no likelihood: profile a fit of squares.")
    of = ProfileSearch(fit)
    return {name: _interval(of, fit.names.index(name), name) for name in names}


def asymmetric(fit: "Fit", names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Those of these parameters' intervals an end of which is off the standard error's by more than
    a tenth: where it is not, most take two calls of the model. A profile that is not found is left
    out, as this is for a report."""
    intervals: dict[str, tuple[float, float]] = {}
    if not fit.converged or fit._objective.is_robust or fit.undetermined:
        return intervals
    of = ProfileSearch(fit)
    for name in names:
        i = fit.names.index(name)
        half = BAND_90 * float(fit.plain_stderr[i])
        if not 0 < half < np.inf or name in fit.at_bound:
            continue
        try:
            ends = of.interval(i, half / BAND_90, ASYMMETRIC * BAND_90)
        except (NotAMinimum, NotFound):
            continue
        off = max(abs(abs(end - fit._z[i]) / half - 1) for end in ends)
        if off > ASYMMETRIC:
            intervals[name] = _with_errors(fit, i, ends)
    return intervals


def _with_errors(fit: "Fit", i: int, ends: tuple[float, float]) -> tuple[float, float]:
    """The ends with what the standard error contains beside noise and priors, added in squares."""
    more = max(float(fit.covariance[i, i]) - float(fit.plain_stderr[i]) ** 2, 0.0)
    z, half = float(fit._z[i]), BAND_90 * np.sqrt(more)
    low, high = (
        z + sign * np.hypot(end - z, half) for sign, end in zip((-1, 1), ends, strict=True)
    )
    return float(low), float(high)


def _interval(of: ProfileSearch, i: int, name: str) -> tuple[float, float]:
    stderr = float(of.fit.plain_stderr[i])
    if not np.isfinite(stderr):
        return float(of._lower[i]), float(of._upper[i])
    try:
        return _with_errors(of.fit, i, of.interval(i, stderr))
    except NotAMinimum as error:
        raise BadInput(
            f"The cost is lower at {name} = {error.value:g}: fit again from there."
        ) from error
    except NotFound as error:
        raise BadInput(
            f"The refits along {name} do not converge: draw samples by srsinv.sample instead."
        ) from error
