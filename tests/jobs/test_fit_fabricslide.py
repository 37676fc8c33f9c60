"""The pitch of a ridged board: from channels whose pitch is known, and from real ones."""

import re
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from srsinv.errors import BadInput
from srsinv.inverse.board.pitch import drift, fit_pitch, scan_pitch, shifts
from srsinv.inverse.board.spectral_lines import find_lines
from srsinv.recording import Recording, load, save
from tests.golden.check import golden_test
from tests.jobs.run import command, outcome
from tests.shared import SHARED, needs_shared
from tests.tiers import quick

FORMS = ("fit_fabricslide",)

test_nothing_has_moved = golden_test(FORMS, *FORMS)

BOARDS = SHARED / "recordings" / "fabricslide"
SPEED = 0.02
CHANNELS = tuple(f"channel{i}" for i in range(1, 17))
COARSE, FINE = (0.015, 0.03), (0.003, 0.0055)
RANGES = {"Board10mm": COARSE, "Board2mm": FINE}
HARMONICS = 2


def noise(rng, samples, memory, common):
    """Unit noise (channel, sample) that remembers `memory` samples; `common` is the share of its
    variance that all channels have together."""
    rho = np.exp(-1 / memory)
    white = rng.normal(size=(len(CHANNELS) + 1, samples + 500))
    red = np.asarray(signal.lfilter([np.sqrt(1 - rho**2)], [1, -rho], white, axis=1))[:, 500:]
    return np.sqrt(1 - common) * red[:-1] + np.sqrt(common) * red[-1]


def scan(seed, pitch_m, samples=240, level=0.3, memory=5.0, common=0.5):
    """Positions and 16 channels: two harmonics of each one's own phase and size, drift, noise."""
    rng = np.random.default_rng(seed)
    x_m = np.linspace(0, 0.15, samples)
    phase = rng.uniform(0, 2 * np.pi, (len(CHANNELS), 1))
    size = rng.uniform(0.3, 1.5, (len(CHANNELS), 1))
    k = 2 * np.pi / pitch_m
    pattern = size * (np.cos(k * x_m + phase) + 0.3 * np.sin(2 * k * x_m + phase))
    slow = rng.normal(size=(len(CHANNELS), 1)) * np.linspace(-1, 1, samples) ** 2
    return x_m, pattern + slow + level * noise(rng, samples, memory, common)


def fitted(x_m, channels, range_m, by=scan_pitch, harmonics=HARMONICS):
    return by(x_m, channels, drift(x_m, 2 * range_m[1]), range_m, harmonics)


def written(path, x_m, channels, speed_m_per_s=SPEED):
    time_s = x_m / abs(speed_m_per_s)
    speed = np.full(x_m.size, speed_m_per_s)
    save(Recording(channels, time_s, speed, CHANNELS, {}, "counts"), path)
    return path


def job(path, *overrides, range_m=COARSE) -> Any:
    listed = ",".join(map(str, range_m))
    return outcome(
        "experiment=fit_fabricslide",
        f"recording.path={path}",
        f"feature.pitch_range_m=[{listed}]",
        *overrides,
    )


@pytest.mark.full
@pytest.mark.parametrize(("pitch_m", "range_m"), [(0.0201, COARSE), (0.00399, FINE)])
@pytest.mark.parametrize(
    ("memory", "common"),
    [(0.1, 0.0), pytest.param(5.0, 0.5, marks=pytest.mark.claim), (40.0, 0.9)],
    ids=["white", "red", "shared"],
)
def test_standard_error_is_the_spread(pitch_m, range_m, memory, common):
    pitches = [
        fitted(*scan(seed, pitch_m, memory=memory, common=common), range_m) for seed in range(40)
    ]
    error = np.array([each.pitch_m for each in pitches]) - pitch_m
    stderr = np.array([each.stderr_m for each in pitches])
    assert 0.75 < np.sqrt(np.mean(stderr**2)) / np.std(error) < 1.35
    freedom = pitches[0].shifts.shift_m.size - 2
    assert np.mean(np.abs(error) < stats.t.ppf(0.95, freedom) * stderr) > 0.8  # of the central 90 %
    assert np.abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(len(pitches))


def test_white_noise_error_is_too_small_for_red_noise():
    scans = [scan(seed, 0.0201, level=1.0) for seed in range(3)]
    pitches = [fitted(*each, COARSE, by=fit_pitch) for each in scans]
    for pitch, each in zip(pitches, scans, strict=True):
        assert pitch.status == "converged"
        scanned = fitted(*each, COARSE)
        assert abs(pitch.pitch_m - scanned.pitch_m) < 0.05 * pitch.stderr_m
        assert pitch.stderr_m == pytest.approx(scanned.stderr_m, rel=0.05)
    assert np.mean([p.stderr_white_m for p in pitches]) < 0.8 * np.mean(
        [p.stderr_m for p in pitches]
    )


