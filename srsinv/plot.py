"""The figures of pages, public: what `srsinv.report.plot` has, under the name that stays."""

from .report.plot import *  # noqa: F403
