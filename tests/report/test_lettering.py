"""Names from files on figures and pages: shown as they are written, whatever they hold."""

import io
import json
from collections.abc import Sequence

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from matplotlib.text import Text

from srsinv import plot
from srsinv.jobs import _inspection_plots as own
from srsinv.report.plot.style import grid_of_axes, legend_beside, styled
from tests.jobs.run import command
from tests.recording.files import N, columns, write_csv
from tests.report import synthetic
from tests.tiers import quick

NAMES = (
    "a$b", "$", "$$", r"$\frac{", r"$\frac{1}{2}$", "x_^{", "100 %", "\\", r"\$", "<b>bold</b>",
    "&amp;", "😀", "\u200fabc\u202e", "温度", "n" * 200, "$" * 200, "many words " * 18, r"$\mu$$",
)  # fmt: skip
PAGE = (
    plot.scene, plot.traction, plot.stress, plot.signals, plot.residual, plot.estimates,
    plot.spectra, plot.averaging_kernel,
)  # fmt: skip
INSPECTION = (own.signals, own.spectra, own.motion)


def saved(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=40, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()


def texts(figure: Figure) -> list[Text]:
    return [each for each in figure.findobj(Text) if isinstance(each, Text) and each.get_text()]


@pytest.mark.full
@pytest.mark.parametrize("draw", PAGE)
def test_every_figure_of_the_page_with_names_from_files(draw):
    dataset = synthetic.dataset(elements=3, samples=64)
    named = dataset.assign_coords(element=[r"0: $\frac{", f"1: {'n' * 200}", "$2:温"])
    assert saved(draw(named))


def inspected(names: Sequence[str], units: Sequence[str]) -> xarray.Dataset:
    """A dataset as the inspection makes it, each signal of one line and noise."""
    signals = len(names)
    rng, rows, bins = np.random.default_rng(0), 64, 16
    of_signal, over = ("signal",), ("signal", "row")
    values = rng.normal(size=(signals, rows))
    variables = {
        "time": ("row", np.arange(rows) / 100, {"units": "s"}),
        "value": (over, values),
        "flat": (over, values > 1.5),
        "signal_unit": (of_signal, list(units)),
        "density": (("signal", "frequency"), np.ones((signals, bins))),
        "noise_floor": (of_signal, np.ones(signals)),
        "line_frequency": (("signal", "line"), np.full((signals, 1), 3.0)),
        "gap_start": ("gap", [0.2]),
        "gap_end": ("gap", [0.3]),
        "speed": ("row", np.ones(rows), {"units": "m/s"}),
    }
    coordinates = {
        "signal": ("signal", list(names)),
        "frequency": ("frequency", np.arange(1.0, bins + 1), {"units": "Hz"}),
    }
    return xarray.Dataset(variables, coordinates)


@pytest.mark.full
@pytest.mark.parametrize("draw", INSPECTION)
def test_figures_of_an_inspection_with_names_from_files(draw):
    assert saved(draw(inspected(NAMES, NAMES)))


SHORT = [each for each in NAMES if len(each) < 60]


@pytest.mark.parametrize("name", quick(SHORT, *SHORT[::8]))
def test_a_name_is_shown_as_it_is_written(name):
    """As the same characters are where no mathematics is read at all."""

    def panel(parse_math: bool | None) -> bytes:
        figure, grid = grid_of_axes(1, 1, 2.0)
        grid[0, 0].set_title("?" if parse_math is False else name)
        figure = styled(lambda: figure)()
        if parse_math is False:
            grid[0, 0].title.set_parse_math(False)
            grid[0, 0].title.set_text("".join("\ufffd" if c in "温度" else c for c in name))
        return saved(figure)

    if "$\\mu$" not in name:
        assert panel(None) == panel(False)


def test_formulae_stay_formulae_and_names_beside_them_do_not_become_any():
    @styled
    def draw() -> Figure:
        figure, grid = grid_of_axes(1, 1, 2.0)
        grid[0, 0].set(title=r"$\mu$ of a$b", xlabel=r"$\mu$", ylabel="a$b$c")
        return figure

    figure = draw()
    parsed = {each.get_text(): each.get_parse_math() for each in texts(figure)}
    assert parsed[r"$\mu$ of a\$b"]
    assert parsed[r"$\mu$"]
    assert not parsed["a$b$c"]
    assert saved(figure)


def test_names_at_ticks_and_in_legends():
    @styled
    def draw() -> Figure:
        figure, grid = grid_of_axes(1, 1, 4.0)
        for row, name in enumerate(NAMES):
            grid[0, 0].plot([0, 1], [row, row], label=name)
        grid[0, 0].set_yticks(range(len(NAMES)), NAMES)
        legend_beside(grid[0, 0])
        return figure

    figure = draw()
    assert saved(figure)
    assert all(len(text.get_text()) <= 2 * 38 for text in texts(figure))  # a dollar sign as two


@pytest.mark.full
def test_many_signals_and_gaps_are_drawn_in_part():
    dataset = inspected([*map(str, range(200))], ["V"] * 200)
    starts = np.linspace(0, 0.5, 50_000)
    gaps = {"gap_start": ("gap", starts), "gap_end": ("gap", starts + 1e-6)}
    figure = own.signals(dataset.drop_dims("gap").assign(gaps))
    assert len(figure.axes) == 24
    assert len(figure.axes[0].patches) <= 200


@pytest.mark.full
def test_an_inspection_of_such_names(tmp_path):
    """Page, numbers, arrays and sidecar hold them all; the page as text, not as marks."""
    names = [r"$\frac{", "<b>bold</b>", "\u200f温$" + "n" * 190]
    table = columns(voltage_0_V=None, voltage_1_V=None)
    rng = np.random.default_rng(0)
    table |= {f'"{name}"': rng.normal(size=N) for name in names}
    write_csv(tmp_path / "r.csv", table)
    (tmp_path / "r.json").write_text(json.dumps({"channels": names, "signal_unit": "<i>$x_^{"}))
    run = tmp_path / "run"
    assert command(run, "experiment=inspect_recording", f"recording.path={tmp_path}/r.csv") == 0
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "<b>bold" not in page
    assert "&lt;b&gt;bold" in page
    assert "<i>$x" not in page
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    assert all(f"missing_{name}" in metrics for name in names)
