"""Views of an answer: its printed report, its figure, its arrays and its table of parameters.

Estimates and fits have them in common. The report room, which stands above the inversions, makes
them from the answer's dataset; it is imported when a view is asked for.
"""

import abc
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .errors import BadInput
from .numerics import BAND_90

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

_OF_UNKNOWN = {"value": "value", "stderr": "value_stderr"}
Arrays = dict[str, tuple[Any, ...]]


class ViewData(NamedTuple):
    """What the views of an answer are made of.

    - `title`: what the answer is, in a few words.
    - `variables`, `coordinates`: arrays by name, as `srsinv.report.data.dataset` takes them.
    - `parameters`: value and standard error by name, in SI units; `notes` on some of them, by name.
    - `attributes`: of the dataset.
    - `intervals`: ends of the 90 % interval by name, of parameters whose interval is not the
      standard error's.
    """

    title: str
    variables: Arrays
    coordinates: Arrays
    parameters: Mapping[str, tuple[float, float]]
    notes: Mapping[str, str]
    attributes: Mapping[str, Any] = {}
    intervals: Mapping[str, tuple[float, float]] = {}


class Views(abc.ABC):
    """Views of an answer: `print` gives a report, a notebook the same as HTML, and `plot`,
    `to_xarray` and `to_dataframe` give figures, arrays and tables.

    A class that has them gives `view_data`, and has `quality`, `status`, `warnings`, `reasons` and
    `stats`.
    """

    @abc.abstractmethod
    def view_data(self) -> ViewData:
        """What is printed, plotted and tabulated."""

    def to_xarray(self) -> "xarray.Dataset":
        """The arrays and numbers of the answer, each with the attribute `units`.

        Names are those that `result.nc` of a run has: `estimate` (component, x), `estimate_stderr`,
        `fitted_signal`, `whitened_residual`, `parameter_value` (reported), `quality`, `warnings`
        and others, of which an answer has some.
        """
        return self._dataset()

    def _dataset(self) -> "xarray.Dataset":
        """What is printed and drawn of the answer."""
        from .report.answers import answer_of, reported_parameters
        from .report.data import dataset, scalars

        answer: Any = self
        of = self.view_data()
        title, variables, coordinates, parameters, notes, attributes, intervals = of
        named: Arrays = {}
        if parameters:
            coordinates = coordinates | {"reported": (np.array(list(parameters), str), "1")}
            named = reported_parameters(parameters)
            every = np.array([notes.get(name, "") for name in parameters], str)
            named["parameter_note"] = ("reported", every, "1")
        if intervals:
            ends = np.array([intervals.get(name, (np.nan, np.nan)) for name in parameters])
            named["parameter_low"], named["parameter_high"] = (
                ("reported", own, "SI") for own in ends.T
            )
        every = scalars(answer.stats) | variables | named | answer_of(answer)
        return dataset(every, coordinates, title=title, **attributes)

    def to_dataframe(self) -> "pandas.DataFrame":
        """The answer as a table, in SI units.

        With parameters, a row for each: name, value, stderr, low and high (the ends of the 90 %
        interval) and unit. Without, a row for each cell: x_m, p_Pa, p_stderr_Pa, q_Pa,
        q_stderr_Pa; of a linear problem a row for each unknown: index, value and stderr.

        Raises `BadInput` where pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise BadInput(
                "to_dataframe needs pandas, which is not installed: type pip install pandas."
            ) from error
        data = self._dataset()
        if "value_stderr" in data:
            flat = {name: data[key].values.ravel() for name, key in _OF_UNKNOWN.items()}
            return pandas.DataFrame({"index": np.arange(data["value"].size), **flat})
        if "reported" not in data.dims:
            columns = {"x_m": data["x"].values}
            for name, of in data.groupby("component"):
                columns[f"{name}_Pa"] = of["estimate"].values.ravel()
                columns[f"{name}_stderr_Pa"] = of["estimate_stderr"].values.ravel()
            return pandas.DataFrame(columns)
        value, stderr = data["parameter_value"].values, data["parameter_stderr"].values
        ends = {"low": value - BAND_90 * stderr, "high": value + BAND_90 * stderr}
        for what, normal in ends.items():
            if (own := data.get(f"parameter_{what}")) is not None:
                ends[what] = np.where(np.isnan(own.values), normal, own.values)
        return pandas.DataFrame(
            {"name": data["reported"].values, "value": value, "stderr": stderr, **ends,
             "unit": data["parameter_unit"].values}
        )  # fmt: skip

    def plot(
        self, x: Any = None, *, truth: Any = None, marks: Sequence[Any] = (), title: Any = None
    ) -> "Figure":
        """A figure of the answer: p and q with their 90 % bands along x, and each signal with its
        fit and residual, those that it has.

        - `x` (sample,): what the data of a fit are drawn over; None: position or number.
        - `truth` (2, n) [Pa]: the true p and q on the line of an estimate; of a linear problem the
          true unknown, in its shape.
        - `marks`: of `srsinv.plot.Mark`, across the panels of p and q.
        - `title`: of the figure; None: what the answer is, and its quality.

        Raises `BadInput` for a truth or an `x` of another shape.
        """
        from .report import plot

        return plot.answer(self._dataset(), truth=truth, x=x, marks=marks, title=title)

    def __str__(self) -> str:
        from .report.printed import text

        return text(self._dataset(), self._reasons)

    def __repr__(self) -> str:
        answer: Any = self
        return f"<{type(self).__name__}: {answer.quality}; print it for a report>"

    def _repr_html_(self) -> str:
        from .report.printed import html

        return html(self._dataset(), self._reasons)

    @property
    def _reasons(self) -> tuple[str, ...]:
        answer: Any = self
        return answer.reasons