def test_shift_of_the_pattern_is_read_in_each_period():
    x_m = np.linspace(0, 0.1, 500)
    moved_m = 2e-4 * np.sign(x_m - 0.05)
    k = 2 * np.pi / 0.01 * x_m
    slope = np.stack([np.cos(k), 3 * np.sin(k)])
    each = shifts(x_m, slope, -slope * moved_m, np.array([1.0, 3.0]), 0.01)
    np.testing.assert_allclose(each.shift_m, 2e-4 * np.repeat([-1, 1], 5), rtol=1e-12)


@pytest.mark.parametrize(("memory", "common"), [(0.1, 0.0), (5.0, 0.5), (40.0, 0.9)])
def test_other_lines_are_those_put_in(memory, common):
    false = 0
    for seed in range(8):
        x_m, channels = scan(seed, 0.00399, memory=memory, common=common)
        given = (0.00399, HARMONICS)
        false += len(find_lines(x_m, channels, given, 0.04, 0.01).lines)
        for wavelength, size in ((0.0201, 1.0), (0.0067, 0.7)):
            phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (len(CHANNELS), 1))
            channels = channels + size * np.cos(2 * np.pi / wavelength * x_m + phase)
        long, short = find_lines(x_m, channels, given, 0.04, 0.01).lines
        assert abs(long.wavelength_m - 0.0201) < 6 * long.stderr_m
        assert abs(short.wavelength_m - 0.0067) < 6 * short.stderr_m
        assert long.explained_fraction > short.explained_fraction
    assert false <= 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("boards")


@pytest.fixture(scope="module")
def known(folder):
    """The job on a scan of 20.1 mm pitch, forward and backward."""
    x_m, channels = scan(3, 0.0201)
    forward = written(folder / "forward.csv", x_m, channels)
    backward = written(folder / "backward.csv", x_m, channels[:, ::-1], -SPEED)
    return job(forward), job(backward)


@pytest.mark.full
def test_job_finds_the_pitch_whichever_way_the_finger_goes(known):
    forward, backward = (each.metrics for each in known)
    assert forward["status"] == "converged"
    assert abs(forward["pitch_m"] - 0.0201) < 4 * forward["pitch_m_stderr"] < 4e-4
    assert backward["pitch_m"] == pytest.approx(forward["pitch_m"], rel=1e-9)
    assert forward["periods"] == 7
    assert forward["lines"] == 0


def test_page_shows_what_was_fitted(known):
    result = known[0]
    assert all("units" in values.attrs for values in result.dataset.variables.values())
    drawn = {name: figure for name, (figure, _) in result.page.figures.items()}
    assert set(drawn) == {"channel_fits", "pattern_shifts", "channel_pitches", "line_spectrum"}
    for figure in drawn.values():
        for axes in figure.axes:
            assert axes.get_ylabel().endswith("]") or axes.get_yticklabels()[0].get_text()
    lines = drawn["line_spectrum"].axes[0].get_lines()
    marks = {line.get_label(): np.asarray(line.get_xdata()) for line in lines}
    assert marks["pitch"][0] == pytest.approx(1e3 * result.metrics["pitch_m"])
    residual = result.dataset["signal"] - result.dataset["fitted_signal"]
    assert 0.2 < float(residual.std()) < 0.3  # of the noise, the drift takes what is slow


@pytest.mark.parametrize(
    ("pitch_m", "level", "result"),
    [(0.0201, 300.0, "not above the noise"), (0.034, 0.1, "at an end")],
    ids=["noise alone", "pitch out of range"],
)
def test_what_is_no_pitch_does_not_pass_as_one(folder, pitch_m, level, result):
    path = written(folder / "none.csv", *scan(5, pitch_m, level=level, memory=0.1, common=0.0))
    assert result in job(path).metrics["status"]


@pytest.mark.full
@needs_shared
@pytest.mark.parametrize(
    ("board", "pitch_m", "within_m"), [("Board10mm", 0.0201, 3e-4), ("Board2mm", 0.00399, 5e-5)]
)
def test_all_scans_of_a_real_board_agree_within_their_errors(board, pitch_m, within_m):
    value, stderr = [], []
    for path in sorted(BOARDS.glob(f"{board}_*.csv")):
        speed = 1e-3 * float(re.findall(r"V-(\d+)mmps", path.name)[0])
        real = load(path, channels=CHANNELS, time_unit="ms", speed_m_per_s=speed)
        x_m = np.linspace(0, real.position_m[-1], real.time_s.size)
        harmonics = min(4, int(RANGES[board][0] / (2 * x_m[1])))
        pitch = fitted(x_m, real.signal, RANGES[board], harmonics=harmonics)
        value.append(pitch.pitch_m)
        stderr.append(pitch.stderr_m)
    value, weight = np.array(value), np.array(stderr) ** -2
    assert value.size == 8
    assert np.all(np.abs(value - pitch_m) < within_m)
    chi2 = np.sum(weight * (value - np.average(value, weights=weight)) ** 2)
    assert 0.02 < stats.chi2.sf(chi2, value.size - 1) < 0.98


