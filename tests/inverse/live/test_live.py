"""Live inversion of samples: bands that hold whatever the motion, the noise and the chunks."""

import io

import numpy as np
import pytest

from srsinv import Film, LineProblem, Live, LiveCells, Open, Sensor, Tikhonov, Wiener
from srsinv.forward.amplifier import ChargeReadout, IntegratedCurrent
from srsinv.forward.filter import FirstOrder
from srsinv.forward.scan import ConstantSpeed
from srsinv.inverse.tikhonov import DerivativePenalty
from srsinv.inverse.wiener import Exponential, SpectralPrior
from tests.inverse.live.scans import (
    CELL_M,
    CORRELATION_M,
    DEPTH_M,
    RATE_HZ,
    RMS_PA,
    SPEED_M_PER_S,
    drawn,
    live,
    paced,
    prior,
    recorded,
    run,
    steady,
    volts,
    world,
)
from tests.refusals import refused
from tests.tiers import quick

SETTLED = slice(48, -40)  # cells with a settled noise level, and a full lag
MOTIONS = {
    "steady": steady,
    "wavy": lambda: paced(lambda t: 1 + 0.3 * np.sin(2 * np.pi * t / 0.13)),
    "stop_and_go": lambda: paced(
        lambda t: np.clip(0.5 + 1.2 * np.sin(2 * np.pi * (t / 0.4 + 0.25)), 0, 1)
    ),
}


def with_gaps(rng, signal):
    signal[:, rng.random(signal.shape[1]) < 0.03] = np.nan
    for start in rng.integers(500, signal.shape[1] - 500, 12):
        signal[:, start : start + 50] = np.nan


@pytest.mark.parametrize("case", quick([*MOTIONS, "gaps", "rows"], "wavy", "gaps"))
def test_errors_are_as_large_as_the_bands_say(case):
    """Of scans drawn from the prior, the errors over the standard errors have an rms of 1, at 40 dB
    with an adaptive noise level; with missing samples and missing rows too."""
    rng, scores = np.random.default_rng(3), []
    time_s, x_m, speed = MOTIONS.get(case, steady)()
    for _ in range(8):
        own = drawn(rng)
        signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
        here = np.ones(x_m.size, bool)
        if case == "gaps":
            with_gaps(rng, signal)
        if case == "rows":
            here = rng.random(x_m.size) > 0.03
            for start in rng.integers(500, x_m.size - 500, 12):
                here[start : start + 50] = False
        cells = run(live(), time_s[here], x_m[here], signal[:, here])
        scores.append(own.scores(cells)[:, SETTLED])
    scores = np.concatenate(scores, axis=1)
    # Some 8 x 60 independent errors of each component: 3 % is one standard error.
    assert np.sqrt(np.mean(scores**2, axis=1)) == pytest.approx([1, 1], abs=0.12)
    assert np.mean(np.abs(scores) < 1.645) == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("spacing", quick([0.5, 0.9, 1.7], 1.7))
def test_samples_farther_apart_than_cells(spacing):
    """Without waves of noise alone the level comes from innovations, and bands hold."""
    rng, scores = np.random.default_rng(4), []
    x_m = np.arange(1e-5, 0.03, spacing * CELL_M)
    for _ in range(8):
        own = drawn(rng)
        signal = recorded(rng, own, x_m, SPEED_M_PER_S, 1e-2 * volts(own))
        cells = run(live(), x_m / SPEED_M_PER_S, x_m, signal)
        scores.append(own.scores(cells)[:, SETTLED])
    rms = np.sqrt(np.mean(np.concatenate(scores, axis=1) ** 2, axis=1))
    assert rms == pytest.approx([1, 1], abs=0.15)


