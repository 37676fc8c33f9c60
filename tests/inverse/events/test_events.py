"""Detectors of events: rates of false alarms against counting, and events that are known."""

import numpy as np
import pytest
import scipy

from srsinv.forward.episode import Episode, Ramp, RecordedEpisode
from srsinv.forward.partial_slip import CylinderContact
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import StepUp
from srsinv.inverse.events.bank import TemplateBank
from srsinv.inverse.events.matched import EventDetector
from srsinv.inverse.events.templates import EventTemplate, event_templates
from srsinv.inverse.events.threshold import ThresholdDetector, detection_by_threshold
from srsinv.inverse.events.whitening import StreamWhitener, as_samples
from tests.refusals import refused
from tests.tiers import quick

RATE = 5000.0
RMS = 6.4e-6
SLIDING, KEEP = 1e-5, np.exp(-1 / 15)
WHITE = StreamWhitener.white([RMS, 2 * RMS])


def white(rng, n, elements=2):
    return RMS * np.arange(1, elements + 1)[:, None] * rng.standard_normal((elements, n))


def coloured(rng, n):
    """White noise, and noise correlated as exp(-lag/15)."""
    drive = SLIDING * np.sqrt(1 - KEEP**2) * rng.standard_normal((2, n + 500))
    slow = scipy.signal.lfilter([1.0], [1.0, -KEEP], drive)[:, 500:]
    return slow + white(rng, n)


def of_coloured():
    slow, first = SLIDING**2 * KEEP ** np.arange(33), RMS**2 * (np.arange(33) == 0)
    return StreamWhitener.of_covariance(np.stack([slow + first, slow + 4 * first]))


def shapes():
    """A step that decays, a ramp, and a wave, of two elements."""
    t = np.arange(60)
    rows = {
        "step": np.exp(-t / 20),
        "ramp": t / 60,
        "wave": np.sin(2 * np.pi * t / 40),
    }
    gains = {"step": (1.0, 0.2), "ramp": (1.0, -0.5), "wave": (0.4, 1.0)}
    return [
        EventTemplate(kind, 60 / RATE, RMS * np.outer(gains[kind], row))
        for kind, row in rows.items()
    ]


@pytest.mark.parametrize("elements", [1, 2])
def test_a_threshold_has_as_many_false_alarms_as_stated_in_white_noise(elements):
    """Within four standard deviations of their number."""
    rng, n, stated = np.random.default_rng(1), 400_000, 10.0
    whitener = StreamWhitener.white(RMS * np.arange(1, elements + 1))
    count = len(ThresholdDetector(whitener, RATE, stated).push(white(rng, n, elements)))
    expected = stated * n / RATE
    assert abs(count - expected) < 4 * np.sqrt(expected)


@pytest.mark.parametrize("source", ["covariance", "quiet"])
def test_coloured_noise_is_whitened_first(source):
    rng, n, stated = np.random.default_rng(2), 400_000, 10.0
    noise = coloured(rng, n)
    whitener = (
        of_coloured() if source == "covariance" else StreamWhitener.of_quiet(coloured(rng, 50_000))
    )
    left = whitener(noise)[:, 100:]
    np.testing.assert_allclose(left @ left.T / left.shape[-1], np.eye(2), atol=0.02)
    for lag in (1, 5, 20):
        assert np.abs(np.mean(left[:, lag:] * left[:, :-lag], -1)).max() < 0.01
    expected = stated * n / RATE
    count = len(ThresholdDetector(whitener, RATE, stated).push(noise))
    assert abs(count - expected) < 5 * np.sqrt(expected)


def test_an_alarm_says_when_and_how_often_noise_is_as_large():
    detector = ThresholdDetector(WHITE, RATE, 0.1)
    signal = np.zeros((2, 1000))
    signal[0, 700:710] = 6 * RMS
    alarms = [*detector.push(signal[:, :300]), *detector.push(signal[:, 300:])]
    (alarm,) = alarms
    assert alarm.time_s == pytest.approx(700 / RATE)
    assert alarm.size == pytest.approx(6.0)
    assert alarm.false_alarms_per_s == pytest.approx(RATE * np.exp(-18), rel=1e-6)
    assert detection_by_threshold(WHITE(signal), detector.limit) > 0.999
    assert detection_by_threshold(WHITE(0 * signal), 3.0) == pytest.approx(
        1 - (1 - np.exp(-4.5)) ** 1000, rel=1e-6
    )


@pytest.mark.parametrize("limit", quick([1.5, 2.5], 2.5))
def test_the_rate_of_alarms_is_that_of_counting(limit):
    """Of correlated statistics, in so much noise that clusters of crossings do not matter."""
    bank = TemplateBank(shapes(), WHITE)
    greatest = bank(np.random.default_rng(3).standard_normal((2, 400_000))).max(0)
    above = greatest >= limit
    counted = np.mean(above[1:] & ~above[:-1])
    assert bank.alarms_per_sample(limit) == pytest.approx(counted, rel=0.06)