@pytest.mark.full
@needs_shared
def test_a_real_board_of_4_mm_shows_a_line_near_20_mm_too():
    path = BOARDS / "Board2mm_F150_V-30mmps_0.csv"
    metrics = job(path, "recording.speed_m_per_s=0.03", range_m=FINE).metrics
    assert metrics["status"] == "converged"
    assert metrics["pitch_m"] == pytest.approx(0.00399, abs=5e-5)
    assert 0.0195 < metrics["line_1_m"] < 0.0205


REFUSALS = {
    "no range": ((), r"'feature\.pitch_range_m' has no value; give one"),
    "one number": (("0.02",), r"pitch_range_m is 0\.02: give two numbers"),
    "three numbers": (("[0.01,0.02,0.03]",), r"is \[0\.01, 0\.02, 0\.03\]: give two numbers"),
    "words": (("[short,long]",), r"is \['short', 'long'\]: give two numbers"),
    "wrong order": (("[0.03,0.015]",), r"is \[0\.03, 0\.015\]: give the shortest pitch"),
    "longer than the scan": (("[0.015,0.2]",), r"0\.15 m long.*a longest pitch up to 0\.05 m"),
    "shorter than samples show": (
        ("[0.001,0.03]",),
        r"are 0\.0006276 m apart.*a shortest pitch of at least 0\.001255 m",
    ),
    "harmonics": (
        ("[0.015,0.03]", "fit_fabricslide.harmonics=0"),
        r"fit_fabricslide\.harmonics is 0: give a whole number from 1",
    ),
    "false alarm": (
        ("[0.015,0.03]", "fit_fabricslide.false_alarm=2"),
        r"fit_fabricslide\.false_alarm is 2: give a number between 0 and 1",
    ),
}


@pytest.mark.parametrize(
    ("arguments", "sentence"), quick(REFUSALS.values(), next(iter(REFUSALS.values()))), ids=REFUSALS
)
def test_refusals_are_one_sentence(folder, capsys, arguments, sentence):
    path = written(folder / "good.csv", *scan(3, 0.0201))
    given = [f"feature.pitch_range_m={arguments[0]}", *arguments[1:]] if arguments else []
    run = folder / "run"
    assert command(run, "experiment=fit_fabricslide", f"recording.path={path}", *given) == 2
    assert re.search(sentence, capsys.readouterr().err)
    assert not run.exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [(7.0, r"channel3 is constant \(7\)"), (np.nan, "channel3 has missing samples")],
)
def test_channel_that_tells_nothing_is_refused(folder, change, sentence):
    x_m, channels = scan(3, 0.0201)
    channels[2, 0 if np.isnan(change) else slice(None)] = change
    path = written(folder / "bad.csv", x_m, channels)
    with pytest.raises(BadInput, match=sentence):
        job(path, "recording.missing=allow")


@pytest.mark.full
def test_lost_rows_are_filled_where_they_are_few(folder):
    """Two in ten of the rows gone: the same pitch; a gap of a pitch is refused."""
    x_m, channels = scan(3, 0.0201)
    whole = job(written(folder / "whole.csv", x_m, channels)).metrics
    observed = np.ones(x_m.size, bool)
    observed[3:-3:5] = observed[4:-3:10] = False
    path = folder / "lost.csv"
    save(
        Recording(channels[:, observed], x_m[observed] / SPEED, np.full(observed.sum(), SPEED),
                  CHANNELS, {}, "counts"),
        path,
    )  # fmt: skip
    result = job(path)
    assert result.metrics["quality"] == "good"
    error = result.metrics["pitch_m"] - whole["pitch_m"]
    assert abs(error) < 0.5 * whole["pitch_m_stderr"]
    assert result.dataset.attrs["rows_missing"] == np.sum(~observed)
    observed[60:90] = False
    save(
        Recording(channels[:, observed], x_m[observed] / SPEED, np.full(observed.sum(), SPEED),
                  CHANNELS, {}, "counts"),
        path,
    )  # fmt: skip
    with pytest.raises(BadInput, match=r"no channel has samples from .* cut the recording there"):
        job(path)
