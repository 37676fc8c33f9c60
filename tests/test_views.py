"""What a person sees of an answer in Python: the printed report, figures, arrays and tables."""

import html.parser
import sys
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import srsinv
from srsinv import plot
from srsinv.numerics import BAND_90
from srsinv.report.printed import MOST_LINES, WIDTH

X = np.linspace(0.0, 1.0, 60)
NOISE = 0.02
LINE = srsinv.Periodic(64, cell_m=3e-4, start_m=-9.6e-3)
TAGS = ("div", "p", "b", "table", "thead", "tbody", "tr", "ul", "li")
HOSTILE = "<b onclick=x>\x1b[31m&\u202e_m"


def decay(params):
    """One model for all fits, which compiles once."""
    size, rate, level = (params[name] for name in ("size_Pa", "rate", HOSTILE))
    return 1e-3 * size * jnp.exp(-rate * X) + level


def fit(**options):
    rng = np.random.default_rng(0)
    data = 3.0 * np.exp(-2.0 * X) + 1e-4 + NOISE * rng.normal(size=X.size)
    initial = {"size_Pa": 1e3, "rate": 1.0, HOSTILE: 0.0}
    return srsinv.fit(decay, initial, data, **options)


fitted = cache(fit)


@cache
def inverted(method=None):
    scene = srsinv.TractionScene(1e4, 0.4, [srsinv.UniformStrip(4e3, 3e-3)])
    noises = [srsinv.SignalToNoise(40)]
    scenario = srsinv.Scenario(scene, srsinv.Sensor(), srsinv.ConstantSpeed(0.05), noises)
    made = srsinv.simulate(scenario, LINE, refinement=2)
    return made, srsinv.invert(made.problem, method)


@cache
def features():
    path = srsinv.examples.path("strip_two_element")
    return srsinv.fit_recording(path, {"strip": srsinv.StripFeature()})


def check_report(answer):
    """Its text and its HTML, which say the same under the limits of both."""
    text, page = str(answer), answer._repr_html_()
    assert len(text.splitlines()) < 40
    assert all(len(line) <= WIDTH and line.isprintable() for line in text.splitlines())
    assert f": {answer.quality}." in text.splitlines()[0]
    assert f": {answer.quality}." in page
    assert len(repr(answer).splitlines()) == 1
    parser = html.parser.HTMLParser()
    tags = set()
    parser.handle_starttag = lambda tag, attrs: tags.add((tag, *dict(attrs)))
    parser.feed(page)
    assert tags <= {*((tag,) for tag in TAGS), ("th", "style"), ("td", "style")}
    assert "color" not in page  # those of the notebook
    return text


def check_dataset(data):
    assert all("units" in each.attrs for each in data.variables.values())


def test_a_fit_is_printed_with_its_parameters():
    text = check_report(fitted())
    assert "60 data points" in text
    assert "kPa" in text  # by the name's unit
    (row,) = [line for line in text.splitlines() if line.startswith("rate")]
    value, stderr = fitted().value["rate"], fitted().stderr["rate"]
    low, high = value - BAND_90 * stderr, value + BAND_90 * stderr
    said = [float(word) for word in row.split() if word[0].isdigit()]
    np.testing.assert_allclose(said, [value, stderr, low, high], rtol=0.05)


def test_what_a_user_has_named_is_printed_as_text():
    text = check_report(fitted())
    assert "\\x1b" in text
    assert "<b onclick" not in fitted()._repr_html_()
    assert "&lt;b onclick" in fitted()._repr_html_()


NOTED = {
    "on a bound": ("rate", {"bounds": {"rate": (0.0, 1.5)}}),
    "fixed": ("rate", {"free": ("size_Pa", HOSTILE)}),
}


@pytest.mark.parametrize("note", NOTED)
def test_a_note_says_why_an_error_is_not_valid(note):
    name, options = NOTED[note]
    text = check_report(fit(noise=NOISE, **options))
    (row,) = [line for line in text.splitlines() if line.startswith(name)]
    assert row.endswith(note)


def test_a_direction_that_the_data_leave_open_is_noted():
    made = srsinv.fit(lambda p: (p["a"] + p["b"]) * jnp.ones(9), {"a": 1.0, "b": 0.0}, np.ones(9))
    text = check_report(made)
    assert text.count("not identifiable") == 2
    assert "- The data do not determine" in text


def test_many_parameters_and_warnings_stay_short():
    made = srsinv.fit(lambda p: p["a"] + p["a"][::-1], {"a": np.arange(60.0)}, np.ones(60), noise=1)
    text = check_report(made)
    assert "45 more: to_dataframe() gives all" in text
    assert len(text.splitlines()) <= MOST_LINES
    assert len(made.to_dataframe()) == 60
    assert made._repr_html_().count("<tr>") == 61