def test_one_statistic_of_one_sample_has_the_rate_of_white_noise():
    bank = TemplateBank([EventTemplate("tick", 0.0, np.array([[RMS], [0.0]]))], WHITE)
    tail = scipy.stats.norm.sf(3.0)
    assert bank.alarms_per_sample(3.0) == pytest.approx(tail * (1 - tail), rel=1e-3)
    assert bank.limit(1e-5) == pytest.approx(scipy.stats.norm.isf(1e-5), abs=2e-3)


@pytest.fixture(scope="module")
def detector():
    return EventDetector(shapes(), WHITE, RATE, 0.1)


def stream(rng, *events, n=1500):
    """Noise with templates of the given number, first sample and d'."""
    signal = white(rng, n)
    for number, start, strength in events:
        template = shapes()[number].signal
        signal[:, start : start + 60] += strength * template / np.linalg.norm(WHITE(template))
    return signal


def found(detector, signal, block=None):
    detector.restart()
    n = signal.shape[-1]
    blocks = [signal] if block is None else [signal[:, i : i + block] for i in range(0, n, block)]
    return [*(event for each in blocks for event in detector.push(each)), *detector.finish()]


@pytest.mark.parametrize("number", [0, 1, 2])
def test_an_event_is_found_with_its_time_kind_and_strength(detector, number):
    template, offsets = shapes()[number], []
    for seed in range(8):
        signal = stream(np.random.default_rng([4, seed]), (number, 900, 12.0))
        (event,) = found(detector, signal)
        assert (event.kind, event.answer) == (template.kind, template.kind)
        assert event.onset_s == pytest.approx(900 / RATE, abs=6 / RATE)
        assert 900 / RATE <= event.alarm_s < event.reported_s <= 1100 / RATE
        assert event.false_alarm < 1e-6
        assert sum(event.probability.values()) == pytest.approx(1)
        offsets.append(event.strength - 12.0)
        norm = np.linalg.norm(WHITE(template.signal))
        assert event.amplitude == pytest.approx(event.strength / norm)
    assert abs(np.mean(offsets)) < 4 / np.sqrt(8)


@pytest.mark.parametrize("block", quick([1, 137, 700], 137))
def test_blocks_of_any_length_give_the_same_events(detector, block):
    signal = stream(np.random.default_rng(5), (0, 200, 9.0), (2, 330, 15.0), (1, 1430, 14.0))
    signal = signal[:, :1480] if block > 1 else signal[:, 100:600]
    whole, parts = found(detector, signal), found(detector, signal, block)
    assert len(whole) == len(parts) >= 2
    for one, other in zip(whole, parts, strict=True):
        assert one.kind == other.kind
        np.testing.assert_allclose(one[:3], other[:3])
        assert one.strength == pytest.approx(other.strength)


def test_events_that_overlap_are_found_one_after_the_other(detector):
    signal = stream(np.random.default_rng(6), (0, 500, 14.0), (2, 540, 12.0))
    first, second = sorted(found(detector, signal), key=lambda event: event.onset_s)
    assert (first.kind, second.kind) == ("step", "wave")
    assert second.onset_s == pytest.approx(540 / RATE, abs=6 / RATE)


def test_what_a_wrong_template_leaves_of_a_strong_event_is_not_another_one(detector):
    """The step lasts a tenth longer than its template's: the rest has a d' of some 10."""
    signal = white(np.random.default_rng(7), 1500)
    signal[:, 500:560] += 60 * RMS * np.outer((1.0, 0.2), np.exp(-np.arange(60) / 26))
    (event,) = found(detector, signal)
    assert event.answer == "step"
    assert event.strength > 100


def decaying(*samples):
    """Steps that decay over so many samples."""
    rows = [np.outer((1.0, 0.2), np.exp(-np.arange(150) / each)) for each in samples]
    return [EventTemplate("step", 150 / RATE, RMS * row) for row in rows]


def test_an_event_between_its_templates_is_fitted_by_those_near_it():
    """To a fifth of what its own template leaves."""
    bank = TemplateBank(decaying(10, 20, 40), WHITE)
    event = np.pad(WHITE(decaying(28)[0].signal), ((0, 0), (300, 300)))
    event *= 100 / np.linalg.norm(event)
    statistics = bank(event)
    template, at = np.unravel_index(statistics.argmax(), statistics.shape)
    start, fit = bank.fit(event, int(template), int(at) + bank.longest - 1, statistics.max())
    left = event.copy()
    left[:, start : start + fit.shape[-1]] -= fit
    assert np.sum(left**2) < (np.sum(event**2) - statistics.max() ** 2) / 25


