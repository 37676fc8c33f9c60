"""The files of a run: numbers, arrays, figures and one self-contained page.

The same result gives the same bytes: no date, no random name, no version of a drawing library.
"""

from collections.abc import Mapping

from .data import metrics_json
from .result import Result


def render(
    result: Result, record: Mapping[str, str], command: str = "srsinv", figures: str = "all"
) -> dict[str, bytes]:
    """The files of a run's folder by their names in it: `metrics.json`, the dataset (`result.nc`),
    the page (`report.html`), `figures/*.png`, `.hydra/` and the result's own.

    Nothing is written: all is made in memory, where no full disk can cut it short. `record` maps
    the names in `.hydra` to their text, `command` is the command on the page, `figures` says which
    are drawn (page.py). Raises `ValueError` for a variable without `units`.
    """
    page = result.page_with(figures)
    texts: dict[str, str | bytes] = {
        **{f".hydra/{name}": text for name, text in record.items()},
        **result.files,
        "metrics.json": metrics_json(result.metrics),
        result.page_name: page.html(command),
    }
    variables = result.dataset.variables
    unitless = [str(name) for name, each in variables.items() if "units" not in each.attrs]
    if unitless:
        raise ValueError(f"variables without units in the result: {', '.join(unitless)}")
    return {
        **{name: text.encode() if isinstance(text, str) else text for name, text in texts.items()},
        result.data_name: bytes(result.dataset.to_netcdf(engine="h5netcdf")),
        **{f"figures/{name}.png": image for name, image in page.images.items()},
    }
