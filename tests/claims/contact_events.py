"""Contact events: false alarms as stated, detection against them, delay, and confusion of kinds
(half an hour).

Noise alone is 2000 s long for the threshold, and 400 s for matched filters. Episodes have random
fingers, loads, frictions, edges and durations (contact_scenes.py), in the noise of the amplifier or
a multiple of it. The rows of `roc` have single events of these episodes, scaled to a strength d'.
"""

from collections import Counter
from functools import cache

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from srsinv.forward.episode import KINDS_OF_EVENT
from srsinv.inverse.events.bank import TemplateBank
from srsinv.inverse.events.matched import DetectedEvent, EventDetector
from srsinv.inverse.events.threshold import ThresholdDetector, detection_by_threshold, threshold
from srsinv.inverse.events.whitening import StreamWhitener
from srsinv.jobs.trials import Row
from tests.claims.contact_scenes import (
    JOHNSON_V,
    RATE_HZ,
    DrawnEpisode,
    detector,
    drawn,
    templates,
)
from tests.claims.study import Study

BLOCK = 50_000  # samples of noise: 10 s
SLIDING_V, KEEP = 1e-5, np.exp(-1 / 15)  # noise of sliding, correlated over 15 samples
EPISODES, STATED_PER_S = 200, 0.1
STRENGTHS = (3, 4, 5, 6, 8)
FALSE_ALARMS_PER_S = (1e-3, 1e-2, 0.1, 1.0, 10.0)
LONGEST = 2500  # samples of an event, at most
LATE_S = 5e-3  # after an event's end, that its detection may begin
KINDS = {name.replace(" ", "_"): name for name in KINDS_OF_EVENT}


def whitener(noise: str) -> StreamWhitener:
    """That of noise of this name."""
    if noise == "white":
        return StreamWhitener.white([JOHNSON_V] * 2)
    lags = SLIDING_V**2 * KEEP ** np.arange(33) + JOHNSON_V**2 * (np.arange(33) == 0)
    return StreamWhitener.of_covariance(np.stack([lags] * 2))


