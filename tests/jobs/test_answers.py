"""What jobs say of recordings: rows that were lost, units that are none, answers that failed."""

import json
import re

import numpy as np
import pytest

from srsinv.recording import load, save
from srsinv.recording.even import on_even_times
from tests.jobs.run import assumed, command, outcome, tables, words
from tests.jobs.test_fit_recording import EXAMPLES, TRUTH
from tests.refusals import refused

EXAMPLE = EXAMPLES / "strip_two_element.csv"
SHAPE = ("position_m", "width_m", "pressure_Pa", "friction")


def fit(*overrides):
    return outcome("experiment=fit_recording", *overrides)


def invert(*overrides):
    """On wide cells, which a direct solution has in a second."""
    settings = ("method=wiener_evidence", "recording.cell_m=3e-4")
    return outcome("experiment=invert_recording", *settings, *overrides)


@pytest.fixture(scope="module")
def gappy_recording(tmp_path_factory):
    """The bundled recording without a tenth of its rows and without a burst beside the strip."""
    text = EXAMPLE.read_text().splitlines()
    observed = np.random.default_rng(0).random(len(text) - 1) > 0.1
    observed[600:640] = False
    observed[[0, -1]] = True
    folder = tmp_path_factory.mktemp("lost")
    (folder / "scan.json").write_text(EXAMPLE.with_suffix(".json").read_text())
    remaining = [row for row, is_observed in zip(text[1:], observed, strict=True) if is_observed]
    (folder / "scan.csv").write_text("\n".join([text[0], *remaining]) + "\n")
    return folder / "scan.csv", int(np.sum(~observed))


@pytest.mark.full
def test_a_feature_is_where_it_was(gappy_recording):
    path, rows = gappy_recording
    result = fit(f"recording.path={path}")
    assert result.metrics["quality"] == "good"
    for name in SHAPE:
        error = result.metrics[name] - TRUTH[name]
        assert abs(error) < 4 * result.metrics[f"{name}_stderr"], name
    assert result.metrics["noise_rms_V"] == pytest.approx(TRUTH["white_noise_rms_V"], rel=0.05)
    assert assumed(result)["lost rows"].startswith(f"{rows} at ")


@pytest.mark.full
def test_p_and_q_are_where_they_were(gappy_recording):
    """Within the bands of the whole recording."""
    path, rows = gappy_recording
    whole, part = invert(f"recording.path={EXAMPLE}"), invert(f"recording.path={path}")
    x = whole.dataset["x"].values
    inner = (x > x[0] + 0.006) & (x < x[-1] - 0.006)
    for c in range(2):
        value, other = (
            np.interp(x, each.dataset["x"].values, each.dataset["estimate"].values[0, c])[inner]
            for each in (whole, part)
        )
        band = 1.645 * whole.dataset["estimate_stderr"].values[0, c][inner]
        moved = (value - value.mean()) - (other - other.mean())
        assert np.mean(np.abs(moved) < band) > 0.95
    assert part.metrics["noise_rms_V"] == pytest.approx(whole.metrics["noise_rms_V"], rel=0.15)
    assert assumed(part)["lost rows"].startswith(f"{rows} at ")


@pytest.fixture(scope="module")
def counts(tmp_path_factory):
    """The bundled recording in counts of 0.1 uV, which nothing says."""
    path = tmp_path_factory.mktemp("counts") / "counts.csv"
    scan = load(EXAMPLE)
    text = ["time_s,speed_m_per_s,raw_0,raw_1"]
    for row in zip(scan.time_s, scan.speed_m_per_s, *np.round(scan.signal * 1e7), strict=True):
        text.append(",".join(f"{value:.10g}" for value in row))
    path.write_text("\n".join(text) + "\n")
    path.with_suffix(".json").write_text(EXAMPLE.with_suffix(".json").read_text())
    return path


NAMED = "recording.channels=[raw_0,raw_1]"


@pytest.mark.parametrize("job", ["fit_recording", "invert_recording", "compare"])
def test_nothing_in_pa_without_volts(counts, job):
    sentence = refused(
        lambda: outcome(
            f"experiment={job}", f"recording.path={counts}", NAMED,
            *(["recording=file", "sensor=recorded"] if job == "compare" else []),
        ),
        "counts.csv", "in counts", "recording.gain", "recording.signal_unit",
    )  # fmt: skip
    assert "traction_unit=relative" in sentence


