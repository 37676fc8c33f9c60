"""Figures of estimates, fits and results: `srsinv.plot.answer(estimate)`, `.estimates`, `.fit` and
those of pages, each of which takes the dataset of a result.

Every function gives a matplotlib `Figure`; `figure.savefig("name.png")` writes it. Values are in SI
units, and axes have the unit in which they read well.
"""

from types import ModuleType

from .report.plot import *  # noqa: F403

__all__ = sorted(  # pyright: ignore[reportUnsupportedDunderAll]
    name
    for name, each in globals().items()
    if not name.startswith("_") and not isinstance(each, ModuleType) and name != "ModuleType"
)


def __dir__() -> list[str]:
    return list(__all__)