def blocks(noise: str, seconds: int):
    """Noise of this name, block by block."""
    rng, state = np.random.default_rng(11), np.zeros((2, 1))
    for _ in range(int(seconds * RATE_HZ) // BLOCK):
        signal = JOHNSON_V * rng.standard_normal((2, BLOCK))
        if noise == "coloured":
            drive = SLIDING_V * np.sqrt(1 - KEEP**2) * rng.standard_normal((2, BLOCK))
            slow, state = lfilter([1.0], [1.0, -KEEP], drive, zi=state)
            signal = signal + slow
        yield signal


def rate_with_interval(name: str, count: int, seconds: float) -> Row:
    """The rate [1/s] and its 95 % interval, as of independent counts."""
    half = 1.96 * np.sqrt(count + 1)
    return {
        f"{name}_per_s": count / seconds,
        f"{name}_low_per_s": max(count - half, 0) / seconds,
        f"{name}_high_per_s": (count + half) / seconds,
    }


def of_threshold(noise: str, stated_per_s: float) -> Row:
    """Alarms of the threshold in noise alone."""
    detector, seconds = ThresholdDetector(whitener(noise), RATE_HZ, stated_per_s), 2000
    alarms = sum(len(detector.push(signal)) for signal in blocks(noise, seconds))
    return rate_with_interval("alarms", alarms, seconds)


def of_matched(noise: str, stated_per_s: float) -> Row:
    """Alarms of matched filters in noise alone, and the events that are reported. The interval of
    the alarms is by blocks of 10 s, as they come in clusters."""
    of_noise, seconds = whitener(noise), 400
    matched = EventDetector(templates(), of_noise, RATE_HZ, stated_per_s)
    before, rest = np.zeros((2, of_noise.order)), np.zeros((2, matched.bank.longest))
    crossings, events = [], 0
    for signal in blocks(noise, seconds):
        events += len(matched.push(signal))
        rest = np.concatenate([rest[:, -matched.bank.longest :], of_noise(signal, before)], -1)
        before = signal[:, signal.shape[-1] - of_noise.order :]
        above = matched.bank(rest).max(0) >= matched.limit
        crossings.append(int(np.sum(above[1:] & ~above[:-1])))
    half = 1.96 * np.std(crossings, ddof=1) * np.sqrt(len(crossings))
    total = sum(crossings)
    return {
        "alarms_per_s": total / seconds,
        "alarms_low_per_s": (total - half) / seconds,
        "alarms_high_per_s": (total + half) / seconds,
        **rate_with_interval("events", events, seconds),
    }


@cache
def episode(seed: int) -> DrawnEpisode:
    """One of the episodes, the same for all rows."""
    return drawn(seed)


def matches(events: list[DetectedEvent], own: DrawnEpisode) -> tuple[dict, list[DetectedEvent]]:
    """The event found for each kind, of those that overlap the true one the strongest of its kind
    or else of any, and the events that are left."""
    left, pairs = list(events), {}
    for kind, onset in own.onsets_s.items():
        until = own.ends_s[kind] + LATE_S
        near = [e for e in left if e.onset_s <= until and e.onset_s + e.duration_s >= onset]
        best = [e for e in near if e.kind == kind] or near
        if best:
            pairs[kind] = max(best, key=lambda event: event.strength)
            left = [each for each in left if each is not pairs[kind]]
    return pairs, left


def of_episodes(elements: int, noise_factor: float) -> Row:
    """What the detectors report of each kind of event, over all episodes."""
    noise_V = noise_factor * JOHNSON_V
    found, simple_found = Counter(), Counter()
    delays, simple_delays, errors = ({kind: [] for kind in KINDS.values()} for _ in range(3))
    extra = 0
    for seed in range(EPISODES):
        own = episode(seed)
        rng = np.random.default_rng([12, seed])
        signal = own.signal[:elements] + noise_V * rng.standard_normal(own.signal.shape)[:elements]
        matched = detector(STATED_PER_S, elements, noise_V)
        matched.restart()
        pairs, left = matches([*matched.push(signal), *matched.finish()], own)
        extra += len(left)
        alarms = ThresholdDetector(
            StreamWhitener.white([noise_V] * elements), RATE_HZ, STATED_PER_S
        ).push(signal)
        for kind, onset in own.onsets_s.items():
            times = [a.time_s for a in alarms if onset <= a.time_s <= own.ends_s[kind]]
            simple_found[kind] += bool(times)
            simple_delays[kind] += [times[0] - onset] if times else []
            if kind in pairs:
                event = pairs[kind]
                found[kind, event.answer if event.answer in (kind, "unsure") else "wrong"] += 1
                delays[kind].append(event.alarm_s - onset)
                errors[kind].append(event.onset_s - onset)
    row: Row = {"extra_per_episode": extra / EPISODES}
    for name, kind in KINDS.items():
        counts = {each: found[kind, each] for each in (kind, "unsure", "wrong")}
        row |= {
            f"{name}_detected": sum(counts.values()) / EPISODES,
            f"{name}_correct": counts[kind] / EPISODES,
            f"{name}_unsure": counts["unsure"] / EPISODES,
            f"{name}_wrong": counts["wrong"] / EPISODES,
            f"{name}_delay_s": _quantile(delays[kind], 0.5),
            f"{name}_delay_90_s": _quantile(delays[kind], 0.9),
            f"{name}_onset_error_s": _quantile(np.abs(errors[kind]), 0.5),
            f"{name}_threshold_detected": simple_found[kind] / EPISODES,
            f"{name}_threshold_delay_s": _quantile(simple_delays[kind], 0.5),
        }
    return row


def _quantile(values, part: float) -> float:
    return float(np.quantile(values, part)) if len(values) else float("nan")


@cache
def bank() -> TemplateBank:
    """Templates in white noise."""
    return TemplateBank(templates(), whitener("white"))


@cache
def limits() -> list[float]:
    """The matched filters' limits at each rate of false alarms."""
    return [bank().limit(rate / RATE_HZ) for rate in FALSE_ALARMS_PER_S]


@cache
def noise_statistics(seed: int) -> np.ndarray:
    """Statistics of noise alone over half a second."""
    shape = 2, bank().longest - 1 + LONGEST
    return bank()(np.random.default_rng([13, seed]).standard_normal(shape))


def of_roc(event: str) -> Row:
    """Probability of detection at each rate of false alarms, of events that differ from their
    templates, scaled to each d'. The templates capture the part `captured` of it in the median."""
    kind, greatest, simple, captured = KINDS[event], [], [], []
    for seed in range(EPISODES):
        own = episode(seed)
        ends = own.onsets_s[kind] * RATE_HZ, (own.ends_s[kind] + LATE_S) * RATE_HZ
        part = own.signal[:, int(ends[0]) : int(ends[1])]
        part = part / np.linalg.norm(part)
        statistics = bank()(np.pad(part, ((0, 0), (bank().longest - 1, 0))))
        noise = noise_statistics(seed)[:, : part.shape[-1]]
        greatest.append([(noise + strength * statistics).max() for strength in STRENGTHS])
        captured.append(statistics.max())
        simple.append([
            [detection_by_threshold(strength * part, threshold(2, rate / RATE_HZ))
             for rate in FALSE_ALARMS_PER_S]
            for strength in STRENGTHS
        ])  # fmt: skip
    matched = np.array([np.mean(np.array(greatest) >= limit, axis=0) for limit in limits()]).T
    thresholds = np.mean(simple, axis=0)
    return {"captured": float(np.median(captured))} | {
        f"{name}_at_{strength}": values[i].tolist()
        for name, values in (("matched", matched), ("threshold", thresholds))
        for i, strength in enumerate(STRENGTHS)
    }


def of_full_slip() -> Row:
    """The strength of full slip, and the part of the episodes in which a filter of its very shape
    detects it, with all else subtracted exactly: wherever it may be, and at the known time, with
    the chance of a false alarm that is stated for the whole slip.

    `when_steady`: the part in which full slip is reported where friction does not fall.
    """
    shape = next(each for each in templates() if each.kind == KINDS["full_slip"])
    limit = TemplateBank([shape], whitener("white")).limit(STATED_PER_S / RATE_HZ)
    strengths, lasting_s, reported = [], [], 0
    matched = detector(STATED_PER_S)
    for seed in range(EPISODES):
        own, kind = episode(seed), KINDS["full_slip"]
        begin, end = (int(each[kind] * RATE_HZ) for each in (own.onsets_s, own.ends_s))
        strengths.append(np.linalg.norm(own.signal[:, begin:end]) / JOHNSON_V)
        lasting_s.append(own.onsets_s[kind] - own.onsets_s[KINDS["incipient_slip"]])
        steady = drawn(seed, falls=False)
        noise = JOHNSON_V * np.random.default_rng([12, seed]).standard_normal(own.signal.shape)
        matched.restart()
        found = [*matched.push(steady.signal + noise), *matched.finish()]
        reported += any(event.kind == kind for event in found)
    strength, known = np.array(strengths), norm.isf(STATED_PER_S * np.array(lasting_s))
    return {
        "strength": float(np.median(strength)),
        "bound_at_any_time": float(np.mean(norm.sf(limit - strength))),
        "bound_at_known_time": float(np.mean(norm.sf(known - strength))),
        "when_steady": reported / EPISODES,
    }


MEASURES = {
    "threshold_alarms": of_threshold,
    "matched_alarms": of_matched,
    "episodes": of_episodes,
    "roc": of_roc,
    "full_slip": of_full_slip,
}


def measured(what: str, **settings) -> Row:
    """One case."""
    return MEASURES[what](**settings)


def cases() -> list[dict]:
    """Every case, by its labels."""
    return [
        *({"what": "threshold_alarms", "noise": noise, "stated_per_s": 1.0}
          for noise in ("white", "coloured")),
        *({"what": "roc", "event": event} for event in KINDS),
        {"what": "full_slip"},
        *({"what": "episodes", "elements": elements, "noise_factor": factor}
          for elements, factor in ((2, 1.0), (1, 1.0), (2, 3.0))),
        *({"what": "matched_alarms", "noise": noise, "stated_per_s": 2.0}
          for noise in ("white", "coloured")),
    ]  # fmt: skip


STUDY = Study("contact_events", measured, cases)