def test_an_inversion_is_printed_with_p_and_q():
    made, estimate = inverted()
    text = check_report(estimate)
    assert f"{made.problem.sample_count} data points of 2 elements, 64 cells" in text
    (row,) = [line for line in text.splitlines() if line.startswith("p ")]
    peak = float(np.max(estimate.value[0])) / 1e3
    assert float(row.split()[1]) == pytest.approx(peak, rel=0.02)
    assert "kPa" in row
    assert "does not show the mean of q" in text


def test_a_failed_answer_says_so_and_has_no_bands():
    made, _ = inverted()
    estimate = made.problem.estimate(jnp.zeros((2, 64)), jnp.ones((2, 64)))
    assert estimate.quality == "failed"
    text = check_report(estimate)
    assert "These numbers are no answer" in text
    assert np.isinf(estimate.to_xarray()["estimate_stderr"]).all()


def test_arrays_have_units_and_the_names_of_a_result():
    made, estimate = inverted()
    data = estimate.to_xarray()
    check_dataset(data)
    np.testing.assert_array_equal(data["estimate"], estimate.value)
    assert data["estimate"].dims == ("component", "x")
    assert data["fitted_signal"].attrs["units"] == made.problem.sensor.amplifier.unit
    elsewhere = estimate.on(srsinv.Periodic(64, 1e-4, -3e-3)).to_xarray()
    check_dataset(elsewhere)
    assert elsewhere["fitted_signal"].dims == ("element", "sample")  # no longer the line's cells
    check_dataset(fitted().to_xarray())


def test_tables_hold_parameters_or_p_and_q():
    pandas = pytest.importorskip("pandas")
    table = fitted().to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["name", "value", "stderr", "low", "high", "unit"]
    own = table.set_index("name").loc["size_Pa"]
    assert (own["value"], own["unit"]) == (fitted().value["size_Pa"], "Pa")
    assert own["high"] - own["low"] == pytest.approx(2 * BAND_90 * own["stderr"])
    _, estimate = inverted()
    along = estimate.to_dataframe()
    assert list(along.columns) == ["x_m", "p_Pa", "p_stderr_Pa", "q_Pa", "q_stderr_Pa"]
    np.testing.assert_array_equal(along["q_Pa"], estimate.value[1])


def test_without_pandas_a_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(srsinv.BadInput, match="pip install pandas"):
        fitted().to_dataframe()


def labels(figure):
    return {line.get_label() for axes in figure.axes for line in axes.get_lines()}


def test_an_estimate_is_drawn_over_the_truth():
    made, estimate = inverted()
    figure = estimate.plot(truth=made.traction)
    assert isinstance(figure, Figure)
    assert len(figure.axes) == 2
    assert "truth" in labels(figure)
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(srsinv.BadInput, match=r"\(2, 3\): give .* \(2, 64\)"):
        estimate.plot(truth=np.zeros((2, 3)))


def test_estimates_by_name_are_compared():
    _, estimate = inverted()
    other = estimate.on(srsinv.Periodic(32, 6e-4, -9.45e-3))
    figure = plot.estimates({"fine": estimate, "coarse": other})
    assert {"fine", "coarse"} <= labels(figure)
    alone, data = plot.estimates(estimate), plot.estimates(estimate.to_xarray())
    assert labels(alone) == labels(data)


@pytest.mark.parametrize("given", [5, {}, {"a": 1}, "result.nc"])
def test_what_cannot_be_drawn_is_refused(given):
    with pytest.raises(srsinv.BadInput, match="cannot be drawn: give an estimate"):
        plot.estimates(given)


def test_a_fit_is_drawn_over_x_or_its_samples():
    by_number, over_x = fitted().plot(), fitted().plot(X)
    for figure, last in ((by_number, X.size - 1), (over_x, X[-1])):
        assert len(figure.axes) == 2  # data with fit, and residual
        assert figure.axes[0].get_xlim()[1] == pytest.approx(last)
    with pytest.raises(srsinv.BadInput, match="give one of 60 numbers"):
        fitted().plot(x=X[:-1])


@pytest.mark.full
def test_features_are_printed_and_drawn_with_what_they_fit():
    made, truth = features(), srsinv.examples.truth("strip_two_element")
    text = check_report(made)
    assert text.splitlines()[0] == "Strip fitted; quality: good."
    table = made.to_dataframe().set_index("name")
    for name in ("position_m", "width_m", "pressure_Pa", "friction"):
        assert table.loc[name, "low"] < truth[name] < table.loc[name, "high"]
    check_dataset(made.to_xarray())
    assert made.to_xarray()["signal"].attrs["units"] == "V"
    assert len(made.plot().axes) == 2 + 2 * 2
    assert len(made.on(LINE).plot().axes) == 2 + 2 * 2
    check_report(made.fit)
