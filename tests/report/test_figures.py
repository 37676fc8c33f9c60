"""The figures: what is drawn is what the dataset holds, with units, signs and cut-offs."""

import io
import re
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import xarray
from matplotlib.collections import PolyCollection
from scipy.special import ndtri

from srsinv import plot
from srsinv.numerics import runs
from srsinv.report.data import dataset
from srsinv.report.plot.style import colours, scale
from tests.report import synthetic
from tests.tiers import quick

BAND_90 = ndtri(0.95)
PAGE = (
    plot.scene,
    plot.traction,
    plot.stress,
    plot.signals,
    plot.residual,
    plot.estimates,
    plot.spectra,
    plot.averaging_kernel,
)


@pytest.fixture(scope="module")
def full():
    return synthetic.dataset(mean_unobserved="q")


@pytest.fixture(scope="module")
def page(full) -> dict[str, Any]:
    """The figures of the full run, by name; tests only look at them."""
    return {draw.__name__: draw(full) for draw in PAGE}


@pytest.fixture(scope="module")
def tilted_scene() -> Any:
    return plot.scene(synthetic.dataset(elements=3, samples=64))


@pytest.fixture(scope="module")
def recording():
    return synthetic.recording()


def panels_of(figure) -> list[Any]:
    return figure.axes


def line(axes, label):
    (curve,) = [line for line in axes.get_lines() if line.get_label() == label]
    return np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())


def verticals(axes):
    """Positions of the axes' vertical lines from bottom to top."""
    return sorted(
        line.get_xdata()[0]
        for line in axes.get_lines()
        if len(line.get_xdata()) == 2 and list(line.get_ydata()) == [0, 1]
    )


def png(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=40, metadata={"Software": None})
    return buffer.getvalue()


def drawn(figure):
    """The figure after a drawing that leaves out the slow search for a layout."""
    figure.set_layout_engine("none")
    figure.draw_without_rendering()
    return figure


def check_labels(figure):
    """Units on every axis label, and a legend where a panel has several lines."""
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel())]
    for label in filter(None, labels):
        assert re.search(r"\[.+\]$", label) or label == "element", label
    for axes in figure.axes:
        named = set(axes.get_legend_handles_labels()[1])
        legends = [axes.get_legend(), *figure.legends]
        shown = {text.get_text() for legend in legends if legend for text in legend.get_texts()}
        assert len(named) < 2 or named <= shown


@pytest.mark.parametrize("draw", quick(PAGE, *PAGE[::3]), ids=lambda draw: draw.__name__)
@pytest.mark.parametrize(
    "make",
    [
        lambda: synthetic.dataset(elements=3, samples=64, mean_unobserved="p,q"),
        synthetic.without_samples,
    ],
    ids=["three elements", "no samples"],
)
def test_page_figures_are_readable(draw, make):
    dataset = make()
    before = dataset.copy(deep=True)
    check_labels(drawn(draw(dataset)))
    assert dataset.identical(before)


@pytest.mark.full
@pytest.mark.parametrize("draw", quick(PAGE, *PAGE[::3]), ids=lambda draw: draw.__name__)
def test_same_bytes_whatever_the_users_settings(draw, recording, full):
    dataset = full if draw in (plot.traction, plot.stress) else recording
    figure = draw(dataset)
    first = png(figure)
    check_labels(figure)
    with mpl.rc_context({"lines.linewidth": 7.0, "font.size": 20.0, "axes.facecolor": "red"}):
        before = dict(mpl.rcParams)
        again = png(draw(dataset))
        assert dict(mpl.rcParams) == before
    assert again == first


