"""Results as data: metrics are views of the dataset, sections show where their needs are met."""

import html
import json
import re

import numpy as np
import pytest
import xarray

import srsinv
from srsinv.report.data import dataset, scalars
from srsinv.report.files import render
from srsinv.report.result import Result
from srsinv.report.section import WrittenSection, sections
from srsinv.report.terminal import print_summary
from srsinv.report.text import format_with_error, quantity_with_error
from srsinv.report.words import Paragraph, Table, blocks

DATA = dataset(
    {
        "error": (("estimator", "component"), [[0.1, np.nan], [0.3, 0.4]], "1",
                  "error_{component}_{estimator}"),
        "value": ("parameter", [2e-5, 5e3], "SI", "{parameter!s}"),
        "wave": ("x", np.sin(np.arange(8.0)), "Pa"),
        "quality": ("estimator", ["good", "failed"], "1", "quality_{estimator}"),
        "reasons": ("estimator", ["", "It did not converge."], "1"),
        **scalars({"height_m": 2e-5, "cells": 8, "is_even": True, "word": "none", "unknown": None}),
    },
    {
        "estimator": (["Wiener paper", "Tikhonov"], "1"),
        "component": (["p", "q"], "1"),
        "parameter": (["height_m", "pressure_Pa"], "1"),
        "x": (np.arange(8) * 1e-3, "m"),
    },
    cells_wide=3,
)  # fmt: skip


def test_metrics_are_the_marked_variables_element_by_element():
    assert Result("", DATA).metrics == {
        "error_p_wiener_paper": 0.1, "error_q_wiener_paper": None,
        "error_p_tikhonov": 0.3, "error_q_tikhonov": 0.4,
        "height_m": 2e-5, "pressure_Pa": 5e3,
        "quality_wiener_paper": "good", "quality_tikhonov": "failed",
        "cells": 8, "is_even": True, "word": "none", "unknown": None,
    }  # fmt: skip


def test_a_result_keeps_its_metrics_in_its_file():
    files = render(Result("A title", DATA), {})
    with xarray.open_dataset(files["result.nc"], engine="h5netcdf") as stored:
        assert Result("", stored.load()).metrics == Result("", DATA).metrics
    metrics = json.loads(files["metrics.json"])
    assert metrics["error_q_wiener_paper"] is None
    assert metrics["is_even"] is True


@pytest.mark.parametrize("name", ["missing_{0.__class__}", "missing_{x", "a}}b", "{}"])
def test_a_name_from_a_file_is_no_pattern(name):
    assert Result("", dataset(scalars({name: 1.0}), {})).metrics == {name: 1.0}


@pytest.mark.parametrize(("name", "unit"), [
    ("height_m", "m"), ("width_m_stderr", "m"), ("load_N_per_m", "N/m"), ("speed_m_per_s", "m/s"),
    ("first_call_s", "s"), ("friction", "1"), ("snr_dB", "dB"), ("noise_rms_V", "V"),
])  # fmt: skip
def test_a_number_has_the_unit_at_its_names_end(name, unit):
    assert dataset(scalars({name: 1.0}), {})[name].attrs["units"] == unit


@pytest.mark.parametrize(
    ("needs", "is_met"),
    [
        ({}, True),
        ({"wave": ("x",)}, True),
        ({"wave": ("x", "estimator")}, False),
        ({"absent": ()}, False),
        ({"wave": ("x",), "absent": ()}, False),
    ],
)
def test_a_section_is_shown_where_the_data_have_what_it_needs(needs, is_met):
    own = WrittenSection("Wave", needs, "It goes up and down.")
    page = render(Result("A title", DATA, (own,)), {})["report.html"].decode()
    assert ("It goes up and down." in page) == is_met


PAGE = """
Printed: {{ m.height_m|quantity("m") }}.

{{ table({"method": ds.estimator, "error of p": ds.error.sel(component="p")|percent}) }}

# Wave
needs: wave(x)
folded
A first paragraph
in two lines.

- an item with `code`

{{ figure("wave", plot.curves, "The wave goes up and down.", names="wave") }}

# Lacking
needs: absent(x)
{{ ds.absent }}
"""


