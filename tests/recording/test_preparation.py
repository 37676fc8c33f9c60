"""Preparation of signals: what is taken out, what is left as it is, and what is refused."""

import numpy as np
import pytest

from srsinv.recording import Recording, load, save
from srsinv.recording.even import load_even, on_even_times
from srsinv.recording.inspection import inspect
from srsinv.recording.preparation import preparation_warnings, prepare
from tests.refusals import refused

RATE_HZ, COUNT = 2000.0, 20_000
TIME_S = np.arange(COUNT) / RATE_HZ
MIDDLE = slice(9500, 10_500)  # 4.75 s from either end
DECAYED = np.exp(-np.sqrt(2) * np.pi * 4.75)  # of the slowest filter here, over these: 7e-10


def recorded(signal, **facts):
    rows = np.atleast_2d(signal)
    channels = [f"voltage_{n}_V" for n in range(len(rows))]
    time_s = np.arange(rows.shape[1]) / RATE_HZ
    return Recording(rows, time_s, np.full(time_s.size, 0.02), tuple(channels), facts)


def prepared(signal, **facts):
    return on_even_times(recorded(signal, **facts)).signal[0]


def wave(frequency_Hz, phase=0.7):
    return np.sin(2 * np.pi * frequency_Hz * TIME_S + phase)


def warped(frequency_Hz):
    """The bilinear transform's frequency."""
    return np.tan(np.pi * frequency_Hz / RATE_HZ)


def notch_gain(frequency_Hz, centre_Hz=50.0, width_Hz=2.0):
    """Of a second-order notch, squared: (cos w - cos w0)^2 over that and (tan(b/2) sin w)^2."""
    w, w0 = (2 * np.pi * f / RATE_HZ for f in (frequency_Hz, centre_Hz))
    off = (np.cos(w) - np.cos(w0)) ** 2
    return off / (off + (warped(width_Hz) * np.sin(w)) ** 2)


def high_pass_gain(frequency_Hz, from_Hz=1.0):
    """Of a Butterworth filter of order 2, squared."""
    return 1 / (1 + (warped(from_Hz) / warped(frequency_Hz)) ** 4)


def test_nothing_is_asked_for_and_nothing_changes():
    signal = np.random.default_rng(0).normal(size=COUNT)
    given = recorded(signal, mains_Hz=50.0, drift=1e-3)
    assert on_even_times(given).raw_signal is None
    assert np.array_equal(on_even_times(given).signal[0], signal)


@pytest.mark.parametrize(("detrend", "trend"), [("constant", 3.0 + 0 * TIME_S),
                                                ("linear", 3.0 - 5 * TIME_S)])  # fmt: skip
def test_an_offset_and_a_trend_are_taken_out_exactly(detrend, trend):
    missing = (TIME_S > 1.0) & (TIME_S < 1.3)
    left = prepared(np.where(missing, np.nan, 1e3 * trend), detrend=detrend)
    assert np.array_equal(np.isnan(left), missing)
    assert np.nanmax(np.abs(left)) < 1e-9


def test_detrending_is_orthogonal_to_what_it_takes():
    signal = np.random.default_rng(1).normal(size=COUNT)
    left = prepared(signal, detrend="linear")
    assert [np.mean(left), np.mean(left * TIME_S)] == pytest.approx([0, 0], abs=1e-12)
    assert prepared(signal, detrend="constant") == pytest.approx(signal - signal.mean(), abs=1e-12)


def test_a_line_leaves_nothing_from_end_to_end():
    hum = 1e3 * (wave(50.0) + 0.3 * wave(150.0, 2.0))
    assert np.max(np.abs(prepared(1e3 * wave(50.0), notch_Hz=50))) < 1e-8
    # Of a second line, the state at the ends takes as much as a taper's side lobes let through.
    assert np.max(np.abs(prepared(hum, notch_Hz=[50, 150]))) < 1e-4


def test_an_offset_and_a_trend_leave_nothing_of_a_high_pass_from_end_to_end():
    assert np.max(np.abs(prepared(1e3 * (1 - 2 * TIME_S), high_pass_Hz=1.0))) < 1e-6


@pytest.mark.parametrize(
    ("facts", "gain", "frequency_Hz"),
    [
        *(({"notch_Hz": 50.0}, notch_gain, each) for each in (45.0, 49.0, 52.0, 300.0)),
        *(({"high_pass_Hz": 1.0}, high_pass_gain, each) for each in (1.0, 2.0, 30.0)),
    ],
)
def test_a_wave_keeps_its_phase_and_the_amplitude_of_the_closed_form(facts, gain, frequency_Hz):
    left = prepared(wave(frequency_Hz), **facts)
    expected = gain(frequency_Hz) * wave(frequency_Hz)
    assert left[MIDDLE] == pytest.approx(expected[MIDDLE], abs=100 * DECAYED)


def test_half_is_left_at_a_notch_s_edges_and_at_the_high_pass():
    assert high_pass_gain(1.0) == 0.5
    # A wave has the notch's edges at 48.99 and 50.99 Hz: as far apart as its width.
    edges = [f for f in np.arange(48, 52, 1e-3) if notch_gain(f) < 0.5]
    assert edges[-1] - edges[0] == pytest.approx(2.0, abs=3e-3)


def test_what_is_beside_a_line_stays_up_to_the_ends():
    slow = 2 + np.sin(2 * np.pi * 1.7 * TIME_S + 0.3)
    left = prepared(slow + 10 * wave(50.0), notch_Hz=50)
    assert left == pytest.approx(slow, abs=2e-3)


