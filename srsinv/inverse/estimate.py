"""The estimate of an inversion: p and q with their standard errors on a line.

Also scores of it against a truth, and measures of resolution: the width of an averaging kernel and
the cut-off wavenumber.
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ..errors import of_kind
from ..grid import Line
from ..known import Numbers as Numbers
from ..numerics import BAND_90, mean_known
from ..status import Status
from ..views import Arrays, ViewData, Views
from .diagnostics import beyond_band, error_over_truth
from .quality import Quality, quality, reasons

COMPONENTS = ("p", "q")


@jax.tree_util.register_pytree_with_keys_class
class Stats(dict[str, Any]):
    """Numbers and words of a solution, by name. Arrays of jax are leaves of a tree, so that numbers
    have derivatives; all else is part of its structure."""

    leaves: tuple[str, ...]  # the same whatever a tree's map puts in their place

    def __init__(self, values: Mapping[str, Any]):
        super().__init__(values)
        arrays = (name for name, value in values.items() if isinstance(value, jax.Array))
        self.leaves = values.leaves if isinstance(values, Stats) else tuple(arrays)

    def tree_flatten_with_keys(self) -> tuple[Any, Any]:
        rest = tuple((name, value) for name, value in self.items() if name not in self.leaves)
        return [(jax.tree_util.DictKey(name), self[name]) for name in self.leaves], (
            self.leaves,
            rest,
        )

    @classmethod
    def tree_unflatten(cls, names: Any, arrays: Any) -> "Stats":
        leaves, rest = names
        made = cls({**dict(zip(leaves, arrays, strict=True)), **dict(rest)})
        made.leaves = leaves
        return made


class BandedAnswer(Views, eqx.Module):
    """Base of estimates: values with standard errors, and the quality that follows from their
    residual and their warnings."""

    stderr: eqx.AbstractVar[Float[Numbers, "..."]]
    whitened: eqx.AbstractVar[Float[Numbers, "..."]]
    status: eqx.AbstractVar[Status]
    warnings: eqx.AbstractVar[tuple[str, ...]]
    stats: eqx.AbstractVar[dict[str, Any]]

    @property
    def quality(self) -> Quality:
        """Good, doubtful (any warning), no bands, or failed."""
        chi2, freedom = self.stats.get("chi2_per_freedom"), self.stats.get("degrees_of_freedom")
        freedom = np.inf if freedom is None else freedom
        return quality(self.status, chi2, self.warnings, freedom, self.has_bands)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings, self.has_bands)

    @property
    def has_bands(self) -> bool:
        """Whether the values have standard errors."""
        return not np.isnan(np.asarray(self.stderr)).all(axis=-1).any()

    @property
    def chi2_per_freedom(self) -> float | None:
        """Chi-square of the residual per degree of freedom, None where it is undefined."""
        return self.stats.get("chi2_per_freedom")

    @property
    def misfit(self) -> float:
        """Mean square of the residual in units of the noise, 1 where only noise is left, NaN where
        there is no answer."""
        return float(mean_known(np.asarray(self.whitened) ** 2))


class Estimate(BandedAnswer):
    """Recovered traction with its uncertainty; every method gives the same.

    `print` gives a report; `plot`, `to_xarray`, `to_dataframe` give a figure, arrays, a table.

    - `line`: the cells of `value` (2, n), p and q [Pa], and of `stderr` (2, n) [Pa], the standard
      error of the value where its mean is observable, else of its deviation from the mean.
    - `parameters`: (value, standard error) by name, in SI units; may be empty.
    - `fitted` (e, sample): the fitted signal at the problem's samples; `whitened` (e, sample): the
      residual over the noise, NaN where a sample is missing.
    - `status`: how the computation ended; `warnings`: sentences on the validity of the
      bands.
    - `covariance` of the components solved for: (c, c, k) per wavenumber where the line was taken
      as periodic, else (c n, c n); `averaging` (c, c, n): the estimate's response to a unit
      traction in the middle cell, whose transform has the resolution at each wavenumber on its
      diagonal. None where they are not known.
    - `stats`: numbers of the solution, among them `chi2_per_freedom` of the residual's
      `degrees_of_freedom`, None where it is undefined.
    """

    line: eqx.AbstractVar[Line]
    value: eqx.AbstractVar[Float[Numbers, "2 n"]]
    stderr: eqx.AbstractVar[Float[Numbers, "2 n"]]
    fitted: eqx.AbstractVar[Float[Numbers, "e sample"]]
    whitened: eqx.AbstractVar[Float[Numbers, "e sample"]]
    parameters: eqx.AbstractVar[Mapping[str, tuple[float, float]]]
    covariance: eqx.AbstractVar[Complex[Numbers, "c c k"] | Float[Numbers, "m m"] | None]
    averaging: eqx.AbstractVar[Float[Numbers, "c c n"] | None]
    status: eqx.AbstractVar[Status]
    warnings: eqx.AbstractVar[tuple[str, ...]]
    stats: eqx.AbstractVar[dict[str, Any]]

    @abc.abstractmethod
    def on(self, line: Line) -> "Estimate":
        """The same estimate on another line, as averages over its cells."""

    @abc.abstractmethod
    def deviation(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p and q (2, n) less their mean over the cells of `cells` (n,), a mask, and the standard
        error of these deviations."""

    @property
    def intervals(self) -> Mapping[str, tuple[float, float]]:
        """Ends of the 90 % intervals of parameters that are not normally distributed, by name."""
        return {}

    def with_warnings(self, warnings: Sequence[str]) -> "Estimate":
        """The same estimate with further warnings."""
        return dataclasses.replace(self, warnings=(*self.warnings, *warnings))

    def coverage(
        self, truth: Float[Numbers, "2 n"], cells: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "2"]:
        """The fraction of the cells of the mask `cells` (n,) whose 90 % band holds `truth` (2, n)
        [Pa], both less their mean over these."""
        value, stderr = self.deviation(cells)
        return coverage_90(value, stderr, np.asarray(truth), cells)

    def z_rms(
        self, truth: Float[Numbers, "2 n"], cells: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "2"]:
        """Rms over the cells of the mask `cells` (n,) of the error by `truth` (2, n) [Pa], both
        less their mean over these, in standard errors."""
        value, stderr = self.deviation(cells)
        return z_rms(value, stderr, np.asarray(truth), cells)

    @property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower and the upper ends (2, n) of the 90 % band [Pa]."""
        value, half = np.asarray(self.value), BAND_90 * np.asarray(self.stderr)
        return value - half, value + half

    def against(self, truth: Float[Numbers, "2 n"], cells: Bool[np.ndarray, " n"]) -> "Estimate":
        """The same estimate, with a warning where its error exceeds its standard error by much.

        `truth` (2, n) [Pa]: the true p and q on its line. `cells` (n,): a mask of the cells that
        are compared; p, q and truth are compared as deviations from their means over them.
        """
        (value, _), truth = self.deviation(cells), np.asarray(truth)
        resolved = [self.stats.get(f"resolved_dof_{name}", 0.0) for name in COMPONENTS]
        each = zip(COMPONENTS, self.z_rms(truth, cells), resolved, strict=True)
        beyond = [s for name, z, dof in each for s in beyond_band(name, float(z), dof)]
        error = overall_error(value, truth, cells)
        return self.with_warnings((*beyond, *error_over_truth(float(error))))

    def view_data(self) -> ViewData:
        value, stderr = map(np.asarray, self._value_and_stderr())
        if self.quality is Quality.FAILED:
            stderr = np.full_like(stderr, np.inf)
        fitted, whitened = np.asarray(self.fitted), np.asarray(self.whitened)
        x, observed = np.asarray(self.line.x), np.isfinite(whitened)
        # A user's own class may have neither.
        unit, are_cells = (getattr(self, each, None) for each in ("signal_unit", "are_cells"))
        are_cells = whitened.shape[-1] == x.size if are_cells is None else are_cells
        samples = "element", "x" if are_cells else "sample"
        is_scanned = np.ones(x.size, bool)
        if are_cells and observed.any():
            is_scanned = np.asarray(observed.any(axis=0))
        peak, place = highest(value, x, is_scanned)
        resolved_dof = [self.stats.get(f"resolved_dof_{name}", np.nan) for name in COMPONENTS]
        variables: Arrays = {
            "estimate": (("component", "x"), value, "Pa"),
            "estimate_stderr": (("component", "x"), stderr, "Pa"),
            "fitted_signal": (samples, fitted, unit or "1"),
            "whitened_residual": (samples, whitened, "1"),
            "peak": ("component", peak, "Pa"),
            "peak_position": ("component", place, "m"),
            "resolved_dof": ("component", resolved_dof, "1"),
        }
        if are_cells:
            variables["observed"] = samples, observed.astype(np.int8), "1"
        elements = np.arange(len(fitted)).astype(str)
        coordinates: Arrays = {
            "x": (x, "m"), "component": (list(COMPONENTS), "1"), "element": (elements, "1"),
        }  # fmt: skip
        method = self.stats.get("method")
        by = f" by {str(method).capitalize()}" if method else ""
        title = f"Pressure p and shear q{by}"
        return ViewData(title, variables, coordinates, self.parameters, {})

    def _value_and_stderr(self) -> tuple[Numbers, Numbers]:
        """Both at once, for estimates that compute them when they are asked for."""
        return self.value, self.stderr


class TractionEstimate(Estimate):
    """An estimate of the traction in every cell.

    - `mean_weights` (c, n): the weights of the mean that was taken out of `stderr`, zero where the
      mean is observable.
    - `friction`: mu where q = mu p was not solved for.
    - `rig_errors` (j, c, n): errors by one standard deviation of the rig, in independent
      directions. They are in `stderr` beside `covariance`: the two have the covariance
      C + sum_j f_j f_j^T. None of a rig that is exact.
    - `rig_sources`: the source of the error in each of these directions.
    - `mean_unobserved`: names of the components whose mean the signal does not show, so that
      `value` is the deviation from it.
    - `signal_unit`: of `fitted`. `are_cells`: whether the samples are the cells of `line`, as
      before [`TractionEstimate.on`][].
    """

    line: Line
    value: Float[Numbers, "2 n"]
    stderr: Float[Numbers, "2 n"]
    fitted: Float[Numbers, "e sample"]
    whitened: Float[Numbers, "e sample"]
    friction: Float[Numbers, ""] | None
    status: Status = eqx.field(static=True, converter=Status)
    warnings: tuple[str, ...] = eqx.field(static=True)
    stats: Stats = eqx.field(converter=Stats)
    parameters: Mapping[str, tuple[float, float]] = eqx.field(static=True, default_factory=dict)
    covariance: Complex[Numbers, "c c k"] | Float[Numbers, "m m"] | None = None
    mean_weights: Float[Numbers, "c n"] | None = None
    averaging: Float[Numbers, "c c n"] | None = None
    rig_errors: Float[Numbers, "j c n"] | None = None
    rig_sources: tuple[str, ...] = eqx.field(static=True, default=())
    mean_unobserved: tuple[str, ...] = eqx.field(static=True, default=())
    signal_unit: str = eqx.field(static=True, default="1")
    are_cells: bool = eqx.field(static=True, default=True)

    def view_data(self) -> ViewData:
        data = super().view_data()
        return data._replace(attributes={"mean_unobserved": ",".join(self.mean_unobserved)})

    def deviation(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value = np.asarray(self.value)
        return value - value[:, cells].mean(axis=-1, keepdims=True), np.asarray(self.stderr)

    def on(self, line: Line) -> "TractionEstimate":
        """The same estimate as averages over the cells of another line, NaN where that goes beyond
        this one; traction is constant over a cell. The standard error follows from the covariance;
        where that is not known, it is that of errors that are the same all over a cell."""
        of_kind("line", line, Line, "a line, such as Open(256, 1.5e-4)")
        weights = overlap(self.line, line)
        value = jnp.asarray(np.asarray(self.value) @ weights.T)
        names = "covariance", "mean_weights", "averaging", "rig_errors"
        changed: dict[str, Any] = dict.fromkeys(names) | {"are_cells": False}
        stderr = self._carried(weights)
        return dataclasses.replace(self, line=line, value=value, stderr=stderr, **changed)

    def of_elements(self, change: Callable[[Any], Any]) -> "TractionEstimate":
        """The same with `change` applied to the rows of its fitted signal and its residual."""
        fitted, whitened = change(jnp.asarray(self.fitted)), change(jnp.asarray(self.whitened))
        return dataclasses.replace(self, fitted=fitted, whitened=whitened)

    def _carried(self, weights: np.ndarray) -> Float[Array, "2 m"]:
        """The standard error of averages with these weights (m, n)."""
        if self.covariance is None:
            return jnp.asarray(np.asarray(self.stderr) @ weights.T)
        components = 1 if self.friction is not None else 2
        means = np.zeros((components, self.line.n))
        means = means if self.mean_weights is None else np.asarray(self.mean_weights)
        rows = []
        for c in range(components):
            off = weights - weights.sum(axis=1, keepdims=True) * means[c]
            carried = np.asarray(self._times_covariance(c, off))
            variance = np.maximum(np.sum(carried * off, axis=1), 0.0)
            if self.rig_errors is not None:
                variance = variance + np.sum((np.asarray(self.rig_errors)[:, c] @ off.T) ** 2, 0)
            rows.append(np.sqrt(variance))
        if self.friction is not None:
            rows.append(np.abs(float(self.friction)) * rows[0])
        return jnp.asarray(np.stack(rows))

    def _times_covariance(self, c: int, rows: np.ndarray) -> Array:
        """Rows (m, n) times the covariance of component c."""
        n, covariance = self.line.n, self.covariance
        assert covariance is not None
        if covariance.ndim == 3:
            return jnp.fft.irfft(jnp.fft.rfft(rows) * covariance[c, c].real, n)
        return jnp.asarray(rows) @ covariance[c * n : (c + 1) * n, c * n : (c + 1) * n]


def deviation(values: np.ndarray, cells: np.ndarray | None = None) -> np.ndarray:
    """Values (..., n) of the cells that the mask `cells` (n,) picks, of all without one, less their
    mean."""
    values = np.asarray(values) if cells is None else np.asarray(values)[..., cells]
    return values - values.mean(axis=-1, keepdims=True)


Values = Float[np.ndarray, "*row n"]
Truth = Float[np.ndarray, "#*row n"]
Score = Float[np.ndarray, "*row"]


def relative_error(value: Values, truth: Truth, cells: np.ndarray | None = None) -> Score:
    """The relative error of a traction: norm of the error over norm of the truth, less their means.

    - `value`, `truth` (..., n): p or q, or both (2, n), in the same unit, on the same line.
    - `cells` (n,): a mask of the cells that are compared and that the means are over; None: all.

    Returns one number for each row, NaN for a truth that is uniform.
    """
    true = deviation(truth, cells)
    size = np.linalg.norm(true, axis=-1)
    wrong = np.linalg.norm(deviation(value, cells) - true, axis=-1)
    return np.asarray(wrong / np.where(size > 0, size, np.nan))


def overall_error(value: Values, truth: Truth, cells: np.ndarray) -> Float[np.ndarray, "*answer"]:
    """[`relative_error`][] of p and q (..., 2, n) together, by the norm of both."""
    true = deviation(truth, cells)
    size = np.linalg.norm(true, axis=(-2, -1))
    wrong = np.linalg.norm(deviation(value, cells) - true, axis=(-2, -1))
    return np.asarray(wrong / np.where(size > 0, size, np.nan))


def coverage_90(value: Values, stderr: Values, truth: Truth, cells: np.ndarray) -> Score:
    """The fraction of the cells of the mask `cells` (n,) whose 90 % band holds the truth, both
    less their mean over these."""
    wrong = deviation(value, cells) - deviation(truth, cells)
    return np.asarray(np.mean(np.abs(wrong) <= BAND_90 * stderr[..., cells], axis=-1))


def z_rms(value: Values, stderr: Values, truth: Truth, cells: np.ndarray) -> Score:
    """Rms over `cells` of the error in standard errors, value and truth less their means; infinite
    where a wrong value has no error."""
    wrong = deviation(value, cells) - deviation(truth, cells)
    stderr = np.maximum(stderr[..., cells].astype(float), np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # to infinity
        z = np.where(wrong == 0, 0.0, np.abs(wrong) / stderr)
        return np.asarray(np.sqrt(np.mean(z**2, axis=-1)))


def highest(
    value: Float[np.ndarray, "*row n"], x: Float[np.ndarray, " n"], cells: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "*row"], Float[np.ndarray, "*row"]]:
    """The highest value of each row over `cells`, a mask, and its place [m]."""
    value, x = value[..., cells], x[cells]
    top = np.argmax(np.where(np.isnan(value), -np.inf, value), axis=-1)
    return np.take_along_axis(value, top[..., None], -1)[..., 0], x[top]


def averages(r: Float[Array, "c n"], line: Line, onto: Line) -> Float[Array, "c m"]:
    """Averages over the cells of `onto` of what is constant over each cell of `line` and zero
    beyond."""
    edges, other = (each.start_m + each.cell_m * (np.arange(each.n + 1) - 0.5)
                    for each in (line, onto))  # fmt: skip
    total = line.cell_m * jnp.pad(jnp.cumsum(r, axis=-1), ((0, 0), (1, 0)))
    return jnp.stack([jnp.diff(jnp.interp(other, edges, row)) for row in total]) / onto.cell_m


def overlap(line: Line, onto: Line) -> np.ndarray:
    """The fraction (m, n) of each cell of `onto` that lies in each cell of `line`; NaN in the rows
    of cells that go beyond the line."""
    own, other = _edges(line), _edges(onto)
    low = np.maximum(own[None, :-1], other[:-1, None])
    high = np.minimum(own[None, 1:], other[1:, None])
    weights = np.maximum(high - low, 0.0) / float(onto.cell_m)
    slack = 1e-6 * float(line.cell_m)
    outside = (other[:-1] < own[0] - slack) | (other[1:] > own[-1] + slack)
    weights[outside] = np.nan
    return weights


def _edges(line: Line) -> np.ndarray:
    return float(line.start_m) + float(line.cell_m) * (np.arange(line.n + 1) - 0.5)


def full_width_at_half_maximum(
    lag_m: Float[np.ndarray, " n"], kernel: Float[np.ndarray, " n"]
) -> float:
    """Width [m] of the peak of `kernel` (n,) over `lag_m` (n,), between its two crossings of half
    the maximum, straight lines between samples; NaN where it does not fall that far."""
    if not np.isfinite(kernel).all() or kernel.max() <= 0:
        return float("nan")
    top, half = int(np.argmax(kernel)), kernel.max() / 2
    left = np.flatnonzero(kernel[:top] < half)
    right = np.flatnonzero(kernel[top:] < half)
    if not left.size or not right.size:
        return float("nan")

    def crossing(i: Any, j: Any) -> float:
        fraction = (half - kernel[i]) / (kernel[j] - kernel[i])
        return float(lag_m[i] + fraction * (lag_m[j] - lag_m[i]))

    return crossing(top + right[0] - 1, top + right[0]) - crossing(left[-1], left[-1] + 1)


def cutoff(
    k: Float[np.ndarray, " k"], resolution: Float[np.ndarray, "*c k"]
) -> Float[np.ndarray, "*c"]:
    """The cut-off wavenumber [rad/m]: where the resolution (..., k) last falls through one half;
    NaN if nowhere."""
    high = resolution[..., :-1] >= 0.5
    falls = high & (resolution[..., 1:] < 0.5)
    last = falls.shape[-1] - 1 - np.argmax(falls[..., ::-1], axis=-1)
    upper = np.take_along_axis(resolution, last[..., None], -1)[..., 0]
    lower = np.take_along_axis(resolution, last[..., None] + 1, -1)[..., 0]
    fraction = (upper - 0.5) / np.where(upper > lower, upper - lower, 1.0)
    return np.where(falls.any(axis=-1), k[last] + fraction * (k[1] - k[0]), np.nan)