@pytest.fixture
def result(tmp_path) -> Result:
    (tmp_path / "job.md.j2").write_text(PAGE)
    return Result("Waves & <more>", DATA, sections(str(tmp_path / "job.py")))


def test_a_page_is_read_from_the_file_beside_the_job(result):
    headline, wave, lacking = result.sections
    assert (headline.heading, wave.heading, lacking.heading) == ("", "Wave", "Lacking")
    assert (headline.is_folded, wave.is_folded) == (False, True)
    assert wave.needs == {"wave": ("x",)}
    first, second, _ = blocks(wave, DATA)
    assert first == Paragraph("A first paragraph in two lines.")
    assert second == Paragraph("an item with `code`", is_item=True)
    (_, caption) = result.page.figures["wave"]
    assert caption == "The wave goes up and down."


def test_a_job_that_is_a_folder_has_its_page_in_it(tmp_path):
    (tmp_path / "page.md.j2").write_text(PAGE)
    headings = [each.heading for each in sections(str(tmp_path / "__init__.py"))]
    assert headings == ["", "Wave", "Lacking"]


def test_the_page_says_the_result_before_everything(result):
    page = render(result, {}, "srsinv experiment=waves")["report.html"].decode()
    assert "<h1>Waves &amp; &lt;more&gt;</h1>" in page
    order = ["<h1>", "these numbers are no answer. It did not converge.", "20.0\xa0µm",
             "error of p", "srsinv experiment=waves", "<h2>Wave</h2>"]  # fmt: skip
    assert sorted(order, key=page.index) == order
    assert "Lacking" not in page
    assert 'alt="The wave goes up and down."' in page
    assert "<code>code</code>" in page


OPEN = WrittenSection("Open", words='{{ figure("open", plot.curves, "Of waves.", names="wave") }}')


def drawn_on_page(result: Result, figures: str) -> tuple[set[str], int]:
    """The figures among a run's files, and the number of images on its page."""
    files = render(result, {}, figures=figures)
    return (
        {name for name in files if name.startswith("figures/")},
        files["report.html"].decode().count("<img"),
    )


def test_figures_are_drawn_where_the_page_is_open(result):
    both = result.with_sections((OPEN,))
    assert drawn_on_page(both, "page") == ({"figures/open.png"}, 1)
    assert drawn_on_page(both, "all") == ({"figures/open.png", "figures/wave.png"}, 2)
    assert drawn_on_page(both, "none") == (set(), 0)
    page = both.page_with("page").html()
    assert re.search(r"<details>\s*<summary><h2>Wave", page)
    assert "figures=all" in page
    assert "The wave goes up and down." in page
    # A page of folded sections alone is open.
    assert drawn_on_page(result, "page") == ({"figures/wave.png"}, 1)


def test_the_page_says_what_draws_a_figure_that_it_lacks(result, tmp_path, monkeypatch):
    page = html.unescape(result.page_with("none").html())
    (python,) = re.findall(r"<code>(srsinv\.plot\..*?)</code>", page)
    monkeypatch.chdir(tmp_path)
    DATA.to_netcdf("result.nc", engine="h5netcdf")
    names = {"srsinv": srsinv, "xarray": xarray}
    eval(python, names)
    assert (tmp_path / "wave.png").stat().st_size > 1000
    figure = eval(python.partition(".savefig")[0], names)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 1e3 * DATA["wave"])


def test_the_terminal_prints_the_same_headline(result, capsys):
    print_summary(result)
    printed = capsys.readouterr().out
    assert printed.splitlines()[:2] == ["Waves & <more>", "Printed: 20.0 µm."]
    assert "| Tikhonov     | 30.0 %     |" in printed
    assert "Tikhonov, failed: these numbers are no answer. It did not converge." in printed
    assert "first paragraph" not in printed