@pytest.mark.full
@pytest.mark.parametrize(
    "stated",
    ["recording.gain=1e7", "recording.gain=[1e7,1e7]"],
)
def test_a_gain_makes_volts_of_counts(counts, stated):
    metrics = fit(f"recording.path={counts}", NAMED, stated).metrics
    assert metrics["pressure_Pa"] == pytest.approx(TRUTH["pressure_Pa"], rel=0.02)


@pytest.mark.full
def test_positions_without_volts_are_of_a_traction_without_a_unit(counts):
    whole = invert(f"recording.path={EXAMPLE}")
    result = invert(f"recording.path={counts}", NAMED, "traction_unit=relative")
    for name in ("p_peak_position_m_wiener", "p_line_wavelength_m_wiener"):
        assert result.metrics[name] == pytest.approx(whole.metrics[name], rel=0.05)
    rows = {what: said for what, said in assumed(result).items() if what != "skin"}  # its modulus
    shown = [[each.columns, each.rows] for each in tables(result)[:-1]]
    said = [result.metrics, shown, words(result), result.title, rows]
    assert not re.search(r"(?<![A-Za-z])[kM]?Pa(?![a-z])", json.dumps(said))
    assert "p_peak_relative_wiener" in result.metrics
    units = {str(each.attrs["units"]) for each in result.dataset.variables.values()}
    assert not [unit for unit in units if "Pa" in unit]


def test_a_nominal_pressure_has_no_place_beside_a_relative_one(counts):
    refused(
        lambda: invert(
            f"recording.path={counts}", NAMED, "traction_unit=relative",
            "recording.nominal_pressure_Pa=2e4",
        ),
        "nominal_pressure_Pa", "traction_unit=relative",
    )  # fmt: skip


@pytest.mark.claim
def test_a_failed_fit_is_no_answer_on_any_channel(tmp_path, capsys):
    """A search that may take one step."""
    run = tmp_path / "run"
    assert command(run, "experiment=fit_recording", "solver.max_steps=1") == 0
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["quality"] == "failed"
    assert [metrics[f"{name}_stderr"] for name in SHAPE] == [None] * 4
    terminal, page = capsys.readouterr().out, (run / "report.html").read_text()
    for channel in (terminal, page):
        assert "these numbers are no answer" in channel
        assert "step limit" in channel
    assert "failed" in page.partition("</h1>")[0]


# Noise stated, as a share of the true one: what the fit is worth, and how its warnings begin.
STATED = {
    0.97: ("good", "none"),
    0.8: ("doubtful", "The residual is 1."),
    0.2: ("doubtful", "The residual is 5"),
}


@pytest.mark.full
@pytest.mark.parametrize("noise_ratio", STATED)
def test_a_fit_is_worth_what_its_residual_says(noise_ratio):
    worth, beginning = STATED[noise_ratio]
    result = fit(f"noise.white.rms={noise_ratio * TRUTH['white_noise_rms_V']}")
    assert result.metrics["quality"] == worth
    assert result.metrics["warnings"].startswith(beginning)
    assert bool(result.dataset["reasons"].item()) == (worth != "good")
    assert result.dataset["quality"].item() == worth


@pytest.mark.full
def test_a_failed_inversion_is_no_answer_on_any_channel(tmp_path, capsys):
    run = tmp_path / "run"
    stated = f"noise.white.rms={0.05 * TRUTH['white_noise_rms_V']}"
    args = ("experiment=invert_recording", "method=wiener", f"recording.path={EXAMPLE}", stated)
    assert command(run, *args) == 0
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["quality_wiener"] == "failed"
    assert metrics["warnings_wiener"] != "none"
    terminal, page = capsys.readouterr().out, (run / "report.html").read_text()
    for channel in (terminal, page):
        assert "these numbers are no answer" in channel
        assert "The residual is" in channel


def test_lost_rows_survive_saving(gappy_recording, tmp_path):
    """As empty cells, at even times."""
    scan = on_even_times(load(gappy_recording[0]))
    save(scan, tmp_path / "even.nc")
    again = load(tmp_path / "even.nc", missing="allow")
    np.testing.assert_array_equal(again.signal, scan.signal)