@pytest.mark.parametrize("part", quick([0.0, 0.3], 0.3))
def test_full_slip_is_expected_as_incipient_slip_ends(part):
    """Its limit is lower then, and no other time; a part of the noise is correlated."""
    kinds = {"ramp": "incipient slip", "step": "full slip", "wave": "edge"}
    templates = [each._replace(kind=kinds[each.kind]) for each in shapes()]
    slow, first = part**2 * KEEP ** np.arange(33), 1.0 * (np.arange(33) == 0)
    own = RMS**2 * np.stack([slow + first, slow + 4 * first])
    whitener = StreamWhitener.of_covariance(own) if part else WHITE
    detector = EventDetector(templates, whitener, RATE, 0.1)
    low = detector.limits_when_due["full slip"]
    strength = detector.limit - 0.1
    assert low < detector.limit - 0.5

    def kinds_found(*events):
        signal = np.zeros((2, 1500))
        for number, start, size in events:
            padded = np.pad(shapes()[number].signal, ((0, 0), (0, 32)))
            norm = np.linalg.norm(whitener(padded))
            signal[:, start : start + 60] += size * shapes()[number].signal / norm
        return [event.answer for event in found(detector, signal)]

    assert kinds_found((1, 600, 12.0), (0, 660, strength)) == ["incipient slip", "full slip"]
    assert kinds_found((1, 600, 12.0), (0, 690, strength)) == ["incipient slip"]
    assert kinds_found((1, 600, 12.0)) == ["incipient slip"]
    assert kinds_found((0, 660, strength)) == []


def test_two_kinds_of_one_shape_are_not_distinguished():
    alike = [each._replace(kind=kind) for kind, each in zip("ab", shapes()[:1] * 2, strict=True)]
    detector = EventDetector(alike, WHITE, RATE, 0.1)
    (event,) = found(detector, stream(np.random.default_rng(8), (0, 700, 15.0)))
    assert event.answer == "unsure"
    assert event.probability["a"] == pytest.approx(0.5)


@pytest.mark.full
def test_noise_alone_gives_no_more_events_than_stated():
    detector = EventDetector(shapes(), WHITE, RATE, 1.0)
    events = found(detector, white(np.random.default_rng(9), 200_000))
    assert 5 < len(events) < 40 + 4 * np.sqrt(40)
    assert np.median([event.false_alarm for event in events]) > 0.3


def test_what_cannot_be_is_refused():
    refused(lambda: StreamWhitener.white([1.0, 0.0]), "rms")
    refused(lambda: StreamWhitener.of_covariance(np.array([[1.0, 2.0]])), "autocovariance")
    refused(lambda: StreamWhitener.of_quiet(np.zeros((1, 50))), "quiet stretch")
    refused(lambda: WHITE(np.zeros((1, 50))), "shape")
    refused(lambda: WHITE(np.full((2, 50), np.nan)), "finite")
    refused(lambda: ThresholdDetector(WHITE, RATE, 600.0), "false_alarms_per_s", "500")
    refused(lambda: EventDetector([], WHITE, RATE, 0.1), "templates")
    refused(lambda: EventDetector(shapes(), WHITE, RATE, 400.0), "fewer false_alarms_per_s")
    refused(lambda: EventDetector(shapes(), WHITE, RATE, 1e-300), "more false_alarms_per_s")
    refused(lambda: as_samples(np.zeros(5000)), "shape")
    twice = np.repeat(white(np.random.default_rng(10), 2000, 1), 2, axis=0)
    refused(lambda: StreamWhitener.of_quiet(twice), "repeats")
    refused(lambda: ThresholdDetector(WHITE, RATE, 1.0).push(np.zeros((3, 9))), "shape")
    refused(lambda: EventDetector(shapes(), WHITE, RATE, 1.0).push(np.zeros((1, 9))), "shape")
    silent = [EventTemplate("none", 0.1, np.zeros((2, 10)))]
    refused(lambda: EventDetector(silent, WHITE, RATE, 0.1), "no signal")


def test_templates_that_cannot_be_are_refused():
    contact, touch = CylinderContact(0.01, 0.6e-3), Ramp(0.0, 0.05)
    steady = Episode(contact, 20.0, touch, friction=0.5, sliding_friction=0.5)

    def made(*given, own=steady, rate=RATE, **others):
        return lambda: event_templates(own, Sensor(), rate, *given, **others)

    refused(made([0.05], rate=-RATE), "rate_hz")
    refused(made([1e-5]), "shorter than the sampling interval")
    refused(made([], [4e-3]), "sliding_friction")
    refused(made([], edges=[StepUp(1e-5)]), "speeds_m_per_s")
    refused(made([], edges=[StepUp(1e-5)], speeds_m_per_s=[0.0]), "positive speed")


def test_a_template_begins_at_its_onset_and_lasts_to_its_end():
    """Its sum is the whole change of charge, and nothing comes before the first change."""
    touch = Episode(CylinderContact(0.01, 0.6e-3), 20.0, Ramp(0.0, 0.05))
    first, *_, drop = event_templates(touch, Sensor(), RATE, [0.05], [4e-3])
    charge = RecordedEpisode(touch, Sensor()).charge(np.array([0.05]))
    np.testing.assert_allclose(1e-6 * first.signal.sum(1) / RATE, charge[:, 0], rtol=1e-9)
    assert np.abs(drop.signal[:, 0]).max() < 1e-3 * np.abs(drop.signal).max()