@pytest.mark.parametrize(
    ("units", "values", "factor", "shown"),
    [
        ("Pa", [15e3, -2.0, np.nan], 1e-3, "kPa"),
        ("Pa", [1e3], 1e-3, "kPa"),
        ("Pa", [-999.0], 1.0, "Pa"),
        ("V", [3e-7], 1e9, "nV"),
        ("V m", [4e-5], 1e6, "µV m"),
        ("C", [2e-11], 1e12, "pC"),
        ("A", [1e-30], 1e15, "fA"),
        ("Pa", [0.0], 1.0, "Pa"),
        ("Pa", [np.nan, np.inf], 1.0, "Pa"),
        ("counts", [4e5], 1.0, "counts"),
        ("V^2", [1e-12], 1.0, "V²"),
        ("(V m)^2", [1e-12], 1.0, "(V m)²"),
        ("(counts)^2", [1e-12], 1.0, "counts²"),
    ],
)
def test_units_are_scaled_for_reading(units, values, factor, shown):
    chosen = scale(units, values)
    assert chosen.unit == shown
    assert chosen.factor == pytest.approx(factor)


def test_a_pressure_of_unknown_gain_is_relative(recording):
    labels = [axes.get_ylabel() for axes in plot.estimates(recording).axes]
    assert labels == ["pressure (relative) [1]", "shear (relative) [1]"]


def test_names_keep_their_colours():
    alone, together = colours(["Tikhonov"]), colours(["fit", "Wiener", "Tikhonov", "other"])
    assert alone["Tikhonov"] == together["Tikhonov"]
    assert len(set(together.values())) == 4
    assert colours(["p"])["p"] != colours(["q"])["q"]


def test_runs_of_a_mask():
    assert runs(np.array([1, 1, 0, 1, 0], bool)) == [(0, 2), (3, 4)]
    assert runs(np.zeros(3, bool)) == []


def test_traction_is_the_datasets(page, full):
    panels = page["traction"].axes
    assert [axes.get_ylabel() for axes in panels] == [
        "pressure p [kPa]",
        "shear q [kPa]",
        r"$\mu$ [1]",
    ]
    for axes, name, expected in zip(
        panels, ("p", "q", r"$\mu$"), (*full["traction"].values / 1e3, full["friction"].values),
        strict=True,
    ):  # fmt: skip
        x, y = line(axes, name)
        np.testing.assert_allclose(x, full["x"].values * 1e3)
        np.testing.assert_allclose(y, expected)


def test_elements_at_one_depth_share_a_panel_of_stress():
    dataset = synthetic.dataset(elements=3, samples=64)
    shallow, deep = panels_of(plot.stress(dataset))
    assert "0.75 mm deep (elements 0, 1)" in shallow.get_title("left")
    assert "1.1 mm deep (element 2)" in deep.get_title("left")
    shear = dataset["stress"].sel(stress_name="tau_xz").values / 1e3
    np.testing.assert_allclose(line(shallow, r"$\tau_{xz}$")[1], shear[0])
    np.testing.assert_allclose(line(deep, r"$\tau_{xz}$")[1], shear[2])


def test_signals_show_data_and_fits(page, full):
    for e, signal in enumerate(page["signals"].axes):
        assert signal.get_ylabel() == "signal [µV]"
        np.testing.assert_allclose(line(signal, "recorded")[1], full["signal"].values[e] * 1e6)
        for m, name in enumerate(("Wiener", "Tikhonov")):
            fit = full["fitted_signal"].values[m, e] * 1e6
            np.testing.assert_allclose(line(signal, f"fit, {name}")[1], fit)


def test_a_fit_has_its_residual_below_each_signal(full):
    one = full.isel(estimator=0, drop=True)
    signal, left, *_ = panels_of(plot.fit(one))
    np.testing.assert_allclose(line(signal, "fitted")[1], one["fitted_signal"].values[0] * 1e6)
    drawn = left.get_lines()[0].get_ydata()
    np.testing.assert_array_equal(drawn, one["whitened_residual"].values[0])


def test_a_fit_where_nothing_was_observed_does_not_set_the_scale(page, full):
    wild = full.copy(deep=True)
    missing = ~full["observed"].values.astype(bool)
    wild["fitted_signal"].values[:, missing] = 1.0
    for before, after in zip(page["signals"].axes, plot.signals(wild).axes, strict=True):
        assert after.get_ylabel() == before.get_ylabel()
        assert np.ptp(after.get_ylim()) < 2 * np.ptp(before.get_ylim())