def test_words_from_a_file_do_not_stand_for_a_table():
    data = dataset(scalars({"name": "\x000\x00"}), {})
    own = WrittenSection("S", words='{{ table({"a": [1]}) }}\n\n{{ m.name }}')
    first, second = blocks(own, data)
    assert isinstance(first, Table)
    assert second == Paragraph("0")


def test_a_column_has_one_unit():
    own = WrittenSection("S", words='{{ table({"width": ds.w|quantity("m")}) }}')
    data = dataset({"w": ("i", [7.5e-4, 2.25e-3, np.nan], "m")}, {"i": ([0, 1, 2], "1")})
    (table,) = blocks(own, data)
    assert isinstance(table, Table)
    assert table.rows == (("0.750 mm",), ("2.25 mm",), ("–",))


@pytest.mark.parametrize(
    ("cell", "shown"),
    [
        ("100 %", "100\xa0%"),
        ("25.89 ± 0.32 µm", "25.89\xa0±\xa00.32\xa0µm"),
        ("11.5 nV s", "11.5\xa0nV\xa0s"),
        ("two words", "two words"),
    ],
)
def test_no_line_ends_between_a_number_and_its_unit(cell, shown):
    data = dataset(scalars({"width": cell}), {})
    page = render(Result(f"Of {cell}", data), {})["report.html"].decode()
    assert f"<td>{shown}</td>" in page
    assert f"<h1>Of {shown}</h1>" in page


@pytest.mark.parametrize(("typed", "printed"), [
    ("1e-05", "10⁻⁵"), ("-2.5e-06 V", "−2.5\xa0×\xa010⁻⁶\xa0V"), ("towards -x", "towards −x"),
    ("depth_m=5e-5", "depth_m=5e-5"), ("2026-11-28", "2026-11-28"), ("file-3e5.csv",
    "file-3e5.csv"),
])  # fmt: skip
def test_powers_and_signs_are_typeset_but_in_settings_and_names(typed, printed):
    data = dataset(scalars({"width": typed}), {})
    page = render(Result(typed, data), {})["report.html"].decode()
    assert f"<td>{printed}</td>" in page
    assert f"<h1>{printed}</h1>" in page


def test_rows_of_one_quantity_share_a_unit_that_reads_well():
    words = '{{ table({"w": ds.w|with_error(ds.e, ["m"] * 3)}) }}'
    data = dataset(
        {"w": ("i", [1.03e-3, 9.3e-4, 2e-5], "m"), "e": ("i", [1e-5, 1e-5, 1e-6], "m")},
        {"i": ([0, 1, 2], "1")},
    )
    (table,) = blocks(WrittenSection("S", words=words), data)
    assert isinstance(table, Table)
    assert [row[0].split()[-1] for row in table.rows] == ["mm", "mm", "µm"]


def test_an_interval_from_zero_has_the_unit_of_its_upper_end():
    words = '{{ table({"w": ds.low|between(ds.high, ["m"])}) }}'
    data = dataset({"low": ("i", [0.0], "m"), "high": ("i", [6e-4], "m")}, {"i": ([0], "1")})
    (table,) = blocks(WrittenSection("S", words=words), data)
    assert isinstance(table, Table)
    assert table.rows[0][0] == "0 to 600 µm"


@pytest.mark.parametrize(("value", "stderr", "units", "written"), [
    (2.5894e-5, 3.2e-7, "m", "25.89 ± 0.32 µm"),
    (1.50204e-3, 1.2e-5, "m", "1.502 ± 0.012 mm"),
    (6009.26, 9.02, "Pa", "6.0093 ± 0.0090 kPa"),
    (0.4468, 0.0021, "1", "0.4468 ± 0.0021"),
    (2.5e-5, np.inf, "m", "25.0 µm (error not known)"),
])  # fmt: skip
def test_a_value_is_written_to_the_second_digit_of_its_error(value, stderr, units, written):
    assert quantity_with_error(value, stderr, units) == written


def test_an_unknown_error_is_said_to_be_so():
    assert format_with_error(0.35, np.inf) == "0.350 (error not known)"