@pytest.mark.parametrize("louder", [True, False])
def test_noise_level_follows_a_step_of_20_dB(louder):
    """Within 1 dB five depths after it in the mean over scans and elements, and bands that hold
    around it."""
    rng, levels, scores = np.random.default_rng(5), [], []
    time_s, x_m, speed = steady()
    for _ in range(6):
        own = drawn(rng)
        quiet = 1e-3 * volts(own)
        noise = np.where((x_m > 0.015) == louder, 10 * quiet, quiet)
        cells = run(live(), time_s, x_m, recorded(rng, own, x_m, speed, noise))
        after = int(np.argmin(np.abs(cells.x_m - 0.015 - 5 * DEPTH_M)))
        levels.append(20 * np.log10(cells.noise[:, after] / quiet))
        near = np.abs(cells.x_m - 0.015) < 3 * DEPTH_M
        scores.append(own.scores(cells)[:, near])
    assert np.mean(levels) == pytest.approx(20 if louder else 0, abs=0.5)
    assert np.abs(np.array(levels) - (20 if louder else 0)).max() < 2
    assert np.mean(np.abs(scores) < 1.645) > 0.84


def test_a_level_settles_and_says_so():
    rng = np.random.default_rng(6)
    own, (time_s, x_m, speed) = drawn(rng), steady()
    cells = run(live(), time_s, x_m, recorded(rng, own, x_m, speed, 1e-2 * volts(own)))
    assert cells.is_settling[:16].all()
    assert not cells.is_settling[40:].any()
    assert not run(live(1e-7), time_s, x_m, own.field(x_m)).is_settling.any()


def test_chunks_and_a_stored_state_change_nothing():
    """Samples one by one, and a state that went through a file after each hundred."""
    rng = np.random.default_rng(7)
    own, (time_s, x_m, speed) = drawn(rng, 0.012), steady(0.012)
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    whole = run(live(), time_s, x_m, signal)
    single = live()
    each = [single.push(t, x, v) for t, x, v in zip(time_s, x_m, signal.T, strict=True)]
    stored, parts = live(), []
    for i in range(0, time_s.size, 100):
        rows = slice(i, i + 100)
        parts.append(stored.push(time_s[rows], x_m[rows], signal[:, rows]))
        file = io.BytesIO()
        np.savez(file, **stored.state())
        file.seek(0)
        stored = Live.from_state(np.load(file, allow_pickle=False))
    for cells in (
        LiveCells.joined([*each, single.finish()]),
        LiveCells.joined([*parts, stored.finish()]),
    ):
        assert cells.n == whole.n > 100
        for one, other in zip(cells, whole, strict=True):
            assert np.allclose(one, other, rtol=1e-9, atol=0)


def test_memory_does_not_grow():
    """The state is as large after some scans as after one, over each of which a stop counts."""
    rng, inversion, sizes = np.random.default_rng(8), live(), []
    own, (time_s, x_m, speed) = drawn(rng, 0.006), steady(0.006)
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    for i in range(4):
        at_s = 10.0 * i
        inversion.push(at_s + time_s, x_m + 0.006 * i, signal)
        still = at_s + time_s[-1] + np.arange(1, 20_000) / RATE_HZ
        inversion.push(still, np.full(still.size, x_m[-1] + 0.006 * i), np.zeros((2, still.size)))
        arrays = inversion.state()
        sizes.append(sum(each.nbytes for name, each in arrays.items() if "stream" not in name))
        assert arrays["stream.tail"].shape[1] < 400
    assert len(set(sizes)) == 1


def test_a_turn_starts_a_pass_and_a_mirrored_scan_has_mirrored_answers():
    """x and q change their signs together; the signal of u dQ/dx does not."""
    rng = np.random.default_rng(9)
    own, (time_s, x_m, speed) = drawn(rng, 0.012), steady(0.012)
    noise = 1e-2 * volts(own)
    signal = recorded(rng, own, x_m, speed, noise)
    one, other = run(live(noise), time_s, x_m, signal), run(live(noise), time_s, -x_m, signal)
    assert np.allclose(other.x_m, -one.x_m)
    # The model has this symmetry of the physics as far as it is exact.
    assert np.abs((other.p_Pa - one.p_Pa) / one.p_stderr_Pa).max() < 0.02
    assert np.abs((other.q_Pa + one.q_Pa) / one.q_stderr_Pa).max() < 0.02
    # There and back.
    back = recorded(rng, own, x_m[::-1], -speed, noise)
    both = run(live(noise), np.arange(2 * x_m.size) / RATE_HZ, np.append(x_m, x_m[::-1]),
               np.concatenate([signal, back], axis=1))  # fmt: skip
    first, second = both.pass_number == 0, both.pass_number == 1
    unfinished = slice(-40)  # cells that the last samples, which have no neighbours, tell apart
    assert np.allclose(both.p_Pa[first][unfinished], one.p_Pa[unfinished])
    assert np.all(np.diff(both.x_m[second]) < 0)
    scores = own.scores(both)[:, second][:, SETTLED]
    assert np.sqrt(np.mean(scores**2)) == pytest.approx(1, abs=0.3)