def test_signals_and_residuals_mark_what_is_missing(full):
    one_missing = full.copy(deep=True)
    one_missing["observed"].values[0] = 0
    one_missing["whitened_residual"].values[:, 0] = np.nan
    signals = panels_of(plot.signals(one_missing))
    traces = np.reshape(panels_of(plot.residual(one_missing)), (4, 2))[::2, 0]
    for first, second in (signals, traces):
        assert first.patches[0].get_width() == pytest.approx(40.0)
        assert second.patches[0].get_width() < 10


def test_residual_counts_what_lies_inside(page, full):
    panels = np.reshape(page["residual"].axes, (4, 2))
    values = full["whitened_residual"].values
    for (trace, histogram), (e, m) in zip(panels, np.ndindex(2, 2), strict=True):
        np.testing.assert_array_equal(trace.get_lines()[0].get_ydata(), values[m, e])
        present = values[m, e][np.isfinite(values[m, e])]
        percentage = 100 * np.mean(np.abs(present) < BAND_90)
        assert f"{percentage:.1f} %" in trace.get_title("left")
        levels = sorted(line.get_ydata()[0] for line in trace.get_lines()[1:])
        assert levels == pytest.approx([-BAND_90, BAND_90])
        density, at = line(histogram, "histogram")
        assert histogram.get_xlim()[1] >= density.max()
        assert np.sum(density) * (at[1] - at[0]) == pytest.approx(1)


def test_estimates_are_the_datasets_with_bands(page, full):
    pressure, shear = page["estimates"].axes
    assert (pressure.get_ylabel(), shear.get_ylabel()) == ("pressure [kPa]", "shear [kPa]")
    p, half = full["estimate"].values[:, 0] / 1e3, full["estimate_stderr"].values[:, 0] / 1e3
    np.testing.assert_allclose(line(pressure, "truth")[1], full["traction"].values[0] / 1e3)
    bands = [drawn for drawn in pressure.collections if isinstance(drawn, PolyCollection)]
    for m, name in enumerate(("Wiener", "Tikhonov")):
        np.testing.assert_allclose(line(pressure, name)[1], p[m])
        drawn = np.asarray(bands[m].get_paths()[0].vertices)[:, 1]
        assert drawn.min() == pytest.approx((p[m] - BAND_90 * half[m]).min())
        assert drawn.max() == pytest.approx((p[m] + BAND_90 * half[m]).max())


@pytest.mark.parametrize("name", ["truth", "Wiener", "Tikhonov"])
def test_what_has_no_mean_is_drawn_about_its_own(page, full, name):
    _, shear = page["estimates"].axes
    q = full["traction"].values[1] if name == "truth" else full["estimate"].sel(
        {"estimator": name, "component": "q"}
    ).values  # fmt: skip
    observed = full["observed"].values.any(axis=0)
    np.testing.assert_allclose(line(shear, name)[1], (q - q[observed].mean()) / 1e3, atol=1e-9)


def test_a_wide_band_without_samples_does_not_flatten_the_rest(page, full):
    wide = full.copy(deep=True)
    wide["estimate_stderr"].values[..., ~full["observed"].values.any(axis=0)] = 1e9
    for before, after in zip(page["estimates"].axes, plot.estimates(wide).axes, strict=True):
        assert after.get_ylim() == before.get_ylim()
        assert np.diff(after.get_ylim()) < 20


def test_more_than_two_methods_have_panels_of_their_own(full):
    third = full.isel(estimator=[0]).assign_coords(estimator=["third"])
    three = xarray.concat([full, third], "estimator", data_vars="minimal")
    panels = panels_of(plot.estimates(three))
    assert [axes.get_title("left").split(";")[0] for axes in panels] == [
        "Wiener", "Tikhonov", "third"
    ] * 2  # fmt: skip


