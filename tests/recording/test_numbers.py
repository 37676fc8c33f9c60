"""Numbers at the ends of what a format can hold: a right result or one sentence, in a load, in a
look at the file and on its page."""

import json
from contextlib import suppress

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.jobs.inspect_recording import run
from srsinv.recording import load
from srsinv.recording.inspection import inspect
from srsinv.report.data import metrics_json
from tests.recording.files import write_csv
from tests.recording.test_bad_files import check_sentence

N = 40
ROW = np.arange(N)
TIME_S = ROW / 1000
NOISE = np.random.default_rng(0).normal(size=N)
ALTERNATING = (-1.0) ** ROW
LARGEST = np.finfo(np.float64).max
GOOD = {"time_s": TIME_S, "speed_m_per_s": np.full(N, 0.05), "voltage_0_V": NOISE}

# name: (columns in place of the good ones, words of the refusal of `load`; none: it is read)
NUMBERS = {
    "times of 5e-324 s": ({"time_s": ROW * 5e-324}, ["data row 2", "less than 1e-18 s"]),
    "times of 1e-90 s": ({"time_s": ROW * 1e-90}, ["less than 1e-18 s", "unit"]),
    "times 1e308 s apart": ({"time_s": np.linspace(-1, 1, N) * LARGEST}, ["time_s is -1.79769e"]),
    "one time of 1e308 s": ({"time_s": np.where(ROW == 9, 1e308, TIME_S)}, ["time_s is 1e+308"]),
    "times all equal": ({"time_s": np.zeros(N)}, ["does not come after", "data row 2"]),
    "times far from zero": ({"time_s": 1e17 + 16.0 * ROW}, []),
    "times of unsigned integers": ({"time_s": None, "time_us": ROW.astype(np.uint64) << 50}, []),
    "unsigned times that fall": ({"time_s": None, "time_us": ROW[::-1].astype("u8")}, ["row 2"]),
    "times of one byte": ({"time_s": None, "time_ms": ROW.astype("i1")}, []),
    "times of 16 bytes": ({"time_s": TIME_S.astype(np.longdouble)}, []),
    "speeds of 1e300 m/s": (
        {"speed_m_per_s": np.full(N, 1e300)},
        ["speed_m_per_s is 1e+300 at data row 1", "beyond 1e+18"],
    ),
    "speeds that alternate": ({"speed_m_per_s": ALTERNATING * LARGEST}, ["beyond 1e+18"]),
    "positions of 1e300 m": (
        {"speed_m_per_s": None, "position_m": NOISE * 1e300},
        ["position_m", "beyond 1e+18"],
    ),
    "positions of 5e-324 m": ({"speed_m_per_s": None, "position_m": ROW * 5e-324}, []),
    "signal of 1e308": ({"voltage_0_V": ALTERNATING * LARGEST}, []),
    "constant signal of 1e308": ({"voltage_0_V": np.full(N, LARGEST)}, []),
    "signal of 1e200": ({"voltage_0_V": NOISE * 1e200}, []),
    "one sample of netCDF's filling": (
        {"voltage_0_V": np.where(ROW == 3, 9.97e36, NOISE)},
        ["data row 4 of column voltage_0_V is 9.97e+36", "recording.missing=allow"],
    ),
    "signal of 5e-324": ({"voltage_0_V": np.round(4 * NOISE) * 5e-324}, []),
    "signal of 1e-300": ({"voltage_0_V": NOISE * 1e-300}, []),
    "largest unsigned integers": ({"voltage_0_V": np.full(N, 2**64 - 1, np.uint64)}, []),
    "all of the integers' range": ({"voltage_0_V": np.where(ROW % 2, -(2**63), 2**63 - 1)}, []),
    "half precision": ({"voltage_0_V": NOISE.astype(np.float16)}, []),
    "infinite in half precision": (
        {"voltage_0_V": np.where(ROW == 3, np.inf, NOISE).astype(np.float16)},
        ["data row 4 of column voltage_0_V is 'inf'"],
    ),
    "beyond float64": (
        {"voltage_0_V": NOISE.astype(np.longdouble) * np.longdouble("1e4000")},
        ["data row 1 of column voltage_0_V is '1.25"],
    ),
    "truth values": ({"voltage_0_V": NOISE > 0}, ["values of type bool"]),
    "not a number": (
        {"voltage_0_V": np.full(N, np.nan)},
        ["data row 1 of column voltage_0_V is 'nan'"],
    ),
}


@pytest.fixture(params=NUMBERS)
def case(request, tmp_path):
    changes, words = NUMBERS[request.param]
    path = tmp_path / "r.npz"
    np.savez(path, **{key: v for key, v in (GOOD | changes).items() if v is not None})
    return path, changes, words


def test_load(case):
    path, changes, words = case
    if words:
        with pytest.raises(BadInput) as caught:
            load(path)
        check_sentence(str(caught.value), "r.npz", *words)
        return
    got = load(path)
    expected = (GOOD | changes)["voltage_0_V"]
    np.testing.assert_array_equal(got.signal[0], np.asarray(expected, np.float64))
    assert np.isfinite([got.sample_rate_hz, got.sampling_jitter]).all()
    assert np.isfinite(got.position_m).all()
    with suppress(BadInput):  # of sums beyond 1e308
        got.resample_uniform()


@pytest.mark.full
def test_inspect_and_its_page(case):
    path, changes, _ = case
    for column in inspect(path).columns:
        with np.errstate(over="ignore"):
            values = (GOOD | changes)[column.name].astype(np.float64)
        if column.least is None or not np.isfinite(values).all():
            continue
        size = np.max(np.abs(values)) or 1.0
        near = max(1e-15 * size, 5e-324)
        assert (column.least, column.greatest) == (values.min(), values.max())
        assert abs(column.mean - size * np.mean(values / size)) <= near
        assert abs(column.rms - size * np.sqrt(np.mean((values / size) ** 2))) <= near
    by_suffix = {"_target_": "srsinv.recording.formats.BySuffix"}
    result = run({"recording": {"path": str(path)}, "reader": by_suffix, "sensor": {}})
    assert "Infinity" not in metrics_json(result.metrics)
    for figure, _ in result.page.figures.values():
        figure.canvas.draw()


FACTS = {
    "speed": ({"speed_m_per_s": 1e300}, "speed_m_per_s is 1e+300"),
    "low rate": ({"sample_rate_hz": 5e-324}, "the times come at 1000 Hz"),
    "high rate": ({"sample_rate_hz": 1e300}, "the times come at 1000 Hz"),
    "gain": ({"gain": 5e-324}, "voltage_0_V is not finite"),
}


@pytest.mark.parametrize("case", FACTS)
def test_facts(tmp_path, case):
    facts, words = FACTS[case]
    write_csv(tmp_path / "r.csv", GOOD)
    (tmp_path / "r.json").write_text(json.dumps(facts))
    given = {} if case == "gain" else facts
    with pytest.raises(BadInput) as caught:
        load(tmp_path / "r.csv", **given)
    assert words in str(caught.value)
