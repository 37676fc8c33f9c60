"""The answer of a linear problem."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...errors import BadInput
from ...known import Numbers, namespace
from ...status import Status
from ...views import Arrays, ViewData
from ..estimate import BandedAnswer, Stats
from ..quality import Quality


class LinearEstimate(BandedAnswer):
    """The unknown of a linear problem with its uncertainty.

    `print` gives a report; `plot`, `to_xarray`, `to_dataframe` give a figure, arrays, a table.

    - `value` (unknown): in the unknown's shape; `stderr` (unknown): its standard error.
    - `data` (sample), `fitted` (sample): the data, NaN where missing, and the fit to them, in the
      data's shape; `whitened` (sample): the residual in units of the noise.
    - `status`: how the computation ended; `warnings`: sentences on the validity of the bands.
    - `stats`: numbers of the solution, among them `weight` of the penalty, `rule`, `path`,
      `condition`, `resolved_dof` and `chi2_per_freedom`. Where a rule chose the weight on the
      iterative path: `probes` that estimate its degrees of freedom, 0 where they are exact, and
      `weight_error`, the standard deviation of the weight's logarithm by these.
    - `name`: of the problem.
    - `spread` (m, k): a root of `covariance`, of the flat unknown.
    - `gain` (m, s): the solution's response to whitened data, of the valid samples; `model` (s, m):
      the whitened operator. None on the iterative path, which forms no matrix.
    """

    value: Float[Numbers, "..."]
    stderr: Float[Numbers, "..."]
    data: Float[Numbers, "..."]
    fitted: Float[Numbers, "..."]
    whitened: Float[Numbers, "..."]
    spread: Float[Numbers, "m k"]
    status: Status = eqx.field(static=True, converter=Status)
    warnings: tuple[str, ...] = eqx.field(static=True)
    stats: Stats = eqx.field(converter=Stats)
    name: str = eqx.field(static=True)
    gain: Float[Numbers, "m s"] | None = None
    model: Float[Numbers, "s m"] | None = None

    @property
    def covariance(self) -> Float[Numbers, "m m"]:
        """The posterior covariance of the flat unknown; on the iterative path that of its draws."""
        return self.spread @ self.spread.T

    @property
    def resolution(self) -> Float[Numbers, "m m"]:
        """The resolution matrix: the value that a unit in each unknown alone would give, in
        columns. Raises `BadInput` on the iterative path."""
        if self.gain is None or self.model is None:
            raise BadInput("The iterative path forms no resolution matrix: give path=direct.")
        return self.gain @ self.model

    def view_data(self) -> ViewData:
        value, stderr = np.asarray(self.value), np.asarray(self.stderr)
        if self.quality is Quality.FAILED:
            stderr = np.full_like(stderr, np.inf)
        axes = tuple(f"index_{axis}" for axis in range(value.ndim)) if value.ndim != 1 else "index"
        signals = {
            name: (("element", "sample"), np.asarray(values).reshape(1, -1), "1")
            for name, values in (
                ("signal", self.data),
                ("fitted_signal", self.fitted),
                ("whitened_residual", self.whitened),
            )
        }
        variables: Arrays = {"value": (axes, value, "1"), "value_stderr": (axes, stderr, "1")}
        method = str(self.stats.get("method", "")).capitalize()
        title = f"{self.name} by {method}" if method else self.name
        return ViewData(title, variables | signals, {"element": ([""], "1")}, {}, {})


def standard_error(spread: Any) -> Any:
    """The standard error of each unknown, from a root of the covariance."""
    return namespace(spread).sqrt(namespace(spread).sum(spread**2, axis=1))