def test_jitter_at_a_stop_is_no_turn():
    rng = np.random.default_rng(10)
    own = drawn(rng, 0.012)
    time_s, x_m, speed = paced(lambda t: np.where(np.abs(t - 0.1) < 0.05, 0.0, 1.0), 0.012)
    jitter = x_m + 2e-6 * rng.normal(size=x_m.size)
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    inversion = live()
    cells = LiveCells.joined([inversion.push(time_s, jitter, signal, speed), inversion.finish()])
    assert set(cells.pass_number) == {0}
    assert np.sqrt(np.mean(own.scores(cells) ** 2)) < 1.5


def test_one_element_with_friction():
    """q = mu p, with the sign of the motion, on what the nominal pressure is known to be."""
    rng, mu, nominal_Pa = np.random.default_rng(11), 0.4, 5e3
    sensor = Sensor([Film().with_strip_average()])
    inversion = Live(
        sensor, prior(), lag_m=2 * DEPTH_M, friction=mu, nominal_pressure_Pa=nominal_Pa
    )
    both = drawn(rng, 0.02)
    for is_onwards, inverted in ((True, inversion), (False, Live.from_state(inversion.state()))):
        shear = (mu if is_onwards else -mu) * both.traction[0]
        own = world(np.stack([both.traction[0], shear]), sensor=sensor)
        time_s, x_m, speed = steady(0.02)
        x_m, speed = (x_m, speed) if is_onwards else (x_m[::-1], -speed)
        cells = run(inverted, time_s, x_m, recorded(rng, own, x_m, speed, 1e-2 * volts(own)))
        assert np.allclose(cells.q_Pa, (mu if is_onwards else -mu) * cells.p_Pa)
        own_p = np.interp(cells.x_m, own.x_m, own.traction[0]) + nominal_Pa
        score = (cells.p_Pa - own_p)[SETTLED] / cells.p_stderr_Pa[SETTLED]
        assert 0.5 < np.sqrt(np.mean(score**2)) < 1.5


def test_mains_and_drift_are_estimated_jointly():
    """Hum as large as the signal, 0.02 Hz beside its nominal frequency, and a drift: bands hold
    where they are named, and do not where they are not."""
    rng, rms = np.random.default_rng(12), {}
    time_s, x_m, speed = steady()
    for named in (True, False):
        known = {"mains_Hz": [50.0], "drift": 2e-6} if named else {}
        inversion = Live(Sensor(), prior(), lag_m=4 * DEPTH_M, **known)
        scores = []
        for _ in range(4):
            own = drawn(rng)
            size = volts(own)
            hum = size * np.cos(2 * np.pi * 50.02 * time_s + np.array([[0.3], [2.0]]))
            drift = 2e-6 * np.cumsum(rng.normal(size=(2, x_m.size)), axis=1) / np.sqrt(RATE_HZ)
            signal = recorded(rng, own, x_m, speed, 1e-2 * size) + hum + drift
            cells = run(Live.from_state(inversion.state()), time_s, x_m, signal)
            scores.append(own.scores(cells)[:, SETTLED])
        rms[named] = np.sqrt(np.mean(np.square(scores)))
    assert rms[True] == pytest.approx(1, abs=0.15)
    assert rms[False] > 1.5