def test_unobserved_stretch_is_marked(page, full):
    (mark,) = [
        patch for patch in page["estimates"].axes[0].patches
        if not isinstance(patch, PolyCollection)
    ]  # fmt: skip
    assert mark.get_label() == "no samples here"
    first = full["x"].values[~full["observed"].values.any(axis=0)][0]
    half_cell = (full["x"].values[1] - full["x"].values[0]) / 2
    assert mark.get_x() == pytest.approx((first - half_cell) * 1e3)
    assert mark.get_x() + mark.get_width() == pytest.approx(20.0)


def test_spectra_mark_the_cutoffs(page, full):
    gain, power, resolution = page["spectra"].axes[:3]
    assert verticals(resolution) == pytest.approx(sorted(full["cutoff"].values.ravel()))
    k = full["wavenumber"].values[1:]
    for m, method in enumerate(("Wiener", "Tikhonov")):
        for c, component in enumerate("pq"):
            wavelength_mm = 2e3 * np.pi / full["cutoff"].values[m, c]
            x, y = line(resolution, f"{component}, {method}: {wavelength_mm:.3g} mm")
            np.testing.assert_array_equal(x, k)
            np.testing.assert_array_equal(y, full["resolution"].values[m, c, 1:])
    assert gain.get_ylabel() == "gain |G| [V/Pa]"
    np.testing.assert_array_equal(
        line(gain, "q, element 1")[1], full["sensor_gain"].values[1, 1, 1:]
    )
    np.testing.assert_array_equal(line(power, "noise")[1], full["noise_power"].values[1:])


def test_what_was_not_solved_for_is_left_out(recording):
    gain, _, resolution = panels_of(plot.spectra(recording))[:3]
    assert gain.get_legend_handles_labels()[1] == ["p, element 0"]
    (label,) = resolution.get_legend_handles_labels()[1]
    assert label.startswith("p, Wiener")
    (kernel,) = panels_of(plot.averaging_kernel(recording))
    assert kernel.get_title("left") == "Into p from p"


def test_gain_is_shown_down_to_1e_8_of_its_top(page, full):
    bottom, top = page["spectra"].axes[0].get_ylim()
    largest = full["sensor_gain"].values.max()
    assert bottom == pytest.approx(largest * 1e-8)
    assert top > largest


def test_wavelength_axis_is_2_pi_over_k(page):
    axes = drawn(page["spectra"]).axes[0]
    (top,) = axes.child_axes
    k = np.array([500.0, 3000.0])
    for at, same in zip(k, 2e3 * np.pi / k, strict=True):
        across, _ = axes.transData.transform((at, 1e-10))
        assert top.transData.transform((same, 0.0))[0] == pytest.approx(across)


def test_averaging_kernels_with_their_widths(page, full):
    figure = page["averaging_kernel"]
    kernels = full["averaging_kernel"].values
    for axes, (out, into) in zip(figure.axes, np.ndindex(2, 2), strict=True):
        np.testing.assert_allclose(line(axes, "Tikhonov")[1], kernels[1, out, into])
        left, right = axes.get_xlim()
        assert -left == right == pytest.approx(5 * 0.75)


@pytest.mark.parametrize("length_m", [0.2, 0.04, 0.002])
def test_scene_is_to_scale(length_m):
    figure = plot.scene(synthetic.dataset(samples=64, length_m=length_m))
    section, _, *close_ups = figure.axes
    for axes in (section, *close_ups):
        width, height = axes.get_position().size * figure.get_size_inches()
        along, up = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
        assert along / width == pytest.approx(up / height)
        bottom, top = axes.get_ylim()
        assert bottom < 0 < 0.75 < top  # z points up, and the film is in view


def arrows(axes):
    """Directions on the page's x and z of the arrows of a panel."""
    drawn = [text for text in axes.texts if getattr(text, "arrow_patch", None)]
    return [np.subtract(text.xy, text.xyann) for text in drawn]