def test_gaps_stay_gaps_and_hum_goes_on_across_them():
    signal, gap = 10 * wave(50.0), slice(3000, 3100)
    signal[gap] = np.nan
    signal[[1000, -1]] = np.nan
    left = prepared(signal, notch_Hz=50.0)
    assert np.array_equal(np.isnan(left), np.isnan(signal))
    # Where it would pause, a tenth of it is left beside the gap.
    assert np.nanmax(np.abs(left)) < 1e-6


def test_data_far_from_a_gap_are_as_without_it():
    signal = np.random.default_rng(2).normal(size=COUNT)
    gappy = signal.copy()
    gappy[500:520] = np.nan
    left, whole = (prepared(each, notch_Hz=50.0, high_pass_Hz=5.0) for each in (gappy, signal))
    far = slice(520 + 9500, None)
    assert left[far] == pytest.approx(whole[far], abs=100 * DECAYED)


def test_each_channel_is_prepared_by_itself_and_once():
    given = recorded(np.stack([wave(50.0), 1 + wave(300.0)]), notch_Hz=50.0, detrend="constant")
    once = on_even_times(given)
    assert np.max(np.abs(once.signal[0])) < 1e-9
    assert once.raw_signal is not None
    assert np.array_equal(once.raw_signal, given.signal)
    assert np.array_equal(on_even_times(once).signal, once.signal)
    assert prepare(once) is once


def test_the_sidecar_asks_and_the_command_line_overrides(tmp_path):
    path = tmp_path / "hum.csv"
    save(recorded(1 + wave(50.0), notch_Hz=[150.0], detrend="constant"), path)
    settings = {"path": path, "notch_Hz": [50.0], "high_pass_Hz": None}
    assert np.max(np.abs(load_even(settings, {}).signal)) < 1e-9
    by_sidecar = load_even({"path": path}, {}).signal[0]
    assert np.std(by_sidecar) == pytest.approx(np.sqrt(0.5), rel=1e-3)


def test_a_file_is_read_and_inspected_as_it_is(tmp_path):
    path = tmp_path / "hum.csv"
    save(recorded(1 + wave(50.0), notch_Hz=50.0, high_pass_Hz=2.0), path)
    assert load(path).signal[0] == pytest.approx(1 + wave(50.0))
    shown = inspect(path)
    assert shown.refusal is None
    assert shown.signals["voltage_0_V"].values == pytest.approx(1 + wave(50.0))


def test_prepared_signals_are_not_saved_to_be_prepared_again(tmp_path):
    once = on_even_times(recorded(wave(50.0), notch_Hz=50.0))
    refused(lambda: save(once, tmp_path / "again.csv"), "again.csv", "filtered already")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"high_pass_Hz": 1000.0}, ("high_pass_Hz is 1000.0", "2000 samples", "980 Hz")),
        ({"high_pass_Hz": 0.09}, ("high_pass_Hz is 0.09", "9.999 s", "detrend")),
        ({"high_pass_Hz": 60.0, "notch_Hz": 50.0}, ("high_pass_Hz is 60.0", "49 Hz")),
        ({"notch_Hz": [50.0, 979.5]}, ("notch_Hz at 979.5 Hz", "980 Hz")),
        ({"notch_Hz": 0.5}, ("notch_Hz at 0.5 Hz", "between 0")),
        (
            {"notch_Hz": 50.0, "notch_width_Hz": 0.09},
            ("notch_width_Hz is 0.09", "9.999 s", "mains_Hz"),
        ),
        ({"notch_Hz": [200.0, 400.0], "notch_width_Hz": 60.0}, ("is 60.0", "100 Hz", "fewer")),
        ({"notch_width_Hz": 3.0}, ("notch_width_Hz is 3.0", "notch_Hz")),
        ({"notch_Hz": [50.0, 99.0], "mains_Hz": [50.0, 150.0]}, ("50.0 Hz", "mains_Hz")),
    ],
)
def test_what_cannot_be_is_refused(facts, words):
    refused(lambda: on_even_times(recorded(wave(7.0), **facts)), *words)


def test_a_channel_of_which_most_is_missing_is_not_filtered():
    few = np.where(np.arange(COUNT) % 3, np.nan, wave(7.0))
    refused(lambda: prepared(few, notch_Hz=50.0), "voltage_0_V", "6667 of 20000", "notch_Hz")
    assert np.isfinite(prepared(few, detrend="linear")).sum() == 6667


@pytest.mark.parametrize(
    ("facts", "is_mean_known", "words"),
    [
        ({"notch_Hz": [50.0, 150.0]}, False, ["notch_Hz=50 removed", "100 Hz", "mains_Hz"]),
        ({"notch_Hz": [101.1, 150.0]}, False, []),
        ({"notch_Hz": 100.9}, False, ["notch_Hz=100.9 removed"]),
        ({"high_pass_Hz": 1.0}, False, ["high_pass_Hz=1 removed", "recording.drift"]),
        ({"detrend": "linear"}, False, ["detrend=linear removed", "recording.drift"]),
        ({"detrend": "constant"}, False, []),
        ({"detrend": "constant"}, True, ["detrend=constant removed the mean"]),
    ],
)
def test_what_the_bands_do_not_hold_is_said(facts, is_mean_known, words):
    said = preparation_warnings(recorded(wave(7.0), **facts), 100.0, is_mean_known)
    assert len(said) == bool(words)
    assert [word for word in words if word not in said[0]] == []