def test_a_drift_goes_on_between_passes():
    """After a pause the offset may be anything that the drift allows; hum has another phase."""
    rng, scores = np.random.default_rng(17), []
    inversion = Live(Sensor(), prior(), lag_m=4 * DEPTH_M, drift=2e-6, mains_Hz=[50.0])
    time_s, x_m, speed = steady(0.02)
    for i in range(3):
        own = drawn(rng, 0.02)
        hum = volts(own) * np.cos(2 * np.pi * 50 * time_s + 2.0 * i)
        offset = 2e-6 * np.sqrt(1000.0) * i * rng.choice([-1, 1], size=(2, 1))
        signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own)) + hum + offset
        cells = run(inversion, 1000.0 * i + time_s, x_m, signal)
        scores.append(own.scores(cells)[:, SETTLED])
        assert set(cells.pass_number) == {i}
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1, abs=0.2)


def test_a_charge_readout_with_an_unknown_offset():
    rng, scores = np.random.default_rng(13), []
    amplifier = ChargeReadout(1e9)
    inversion = Live(Sensor(amplifier=amplifier), prior(), lag_m=4 * DEPTH_M)
    time_s, x_m, _ = steady()
    for _ in range(4):
        own = drawn(rng)
        integral = own.field.antiderivative()
        clean = 1e9 * (integral(x_m) - integral(own.x_m[:1]))
        noise = 1e-2 * np.std(clean)
        signal = clean + 5.0 * noise + noise * rng.normal(size=clean.shape)
        cells = run(Live.from_state(inversion.state()), time_s, x_m, signal)
        scores.append(own.scores(cells)[:, SETTLED])
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1, abs=0.2)


def test_filters_act_at_a_stated_speed():
    """A first-order filter moves the signal by its time constant times the speed."""
    rng, delay_s = np.random.default_rng(14), 8e-3
    filtered = Sensor(filters=[FirstOrder(delay_s)])
    refused(lambda: Live(filtered, prior(), lag_m=0.0), "speed_m_per_s")
    inversion = Live(filtered, prior(), lag_m=4 * DEPTH_M, speed_m_per_s=SPEED_M_PER_S)
    time_s, x_m, speed = steady()
    own = drawn(rng)
    noise = 1e-2 * volts(own)
    decay = np.exp(-1 / (RATE_HZ * delay_s))
    clean = recorded(rng, own, x_m, speed, 0.0)
    lagged = clean.copy()
    for i in range(1, x_m.size):
        lagged[:, i] = decay * lagged[:, i - 1] + (1 - decay) * clean[:, i]
    signal = lagged + noise * rng.normal(size=lagged.shape)
    rms = [
        np.sqrt(np.mean(own.scores(run(each, time_s, x_m, signal))[:, SETTLED] ** 2))
        for each in (inversion, live())
    ]
    assert rms[0] < 1.25 < rms[1]


def test_prior_that_tikhonov_chose_on_an_earlier_recording():
    """The weights of another cell width give the same live answer as of its own."""
    rng, answers = np.random.default_rng(15), []
    time_s, x_m, speed = steady(0.012)
    own = drawn(rng, 0.012)
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    for times in (1, 2):
        cell_m = times * CELL_M
        line = Open(round(0.03 / cell_m), cell_m, 0.0)
        sensor, scan = Sensor(), ConstantSpeed(SPEED_M_PER_S)
        r = np.repeat(own.traction[:, : line.n * times].reshape(2, line.n, times).mean(axis=2), 1)
        data = np.asarray(sensor.operator(line, scan)(r.reshape(2, line.n)))
        data = data + 1e-2 * np.std(data) * rng.normal(size=data.shape)
        problem = LineProblem.of_sensor(
            line, sensor, scan, data, np.full(line.k.size, (1e-2 * np.std(data)) ** 2)
        )
        method = Tikhonov(weight_p=1e-5 * times, weight_q=1e-5 * times)
        chosen = method.prior_fixed_on(problem)
        inversion = Live(sensor, chosen, lag_m=4 * DEPTH_M, memory_m=32 * DEPTH_M)
        answers.append(run(inversion, time_s, x_m, signal))
    assert np.allclose(answers[0].p_Pa, answers[1].p_Pa, atol=1e-6 * answers[0].p_stderr_Pa.max())