def test_scene_shows_the_signs(page):
    signs = page["scene"].axes[2]
    pressure, shear, x, z = arrows(signs)
    assert pressure[1] > 0 == pressure[0]  # into the finger
    assert shear[0] > 0 == shear[1]
    assert x[0] > 0 == x[1]
    assert z[1] > 0 == z[0]


@pytest.mark.parametrize(
    ("element", "one", "three"),
    [
        (0, (1, 0), (0, 1)),
        (1, (0, 1), (1, 0)),
        (2, (np.sqrt(3) / 2, 1 / 2), (-1 / 2, np.sqrt(3) / 2)),
    ],
)
def test_scene_draws_each_element_with_its_axes(tilted_scene, element, one, three):
    axes = tilted_scene.axes[3 + element]
    drawn = [arrow / np.linalg.norm(arrow) for arrow in arrows(axes)]
    np.testing.assert_allclose(drawn, [one, three], atol=1e-12)
    strip = axes.get_lines()[-1]
    ends = np.array(strip.get_data())
    offset, depth = ((0.0, 0.75), (0.0, 0.75), (0.9, 1.1))[element]
    np.testing.assert_allclose(ends.mean(axis=1), (offset, depth), atol=1e-12)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 0.7 * np.array(one), atol=1e-12)


@pytest.mark.parametrize(
    ("speed", "words", "direction"),
    [
        (0.05, "towards +x at 50 mm/s", 1),
        (-0.012, "towards −x at 12 mm/s", -1),
    ],
)
def test_scene_shows_the_sliding(speed, words, direction):
    section = panels_of(plot.scene(synthetic.dataset(samples=64, speed_m_per_s=speed)))[0]
    assert words in section.get_title("left")
    ((along, down),) = arrows(section)
    assert np.sign(along) == direction
    assert down == 0


@pytest.mark.parametrize(("speed", "words"), [(0.0, "rests"), (np.nan, "not known")])
def test_scene_without_sliding_has_no_arrow(speed, words):
    dataset = synthetic.dataset(samples=64)
    dataset.attrs["speed_m_per_s"] = speed
    section = panels_of(plot.scene(dataset))[0]
    assert section.get_title("left").endswith(words)
    assert arrows(section) == []


def test_panels_share_units_x_and_colours():
    x = np.linspace(-1e-3, 1e-3, 5)
    along, up = plot.PanelAxis("distance", "m"), plot.PanelAxis("signal", "V")
    figure = drawn(
        plot.panels(
            [
                plot.Panel([plot.Curve(x, "p"), plot.Curve(-x, "q")], along, up, x, "Along"),
                plot.Panel([plot.Curve(1e-4 * x, "p")], along, up, x, "Upright"),
            ]
        )
    )
    check_labels(figure)
    first, second = figure.axes
    assert (first.get_xlabel(), second.get_xlabel()) == ("", "distance [mm]")
    assert first.get_ylabel() == second.get_ylabel() == "signal [mV]"
    assert first.get_shared_x_axes().joined(first, second)
    np.testing.assert_allclose(line(first, "q"), (x * 1e3, -x * 1e3))
    assert first.get_lines()[0].get_color() == second.get_lines()[0].get_color()


def test_curves_have_bands_of_their_standard_errors():
    x, value, stderr = np.linspace(0.0, 0.01, 5), np.arange(5.0), np.full(5, 0.1)
    data = dataset(
        {"gain": (("rig", "x"), [value, 2 * value], "V/Pa"),
         "gain_stderr": (("rig", "x"), [stderr, stderr], "V/Pa")},
        {"x": (x, "m"), "rig": (["one", "two"], "1")},
    )  # fmt: skip
    (axes,) = panels_of(plot.curves(data, "gain"))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "gain [V/Pa]")
    np.testing.assert_allclose(line(axes, "two"), (1e3 * x, 2 * value))
    band = np.asarray(axes.collections[0].get_paths()[0].vertices)[:, 1]
    assert (band.min(), band.max()) == pytest.approx((-0.1 * BAND_90, 4 + 0.1 * BAND_90))
    apart = panels_of(plot.curves(data, "gain", rows="rig"))
    assert [each.get_title("left") for each in apart] == ["one", "two"]


def test_lines_of_a_panel_have_coordinates_of_their_own():
    dense, few = np.linspace(0.0, 0.01, 11), np.linspace(0.0, 0.01, 3)
    data = dataset(
        {"wave": ("x", 1e-3 * dense, "V"), "mean": ("place", few, "V")},
        {"x": (dense, "m"), "place": (few, "m")},
    )
    lines, look = {"one": data["wave"], "all": data["mean"]}, {"color": "#123456"}
    part = plot.panel(lines, looks={"all": look}, along="way", within=(0, 0.02), title="Two")
    (axes,) = panels_of(plot.panels([part]))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("way [mm]", "wave [mV]")
    np.testing.assert_allclose(line(axes, "one"), (1e3 * dense, dense))
    np.testing.assert_allclose(line(axes, "all"), (1e3 * few, 1e3 * few))
    assert axes.get_xlim() == pytest.approx((0, 20))
    assert [each.get_color() for each in axes.get_lines()][1] == "#123456"


def test_a_matrix_has_a_number_in_every_cell():
    data = dataset(
        {"chosen": (("truth", "candidate"), [[3.0, np.nan], [1.0, 2.0]], "1")},
        {"truth": (["a", "b"], "1"), "candidate": (["a", "b"], "1")},
    )
    axes = panels_of(plot.matrix(data, "chosen"))[0]
    assert [text.get_text() for text in axes.texts] == ["3", "–", "1", "2"]


def test_a_spread_goes_from_the_least_to_the_greatest():
    data = dataset(
        {"error": (("estimator", "draw"), [[0.1, 0.2, 0.6], [0.3, 0.3, 0.3]], "1")},
        {"estimator": (["Wiener", "Tikhonov"], "1")},
    )
    (axes,) = panels_of(plot.spread(data, {"error of p": "error"}, "estimator", draws="draw"))
    (marks,) = axes.containers
    np.testing.assert_allclose(marks.lines[0].get_xdata(), [0.3, 0.3])
    ends = np.array(marks.lines[2][0].get_segments())[:, :, 0]
    np.testing.assert_allclose(ends, [[0.1, 0.6], [0.3, 0.3]])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["Wiener", "Tikhonov"]


def test_a_logarithmic_axis_of_a_spread_spans_its_values():
    """Of 0.01 to 20 % in draws: not of what a linear axis leaves below zero."""
    data = dataset(
        {"error": (("estimator", "draw"), [[1e-4, 2e-4], [0.1, 0.2]], "1")},
        {"estimator": (["a", "b"], "1")},
    )
    (axes,) = panels_of(
        plot.spread(data, {"error": "error"}, "estimator", draws="draw", log=["error"])
    )
    low, high = axes.get_xlim()
    assert 1e-5 < low < 1e-4
    assert 0.2 < high < 2


def test_the_axis_of_a_spread_holds_its_values_in_their_unit():
    data = dataset({"error": ("estimator", [-3.5e-6, 5e-6], "m")}, {"estimator": (["a", "b"], "1")})
    (axes,) = panels_of(plot.spread(data, {"error": "error"}, "estimator", log=["error"]))
    assert axes.get_xlabel() == "error [µm]"
    assert axes.get_xlim() == pytest.approx((-7.0, 10.0))


@pytest.mark.parametrize("draw", quick([plot.estimates, plot.signals, plot.spectra], plot.signals))
def test_what_a_run_leaves_can_be_drawn_again(full, draw, tmp_path):
    path = tmp_path / "result.nc"
    full.to_netcdf(path, engine="h5netcdf")
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        assert png(draw(stored.load())) == png(draw(full))