def test_a_spectrum_and_a_penalty_are_priors():
    """As the methods with them, at the same cell width."""
    made = [
        [Live(Sensor(), each, lag_m=0.0, memory_m=16 * DEPTH_M).state() for each in pair]
        for pair in (
            (Exponential(RMS_PA, CORRELATION_M), prior()),
            (DerivativePenalty(np.full(2, 1e-6), np.array(0.75e-3), 1), Tikhonov(1, 1e-6, 1e-6)),
        )
    ]
    for one, other in made:
        assert np.allclose(one["onwards.matrix"], other["onwards.matrix"], atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"lag_m": -1.0}, ["lag_m", "-1.0"]),
        ({"cell_m": 1.0}, ["cell_m"]),
        ({"memory_m": 1e-4}, ["memory_m"]),
        ({"noise": "automatic"}, ["noise", "adaptive"]),
        ({"noise": [1.0, 2.0, 3.0]}, ["noise", "2 elements"]),
        ({"noise": 0.0}, ["noise", "above 0"]),
        ({"drift": -1.0}, ["drift"]),
        ({"mains_Hz": [0.0]}, ["mains_Hz"]),
        ({"friction": np.inf}, ["friction"]),
        ({"sensor": Sensor([Film()])}, ["friction", "element"]),
        ({"sensor": Sensor(amplifier=IntegratedCurrent())}, ["integrated"]),
        ({"prior": 3}, ["prior", "Wiener()"]),
        ({"prior": SpectralPrior(np.ones((2, 65)))}, ["prior", "line"]),
        ({"prior": Tikhonov()}, ["Tikhonov", "prior_fixed_on"]),
        ({"prior": Wiener(scale="evidence")}, ["Wiener", "prior_fixed_on"]),
    ],
)
def test_settings_that_cannot_be(settings, words):
    given = {"sensor": Sensor(), "prior": prior(), "lag_m": 0.0} | settings
    refused(lambda: Live(given.pop("sensor"), given.pop("prior"), **given), *words)


def test_samples_that_cannot_be_leave_everything_as_it_was():
    rng, inversion = np.random.default_rng(16), live()
    own, (time_s, x_m, speed) = drawn(rng, 0.012), steady(0.012)
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    first = inversion.push(time_s[:1000], x_m[:1000], signal[:, :1000])
    for bad, word in (
        ((time_s[1000:], x_m[999:], signal[:, 1000:]), "shapes"),
        ((time_s[999:1100], x_m[999:1100], signal[:, 999:1100]), "time_s"),
        ((time_s[1000:], np.full(x_m.size - 1000, np.nan), signal[:, 1000:]), "finite"),
        ((time_s[1000:], x_m[1000:] + 1e12, signal[:, 1000:]), "large"),
        ((time_s[1000:], x_m[1000:], signal[:, 1000:] + np.inf), "finite"),
    ):
        refused(lambda bad=bad: inversion.push(*bad), word)
    rest = inversion.push(time_s[1000:], x_m[1000:], signal[:, 1000:])
    cells = LiveCells.joined([first, rest, inversion.finish()])
    assert np.allclose(cells.p_Pa, run(live(), time_s, x_m, signal).p_Pa)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"version": np.array(2)}, "version"),
        ({"smoother.mean": None}, "smoother.mean"),
        ({"record.cells": np.zeros((3, 4))}, "record.cells"),
        ({"level.variance": np.array(["a", "b"])}, "level.variance"),
        ({"settings.cell_m": np.array(1e-9)}, "shape"),
        ({"track.direction": np.zeros(2)}, "track.direction"),
    ],
)
def test_what_is_no_state(change, word):
    state = live().state() | change
    refused(lambda: Live.from_state({k: v for k, v in state.items() if v is not None}), word)


def test_a_standstill_and_nothing_at_all():
    inversion = live()
    none = np.zeros(0)
    assert inversion.push(none, none, np.zeros((2, 0))).n == 0
    still = inversion.push(np.arange(1000) / RATE_HZ, np.zeros(1000), np.zeros((2, 1000)))
    assert still.n == inversion.finish().n == 0
